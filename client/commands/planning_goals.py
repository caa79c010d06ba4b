"""Goals and constraints on the command line of ``ur-client plan``."""

import re
from collections.abc import Sequence
from math import radians
from typing import TYPE_CHECKING, Final

import typer

from urproto.robots.pose import Pose
from urproto.vectors import Vector3

if TYPE_CHECKING:
    from client.planning import (
        Goal,
        JointGoal,
        MotionSequenceItem,
        NamedGoal,
        PathConstraints,
        PlanningScene,
        PoseGoal,
    )

_NUMBERS: Final = re.compile(r"(p?)\[?([^\[\]]*)\]?")
_EXTRA: Final = re.compile(r"\s+(blend|interim|center)=(\S+)$")
_OR: Final = re.compile(r"\s+or\s+")
_KINDS: Final = "six joint angles, a pose p[x,y,z,rx,ry,rz], or a named configuration: home, up, test_configuration"


def parse_item(text: str, planner: str, degrees: bool) -> "MotionSequenceItem":
    """Parse a motion: ``[PLANNER] GOAL [or GOAL]... [blend=R] [interim=x,y,z] [center=x,y,z]``, lengths in m.

    planner: for a motion that names none. degrees: whether joint angles are in degrees. Raises typer.BadParameter,
    PlanningError.
    """
    from client.planning import CircGoal, GoalSet, MotionSequenceItem, PoseGoal
    from client.planning.planner import PLANNERS

    rest, extras = text.strip(), dict[str, str]()
    while found := _EXTRA.search(rest):
        if found[1] in extras:
            raise typer.BadParameter(f"{text!r} has {found[1]} twice")
        extras[found[1]] = found[2]
        rest = rest[: found.start()]
    first, _, after = rest.partition(" ")
    if first in PLANNERS:
        planner, rest = first, after.strip()
    each = [_goal(part, degrees) for part in _OR.split(rest)]
    goal: Goal = each[0] if len(each) == 1 else GoalSet(each)
    points = {name: _parse_vector(extras[name], text) for name in ("interim", "center") if name in extras}
    if points or planner == "CIRC":
        if not isinstance(goal, PoseGoal) or planner != "CIRC":
            raise typer.BadParameter(
                f"{text!r}: for an arc give CIRC p[x,y,z,rx,ry,rz] with interim=x,y,z or center=x,y,z"
            )
        goal = CircGoal(goal.pose, points.get("interim"), points.get("center"))
    blend = numbers(extras["blend"], 1, f"{text!r}: blend is a radius in m")[0] if "blend" in extras else 0.0
    return MotionSequenceItem(goal, planner, blend)


def _goal(text: str, degrees: bool) -> "JointGoal | PoseGoal | NamedGoal":
    from client.planning import NAMED_CONFIGURATIONS, JointGoal, NamedGoal, PoseGoal

    if text in NAMED_CONFIGURATIONS:
        return NamedGoal(text)
    match = _NUMBERS.fullmatch(text)
    if match and match[1]:
        return PoseGoal(numbers(match[2], 6, f"{text!r} is not a goal: give {_KINDS}"))
    return JointGoal(angles(text, degrees))


def angles(text: str, degrees: bool) -> tuple[float, ...]:
    """Parse six joint angles [rad]. Raises typer.BadParameter."""
    match = _NUMBERS.fullmatch(text.strip())
    found = numbers(match[2] if match and not match[1] else "", 6, f"{text!r} is not a goal: give {_KINDS}")
    return tuple(map(radians, found)) if degrees else found


def constraints(
    scene: "PlanningScene", start_rad: Sequence[float], tcp_offset: Pose, orientation: str | None, box: str | None
) -> "PathConstraints | None":
    """The path constraints of the options. orientation: tolerances about the orientation at the start.

    box: edge lengths and centre. Raises typer.BadParameter, PlanningError.
    """
    from client.planning import OrientationConstraint, PathConstraints, PositionConstraint

    if orientation is None and box is None:
        return None
    turned = place = None
    if orientation is not None:
        _, _, _, *turn = scene.kinematics.forward(start_rad, tcp_offset)
        a, b, c = turn
        turned = OrientationConstraint((a, b, c), _parse_vector(orientation, "--keep-orientation"))
    if box is not None:
        x, y, z, *middle = numbers(
            box, 6, f"--keep-within {box!r}: give six numbers, the edge lengths of the box and its centre [m]"
        )
        place = PositionConstraint((x, y, z), (*middle, 0.0, 0.0, 0.0))
    return PathConstraints(turned, place, tcp_offset)


def _parse_vector(text: str, option: str) -> Vector3:
    x, y, z = numbers(text.strip("[]"), 3, f"{option}: {text!r} is not three numbers x,y,z")
    return (x, y, z)


def numbers(text: str, count: int, otherwise: str) -> tuple[float, ...]:
    """Parse this many numbers. otherwise: the message of the typer.BadParameter that it raises if there are not."""
    try:
        values = tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        values = ()
    if len(values) != count:
        raise typer.BadParameter(otherwise)
    return values
