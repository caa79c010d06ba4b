"""Cartesian paths: straight lines of the TCP through waypoints, as far as the arm can follow them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.goals import PoseGoal
from client.planning.industrial import (
    BlendedMotion,
    MotionSequenceItem,
    PlannedSegment,
    blended_motions,
    first_collision,
    interpolator_for,
)
from client.planning.lines import TURN_RAD_M, StraightLine
from client.planning.parameterisation import Array
from client.planning.path import PiecewisePath
from urproto.robots import Joints
from urproto.vectors import as_six

_MIN_STEPS: Final = 10  # over which the average step is taken, as MoveIt's MIN_STEPS_FOR_JUMP_THRESH
_BLEND_SHARE: Final = 0.45  # largest share of a line that the blend at its end may take


@dataclass(frozen=True, slots=True)
class CartesianMotions:
    """The motions between stops, the configuration at the end of each line, the fraction, and why it is below 1."""

    motions: tuple[BlendedMotion, ...]
    waypoints: tuple[Joints, ...]
    fraction: float
    stopped_by: str


def cartesian_motions(
    checker: CollisionChecker,
    start: Joints,
    waypoints: Sequence[Sequence[float]],
    tcp_offset: Sequence[float] | None,
    max_step_m: float,
    jump_thresholds: tuple[float, float],
    avoid_collisions: bool,
    blend_radius_m: float,
) -> CartesianMotions:
    if not len(waypoints):
        raise PlanningError("a Cartesian path needs at least one waypoint")
    interpolator = interpolator_for(checker, PoseGoal(waypoints[0], tcp_offset))
    segments: list[PlannedSegment] = []
    lengths: list[float] = []
    fraction, reason, q = 0.0, "", start
    for number, waypoint in enumerate(waypoints):
        line = StraightLine(interpolator.pose(q), waypoint)
        found = interpolator.interpolate(line, q, max_step_m)
        path, share, reason = found.path, found.reached, found.stopped_by
        if path is not None:
            steps = max(_MIN_STEPS, int(np.ceil(max(line.length_m, line.turn_rad / TURN_RAD_M) / max_step_m)))
            path, share, reason = _truncate(checker, path, share, reason, steps, jump_thresholds, avoid_collisions)
        if path is not None:
            q = as_six(path.at(path.length)[:6])
            segments.append(
                PlannedSegment(path, (segments[-1].waypoints[-1] if segments else start, q), interpolator.pose)
            )
            lengths.append(share * line.length_m)
        fraction = (number + share) / len(waypoints)
        if share < 1.0:
            reason = f"line {number + 1} ends after {100 * share:.1f} % of its length: {reason}"
            break
    radii = [min(blend_radius_m, _BLEND_SHARE * min(pair)) for pair in pairwise(lengths)]
    items = [
        MotionSequenceItem(PoseGoal(pose), "LIN", radius)
        for pose, radius in zip(waypoints, (*radii, *([0.0] if segments else [])), strict=False)
    ]
    parts = tuple(blended_motions(segments, items))
    return CartesianMotions(parts, tuple(segment.waypoints[1] for segment in segments), fraction, reason)


def _truncate(
    checker: CollisionChecker,
    path: PiecewisePath,
    share: float,
    reason: str,
    steps: int,
    jump_thresholds: tuple[float, float],
    avoid_collisions: bool,
) -> tuple[PiecewisePath | None, float, str]:
    """The part of a line before its first jump or collision, its share of the line, and why it ends there."""
    jump = _find_jump(path, max(1, round(steps * share)), jump_thresholds)
    if jump is not None:
        share, angle = jump
        reason = f"a joint would move {angle:.3f} rad in the next step, more than the jump threshold allows"
    near = first_collision(checker, path) if avoid_collisions else None
    if near is not None and path.starts[near[0]] < share:
        share, reason = float(path.starts[near[0]]), checker.violation(near[1])
    return path.subpath(0.0, share) if share > 0.0 else None, share, reason


def _find_jump(path: PiecewisePath, steps: int, thresholds: tuple[float, float]) -> tuple[float, float] | None:
    """Where the first jump is, and the largest joint motion in that step; None for a path without jumps."""
    factor, farthest = thresholds
    samples: Array = np.linspace(0.0, path.length, steps + 1)
    changes = abs(np.diff(path(samples)[0][:, :6], axis=0))
    distances = np.linalg.norm(changes, axis=1)
    jumps = np.zeros(steps, dtype=bool)
    if factor:
        jumps |= distances > factor * distances.mean()
    if farthest:
        jumps |= changes.max(axis=1) > farthest
    if not jumps.any():
        return None
    first = int(np.argmax(jumps))
    return float(samples[first]), float(changes[first].max())
