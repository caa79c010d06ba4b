"""A trajectory being followed: can be sampled at any time, and begins at the arm's position at its start."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

from client.controllers.goals import JointTrajectory, JointTrajectoryPoint


def filled(trajectory: JointTrajectory, joints: Sequence[str], hold_rad: Sequence[float]) -> list[JointTrajectoryPoint]:
    """Points of a trajectory for all joints; joints that it does not name stay at ``hold_rad`` (n,)."""
    holding = JointTrajectoryPoint(tuple(hold_rad), *((0.0,) * len(joints),) * 3)
    return [_merged(point, trajectory.joint_names, joints, holding) for point in trajectory.points]


def blended(
    trajectory: JointTrajectory, joints: Sequence[str], path: "Path", cursor_s: float, begin_s: float
) -> tuple[list[JointTrajectoryPoint], int] | None:
    """Points that lead from the path into a new trajectory, timed from ``cursor_s``, and how many of them are old.

    cursor_s: how far the path has been followed; begin_s: where the trajectory begins; both in the path's time. None if
    the trajectory leaves out joints whose final position is not known.
    """
    named = set(trajectory.joint_names)
    partial = len(named) < len(joints)
    if partial and not trajectory.points[-1].positions:
        return None
    bridge_s = max(begin_s, cursor_s)
    bridge = path.sample(bridge_s)
    new = []
    for point in trajectory.points:
        due_s = begin_s + point.time_from_start_s
        if due_s > bridge_s or point is trajectory.points[-1]:
            old = path.sample(due_s) if partial else None
            place = old.point if old else JointTrajectoryPoint((0.0,) * len(joints))
            new.append(_at(_merged(point, trajectory.joint_names, joints, place), due_s - cursor_s))
    prefix = [_at(point, due_s - cursor_s) for due_s, point in path.due() if cursor_s < due_s < bridge_s]
    if bridge is not None and bridge_s - cursor_s < new[0].time_from_start_s:
        prefix.append(_at(bridge.point, bridge_s - cursor_s))
    end_s = cursor_s + new[-1].time_from_start_s
    rest = [(due_s, point) for due_s, point in path.due() if due_s > end_s] if partial else []
    suffix = [_at(_holding_positions(point, new[-1], joints, named), due_s - cursor_s) for due_s, point in rest]
    return [*prefix, *new, *suffix], len(prefix)


def _merged(
    point: JointTrajectoryPoint, names: Sequence[str], joints: Sequence[str], others: JointTrajectoryPoint
) -> JointTrajectoryPoint:
    """Sort a point into the order of the joints; values of joints that it does not name come from ``others``."""

    def merged(values: Sequence[float], rest: Sequence[float]) -> tuple[float, ...]:
        if not values:
            return ()
        by_name = dict(zip(names, values, strict=True))
        return tuple(by_name.get(joint, rest[place] if rest else 0.0) for place, joint in enumerate(joints))

    return JointTrajectoryPoint(
        merged(point.positions, others.positions),
        merged(point.velocities, others.velocities),
        merged(point.accelerations, others.accelerations),
        merged(point.effort, others.effort),
        point.time_from_start_s,
    )


def _holding_positions(
    point: JointTrajectoryPoint, last: JointTrajectoryPoint, joints: Sequence[str], named: set[str]
) -> JointTrajectoryPoint:
    """A point at which the named joints rest at their final positions."""
    commanded = [joint in named for joint in joints]

    def merged(values: Sequence[float], ends: Sequence[float]) -> tuple[float, ...]:
        pairs = zip(commanded, values, ends or (0.0,) * len(joints), strict=True) if values else ()
        return tuple(end if held else value for held, value, end in pairs)

    return replace(
        point,
        positions=merged(point.positions, last.positions),
        velocities=merged(point.velocities, ()),
        accelerations=merged(point.accelerations, ()),
    )


def _at(point: JointTrajectoryPoint, time_from_start_s: float) -> JointTrajectoryPoint:
    return replace(point, time_from_start_s=time_from_start_s)


Coefficients = tuple[float, float, float, float, float, float]


class SplineSegment:
    """The motion from one point to the next: joints (n,), time [s] counted from the first one."""

    __slots__ = ("_duration_s", "_effort", "_polynomials")

    def __init__(self, first: JointTrajectoryPoint, second: JointTrajectoryPoint, duration_s: float) -> None:
        self._duration_s = duration_s
        self._polynomials = _polynomials(first, second, duration_s)
        self._effort = _lines(first.effort, second.effort, duration_s) if first.effort and second.effort else ()

    def at(self, t: float) -> JointTrajectoryPoint:
        """Positions, velocities and accelerations after ``t`` seconds, and effort if both ends have it."""
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
    # what is missing at the end if the motion continues with the first three terms only
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
    """Complete the second point with the positions that its derivatives lead to, by Heun's method.

    A point with positions is unchanged. The first point may get velocities or accelerations of zero, so that the degree
    of the polynomial matches the given values.
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


@dataclass(frozen=True, slots=True)
class Sample:
    """Desired state of the joints.

    index: index of the next point; after the last point, the number of points. since_s: time since the last point that
    was passed [s], negative before the first one.
    """

    point: JointTrajectoryPoint
    index: int
    since_s: float


class Path:
    """Timed points (positions, velocities, accelerations in the order of the controller's joints).

    stamp_s: start time, by the clock used for sampling; 0 starts with the first sample. splines: False returns each
    point without interpolation, from the moment at which the previous one has been passed.
    """

    def __init__(self, points: Sequence[JointTrajectoryPoint], stamp_s: float = 0.0, *, splines: bool = True) -> None:
        self.points = list(points)
        self.start_s = stamp_s
        self.begun = False
        self._splines = splines
        self._before = JointTrajectoryPoint()
        self._before_s = 0.0
        self._times: list[float] = []
        self._segment: tuple[int, SplineSegment] | None = None

    @property
    def size(self) -> int:
        return len(self.points)

    def begin(self, time_s: float, now: JointTrajectoryPoint, before_s: float | None = None) -> None:
        """Start at ``time_s`` from the state ``now``, which the arm had at ``before_s`` (by default ``time_s``)."""
        self.begun = True
        if self.start_s == 0.0:
            self.start_s = time_s
        first = self.points[0]
        zeros = (0.0,) * len(now.positions)
        # gives the segment to the first point a polynomial of the same degree as the others
        if first.velocities and not now.velocities:
            now = replace(now, velocities=zeros)
        if first.accelerations and not now.accelerations:
            now = replace(now, accelerations=zeros)
        self._before, self._before_s = now, time_s if before_s is None else before_s
        self._times = [self.start_s + point.time_from_start_s for point in self.points]
        if self._splines:
            self._complete()

    def _complete(self) -> None:
        if all(point.positions for point in self.points):
            return
        before, before_s = self._before, self._before_s
        for index, point in enumerate(self.points):
            before, self.points[index] = complete(before, point, self._times[index] - before_s)
            if index == 0:
                self._before = before
            else:
                self.points[index - 1] = before
            before, before_s = self.points[index], self._times[index]

    def sample(self, time_s: float) -> Sample | None:
        """Desired state at a time; None before the start, and if positions are unknown."""
        if time_s < self._before_s:
            return None
        index = bisect_right(self._times, time_s)
        passed_s = self._times[max(index - 1, 0)]
        if index == self.size:
            point = self.last()
        elif self._splines:
            point = self._between(index, time_s)
        else:
            point = self._before if index == 0 else self.points[index]
        return Sample(point, index, time_s - passed_s) if point.positions else None

    def due(self) -> list[tuple[float, JointTrajectoryPoint]]:
        """The points, each with its time; available after the start."""
        return list(zip(self._times, self.points, strict=True))

    def last(self) -> JointTrajectoryPoint:
        """The last point, with zero velocities and accelerations if it has none."""
        point = self.points[-1]
        zeros = (0.0,) * len(point.positions)
        return replace(point, velocities=point.velocities or zeros, accelerations=point.accelerations or zeros)

    def _between(self, index: int, time_s: float) -> JointTrajectoryPoint:
        before_s = self._times[index - 1] if index else self._before_s
        if self._segment is None or self._segment[0] != index:
            before = self.points[index - 1] if index else self._before
            self._segment = index, SplineSegment(before, self.points[index], self._times[index] - before_s)
        return self._segment[1].at(time_s - before_s)
