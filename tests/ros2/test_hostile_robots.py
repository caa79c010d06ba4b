"""The ROS 2 driver before robots that do harm: an error that explains itself, or it lives on and can be ended.

HOSTILE_ROBOTS=3000 (``make soak``) meets a hundredth of so many.
"""

import asyncio
import os
from contextlib import suppress
from random import Random
from typing import Any, Final

import pytest
from ros2_rig import free_domain, in_this_process

from client.ros2 import message_packages
from client.ros2.control_side import ControlSide
from client.ros2.driver import DriverOptions, Ros2Driver
from tests.hostile import KINDS, HostileRobot
from urproto.compat_asyncio import timeout
from urproto.errors import URError

pytestmark = pytest.mark.xdist_group("ros2")

ROBOTS: Final = max(4, int(os.environ.get("HOSTILE_ROBOTS", "0")) // 100)
LIVED_S: Final = 1.5
ENDED_S: Final = 60.0
_PORTS: Final = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)


async def _live(host: str, domain: int) -> str:
    """What the driver said when it gave up, "" for one that had to be ended."""
    options = DriverOptions(host, {"silence_s": 0.4, "start_timeout_s": 1.0, **_PORTS}, domain=domain)
    try:
        with suppress(TimeoutError):
            async with timeout(LIVED_S), in_this_process(ControlSide()) as link, Ros2Driver(options, link):
                await asyncio.sleep(LIVED_S)
    except URError as error:
        return str(error)
    return ""


async def test_a_robot_that_does_harm_is_an_error_at_most(caplog: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    message_packages.ensure()  # `make test` has made them
    with HostileRobot() as robot, free_domain() as domain:
        for seed in range(1, ROBOTS + 1):
            random = Random(seed)
            kinds = (random.choice(KINDS), "honest", "honest", random.choice(KINDS))
            robot.begin(kinds if random.random() < 0.5 else kinds[::-1], seed)
            caplog.clear()
            async with timeout(ENDED_S):
                error = await _live(robot.host, domain)
            assert not error or (len(error) >= 20 and "\n" not in error), (
                f"seed {seed}, {kinds}: explains nothing: {error}"
            )
            traces = [
                entry for entry in caplog.records if entry.exc_info and entry.name.startswith(("client", "async"))
            ]
            assert not traces, f"seed {seed}, {kinds}: {traces[0].getMessage()} {traces[0].exc_info}"
