"""A driver and an emulator in the same process, on free ports of the loopback interface; time goes faster than ours."""

import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import pytest

from tests.budget import subset

# driver_rig, and an emulator in a process of its own; importlib mode does not add the folders
sys.path.insert(0, str(Path(__file__).parents[1] / "real_clients"))
sys.path.insert(0, str(Path(__file__).parent))

from driver_rig import HOST, Pair, emulator

from client.commands.control import Target
from emulator.app import Emulator

# Robot seconds in a second: the driver keeps step with the robot, not with the clock on the wall.
SPEED = {"ur3": 3.0, "ur5e": 2.0}


@pytest.fixture(params=subset(["ur3", "ur5e"], now=["ur3"]))
async def robot(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Emulator]:
    """A running emulator: a UR3 of the CB3 series and a UR5e, or what the test is parametrised with.

    "ur5e 5.25.1 dynamic": model, version, and a dynamic arm; the last two may be left out, from the end on.
    """
    model, version, arm = (*str(request.param).split(), "", "")[:3]
    assert arm in ("", "dynamic")
    async with emulator(model, version or None, tmp_path, SPEED[model], dynamic=bool(arm)) as running:
        # Who is late by the clock of a machine that is busy with other things is not the subject.
        monkeypatch.setattr("client.driver.reverse.time", running.clock)
        yield running


@pytest.fixture
def target(robot: Emulator, monkeypatch: pytest.MonkeyPatch) -> Target:
    """What a command of a shell gets as its robot: the running one."""
    monkeypatch.setattr("client.driver.config.ROBOT_PORTS", robot.ports)
    return Target(HOST, 0)


@pytest.fixture
def connect(robot: Emulator) -> Callable[..., AbstractAsyncContextManager[Pair]]:
    """``async with connect() as pair``: a driver of that robot; options are those of DriverConfig."""

    @asynccontextmanager
    async def open_pair(*, start: bool = True, **options: object) -> AsyncIterator[Pair]:
        pair = Pair(robot, **options)
        async with pair.driver:
            if start:
                await pair.driver.start_program()
            yield pair

    return open_pair


@pytest.fixture
async def pair(connect: Callable[..., AbstractAsyncContextManager[Pair]]) -> AsyncIterator[Pair]:
    """A driver whose control program runs."""
    async with connect() as pair:
        yield pair
