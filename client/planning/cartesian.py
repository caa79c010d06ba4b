"""Straight lines of the TCP through waypoints, as far as they can be followed."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.goals import PoseGoal
from client.planning.industrial import MotionSequenceItem, Run, Segment, blocked, follower_of, runs
from client.planning.lines import TURN_RAD_M, Line
from client.planning.path import PiecewisePath
from client.planning.timing import Array
from urproto.robots import Joints

_FEWEST: Final = 10  # steps of which an average is taken, as MoveIt's MIN_STEPS_FOR_JUMP_THRESH
_BLEND_SHARE: Final = 0.45  # of a line that a blend at its end may take

AnyPlan = TypeVar("AnyPlan")


class CartesianPath(NamedTuple, Generic[AnyPlan]):
    """What `Planner.compute_cartesian_path` gives: what can be executed, and what fraction of the waypoints it is."""

    plan: AnyPlan
    fraction: float


@dataclass(frozen=True, slots=True)
class CartesianRuns:
    """The motions without a stop, the joint angles at the end of each line, the fraction, and why it is below 1."""

    runs: tuple[Run, ...]
    way: tuple[Joints, ...]
    fraction: float
    stopped_by: str


def cartesian_runs(
    checker: CollisionChecker,
    start: Joints,
    waypoints: Sequence[Sequence[float]],
    tcp_offset: Sequence[float] | None,
    max_step_m: float,
    jump_thresholds: tuple[float, float],
    avoid_collisions: bool,
    blend_radius_m: float,
) -> CartesianRuns:
    """See `Planner.compute_cartesian_path`."""
    _check(waypoints, max_step_m, jump_thresholds, blend_radius_m)
    follower = follower_of(checker, PoseGoal((), tcp_offset))
    segments: list[Segment] = []
    lengths: list[float] = []
    fraction, why, q = 0.0, "", start
    for number, waypoint in enumerate(waypoints):
        line = Line(follower.pose(q), waypoint)
        found = follower.follow(line, q, max_step_m)
        path, share, why = found.path, found.reached, found.stopped_by
        if path is not None:
            steps = max(_FEWEST, int(np.ceil(max(line.length_m, line.turn_rad / TURN_RAD_M) / max_step_m)))
            path, share, why = _cut(checker, path, share, why, steps, jump_thresholds, avoid_collisions)
        if path is not None:
            a, b, c, d, e, f = path.at(path.length)[:6].tolist()
            q = (a, b, c, d, e, f)
            segments.append(Segment(path, (segments[-1].way[-1] if segments else start, q), follower.pose))
            lengths.append(share * line.length_m)
        fraction = (number + share) / len(waypoints)
        if share < 1.0:
            why = f"line {number + 1} ends after {100 * share:.1f} % of its way: {why}"
            break
    radii = [min(blend_radius_m, _BLEND_SHARE * min(pair)) for pair in pairwise(lengths)]
    items = [MotionSequenceItem(PoseGoal(()), "LIN", radius) for radius in (*radii, *([0.0] if segments else []))]
    parts = tuple(runs(segments, items))
    return CartesianRuns(parts, tuple(segment.way[1] for segment in segments), fraction, why)


def _check(
    waypoints: Sequence[Sequence[float]], max_step_m: float, jump_thresholds: tuple[float, float], radius_m: float
) -> None:
    if not waypoints:
        raise PlanningError("a Cartesian path has at least one waypoint")
    for number, pose in enumerate(waypoints, 1):
        if len(pose) != 6 or not all(map(isfinite, pose)):
            raise PlanningError(f"waypoint {number} is not six finite numbers: {list(pose)}")
    if not (isfinite(max_step_m) and max_step_m > 0.0):
        raise PlanningError(f"the largest step is above 0 m, not {max_step_m}")
    for value in (*jump_thresholds, radius_m):
        if not (isfinite(value) and value >= 0.0):
            raise PlanningError(f"jump thresholds and blend radius are 0 or above, not {value}")


def _cut(
    checker: CollisionChecker,
    path: PiecewisePath,
    share: float,
    why: str,
    steps: int,
    jump_thresholds: tuple[float, float],
    avoid_collisions: bool,
) -> tuple[PiecewisePath | None, float, str]:
    """As much of a line as has neither a jump nor a collision."""
    jump = _jump(path, max(1, round(steps * share)), jump_thresholds)
    if jump is not None:
        share, angle = jump
        why = f"a joint would go {angle:.3f} rad in the next step, more than the jump threshold allows"
    near = blocked(checker, path) if avoid_collisions else None
    if near is not None and path.starts[near[0]] < share:
        share, why = float(path.starts[near[0]]), checker.objection(near[1])
    return path.part(0.0, share) if share > 0.0 else None, share, why


def _jump(path: PiecewisePath, steps: int, thresholds: tuple[float, float]) -> tuple[float, float] | None:
    """Where the joints jump, and how far one of them goes in that step; None for a path without jumps."""
    factor, farthest = thresholds
    places: Array = np.linspace(0.0, path.length, steps + 1)
    changes = abs(np.diff(path(places)[0][:, :6], axis=0))
    ways = np.linalg.norm(changes, axis=1)
    jumps = np.zeros(steps, dtype=bool)
    if factor:
        jumps |= ways > factor * ways.mean()
    if farthest:
        jumps |= changes.max(axis=1) > farthest
    if not jumps.any():
        return None
    first = int(np.argmax(jumps))
    return float(places[first]), float(changes[first].max())
