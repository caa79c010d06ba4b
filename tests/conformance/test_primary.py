"""Primary interface: version first, full state once, ten states per second; effects of commands."""

import math
from itertools import pairwise

import pytest

from client.primary import BRAKE_RELEASE, POWER_OFF, POWER_ON
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, RobotSubType
from urproto.primary.messages import VersionMessage
from urproto.primary.state import RobotStateData
from urproto.versions import Series

AT_REST_RAD = 1e-3  # between two readings of an arm at rest
NEAR_M = 1e-3


def test_the_version_comes_first(robot):
    with robot.primary() as primary:
        message = primary.run(primary.core.next_message())
        assert isinstance(message, VersionMessage)
        assert (message.major, message.minor) == (robot.version.major, robot.version.minor)


def test_the_first_state_is_full(robot):
    with robot.primary() as primary:
        state = primary.run(primary.core.robot_state())
        kinematics = primary.run(primary.core.kinematics_info())
        configuration = primary.run(primary.core.configuration_data())
    assert state.configuration is not None
    assert 0.05 < kinematics.dh_d[0] < 0.3  # m, the shoulder's height of every arm sold
    assert kinematics.dh_a == pytest.approx(configuration.dh_a, abs=0.01)  # calibration shifts it by millimetres
    assert all(low < high for low, high in zip(configuration.q_min, configuration.q_max, strict=True))
    assert all(math.pi / 2 < speed < 3 * math.pi for speed in configuration.qd_max)  # rad/s
    generation = RobotSubType.CB3 if robot.version.series is Series.CB3 else RobotSubType.E_SERIES
    assert configuration.sub_type == generation


def test_ten_states_per_second(robot):
    with robot.primary() as primary:
        stamps = [primary.run(primary.core.robot_state()).mode.timestamp_us for _ in range(12)]
    steps_s = [(after - before) / 1e6 for before, after in pairwise(stamps[1:])]
    assert steps_s == pytest.approx([0.1] * len(steps_s), abs=0.02)


def test_joints_and_pose_agree_with_rtde(robot):
    with robot.primary() as primary, robot.rtde(["actual_q", "actual_TCP_pose", "robot_mode"]) as rtde:
        state = primary.run(primary.core.robot_state())
        seen = rtde.latest()
    assert [joint.q_actual for joint in state.joints.joints] == pytest.approx(seen["actual_q"], abs=AT_REST_RAD)
    assert state.cartesian.pose_base_tcp[:3] == pytest.approx(seen["actual_TCP_pose"][:3], abs=NEAR_M)
    assert state.mode.robot_mode == seen["robot_mode"]


@pytest.mark.moves
def test_power_through_the_script_port(robot):
    with robot.primary() as primary:
        for command, mode in (
            (POWER_OFF, RobotMode.POWER_OFF),
            (POWER_ON, RobotMode.IDLE),
            (BRAKE_RELEASE, RobotMode.RUNNING),
        ):
            primary.run(primary.core.command(command))
            assert primary.core.state.mode.robot_mode == mode


@pytest.mark.moves
def test_programs_do_not_run_while_the_robot_is_off(robot):
    with robot.primary() as primary:
        primary.run(primary.core.command(POWER_OFF))
        with pytest.raises(RobotRefused, match="POWER_OFF"):
            primary.run(primary.core.execute("textmsg(1)"))


def test_states_continue_with_other_listeners(robot):
    with robot.primary() as first, robot.primary() as second:
        for client in (first, second):
            assert isinstance(client.run(client.core.robot_state()), RobotStateData)
