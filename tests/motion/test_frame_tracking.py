"""Motions that track a frame, against exact poses by numpy matrices."""

from math import pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.motion.profile import Limits
from emulator.motion.superposition import OffsetFrame
from emulator.motion.tracking import FrameTracking, LinearConveyor, pursuit
from tests.budget import examples
from urproto.robots.pose import pose_trans

ZERO = (0.0,) * 6
FRAME = (0.3, -0.2, 0.1, 0.2, -0.3, 0.5)  # in the base frame, when tracking begins


def matrix(pose):
    """4x4 of a pose, by Rodrigues' formula."""
    t, r = np.array(pose[:3]), np.array(pose[3:])
    angle = np.linalg.norm(r)
    m = np.eye(4)
    if angle:
        x, y, z = r / angle
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        m[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    m[:3, 3] = t
    return m


def apart(pose, expected):
    """The largest difference of two poses as matrices."""
    return np.abs(matrix(pose) - expected).max()


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


class Part:
    """A frame moved by the test, and its motion since tracking began."""

    def __init__(self, rig, pose=FRAME):
        self.rig, self.pose, self.first = rig, pose, matrix(pose)
        rig.motion.superposition.track_frame(FrameTracking("part", self.place))

    def place(self):
        if self.pose is None:
            raise ValueError('there is no frame "part"')
        return self.pose

    def takes(self, pose):
        """The current target of a pose of the path (4x4)."""
        return matrix(self.pose) @ np.linalg.inv(self.first) @ matrix(pose)

    def step(self, by=ZERO, count=1, fraction=1.0):
        """Move the frame in its own axes once a period."""
        for _ in range(count):
            if any(by):
                self.pose = pose_trans(self.pose, by)
            self.rig.step(fraction)


MOVES = {
    "along": (2e-4, 0, 1e-4, 0, 0, 0),  # m per period of 2 ms
    "turning": (0, 0, 0, 0, 0, 4e-4),  # rad per period, about its own origin
    "screw": (1e-4, 0, 5e-5, 1e-4, 2e-4, -1e-4),
}


@pytest.mark.parametrize("by", MOVES.values(), ids=MOVES)
def test_a_frame_at_constant_speed_is_followed_without_lag_after_a_soft_start(rig, by):
    start = rig.pose()
    part = Part(rig)
    part.step(by, 800)
    for _ in range(400):
        part.step(by)
        assert apart(rig.pose(), part.takes(start)) < 2e-7
    assert rig.fault is None
    assert rig.largest_acceleration() < 20.0
    assert rig.motion.path_q == pytest.approx(rig.q[0], abs=1e-12)


@pytest.mark.parametrize("by", MOVES.values(), ids=MOVES)
def test_the_arm_is_exactly_at_rest_once_the_frame_stops(rig, by):
    start = rig.pose()
    part = Part(rig)
    part.step(by, 500)
    part.step(count=800)
    q = rig.motion.q
    part.step(count=50)
    assert rig.motion.q == q
    assert rig.motion.qd == ZERO
    assert apart(rig.pose(), part.takes(start)) < 1e-8
    assert rig.largest_acceleration() < 20.0


@pytest.mark.parametrize("jump", [(0.1, 0, -0.05, 0, 0, 0), (0, 0, 0, 0, 0.1, 0.3), (0.05, 0.05, 0, 0.1, 0, -0.2)])
def test_a_jump_of_the_frame_is_followed_smoothly(rig, jump):
    start = rig.pose()
    part = Part(rig)
    part.step(jump)
    assert apart(rig.pose(), matrix(start)) < 0.5 * 8.0 * 0.002**2 * 1.1
    tool = [rig.pose()]
    while apart(rig.pose(), part.takes(start)) > 1e-7:
        part.step()
        tool.append(rig.pose())
        assert len(tool) < 1500
    way = np.diff([pose[:3] for pose in tool], axis=0) / 0.002
    assert np.linalg.norm(way, axis=1).max() < 0.25 + 0.01
    assert np.linalg.norm(np.diff(way, axis=0) / 0.002, axis=1).max() < 2.0 + 0.2
    assert rig.fault is None


def test_a_long_distance_is_covered_within_the_limits(rig):
    start = rig.pose()
    part = Part(rig)
    part.step((0.0, 0.0, 0.2, 0, 0, 0))
    count = 0
    while apart(rig.pose(), part.takes(start)) > 1e-3:
        part.step()
        count += 1
    even = 0.2 / 0.25  # s at full speed; as much again of speeding up and slowing down as that takes at 2 m/s2
    assert even + 0.25 / 2.0 - 0.01 < count * 0.002 < even + 0.25 / 2.0 + 0.25


def test_a_frame_that_moves_in_steps_is_followed_smoothly(rig):
    start = rig.pose()
    part = Part(rig)
    for _ in range(150):
        part.step((1e-3, 0, 0, 0, 0, 0))
        part.step(count=9)  # 0.05 m/s, set every 20 ms
    assert apart(rig.pose(), part.takes(start)) < 1e-3 + 2 * 0.05 / 25.0  # a step, and the lag without its speed
    assert rig.fault is None
    assert rig.largest_acceleration() < 20.0


def test_the_lag_behind_a_swinging_frame_is_its_acceleration_over_the_bandwidth_squared(rig):
    start = rig.pose()
    part = Part(rig, ZERO)
    worst, omega, far = 0.0, 2 * pi * 0.5, 0.05
    for count in range(3000):
        part.pose = (0.0, far * sin(omega * count * 0.002), 0.0, 0.0, 0.0, 0.0)
        part.step()
        if count > 1500:
            worst = max(worst, apart(rig.pose(), part.takes(start)))
    assert worst == pytest.approx(far * omega**2 / 25.0**2, rel=0.1)


def test_move_targets_refer_to_positions_at_the_start_of_tracking(rig):
    start = rig.pose()
    part = Part(rig)
    by = (5e-5, 0, 0, 0, 0, 2e-4)
    goal = add(start, 0.08, -0.02, -0.05)
    move = rig.commands.movel(goal, v=0.1)
    count = 0
    while not move.ready:
        part.step(by)
        count += 1
    way = (0.08**2 + 0.02**2 + 0.05**2) ** 0.5
    assert count * 0.002 == pytest.approx(way / 0.1 + 0.1 / 1.2, abs=0.004)
    assert rig.motion.target_waypoint == pytest.approx(goal)
    assert apart(rig.pose(), part.takes(goal)) < 1e-6
    part.step(by, 400)
    assert apart(rig.pose(), part.takes(goal)) < 1e-7
    assert rig.fault is None


def test_the_path_is_exact_relative_to_the_moving_frame(rig):
    start = rig.pose()
    part = Part(rig)
    by = (5e-5, 2e-5, 0, 0, 1e-4, 2e-4)
    part.step(by, 800)
    rig.commands.movel(add(start, 0.1), v=0.1)
    for _ in range(300):
        part.step(by)
        path = rig.kinematics.forward(rig.motion.path_q, rig.motion.tcp_offset)
        assert path[1:] == pytest.approx(start[1:], abs=1e-9)
        assert apart(rig.pose(), part.takes(path)) < 1e-6


def test_the_speed_slider_slows_the_path_and_not_the_frame(rig):
    start = rig.pose()
    part = Part(rig, ZERO)
    rig.commands.movel(add(start, 0.1), v=0.1, a=1.0)
    part.step((0, 1e-4, 0, 0, 0, 0), 600, fraction=0.5)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.06, abs=1e-4)
    assert rig.pose()[0] == pytest.approx(start[0] + 0.05 * (1.2 - 0.1), abs=2e-3)


@pytest.mark.parametrize("halt", ["pause", "protective_stop"])
@pytest.mark.parametrize("moving", [False, True])
def test_a_paused_arm_stands_still_and_catches_up_afterwards(rig, halt, moving):
    start = rig.pose()
    part = Part(rig)
    by = (2e-4, 0, 0, 0, 0, 3e-4)
    goal = add(start, 0.0, 0.05)
    if moving:
        rig.commands.movel(goal, v=0.02)
    part.step(by, 400)
    getattr(rig.motion, halt)()
    part.step(by, 250)
    assert rig.motion.qd == ZERO
    q = rig.motion.q
    part.step(by, 50)
    assert rig.motion.q == q
    rig.motion.resume()
    part.step(by, 1300)
    assert apart(rig.pose(), part.takes(goal if moving else start)) < 2e-6
    assert rig.fault is None
    assert rig.largest_acceleration() < 45.0


def test_disabling_keeps_the_tool_in_place_and_poses_in_the_base_frame(rig):
    start = rig.pose()
    part = Part(rig)
    part.step((1e-4, 0, 0, 0, 0, 2e-4), 1000)
    there = part.takes(start)
    assert rig.finish(rig.commands.stop_tracking_frame(20.0)) < 0.05
    assert rig.motion.idle
    assert apart(rig.pose(), there) < 5e-3
    rig.finish(rig.commands.movel(start))
    assert rig.pose() == pytest.approx(start, abs=1e-8)
    assert rig.largest_acceleration() < 45.0


def test_a_frame_combined_with_an_offset_and_a_conveyor(rig):
    class Belt:
        travel, speed = 5.0, 50.0

    start = rig.pose()
    part, belt = Part(rig), Belt()
    rig.motion.superposition.track(LinearConveyor(belt, (0.0, 1.0, 0.0), 1000.0))
    rig.motion.superposition.enable_path_offset()
    rig.motion.superposition.settings.alpha = 0.02
    rig.motion.superposition.set_path_offset((0, 0, 0.01, 0, 0, 0), OffsetFrame.BASE)
    for _ in range(800):
        belt.travel += belt.speed * 0.002
        part.step((0, 0, 2e-5, 0, 0, 2e-4))
    expected = matrix((0.0, 0.05 * 1.6, 0.0, 0, 0, 0)) @ part.takes(add(start, 0.0, 0.0, 0.01))
    assert apart(rig.pose(), expected) < 1e-5
    rig.commands.stop_tracking_frame(20.0)  # the others stay at rest
    at = rig.pose()
    for _ in range(500):
        belt.travel += belt.speed * 0.002
        rig.step()
    assert rig.pose() == pytest.approx(add(at, 0.0, 0.05), abs=3e-3)
    assert rig.fault is None


def test_force_mode_while_tracking_a_frame(rig):
    start = rig.pose()
    part = Part(rig, ZERO)
    rig.motion.force_control.force_mode(ZERO, (0, 0, 1, 0, 0, 0), (0, 0, -10, 0, 0, 0), 2, (0.1,) * 6)
    part.step((0, 1e-4, 0, 0, 0, 0), 1500)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.15, abs=1e-4)
    assert rig.pose()[2] < start[2] - 0.02
    assert rig.fault is None


def test_a_missing_frame_stops_the_arm(rig):
    part = Part(rig)
    part.step((1e-4, 0, 0, 0, 0, 0), 200)
    part.pose = None
    part.step()
    assert str(rig.fault).startswith('C204A5: the frame "part" can no longer be tracked: there is no frame "part"')
    rig.rest()


@pytest.mark.parametrize(
    ("by", "problem"), [((4e-3, 0, 0, 0, 0, 0), "2.000 m/s"), ((0, 0, 0, 0, 0, 0.02), "10.000 rad/s")]
)
def test_a_frame_that_is_too_fast_stops_the_arm(rig, by, problem):
    part = Part(rig)
    part.step(by, 10)
    assert rig.fault is None  # until here it could have been repositioned
    part.step(by, 2)
    assert problem in str(rig.fault)
    rig.rest()


def test_many_small_jumps_do_not_count_as_too_fast(rig):
    part = Part(rig)
    for _ in range(20):
        part.step((5e-3, 0, 0, 0, 0, 0))
        part.step(count=3)
    assert rig.fault is None


def test_a_frame_that_leaves_the_workspace_stops_the_arm(rig):
    part = Part(rig, ZERO)
    for _ in range(6000):
        part.step((-4e-4, 0, 0, 0, 0, 0))
        if rig.fault is not None:
            break
    assert rig.fault is not None
    rig.rest()


@pytest.mark.parametrize("far", [1e9, 1e200, float("inf"), float("nan")])
def test_absurdly_distant_frames_keep_joint_positions_finite(rig, far):
    part = Part(rig)
    part.step((2e-5, 0, 0, 0, 0, 0), 100)
    part.pose = (far, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(8000):
        part.step()
        if rig.fault is not None:
            break
    assert rig.fault is not None
    assert all(np.isfinite(rig.motion.q))


def test_only_one_frame_at_a_time(rig):
    Part(rig)
    with pytest.raises(ValueError, match="already being tracked"):
        Part(rig)


def test_the_end_of_the_program_brings_the_arm_to_rest(rig):
    part = Part(rig)
    part.step(MOVES["screw"], 500)
    rig.motion.program_stopped()
    assert rig.rest() < 0.1


vectors = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


@given(missing=vectors, velocity=vectors, dt=st.sampled_from([0.002, 0.008]))
@settings(max_examples=examples(20))
def test_a_pursuit_arrives_within_its_acceleration(missing, velocity, dt):
    limits, left, speed = Limits(0.25, 2.0), np.array(missing), velocity
    for _ in range(round(8.0 / dt)):
        before, speed = np.array(speed), pursuit(dt, tuple(left), speed, limits)
        assert np.linalg.norm(speed - before) <= limits.acceleration * dt * (1 + 1e-9)
        left = left - 0.5 * (before + speed) * dt
    assert np.abs(left).max() < 1e-6
