"""movej, movel, movep, movec: durations, final positions and paths."""

from math import cos, dist, pi, sin, sqrt

import pytest

from tests.rows import each_row

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig

TICK = 0.002


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def trapezoid(length, v, a):
    return length / v + v / a if length > v * v / a else 2 * sqrt(length / a)


@pytest.mark.parametrize(("a", "v"), [(1.4, 1.05), (5.0, 2.0), (40.0, 3.0)])
def test_the_duration_of_movej_is_that_of_its_leading_joint(rig, a, v):
    goal = (1.5, -1.2, 1.0, -1.5, -1.9, 0.9)
    taken = rig.finish(rig.commands.movej(goal, a=a, v=v))
    assert taken == pytest.approx(trapezoid(1.2, v, a), abs=TICK)
    assert rig.motion.q == goal
    assert rig.motion.qd == ZERO
    assert rig.motion.idle
    assert rig.largest_acceleration() <= 1.5 * a * 1.01  # speeds are means of a period, and the last one is 0


def test_movej_joints_are_synchronised(rig):
    goal = (1.3, -1.1, 1.7, -1.5, -1.5, 0.2)
    rig.finish(rig.commands.movej(goal))
    for q in rig.q:
        assert (q[0] - START[0]) / 1.0 == pytest.approx((q[1] - START[1]) / 0.5, abs=1e-12)


def test_movej_with_excessive_speeds_keeps_joint_limits(make_rig):
    rig = make_rig("ur3")  # shoulder half as fast as wrists
    goal = (START[0] + 1, START[1], START[2], START[3], START[4], START[5] + 2)
    taken = rig.finish(rig.commands.movej(goal, a=1000, v=100))
    assert taken == pytest.approx(trapezoid(2.0, 2 * pi, 80.0), abs=TICK)  # of the wrist


@pytest.mark.parametrize("t", [0.5, 2.0, 7.0])
def test_movej_in_a_given_time(rig, t):
    taken = rig.finish(rig.commands.movej((1.0, *START[1:]), a=0.001, v=0.001, t=t))
    assert taken == pytest.approx(t, abs=TICK)


def test_movej_in_too_short_a_time_is_stretched(rig):
    """An integration test of the official client library commands 3.14 rad in 0.1 s and expects success."""
    taken = rig.finish(rig.commands.movej((START[0] + 3.14, *START[1:]), t=0.1))
    assert taken == pytest.approx(trapezoid(3.14, pi, 40.0), abs=TICK)
    assert rig.fault is None


@each_row("name", ["ur3", "ur5e", "ur10e", "ur16e", "ur20"])
def test_movel_goes_straight(make_rig, name):
    rig = make_rig(name)
    start = rig.pose()
    goal = add(start, 0.05, 0.04, -0.03)
    taken = rig.finish(rig.commands.movel(goal, a=1.0, v=0.2))
    assert taken == pytest.approx(trapezoid(sqrt(0.005), 0.2, 1.0), abs=TICK)
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert rig.motion.qd == ZERO
    assert rig.motion.idle
    for q in rig.q[::10]:
        at = rig.kinematics.forward(q, ZERO)
        assert dist(start[:3], at[:3]) + dist(at[:3], goal[:3]) == pytest.approx(dist(start[:3], goal[:3]), abs=1e-9)


def test_movel_uses_the_tcp(rig):
    rig.motion.tcp_offset = (0.0, 0.0, 0.15, 0.0, 0.3, 0.0)
    goal = add(rig.pose(), 0.0, 0.1, 0.0)
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert rig.motion.target_waypoint == pytest.approx(goal)


def test_movel_in_too_short_a_time_is_stretched(rig):
    """As for movej: 0.23 m in 0.1 s."""
    goal = add(rig.pose(), 0.0, 0.23, 0.0)
    assert rig.finish(rig.commands.movel(goal, t=0.1)) < 0.5
    assert rig.fault is None
    assert rig.pose() == pytest.approx(goal, abs=1e-9)


def test_pure_rotation_takes_time_by_the_equivalent_radius(rig):
    start = rig.pose()
    rig.motion.tcp_offset = ZERO
    goal = rig.kinematics.forward((*START[:5], START[5] + 1.0), ZERO)
    taken = rig.finish(rig.commands.movel(goal, a=1.2, v=0.25))
    assert taken == pytest.approx(trapezoid(rig.model.eq_radius * 1.0, 0.25, 1.2), abs=TICK)
    assert rig.pose()[:3] == pytest.approx(start[:3], abs=1e-9)
    assert rig.motion.q == pytest.approx((*START[:5], START[5] + 1.0), abs=1e-6)


def test_movec_stays_on_the_circle(rig):
    start = rig.pose()
    radius = 0.06
    centre = add(start, -radius)
    via = add(centre, radius * cos(1.0), radius * sin(1.0), 0.0)
    goal = add(centre, radius * cos(3.0), radius * sin(3.0), 0.0)
    taken = rig.finish(rig.commands.movec(via, goal, a=1.0, v=0.1))
    assert taken == pytest.approx(trapezoid(3.0 * radius, 0.1, 1.0), abs=TICK)
    assert rig.pose() == pytest.approx(goal, abs=1e-9)
    assert all(dist(rig.kinematics.forward(q)[:3], centre[:3]) == pytest.approx(radius, abs=1e-9) for q in rig.q[::10])


def test_movec_in_fixed_mode_turns_the_tool_with_the_arc(rig):
    start = rig.pose()
    radius = 0.06
    centre = add(start, -radius)
    via = add(centre, radius * cos(0.5), radius * sin(0.5), 0.0)
    goal = add(centre, 0.0, radius, 0.0)  # a quarter turn about the base's z
    rig.finish(rig.commands.movec(via, goal, mode=1))
    rig.motion.tcp_offset = ZERO
    turned = rig.kinematics.forward((START[0] + pi / 2, *START[1:]))
    assert rig.pose()[3:] == pytest.approx(turned[3:], abs=1e-9)
    assert rig.pose()[:3] == pytest.approx(goal[:3], abs=1e-9)


def test_movec_over_three_points_on_a_line_is_a_line(rig):
    start = rig.pose()
    goal = add(start, 0.1)
    rig.finish(rig.commands.movec(add(start, 0.05), goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-9)


@pytest.mark.parametrize(
    "command", ["movej", "movel", "movep", "movec", "servoc", "stopj", "stopl", "servoj", "speedj"]
)
def test_a_move_to_the_current_position_takes_one_period(rig, command):
    motion, here = rig.motion, rig.pose()
    move = {
        "movej": lambda: motion.commands.movej(START, t=3.0),
        "movel": lambda: motion.commands.movel(here),
        "movep": lambda: motion.commands.movep(here),
        "movec": lambda: motion.commands.movec(here, here),
        "servoc": lambda: motion.commands.servoc(here),
        "servoj": lambda: motion.commands.servoj(START, t=0.0),
        "speedj": lambda: motion.commands.speedj(ZERO, a=1.0),
        "stopj": lambda: motion.commands.stopj(2.0),
        "stopl": lambda: motion.commands.stopl(2.0),
    }[command]()
    assert not move.ready
    assert rig.finish(move) == TICK
    assert motion.qd == ZERO
    assert motion.idle
    assert motion.q == pytest.approx(START, abs=1e-12)


@pytest.mark.parametrize("command", ["movel", "movep", "servoc", "movec"])
def test_out_of_reach_is_a_fault(rig, command):
    far = (10.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    move = rig.commands.movec(add(rig.pose(), 0.1), far) if command == "movec" else getattr(rig.commands, command)(far)
    assert move.failed is not None
    assert (move.failed.code, move.failed.argument) == (204, 3)
    assert rig.motion.advance(1.0) is move.failed
    assert rig.motion.advance(1.0) is None  # reported once
    assert rig.motion.idle
    assert rig.motion.q == START


def test_a_path_that_leaves_the_workspace_brakes(rig):
    """Both ends can be reached, the middle of the straight line cannot: it runs through the base."""
    start = rig.pose()
    goal = rig.kinematics.forward((START[0] + pi, *START[1:]))
    move = rig.commands.movel(goal, v=0.5)
    rig.finish(move)
    assert move.failed is not None
    assert rig.rest() < 0.2
    assert dist(start[:3], rig.pose()[:3]) > 0.05


@pytest.mark.parametrize("joint", range(6))
def test_joint_target_outside_the_range_is_a_fault(rig, joint):
    goal = tuple(-123.0 if i == joint else q for i, q in enumerate(START))
    move = rig.commands.movej(goal)
    assert move.failed is not None
    assert (move.failed.code, move.failed.joint) == (150, joint)
    assert rig.motion.advance(1.0) is move.failed


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_not_a_number_is_a_fault(rig, bad):
    here = rig.pose()
    for move in (
        rig.commands.movej((bad, *START[1:])),
        rig.commands.movel((bad, *here[1:])),
        rig.commands.servoj((bad, *START[1:]), t=0.1),
        rig.commands.speedj((bad, 0, 0, 0, 0, 0), a=1.0),
        rig.commands.speedl((bad, 0, 0, 0, 0, 0), a=1.0),
        rig.commands.movej(START, a=bad),
        rig.commands.stopj(bad),
    ):
        assert move.failed is not None
    assert rig.motion.advance(1.0) is not None
    assert rig.motion.q == START


def test_an_unlimited_wrist_turns_further_than_the_others(make_rig):
    rig = make_rig("ur3e")
    assert rig.model.wrist3_unlimited
    goal = (*START[:5], 20.0)
    move = rig.commands.movej(goal, v=6.0, a=30.0)
    while not move.ready:
        assert rig.motion.advance(1.0) is None
    assert rig.motion.q == goal
