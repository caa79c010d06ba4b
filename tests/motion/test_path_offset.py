"""Offsets added to the path: tool positions, and behaviour at starts, pauses and stops."""

from math import cos, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.motion.superposition import OffsetFrame, OffsetSettings, PathOffset
from emulator.motion.tracking import Tick
from tests.budget import examples
from urproto.robots.pose import pose_add, pose_inv, pose_trans, rotvec_to_matrix

BASE, TCP, MOTION, WORLD = OffsetFrame
ZERO = (0.0,) * 6
TICK = Tick(0.002, 1.0, None)
LIFT = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
SLANTED = (0.006, -0.004, 0.005, 0.03, -0.02, 0.05)


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def offset_on(rig, alpha=0.02):
    """Enabled, with a filter smooth enough for an offset that is set in one step."""
    rig.motion.superposition.enable_path_offset()
    rig.motion.superposition.settings.alpha = alpha


def path_pose(rig):
    return rig.kinematics.forward(rig.motion.path_q, rig.motion.tcp_offset)


def settle(rig, offset, frame):
    """Enabled, and brought to this offset smoothly."""
    rig.motion.superposition.enable_path_offset()
    for count in range(1, 501):
        share = 0.5 - 0.5 * cos(pi * count / 500)
        rig.motion.superposition.set_path_offset(tuple(share * value for value in offset), frame)
        rig.step()
    rig.step()


@pytest.mark.parametrize("tcp", [ZERO, (0.02, 0.0, 0.15, 0.3, 0.0, 0.0)])
@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (BASE, lambda path: pose_add(SLANTED, path)),
        (TCP, lambda path: pose_trans(path, SLANTED)),
        (WORLD, lambda path: pose_trans(pose_inv(SLANTED), path)),
    ],
)
def test_an_arm_at_rest_moves_by_the_offset(rig, frame, expected, tcp):
    rig.motion.tcp_offset = tcp
    start = rig.pose()
    settle(rig, SLANTED, frame)
    assert rig.pose() == pytest.approx(expected(start), abs=1e-8)
    assert path_pose(rig) == pytest.approx(start, abs=1e-9)
    assert rig.motion.qd == ZERO
    assert rig.motion.superposition.path_offset(frame) == pytest.approx(SLANTED)
    for _ in range(300):
        rig.step()
    assert rig.motion.steady
    assert not rig.motion.idle


def test_the_motion_frame_follows_the_path(rig):
    """Moving along -y with the tool pointing down: x is -y of the base, y is x cross tool z, z is x cross y."""
    start = rig.pose()
    m = rotvec_to_matrix(*start[3:])
    tool_z = (m[2], m[5], m[8])
    offset_on(rig)
    rig.commands.movel(add(start, 0.0, -0.2), v=0.05)
    rig.motion.superposition.set_path_offset((0.0, 0.004, 0.007, 0, 0, 0), MOTION)
    rig.steps(1000)
    x = (0.0, -1.0, 0.0)
    y = cross(x, tool_z)
    size = sum(v * v for v in y) ** 0.5
    y = tuple(v / size for v in y)
    z = cross(x, y)
    away = [a - b for a, b in zip(rig.pose()[:3], path_pose(rig)[:3], strict=True)]
    assert away == pytest.approx([0.004 * b + 0.007 * c for b, c in zip(y, z, strict=True)], abs=1e-6)
    assert path_pose(rig)[0] == pytest.approx(start[0], abs=1e-6)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


POSES = st.tuples(*[st.floats(-0.5, 0.5)] * 3, *[st.floats(-1.5, 1.5)] * 3)
OFFSETS = st.tuples(*[st.floats(-0.1, 0.1)] * 3, *[st.floats(-0.5, 0.5)] * 3)


@given(path=POSES, offset=OFFSETS, frame=st.sampled_from(OffsetFrame), shift=OFFSETS)
@settings(max_examples=examples(25))
def test_an_offset_can_be_undone_and_read_in_every_frame(path, offset, frame, shift):
    source = PathOffset(OffsetSettings())
    source.step(TICK, path, shift)
    source.set(offset, frame)
    source.step(TICK, path, shift)
    there = source.apply(path)
    assert same(source.undo(there), path)
    for other in OffsetFrame:
        reference = PathOffset(OffsetSettings(translation_limit=9.0, rotation_limit=9.0))
        reference.step(TICK, path, shift)
        reference.set(source.get(other), other)
        reference.step(TICK, path, shift)
        assert same(reference.apply(path), there)


def same(a, b):
    """Equal poses, however their rotation vectors are written."""
    turned = zip(rotvec_to_matrix(*a[3:]), rotvec_to_matrix(*b[3:]), strict=True)
    return a[:3] == pytest.approx(b[:3], abs=1e-8) and all(abs(x - y) < 1e-8 for x, y in turned)


def test_the_filter_applies_its_fraction_of_the_difference_each_period(rig):
    offset_on(rig, alpha=0.1)
    rig.motion.superposition.set_path_offset((0, 0, 0.001, 0, 0, 0), BASE)
    for count in range(1, 40):
        rig.step()
        assert rig.motion.superposition.path_offset(BASE)[2] == pytest.approx(0.001 * (1 - 0.9**count))


def test_without_a_filter_the_offset_applies_in_the_same_period(rig):
    start = rig.pose()
    rig.motion.superposition.enable_path_offset()
    for count in range(1000):
        wave = 0.005 * (cos(4 * pi * count / 500) - 1)
        rig.motion.superposition.set_path_offset((0, 0, wave, 0, 0, 0), BASE)
        rig.step()
        assert rig.pose()[2] == pytest.approx(start[2] + wave, abs=1e-9)
    assert rig.fault is None


def test_weaving_does_not_change_the_speed_along_the_line(rig):
    start = rig.pose()
    rig.motion.superposition.enable_path_offset()
    move = rig.commands.movel(add(start, 0.0, 0.1), v=0.05, a=0.5)
    count = 0
    while not move.ready:
        wave = 0.003 * (1 - cos(2 * pi * 3 * count / 500))
        rig.motion.superposition.set_path_offset((wave, 0, 0, 0, 0, 0), BASE)
        rig.step()
        count += 1
        assert rig.pose()[0] == pytest.approx(start[0] + wave, abs=1e-7)
    assert count * 0.002 == pytest.approx(0.1 / 0.05 + 0.05 / 0.5, abs=0.004)
    assert rig.pose()[1] == pytest.approx(start[1] + 0.1, abs=1e-7)
    assert rig.fault is None


@pytest.mark.parametrize("limits", [(0.1, pi / 6), (0.02, 0.1)])
def test_offsets_are_clipped_to_the_limits_of_each_axis(rig, limits):
    rig.motion.superposition.settings.translation_limit, rig.motion.superposition.settings.rotation_limit = limits
    rig.motion.superposition.settings.alpha = 0.05
    settle(rig, (0.0, 0.0, 1.05 * limits[0], 0.0, 0.0, -1.05 * limits[1]), BASE)
    rig.steps(500)
    assert rig.motion.superposition.path_offset(BASE) == pytest.approx((0, 0, limits[0], 0, 0, -limits[1]), abs=1e-9)


def test_a_jump_stops_the_arm(rig):
    rig.motion.superposition.enable_path_offset()
    rig.motion.superposition.set_path_offset((0, 0, 0.02, 0, 0, 0), BASE)
    rig.step()
    assert str(rig.fault).startswith("C204A1: the path offset")
    rig.rest()
    assert rig.motion.superposition.path_offset(BASE) == ZERO


def test_an_offset_out_of_reach_stops_the_arm(make_rig):
    rig = make_rig(q=(0.3, -0.02, 0.1, -1.5, -1.5, 0.2))
    start = rig.pose()
    offset_on(rig, alpha=0.005)
    rig.motion.superposition.settings.translation_limit = 2.0
    size = (start[0] ** 2 + start[1] ** 2) ** 0.5
    rig.motion.superposition.set_path_offset((0.5 * start[0] / size, 0.5 * start[1] / size, 0, 0, 0, 0), BASE)
    rig.steps(800)
    assert rig.fault is not None
    rig.rest()


def test_a_set_offset_does_nothing_unless_enabled(rig):
    rig.motion.superposition.set_path_offset(LIFT, BASE)
    q = rig.motion.q
    rig.steps(10)
    assert rig.motion.q == q
    assert rig.motion.idle
    rig.motion.superposition.enable_path_offset()
    rig.steps(10)
    assert rig.motion.superposition.path_offset(BASE) == ZERO
    assert rig.motion.q == pytest.approx(q, abs=1e-10)


def test_enabling_again_keeps_the_offset(rig):
    settle(rig, LIFT, BASE)
    rig.motion.superposition.enable_path_offset()
    rig.steps(5)
    assert rig.motion.superposition.path_offset(BASE) == pytest.approx(LIFT)


def test_changing_the_frame_continues_from_the_applied_offset(rig):
    settle(rig, SLANTED, BASE)
    before = rig.pose()
    rig.motion.superposition.set_path_offset(rig.motion.superposition.path_offset(TCP), TCP)
    rig.steps(200)
    assert rig.pose() == pytest.approx(before, abs=1e-8)


def test_the_offset_outlives_movements_of_all_kinds(rig):
    start = rig.pose()
    settle(rig, LIFT, BASE)
    goal = add(start, 0.05, 0.03)
    rig.finish(rig.commands.movel(add(start, 0.05), r=0.01))
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(add(goal, 0, 0, 0.01), abs=1e-8)
    assert rig.motion.target_waypoint == pytest.approx(goal)
    q = rig.motion.path_q
    rig.finish(rig.commands.movej((q[0] + 0.2, *q[1:]), v=0.5))
    assert rig.motion.path_q == pytest.approx((q[0] + 0.2, *q[1:]))
    rig.commands.speedl((0, 0, -0.05, 0, 0, 0), a=0.5)
    rig.steps(200)
    rig.finish(rig.commands.stopl(1.0))
    rig.commands.servoj(q, t=0.002)
    rig.steps(2500)
    assert rig.pose() == pytest.approx(add(goal, 0, 0, 0.01), abs=1e-6)
    assert rig.fault is None
    assert rig.largest_acceleration() < 45.0


@pytest.mark.parametrize("moving", [False, True])
def test_disabling_stops_all_joints_together_in_place(rig, moving):
    start = rig.pose()
    settle(rig, LIFT, BASE)
    if moving:
        rig.commands.movel(add(start, 0.2), v=0.2)
        rig.steps(300)
    speed = max(map(abs, rig.motion.qd))
    took = rig.finish(rig.commands.disable_path_offset(2.0))
    assert took == pytest.approx(speed / 2.0, abs=0.004)
    assert rig.motion.idle
    assert rig.pose()[2] == pytest.approx(start[2] + 0.01, abs=2e-3)
    assert rig.motion.path_q == rig.motion.q
    rig.finish(rig.commands.movel(start))
    assert rig.pose() == pytest.approx(start, abs=1e-8)


@pytest.mark.parametrize("halt", ["pause", "protective_stop"])
def test_a_paused_program_stands_still_and_resumes_without_a_jump(rig, halt):
    start = rig.pose()
    rig.motion.superposition.enable_path_offset()
    move = rig.commands.movel(add(start, 0.0, 0.2), v=0.1)
    wave = 0.0
    for count in range(2500):
        if not 600 <= count < 1000:  # the thread that gives offsets is paused as well
            wave = 0.004 * sin(2 * pi * 2 * (count if count < 600 else count - 400) / 500)
            rig.motion.superposition.settings.alpha = 0.1
            rig.motion.superposition.set_path_offset((wave, 0, 0, 0, 0, 0), BASE)
        if count == 600:
            getattr(rig.motion, halt)()
        if count == 1000:
            assert rig.motion.qd == ZERO
            rig.motion.resume()
        rig.step()
    assert rig.fault is None
    assert move.ready
    assert rig.largest_acceleration() < 90.0


def test_the_end_of_the_program_ends_the_offset_and_its_settings(rig):
    start = rig.pose()
    settle(rig, LIFT, BASE)
    rig.commands.movel(add(start, 0.2), v=0.2)
    rig.steps(300)
    rig.motion.program_stopped()
    rig.rest()
    assert rig.motion.superposition.settings == OffsetSettings()
    assert rig.pose()[2] == pytest.approx(start[2] + 0.01, abs=1e-3)
    rig.finish(rig.commands.movel(start))
    assert rig.pose() == pytest.approx(start, abs=1e-8)


def test_power_off_resets_the_offset(rig):
    settle(rig, LIFT, BASE)
    rig.motion.halt()
    assert rig.motion.idle
    assert rig.motion.superposition.path_offset(BASE) == ZERO


def test_force_mode_combined_with_an_offset(rig):
    """The tool sinks under force while the offset moves it sideways; the next move undoes the motion by the force."""
    start = rig.pose()
    settle(rig, (0.01, 0, 0, 0, 0, 0), BASE)
    rig.motion.force_control.force_mode(ZERO, (0, 0, 1, 0, 0, 0), (0, 0, -10, 0, 0, 0), 2, (0.1,) * 6)
    rig.motion.superposition.settings.alpha = 0.02
    rig.motion.superposition.set_path_offset((0.02, 0, 0, 0, 0, 0), BASE)
    rig.steps(1500)
    assert rig.pose()[0] == pytest.approx(start[0] + 0.02, abs=1e-6)
    assert rig.pose()[2] < start[2] - 0.02
    rig.motion.force_control.end()
    rig.steps(500)
    goal = add(start, 0.0, 0.05)
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(add(goal, 0.02), abs=1e-6)
    assert rig.fault is None
