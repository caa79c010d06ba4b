"""The motion of the arm, measured from recorded RTDE periods, and predictions of a trapezoidal profile."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pose_matrices import Array
from raw_rtde import Sample


def profile_time(distance: float, v: float, a: float) -> float:
    """Duration [s] of a trapezoidal (or triangular) move from rest to rest."""
    if distance * a < v * v:
        return 2.0 * math.sqrt(distance / a)
    return distance / v + v / a


@dataclass(frozen=True)
class Track:
    """Recorded periods: t [s] (n,), q [rad] and qd [rad/s] (n, 6), pose and twist of the TCP in base (n, 6)."""

    t: Array
    q: Array
    qd: Array
    pose: Array
    twist: Array

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> "Track":
        names = ("timestamp", "actual_q", "target_qd", "actual_TCP_pose", "target_TCP_speed")
        return cls(*(np.array([sample[name] for sample in samples]) for name in names))

    @property
    def period_s(self) -> float:
        return float(np.median(np.diff(self.t)))

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Periods with a target speed that is not exactly zero."""
        return np.any(self.qd != 0.0, axis=1)

    @property
    def moving_time(self) -> float:
        """From the first to the last period in motion [s]."""
        moving = np.flatnonzero(self.moving)
        assert moving.size, "the arm did not move"
        return float(self.t[moving[-1]] - self.t[moving[0]] + self.period_s)

    @property
    def halts(self) -> int:
        """How often the arm came to rest between the first and the last period in motion."""
        moving = np.flatnonzero(self.moving)
        return int(np.count_nonzero(np.diff(moving) > 1))

    @property
    def in_motion(self) -> "Track":
        """Only the part from the first to the last period in motion."""
        moving = np.flatnonzero(self.moving)
        part = slice(moving[0], moving[-1] + 1)
        return Track(self.t[part], self.q[part], self.qd[part], self.pose[part], self.twist[part])

    @property
    def speed(self) -> Array:
        """Speed of the TCP [m/s], (n,)."""
        return np.linalg.norm(self.twist[:, :3], axis=1)

    def off_line(self, start: Sequence[float], end: Sequence[float]) -> float:
        """Largest distance [m] of the TCP from the straight line through two poses."""
        origin = np.array(start[:3])
        along = np.array(end[:3]) - origin
        along /= np.linalg.norm(along)
        offset = self.pose[:, :3] - origin
        return float(np.linalg.norm(offset - np.outer(offset @ along, along), axis=1).max())

    def nearest(self, point: Sequence[float]) -> float:
        """Smallest distance [m] of the TCP to a point, over the recording."""
        return float(np.linalg.norm(self.pose[:, :3] - np.array(point[:3]), axis=1).min())
