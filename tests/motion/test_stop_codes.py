"""The code of a stop is the one that people search for: what a movement does wrong, and what it is then called.

Sources of the codes are beside the faults in `emulator.motion.faults`.
"""

from math import inf, nan, radians

import pytest

from emulator.motion.faults import Singularity
from emulator.motion.reach import distance_to_singularity, singularity
from tests.rows import each_row
from urproto.robots.model import load_model


def degrees(*angles):
    return tuple(radians(angle) for angle in angles)


BENT = degrees(0, -60, 80, -110, -90, 0)
STRETCHED = degrees(0, -90, 0, -90, 0, 0)  # a home pose of many programs, and URSim's start pose
STRETCHED_ELBOW = degrees(0, -60, 0, -90, -90, 0)
SINGULAR_WRISTS = (degrees(0, -90, 90, -90, 0, 0), degrees(30, -60, 80, -110, 180, 20))
SHIFTS = ((0.0, 0.05, 0.0), (0.05, 0.0, 0.0), (0.0, 0.0, -0.05), (0.0, 0.001, 0.0))


def label(fault):
    return None if fault is None else f"C{fault.code}A{fault.argument}"


def moved(rig, by):
    return [place + change for place, change in zip(rig.pose(), (*by, 0.0, 0.0, 0.0), strict=True)]


def outcome(rig, move):
    """The code of the stop, once the move is over."""
    rig.finish(move)
    rig.rest()
    return label(move.failed)


@each_row("shift", SHIFTS)
@each_row("q", [STRETCHED, STRETCHED_ELBOW])
@each_row("command", ["movel", "movep"])
def test_a_straight_move_of_the_stretched_arm(make_rig, command, q, shift):
    """However short, and inwards too: users of URSim 5.12 and 5.26."""
    rig = make_rig(q=q)
    assert outcome(rig, getattr(rig.commands, command)(moved(rig, shift))) == "C154A0"
    assert rig.motion.q == q


def test_an_arc_of_the_stretched_arm(make_rig):
    rig = make_rig(q=STRETCHED)
    via, to = moved(rig, (0.02, 0.0, -0.02)), moved(rig, (0.04, 0.0, -0.06))
    assert outcome(rig, rig.commands.movec(via, to)) == "C154A0"


@each_row("shift", SHIFTS)
@each_row("q", SINGULAR_WRISTS)
def test_a_straight_move_with_a_singular_wrist_only(make_rig, q, shift):
    """The controller's inverse kinematics continues with another wrist: a sudden change in target position."""
    rig = make_rig(q=q)
    assert outcome(rig, rig.commands.movel(moved(rig, shift))) == "C204A1"


def test_a_movej_leaves_a_singularity_and_a_straight_move_follows(make_rig):
    rig = make_rig(q=STRETCHED)
    assert outcome(rig, rig.commands.movej(BENT)) is None
    assert outcome(rig, rig.commands.movel(moved(rig, (0.0, 0.05, 0.0)))) is None


def test_a_straight_move_to_where_the_arm_is(make_rig):
    rig = make_rig(q=STRETCHED)
    assert outcome(rig, rig.commands.movel(rig.pose())) is None


def test_a_line_through_a_singularity(make_rig):
    """The wrist passes right above the base joint's axis on its way, or leaves the workspace there."""
    rig = make_rig(q=degrees(0, -95, 140, -135, -90, 0))
    x, y, *rest = rig.pose()
    for aside in (0.0, 0.05, 0.2):
        rig = make_rig(q=degrees(0, -95, 140, -135, -90, 0))
        assert outcome(rig, rig.commands.movel((-x, aside - y, *rest), v=0.1)) == "C154A0"


@each_row("direction", [(-0.3, 0, 0.3), (-0.5, 0, 0), (0, 0, 0.5), (0.1, 0.3, 0)])
def test_speedl_until_the_arm_is_stretched(make_rig, direction):
    rig = make_rig(q=BENT)
    rig.commands.speedl((*direction, 0, 0, 0), a=1.0)
    for _ in range(8000):
        rig.step()
        if rig.fault:
            break
    assert label(rig.fault) == "C154A0"


@each_row("command", ["movel", "movep", "servoc"])
def test_a_goal_out_of_reach(make_rig, command):
    rig = make_rig(q=BENT)
    assert outcome(rig, getattr(rig.commands, command)(moved(rig, (-1.0, 0.0, 0.0)))) == "C204A3"


@pytest.mark.parametrize("number", [nan, inf])
def test_a_number_that_is_none(make_rig, number):
    rig = make_rig(q=BENT)
    assert outcome(rig, rig.commands.movel([number, *rig.pose()[1:]])) == "C204A5"
    assert outcome(rig, rig.commands.servoj((number, *BENT[1:]), t=0.002)) == "C204A5"


def test_a_joint_beyond_its_limit(make_rig):
    rig = make_rig(q=BENT)
    assert outcome(rig, rig.commands.movej((7.0, *BENT[1:]))) == "C150A0"


@each_row(
    ("q", "kind"),
    [
        (STRETCHED, Singularity.ELBOW),
        (STRETCHED_ELBOW, Singularity.ELBOW),
        (SINGULAR_WRISTS[0], Singularity.WRIST),
        (SINGULAR_WRISTS[1], Singularity.WRIST),
        (degrees(0, -60, 80, -110, 0.2, 0), None),
        (degrees(0, -60, 0.2, -110, -90, 0), None),
        (BENT, None),
    ],
)
def test_the_singularity_that_an_arm_is_in(q, kind):
    dh = load_model("ur5e").dh
    assert singularity(dh, q) is kind
    assert (distance_to_singularity(dh, q) < 1e-3) is (kind is not None)
