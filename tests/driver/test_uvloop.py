"""The client under another event loop than asyncio's own: uvloop, whose transports are of other classes."""

import asyncio
import sys

import pytest

from client import AsyncRobot
from urproto.testing.process import EmulatorProcess

uvloop = pytest.importorskip("uvloop", reason="has no uvloop for this system")

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="wants an address of its own")


async def _turn_base(host: str) -> float:
    async with AsyncRobot(host) as robot:
        assert type(asyncio.get_running_loop()).__module__ == "uvloop"
        target = (0.1, *robot.q[1:])
        await robot.move_j(target)
        return robot.q[0]


@pytest.mark.long
def test_a_robot_moves() -> None:
    with EmulatorProcess(["--model", "ur3", "--running"]) as process:
        assert uvloop.run(_turn_base(process.host)) == pytest.approx(0.1, abs=1e-3)
