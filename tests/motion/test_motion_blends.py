"""Blend radii, and taking over from an arm in motion."""

from itertools import pairwise
from math import dist

import pytest

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def places(rig):
    return [rig.kinematics.forward(q)[:3] for q in rig.q]


def tool_speeds(rig):
    return [dist(a, b) / rig.motion.period_s for a, b in pairwise(places(rig))]


def corner(rig, command, radius, **arguments):
    """Two legs of 0.1 m at a right angle, the second commanded as soon as the first is ready."""
    start = rig.pose()
    waypoint, goal = add(start, 0.1), add(start, 0.1, 0.1)
    first = getattr(rig.commands, command)(waypoint, r=radius, **arguments)
    rig.finish(first)
    handed_over = rig.pose()
    rig.finish(getattr(rig.commands, command)(goal, **arguments))
    return start, waypoint, goal, handed_over


@pytest.mark.parametrize("command", ["movel", "movep"])
def test_blend_begins_at_the_radius_and_stays_inside(rig, command):
    start, waypoint, goal, handed_over = corner(rig, command, 0.03, a=1.2, v=0.15)
    assert dist(handed_over[:3], waypoint[:3]) == pytest.approx(0.03, abs=0.15 * rig.motion.period_s)
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert min(dist(at, waypoint[:3]) for at in places(rig)) > 0.004  # cut, not reached
    for at in places(rig):
        if dist(at, waypoint[:3]) > 0.03 + 1e-9:
            on_first = abs(at[1] - start[1]) < 1e-9
            on_second = abs(at[0] - waypoint[0]) < 1e-9
            assert on_first or on_second


def test_a_blend_keeps_its_speed(rig):
    corner(rig, "movel", 0.03, a=1.2, v=0.15)
    speeds = tool_speeds(rig)
    assert max(speeds) <= 0.15 + 1e-6
    middle = speeds[len(speeds) // 4 : 3 * len(speeds) // 4]
    assert min(middle) >= 0.15 / 2**0.5 - 1e-3  # superposition at a right angle: no slower than 1/sqrt(2)


def test_movep_rounds_the_corner_at_constant_speed(rig):
    _, waypoint, _, _ = corner(rig, "movep", 0.03, a=1.2, v=0.15)
    speeds = tool_speeds(rig)
    near = [v for v, at in zip(speeds, places(rig), strict=False) if dist(at, waypoint[:3]) < 0.028]
    assert near
    assert all(v == pytest.approx(0.15, rel=1e-3) for v in near)


def test_without_a_next_move_the_arm_stops_at_the_waypoint(rig):
    waypoint = add(rig.pose(), 0.1)
    rig.finish(rig.commands.movel(waypoint, r=0.03))
    assert not rig.motion.idle
    rig.rest()
    assert rig.pose() == pytest.approx(waypoint, abs=1e-9)
    assert rig.motion.qd == ZERO


def test_a_late_next_move_still_blends(rig):
    waypoint = add(rig.pose(), 0.1)
    rig.finish(rig.commands.movel(waypoint, r=0.05))
    rig.steps(30)
    goal = add(waypoint, 0.0, 0.1)
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert min(tool_speeds(rig)[20:-20]) > 0.01


def test_joint_blend(rig):
    waypoint = (0.9, *START[1:])
    goal = (0.9, -1.1, *START[2:])
    first = rig.commands.movej(waypoint, r=0.1)
    rig.finish(first)
    centre = rig.kinematics.forward(waypoint)
    assert dist(rig.pose()[:3], centre[:3]) == pytest.approx(0.1, abs=2e-3)
    rig.finish(rig.commands.movej(goal))
    assert rig.motion.q == goal
    assert all(max(map(abs, qd)) <= 1.05 * (1 + 1e-6) for qd in rig.qd)
    assert rig.largest_acceleration() <= 1.5 * 1.4 * 2
    assert min(dist(q, waypoint) for q in rig.q) > 0.01


@pytest.mark.parametrize(("first", "second"), [("movej", "movel"), ("movel", "movej")])
def test_blend_between_joint_and_tool_moves(rig, first, second):
    q_way = (0.6, -1.5, 1.6, -1.5, -1.5, 0.2)
    way = rig.kinematics.forward(q_way)
    goal = add(way, 0.0, 0.1, 0.05)
    if first == "movej":
        rig.finish(rig.commands.movej(q_way, r=0.05))
        rig.finish(rig.commands.movel(goal))
        assert rig.pose() == pytest.approx(goal, abs=1e-9)
    else:
        rig.finish(rig.commands.movel(way, r=0.05))
        rig.finish(rig.commands.movej(START))
        assert rig.motion.q == START
    moving = [max(map(abs, qd)) for qd in rig.qd[20:-20]]
    assert min(moving) > 0.01
    assert rig.largest_acceleration() < 15.0


def test_a_chain_of_blends_ends_exactly(rig):
    start = rig.pose()
    corners = [add(start, 0.1), add(start, 0.1, 0.1), add(start, 0.0, 0.1), start]
    for pose in corners[:-1]:
        rig.finish(rig.commands.movel(pose, r=0.02, v=0.2))
    rig.finish(rig.commands.movel(start, v=0.2))
    assert rig.pose() == pytest.approx(start, abs=1e-9)
    assert rig.motion.q == pytest.approx(START, abs=1e-6)
    assert min(tool_speeds(rig)[60:-60]) > 0.1


def codes(rig):
    return [(warning.code, warning.argument) for warning in rig.commands.take_warnings()]


def test_a_radius_larger_than_the_leg_is_cut_to_half_with_a_warning(rig):
    waypoint = add(rig.pose(), 0.1)
    rig.finish(rig.commands.movel(waypoint, r=5.0))
    assert codes(rig) == [(197, 0)]
    assert dist(rig.pose()[:3], waypoint[:3]) == pytest.approx(0.05, abs=1e-3)
    rig.finish(rig.commands.movel(add(waypoint, 0.0, 0.1)))
    assert codes(rig) == [(197, 0)]  # the same blend, at its other end
    assert rig.fault is None


@pytest.mark.parametrize(("command", "argument"), [("movej", 4), ("movel", 11), ("movep", 9), ("movec", 0)])
def test_a_waypoint_whose_blend_overlaps_the_one_before_is_skipped(rig, command, argument):
    """Script Manual, movej: this move will be skipped, with a warning about overlapping blends."""
    start = rig.pose()
    corner, skipped, goal = add(start, 0.1), add(start, 0.1, 0.05), add(start, 0.0, 0.1)
    rig.finish(rig.commands.movel(corner, r=0.03, v=0.2))
    if command == "movec":
        move = rig.commands.movec(add(start, 0.12, 0.03), skipped, r=0.03)
    elif command == "movej":
        move = rig.commands.movej(
            rig.kinematics.inverse_near(skipped, rig.motion.q, rig.model.q_min, rig.model.q_max), r=0.03
        )
    else:
        move = getattr(rig.commands, command)(skipped, r=0.03)
    assert move.ready
    assert codes(rig) == [(171, argument)]
    rig.step()
    rig.finish(rig.commands.movel(goal, v=0.2))
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert min(dist(at, skipped[:3]) for at in places(rig)) > 0.03
    assert min(dist(at, corner[:3]) for at in places(rig)) < 0.03  # and this one is blended with, not skipped
    assert min(tool_speeds(rig)[60:-60]) > 0.02
    assert codes(rig) == []


def test_skipping_the_last_waypoint_leaves_the_arm_at_the_one_before(rig):
    waypoint = add(rig.pose(), 0.1)
    rig.finish(rig.commands.movel(waypoint, r=0.04))
    assert rig.commands.movel(add(waypoint, 0.05), r=0.04).ready
    rig.rest()
    assert rig.pose() == pytest.approx(waypoint, abs=1e-9)


@pytest.mark.parametrize("radius", [0.05, 0.0])
def test_touching_blends_and_waypoints_without_a_blend_are_not_skipped(rig, radius):
    start = rig.pose()
    goal = add(start, 0.1, 0.1)
    rig.finish(rig.commands.movel(add(start, 0.1), r=0.05))
    rig.finish(rig.commands.movel(goal, r=radius))
    rig.rest()
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert codes(rig) == []


def test_a_move_to_the_current_position_causes_no_warning(rig):
    rig.finish(rig.commands.movel(rig.pose(), r=0.05))
    rig.finish(rig.commands.movej(rig.motion.q, r=0.05))
    assert codes(rig) == []


@pytest.mark.parametrize("after", [10, 150, 300])
def test_taking_over_in_mid_motion(rig, after):
    """After `kill` of a moving thread, another one moves the arm from its current position and speed."""
    rig.commands.movej((1.5, -1.2, 1.0, -1.5, -1.9, 0.9))
    rig.steps(after)
    speed = rig.motion.qd
    goal = (0.0, -1.6, 1.7, -1.5, -1.5, 0.2)
    move = rig.commands.movej(goal)
    rig.step()
    assert rig.motion.qd == pytest.approx(speed, abs=0.05)
    rig.finish(move)
    assert rig.motion.q == goal
    assert rig.largest_acceleration() < 20.0


def test_taking_over_by_a_tool_move(rig):
    rig.commands.movej((1.5, -1.2, 1.0, -1.5, -1.9, 0.9))
    rig.steps(200)
    goal = add(rig.pose(), 0.0, 0.0, 0.1)
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert rig.largest_acceleration() < 40.0


def test_a_replaced_move_is_ready(rig):
    old = rig.commands.movej((1.5, *START[1:]))
    rig.steps(10)
    rig.commands.movej(START)
    assert old.ready
