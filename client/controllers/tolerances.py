"""How far the arm may be from where it is meant to be, on the way and at the end.

0 stands for no limit, as in a controllers file. What a goal says replaces it: a positive number
is the limit, -1 takes the limit away, 0 leaves it. Source: control_msgs/JointTolerance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from client.controllers.goals import FollowJointTrajectory, JointTrajectoryPoint, Tolerance

__all__ = ["ToleranceError", "Tolerances", "violation", "with_goal"]

_ANY: Final = -1.0


class ToleranceError(ValueError):
    """A goal's tolerance makes no sense."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Of the joints in the controller's order (n,): on the way, at the end; goal_time_s [s] after the end."""

    path: tuple[Tolerance, ...]
    goal: tuple[Tolerance, ...]
    goal_time_s: float = 0.0


def with_goal(defaults: Tolerances, goal: FollowJointTrajectory, joints: Sequence[str]) -> Tolerances:
    """The tolerances of a goal. Raises ToleranceError."""
    return Tolerances(
        _merged(defaults.path, goal.path_tolerance, joints, "path"),
        _merged(defaults.goal, goal.goal_tolerance, joints, "goal"),
        _limit(defaults.goal_time_s, goal.goal_time_tolerance_s, "goal time"),
    )


def _merged(
    defaults: Sequence[Tolerance], given: Mapping[str, Tolerance], joints: Sequence[str], kind: str
) -> tuple[Tolerance, ...]:
    if unknown := [name for name in given if name not in joints]:
        raise ToleranceError(f"the {kind} tolerance names the joint {unknown[0]}, which the controller does not have")
    return tuple(
        _one(default, given.get(joint, Tolerance()), f"{kind} tolerance of {joint}")
        for default, joint in zip(defaults, joints, strict=True)
    )


def _one(default: Tolerance, given: Tolerance, what: str) -> Tolerance:
    return Tolerance(
        _limit(default.position, given.position, what),
        _limit(default.velocity, given.velocity, what),
        _limit(default.acceleration, given.acceleration, what),
    )


def _limit(default: float, given: float, what: str) -> float:
    if given > 0.0:
        return given
    if given == _ANY:
        return 0.0
    if given == 0.0:
        return default
    raise ToleranceError(f"the {what} is {given}: give a positive number, 0 for the default or -1 for none")


def violation(error: JointTrajectoryPoint, limits: Sequence[Tolerance], joints: Sequence[str]) -> str | None:
    """The first joint that is too far off, in words; None when all are within their limits."""
    for values, kind in (
        (error.positions, "position"),
        (error.velocities, "velocity"),
        (error.accelerations, "acceleration"),
    ):
        for value, limit, joint in zip(values, limits, joints, strict=False):
            allowed = getattr(limit, kind)
            if allowed > 0.0 and abs(value) > allowed:
                return f"{joint}: {kind} error {value:.4f}, tolerance {allowed:g}"
    return None
