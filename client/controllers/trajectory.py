"""A trajectory that is being followed: sampled at any time, from where the arm was when it began."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

from client.controllers.goals import JointTrajectoryPoint
from client.controllers.interpolation import Segment, complete

__all__ = ["Path", "Sample"]


@dataclass(frozen=True, slots=True)
class Sample:
    """Where the joints are meant to be.

    index: the point that comes next; the number of points after the last one. since_s: time
    since the last point that was passed, negative before the first one.
    """

    point: JointTrajectoryPoint
    index: int
    since_s: float


class Path:
    """Points (positions, velocities, accelerations in the order of the controller's joints) and when to be there.

    stamp_s: when it begins, in the time it is sampled with; 0 with the first sample.
    splines: False gives each point from the moment the one before it has been passed.
    """

    def __init__(self, points: Sequence[JointTrajectoryPoint], stamp_s: float = 0.0, *, splines: bool = True) -> None:
        self.points = list(points)
        self.start_s = stamp_s
        self.begun = False
        self._splines = splines
        self._before = JointTrajectoryPoint()
        self._before_s = 0.0
        self._times: list[float] = []
        self._segment: tuple[int, Segment] | None = None

    @property
    def size(self) -> int:
        """How many points there are."""
        return len(self.points)

    def begin(self, time_s: float, now: JointTrajectoryPoint, before_s: float | None = None) -> None:
        """Begin at ``time_s`` from the state ``now``, which the arm had at ``before_s`` if not just then."""
        self.begun = True
        if self.start_s == 0.0:
            self.start_s = time_s
        first = self.points[0]
        zeros = (0.0,) * len(now.positions)
        # so that the way to the first point is a polynomial of the same degree as the others
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
        """Where to be at a time; None before the beginning, and where positions are not known."""
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
        """The points, each with the time at which it is due; once it has begun."""
        return list(zip(self._times, self.points, strict=True))

    def last(self) -> JointTrajectoryPoint:
        """The last point, with speeds and accelerations of zero where it has none."""
        point = self.points[-1]
        zeros = (0.0,) * len(point.positions)
        return replace(
            point,
            velocities=point.velocities or zeros,
            accelerations=point.accelerations or zeros,
        )

    def _between(self, index: int, time_s: float) -> JointTrajectoryPoint:
        before_s = self._times[index - 1] if index else self._before_s
        if self._segment is None or self._segment[0] != index:
            before = self.points[index - 1] if index else self._before
            self._segment = index, Segment(before, self.points[index], self._times[index] - before_s)
        return self._segment[1].at(time_s - before_s)
