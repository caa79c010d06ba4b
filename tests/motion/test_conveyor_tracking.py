"""Motions that track a conveyor, against the exact positions of objects on it."""

from math import cos, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.motion.profile import Limits
from emulator.motion.superposition import OffsetFrame
from emulator.motion.tracking import CircularConveyor, Follower, LinearConveyor
from tests.budget import examples
from urproto.robots.pose import pose_trans

ZERO = (0.0,) * 6
TICKS = 1000.0  # per metre


class Belt:
    """A conveyor with exactly known ticks."""

    def __init__(self, speed=0.0):
        self.travel = 77.0
        self.speed = speed


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def steps(rig, belt, count):
    for _ in range(count):
        belt.travel += belt.speed * rig.motion.period_s
        rig.step()


def along_y(rig, metres_per_s):
    belt = Belt(metres_per_s * TICKS)
    rig.motion.superposition.track(LinearConveyor(belt, (0.0, 3.0, 0.0), TICKS))
    return belt


def test_a_tool_at_rest_accelerates_and_then_stays_with_its_part(rig):
    start = rig.pose()
    belt = along_y(rig, 0.1)
    for count in range(1, 1500):
        steps(rig, belt, 1)
        behind = start[1] + 0.1 * count * 0.002 - rig.pose()[1]
        assert abs(behind) < (4e-3 if count < 250 else 1e-5)
    assert rig.pose()[::2] == pytest.approx(start[::2], abs=1e-6)
    assert rig.largest_acceleration() < 20.0
    assert rig.motion.path_q == pytest.approx(rig.q[0], abs=1e-12)


def test_move_targets_refer_to_positions_at_the_start_of_tracking(rig):
    start = rig.pose()
    belt = along_y(rig, 0.05)
    goal = add(start, 0.08, -0.02, -0.05)
    move = rig.commands.movel(goal, v=0.2)
    count = 0
    while not move.ready:
        steps(rig, belt, 1)
        count += 1
    way = (0.08**2 + 0.02**2 + 0.05**2) ** 0.5
    assert count * 0.002 == pytest.approx(way / 0.2 + 0.2 / 1.2, abs=0.004)
    assert rig.pose() == pytest.approx(add(goal, 0.0, 0.05 * count * 0.002), abs=1e-5)
    assert rig.motion.target_waypoint == pytest.approx(goal)
    steps(rig, belt, 500)
    assert rig.pose() == pytest.approx(add(goal, 0.0, 0.05 * (count + 500) * 0.002), abs=1e-6)


@pytest.mark.parametrize("rotate_tool", [False, True])
def test_a_circular_conveyor(rig, rotate_tool):
    start = rig.pose()
    center = add(start, -0.2, 0.05)
    belt = Belt(25.0)
    rig.motion.superposition.track(CircularConveyor(belt, (*center[:3], 0, 0, 0), 500.0, rotate_tool=rotate_tool))
    steps(rig, belt, 1000)
    angle = 2 * pi * 25.0 * 2.0 / 500.0
    x, y = 0.2, -0.05
    expected = (
        center[0] + cos(angle) * x - sin(angle) * y,
        center[1] + sin(angle) * x + cos(angle) * y,
        start[2],
    )
    assert rig.pose()[:3] == pytest.approx(expected, abs=1e-4)
    turned = pose_trans((0, 0, 0, 0, 0, angle), start)[3:] if rotate_tool else start[3:]
    assert rig.pose()[3:] == pytest.approx(turned, abs=1e-3)
    assert rig.fault is None


def test_a_circular_conveyor_turns_about_the_z_axis_of_its_centre(rig):
    start = rig.pose()
    belt = Belt(-10.0)  # backwards about base x
    center = (start[0], start[1], start[2] - 0.1, 0.0, pi / 2, 0.0)
    rig.motion.superposition.track(CircularConveyor(belt, center, 500.0, rotate_tool=False))
    steps(rig, belt, 1000)
    angle = -2 * pi * 10.0 * 2.0 / 500.0
    expected = add(start, 0.0, -0.1 * sin(angle), 0.1 * (cos(angle) - 1))
    assert rig.pose() == pytest.approx(expected, abs=1e-4)


def test_stopping_keeps_the_tool_in_place_and_poses_in_the_base_frame(rig):
    start = rig.pose()
    belt = along_y(rig, 0.1)
    steps(rig, belt, 1000)
    assert rig.finish(rig.commands.stop_tracking(20.0)) < 0.05
    assert rig.motion.idle
    assert rig.pose()[1] == pytest.approx(start[1] + 0.2, abs=3e-3)
    rig.finish(rig.commands.movel(start))
    assert rig.pose() == pytest.approx(start, abs=1e-8)
    assert rig.largest_acceleration() < 45.0


def test_the_speed_slider_slows_the_path_and_not_the_conveyor(rig):
    start = rig.pose()
    belt = along_y(rig, 0.05)
    rig.commands.movel(add(start, 0.1), v=0.1, a=1.0)
    for _ in range(600):
        belt.travel += belt.speed * 0.002
        rig.step(0.5)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.06, abs=1e-4)
    assert rig.pose()[0] == pytest.approx(start[0] + 0.05 * (1.2 - 0.1), abs=2e-3)


@pytest.mark.parametrize("halt", ["pause", "protective_stop"])
@pytest.mark.parametrize("moving", [False, True])
def test_a_paused_arm_stands_still_and_catches_up_afterwards(rig, halt, moving):
    start = rig.pose()
    belt = along_y(rig, 0.1)
    if moving:
        rig.commands.movel(add(start, 0.1), v=0.02)
    steps(rig, belt, 500)
    getattr(rig.motion, halt)()
    steps(rig, belt, 250)
    assert rig.motion.qd == ZERO
    q = rig.motion.q
    steps(rig, belt, 50)
    assert rig.motion.q == q
    rig.motion.resume()
    steps(rig, belt, 700)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.3, abs=1e-4)
    assert rig.fault is None
    assert rig.largest_acceleration() < 45.0


def test_a_conveyor_that_leaves_the_workspace_stops_the_arm(rig):
    belt = Belt(0.2 * TICKS)
    rig.motion.superposition.track(LinearConveyor(belt, (1.0, 0.0, 0.0), -TICKS))
    for _ in range(5000):
        steps(rig, belt, 1)
        if rig.fault is not None:
            break
    assert rig.fault is not None
    rig.rest()


def test_a_conveyor_that_is_too_fast_stops_the_arm(rig):
    belt = along_y(rig, 2.0)
    steps(rig, belt, 1)
    assert str(rig.fault).startswith("C195A2: the conveyor runs at 2.000 m/s")
    rig.rest()


def test_only_one_conveyor_at_a_time(rig):
    belt = along_y(rig, 0.1)
    with pytest.raises(ValueError, match="already being tracked"):
        rig.motion.superposition.track(LinearConveyor(belt, (1.0, 0.0, 0.0), TICKS))


def test_blends_and_streams_follow_the_conveyor(rig):
    start = rig.pose()
    belt = along_y(rig, 0.05)
    steps(rig, belt, 500)
    corner, goal = add(start, 0.1), add(start, 0.1, 0.0, 0.1)
    first = rig.commands.movel(corner, r=0.03)
    while not first.ready:
        steps(rig, belt, 1)
    second = rig.commands.movel(goal)
    while not second.ready:
        steps(rig, belt, 1)
    belt_at = (belt.travel - 77.0) / TICKS
    assert rig.pose() == pytest.approx(add(goal, 0.0, belt_at), abs=1e-5)
    rig.commands.speedl((-0.05, 0, 0, 0, 0, 0), a=0.5)
    steps(rig, belt, 500)
    rig.commands.stopl(1.0)
    steps(rig, belt, 100)
    q = rig.motion.path_q
    rig.commands.servoj(q, t=0.002)
    steps(rig, belt, 100)
    belt_at = (belt.travel - 77.0) / TICKS
    assert rig.pose()[1] == pytest.approx(goal[1] + belt_at, abs=1e-5)
    assert rig.fault is None
    assert rig.largest_acceleration() < 45.0


def test_an_offset_combined_with_a_conveyor(rig):
    start = rig.pose()
    belt = along_y(rig, 0.05)
    rig.motion.superposition.enable_path_offset()
    rig.motion.superposition.settings.alpha = 0.02
    rig.motion.superposition.set_path_offset((0, 0, 0.01, 0, 0, 0), OffsetFrame.BASE)
    steps(rig, belt, 1000)
    assert rig.pose() == pytest.approx(add(start, 0.0, 0.1, 0.01), abs=1e-5)
    rig.commands.disable_path_offset(20.0)
    steps(rig, belt, 500)
    assert rig.pose() == pytest.approx(add(start, 0.0, 0.15, 0.01), abs=1e-5)
    assert rig.fault is None


def test_force_mode_on_a_conveyor(rig):
    start = rig.pose()
    belt = along_y(rig, 0.05)
    rig.motion.force_control.force_mode(ZERO, (0, 0, 1, 0, 0, 0), (0, 0, -10, 0, 0, 0), 2, (0.1,) * 6)
    steps(rig, belt, 1500)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.15, abs=1e-4)
    assert rig.pose()[2] < start[2] - 0.02
    rig.motion.force_control.end()
    steps(rig, belt, 300)
    move = rig.commands.movel(start)
    while not move.ready:
        steps(rig, belt, 1)
    assert rig.pose() == pytest.approx(add(start, 0.0, (belt.travel - 77.0) / TICKS), abs=1e-5)
    assert rig.fault is None


def test_the_end_of_the_program_brings_the_arm_to_rest(rig):
    belt = along_y(rig, 0.1)
    steps(rig, belt, 500)
    rig.motion.program_stopped()
    assert rig.rest() < 0.1
    assert rig.motion.idle


@given(
    far=st.floats(-0.5, 0.5),
    rate=st.floats(-0.5, 0.5),
    speed=st.floats(-0.3, 0.3),
    dt=st.sampled_from([0.002, 0.008]),
)
@settings(max_examples=examples(20))
def test_a_follower_arrives_within_its_acceleration(far, rate, speed, dt):
    follower, limits = Follower(speed), Limits(0.25, 2.0)
    for count in range(1, round(8.0 / dt)):
        before = follower.speed
        follower.follow(dt, far + rate * count * dt, rate, limits)
        assert abs(follower.speed - before) <= limits.acceleration * dt * (1 + 1e-9)
        assert abs(follower.speed - rate) <= max(abs(speed - rate), limits.speed) + 2 * limits.acceleration * dt
    assert follower.position == pytest.approx(far + rate * count * dt, abs=2e-3 * dt / 0.002)
    if rate == 0.0:
        assert (follower.position, follower.speed) == (far, 0.0)
