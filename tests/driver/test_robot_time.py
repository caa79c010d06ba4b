"""A robot whose time is not the driver's: setpoints and trajectories follow the robot's clock."""

import pytest
from driver_rig import CALM_S, HOME, Pair, emulator, swing

from client.driver import points
from urproto.external_control import TrajectoryResult


@pytest.mark.parametrize("speed", [0.5, pytest.param(4.0, marks=pytest.mark.long)])
async def test_the_driver_keeps_step_with_a_slower_and_a_faster_robot(speed):
    async with emulator("ur3", speed=speed) as robot:
        pair = Pair(robot)
        async with pair.driver as driver:
            await driver.start_program()
            begin = pair.snapshot.timestamp
            way = [points.movej([HOME[0] + 0.2, *HOME[1:]], duration_s=1.0), points.movej(HOME, duration_s=1.0)]
            assert await driver.execute(way) is TrajectoryResult.SUCCESS
            assert pair.snapshot.timestamp - begin == pytest.approx(2.0, abs=0.3)
            await pair.setpoints(2.0, lambda t: driver.servoj(swing(t), timeout_s=CALM_S))
            await pair.until(lambda: pair.distance() < 0.01)
