"""Waypoints: what a policy sends now and then becomes a smooth way, and nothing that the arm cannot follow."""

from math import nan, pi

import pytest
from driver_rig import HOME, HOST, driver_options, emulator_thread

from client import LateSetpointError, OutOfReachError, ProtectiveStopError, Robot
from client.robot.state import RobotState
from client.robot.waypoints import WaypointFollower, _Joints, _Poses
from urproto.errors import LocalProtocolError

START = (0.0, -1.5, 1.5, -1.5, -1.5, 0.0)


class Clock:
    """A time that stands still."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def follower(clock, space=None, start=START, check=lambda target: None):
    return WaypointFollower(space or _Joints(1.0), start, check, clock)


def turned(base_rad):
    return (base_rad, *START[1:])


def walk(arm, clock, seconds, period_s=0.01):
    """The base's setpoints in the next seconds."""
    found = []
    for _ in range(round(seconds / period_s)):
        clock.now_s += period_s
        found.append(arm.advance()[0])
    return found


def test_setpoints_lie_on_the_way_between_waypoints_and_stay_at_the_last(clock):
    arm = follower(clock)
    arm.send(turned(0.05), 0.1)
    assert walk(arm, clock, 0.2) == pytest.approx([0.005 * i for i in range(1, 11)] + [0.05] * 10)
    arm.send_chunk([turned(0.04), turned(0.06)], 0.1)
    assert walk(arm, clock, 0.2)[9::10] == pytest.approx([0.04, 0.06])
    assert arm.statistics.slowed == 0


def test_a_waypoint_replaces_the_later_ones_from_where_the_arm_is_then(clock):
    arm = follower(clock)
    arm.send_chunk([turned(0.1 * i) for i in range(1, 6)], 0.2)
    walk(arm, clock, 0.3)
    arm.send(turned(0.0), 0.28)  # before 0.3 rad, which was to be reached at 0.6 s, and after 0.2 rad at 0.4 s
    setpoints = walk(arm, clock, 0.6)
    assert max(setpoints) == setpoints[9] == pytest.approx(0.2)
    assert setpoints[-1] == 0.0


def test_waypoints_that_come_too_late_are_left_out(clock):
    arm = follower(clock)
    assert arm.send_chunk([turned(0.01 * i) for i in range(5)], 0.1, first_s=-0.25) == 2
    assert (arm.statistics.taken, arm.statistics.late) == (2, 3)
    assert walk(arm, clock, 0.2)[-1] == pytest.approx(0.04)


def test_what_is_too_fast_is_slowed_on_the_same_line(clock):
    arm = follower(clock)
    arm.send((0.5, -1.25, *START[2:]), 0.1)
    for _ in range(10):
        clock.now_s += 0.01
        base, shoulder, *_ = arm.advance()
        assert shoulder + 1.5 == pytest.approx(0.5 * base)
    assert base == pytest.approx(0.1)
    assert arm.statistics.slowed == 10
    assert walk(arm, clock, 0.5)[-1] == pytest.approx(0.5)


def test_poses_turn_about_one_axis_at_no_more_than_their_speeds(clock):
    start = (0.3, 0.1, 0.2, 0.0, pi, 0.0)
    arm = follower(clock, _Poses(0.1, 0.5), start)
    arm.send((0.3, 0.2, 0.2, 0.0, pi, 0.0), 0.5)
    clock.now_s += 0.5
    assert arm.advance() == pytest.approx((0.3, 0.15, 0.2, 0.0, pi, 0.0))
    arm = follower(clock, _Poses(0.1, 0.5), (0.3, 0.1, 0.2, 0.0, 0.0, 0.0))
    arm.send((0.3, 0.1, 0.2, 0.0, 0.0, 1.0), 0.0)
    clock.now_s += 1.0
    assert arm.advance() == pytest.approx((0.3, 0.1, 0.2, 0.0, 0.0, 0.5))


@pytest.mark.parametrize("waypoint", [(0.0,) * 5, (nan, *START[1:]), [*START[:5], float("inf")]])
def test_a_chunk_with_an_invalid_waypoint_is_refused_as_a_whole(clock, waypoint):
    arm = follower(clock)
    with pytest.raises(LocalProtocolError, match="a waypoint must be 6 finite numbers"):
        arm.send_chunk([turned(0.1), waypoint], 0.1)
    with pytest.raises(LocalProtocolError, match="a finite time apart"):
        arm.send(START, nan)
    assert walk(arm, clock, 0.2)[-1] == 0.0


async def test_after_a_pause_of_this_machine_the_arm_stays_until_the_next_waypoint(clock):
    """The robot stops an arm without setpoints; waypoints of before are no longer what anybody wants."""
    arm, stopped = follower(clock), turned(0.07)
    arm.send(turned(0.5), 0.5)
    state = RobotState({"actual_q": stopped, "timestamp": 0.0})
    calls = iter([None, None, LateSetpointError("servo_j", "late"), None, RuntimeError("the end")])

    async def follow(setpoint):
        clock.now_s += 0.01
        seen.append(setpoint[0])
        if (problem := next(calls)) is not None:
            raise problem
        return state

    async def fresh_state():
        return state

    seen: list[float] = []
    await arm.run(follow, fresh_state)
    assert seen == pytest.approx([0.0, 0.01, 0.02, 0.07, 0.07])
    assert arm.statistics.pauses == 1
    with pytest.raises(RuntimeError, match="the end"):
        arm.send(START, 0.1)


def test_an_emulated_arm_follows_from_a_thread():
    with emulator_thread("ur5e") as emulated, Robot(HOST, **driver_options(emulated)) as robot:
        robot.make_ready()
        with robot.waypoints_j(max_speed_rad_s=2.0) as waypoints:
            for i in range(1, 6):
                waypoints.send([HOME[0] + 0.04 * i, *HOME[1:]], 0.1)
                robot.wait_for(lambda state, to=HOME[0] + 0.04 * i: abs(state.q_rad[0] - to) < 1e-3, 5)
            with pytest.raises(OutOfReachError, match="base at 9"):
                waypoints.send([9.0, *HOME[1:]], 0.1)
            assert waypoints.statistics.taken == 5
        x, y, z, *turn = robot.tcp_pose
        with robot.waypoints_pose() as waypoints:
            waypoints.send_chunk([(x, y, z + 0.01, *turn), (x, y, z + 0.02, *turn)], 0.1)
            robot.wait_for(lambda state: abs(state.pose_base_tcp[2] - z - 0.02) < 1e-3, 5)
        with pytest.raises(ProtectiveStopError):
            follow_into_a_stop(robot)


def follow_into_a_stop(robot):
    with robot.waypoints_j() as waypoints:
        robot.trigger_protective_stop()
        while True:
            robot.wait_for(lambda state: True, 5)
            waypoints.send(HOME, 1.0)
