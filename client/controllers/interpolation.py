"""Polynomials between two points of a trajectory, of the degree that the points determine.

Positions alone: linear. With velocities: cubic. With accelerations too: quintic. Source of the
rule: documentation of ros2_controllers, "Trajectory Representation"; the polynomials are those
that meet the given values at both ends.
"""

from collections.abc import Sequence
from dataclasses import replace

from client.controllers.goals import JointTrajectoryPoint

__all__ = ["Segment", "complete"]

Coefficients = tuple[float, float, float, float, float, float]


class Segment:
    """The motion from one point to the next: joints (n,), time [s] counted from the first one."""

    __slots__ = ("_duration_s", "_effort", "_polynomials")

    def __init__(self, first: JointTrajectoryPoint, second: JointTrajectoryPoint, duration_s: float) -> None:
        self._duration_s = duration_s
        self._polynomials = _polynomials(first, second, duration_s)
        self._effort = _lines(first.effort, second.effort, duration_s) if first.effort and second.effort else ()

    def at(self, t: float) -> JointTrajectoryPoint:
        """Positions, velocities and accelerations after ``t`` seconds, and effort where both ends have it."""
        t = min(max(t, 0.0), self._duration_s)
        q, qd, qdd = [], [], []
        for c0, c1, c2, c3, c4, c5 in self._polynomials:
            q.append(((((c5 * t + c4) * t + c3) * t + c2) * t + c1) * t + c0)
            qd.append((((5.0 * c5 * t + 4.0 * c4) * t + 3.0 * c3) * t + 2.0 * c2) * t + c1)
            qdd.append(((20.0 * c5 * t + 12.0 * c4) * t + 6.0 * c3) * t + 2.0 * c2)
        effort = tuple(start + slope * t for start, slope in self._effort)
        return JointTrajectoryPoint(tuple(q), tuple(qd), tuple(qdd), effort)


def _polynomials(first: JointTrajectoryPoint, second: JointTrajectoryPoint, duration_s: float) -> list[Coefficients]:
    has_speeds = bool(first.velocities and second.velocities)
    if has_speeds and first.accelerations and second.accelerations:
        ends = zip(
            first.positions,
            second.positions,
            first.velocities,
            second.velocities,
            first.accelerations,
            second.accelerations,
            strict=True,
        )
        return [_quintic(q0, q1, v0, v1, a0, a1, duration_s) for q0, q1, v0, v1, a0, a1 in ends]
    if has_speeds:
        cubic_ends = zip(first.positions, second.positions, first.velocities, second.velocities, strict=True)
        return [_cubic(*values, duration_s) for values in cubic_ends]
    lines = _lines(first.positions, second.positions, duration_s)
    return [(start, slope, 0.0, 0.0, 0.0, 0.0) for start, slope in lines]


def _lines(first: Sequence[float], second: Sequence[float], duration_s: float) -> tuple[tuple[float, float], ...]:
    slopes = ((b - a) / duration_s if duration_s > 0.0 else 0.0 for a, b in zip(first, second, strict=True))
    return tuple(zip(first, slopes, strict=True))


def _cubic(q0: float, q1: float, v0: float, v1: float, duration_s: float) -> Coefficients:
    if duration_s <= 0.0:
        return (q0, v0, 0.0, 0.0, 0.0, 0.0)
    mean = (q1 - q0) / duration_s
    c2 = (3.0 * mean - 2.0 * v0 - v1) / duration_s
    c3 = (v0 + v1 - 2.0 * mean) / duration_s**2
    return (q0, v0, c2, c3, 0.0, 0.0)


def _quintic(q0: float, q1: float, v0: float, v1: float, a0: float, a1: float, duration_s: float) -> Coefficients:
    t = duration_s
    if t <= 0.0:
        return (q0, v0, 0.5 * a0, 0.0, 0.0, 0.0)
    # what is missing at the end when the motion goes on with the first three terms
    gap_q = q1 - q0 - v0 * t - 0.5 * a0 * t * t
    gap_v = (v1 - v0 - a0 * t) * t
    gap_a = (a1 - a0) * t * t
    c3 = (10.0 * gap_q - 4.0 * gap_v + 0.5 * gap_a) / t**3
    c4 = (-15.0 * gap_q + 7.0 * gap_v - gap_a) / t**4
    c5 = (6.0 * gap_q - 3.0 * gap_v + 0.5 * gap_a) / t**5
    return (q0, v0, 0.5 * a0, c3, c4, c5)


def complete(
    first: JointTrajectoryPoint, second: JointTrajectoryPoint, duration_s: float
) -> tuple[JointTrajectoryPoint, JointTrajectoryPoint]:
    """Both points with the positions that the second one's derivatives lead to, by Heun's method.

    A point with positions is left alone. The first one may get speeds or accelerations of zero,
    so that the degree of the polynomial is that of what is given.
    """
    if second.positions:
        return first, second
    count = len(first.positions)
    zeros = (0.0,) * count
    first = replace(first, velocities=first.velocities or zeros)
    if not second.velocities:
        first = replace(first, accelerations=first.accelerations or zeros)
        second = replace(
            second, velocities=_heun(first.velocities, first.accelerations, second.accelerations, duration_s)
        )
    return first, replace(second, positions=_heun(first.positions, first.velocities, second.velocities, duration_s))


def _heun(
    start: Sequence[float], rate_0: Sequence[float], rate_1: Sequence[float], duration_s: float
) -> tuple[float, ...]:
    return tuple(x + (a + b) * 0.5 * duration_s for x, a, b in zip(start, rate_0, rate_1, strict=True))
