"""ROS' time is the robot's: /clock and stamps, at another speed than real time and while it is paused."""

import asyncio

import pytest
from driver_rig import driver_options, emulator
from ros2_requests import SUCCEEDED, follow, shifted
from ros2_rig import SCALED, laboratory

pytestmark = [pytest.mark.xdist_group("ros2")]

SPEED = 4.0
ROUNDING_S = 1e-9  # a stamp is a whole number of nanoseconds


def seconds(stamp: dict[str, int]) -> float:
    return stamp["sec"] + stamp["nanosec"] * 1e-9


async def test_the_robots_time_is_that_of_ros() -> None:
    async with (
        emulator("ur3", speed=SPEED) as robot,
        laboratory(robot, driver_options(robot), use_sim_time=True) as lab,
    ):
        now_s = robot.controller.time_s
        clock = await lab.peer.echo("/clock", "rosgraph_msgs/msg/Clock", new=True)
        joints = await lab.peer.echo("/joint_states", "sensor_msgs/msg/JointState", new=True)
        activity = await lab.peer.echo("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", new=True)
        stamps = [seconds(clock["clock"]), *(seconds(one["header"]["stamp"]) for one in (joints, activity))]
        assert [now_s, *stamps] == sorted([now_s, *stamps])
        assert stamps[-1] <= robot.controller.time_s + ROUNDING_S

        began_s = seconds((await lab.peer.echo("/clock", "rosgraph_msgs/msg/Clock", new=True))["clock"])
        ended = await follow(lab, SCALED, shifted(0.3), 2.0)
        assert ended["status"] == SUCCEEDED
        assert seconds((await lab.peer.echo("/clock", "rosgraph_msgs/msg/Clock", new=True))["clock"]) >= began_s + 2.0

        before = robot.controller.time_s
        robot.clock.pause()
        await asyncio.sleep(0.2)
        assert lab.driver.host.now_ns() <= round(robot.controller.time_s * 1e9)
        assert robot.controller.time_s <= before + 1.0
        robot.clock.resume()
        await lab.peer.echo("/clock", "rosgraph_msgs/msg/Clock", new=True)
