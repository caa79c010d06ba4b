"""The helpers of the driver's tests serve here too; importlib mode does not add the folders."""

import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest_asyncio

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))
sys.path.insert(0, str(Path(__file__).parent))
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # every field's type is checked, as always in Humble

from driver_rig import HOME, driver_options, emulator
from ros2_requests import SUCCEEDED, TRIGGER, follow, only, q
from ros2_rig import SCALED, Lab, laboratory


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def laboratory_() -> AsyncIterator[Lab]:
    """A UR5e, its driver and a peer, for all tests of a module."""
    async with emulator("ur5e") as robot, laboratory(robot, driver_options(robot)) as lab:
        yield lab


@pytest_asyncio.fixture(loop_scope="module")
async def lab(laboratory_: Lab) -> Lab:
    """With the scaled controller active and the arm where it was in the beginning."""
    lab = laboratory_
    if not lab.control.driver.program_running:
        assert (await lab.peer.call("/io_and_status_controller/resend_robot_program", TRIGGER))["success"]
    await only(lab, SCALED)
    if max(abs(a - b) for a, b in zip(q(lab), HOME, strict=True)) > 1e-3:
        assert (await follow(lab, SCALED, HOME, 1.0))["status"] == SUCCEEDED
    return lab
