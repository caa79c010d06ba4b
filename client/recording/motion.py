"""A recorded joint path as a trajectory that an arm can replay.

The path consists of cubic splines. Their knots are dense enough to keep it within a tolerance of every recorded
state. It starts and ends at rest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.driver import points
from client.errors import MotionError, RecordingError
from client.recording.recording import Recording
from client.robot.reach import Reach
from urproto.external_control import TrajectoryPoint
from urproto.joints import JOINT_LABELS
from urproto.primary.subpackages import ConfigurationData

Array = NDArray[np.float64]

_KNOTS_S: Final = 0.04  # guess: spacing of the knots, where that is dense enough
_TOLERANCE_RAD: Final = 5e-4  # guess: an arm does not follow its targets more closely
_GAP: Final = 10.0  # guess: recorded periods without a state that count as a gap, if no speeds were recorded
_GAP_S: Final = 0.1  # guess: the same if they were; a spline across it is off by a few mrad at most
_MOVED_RAD: Final = 2e-3  # guess: less motion within a gap does not matter
_DOING: Final = "the replay"


@dataclass(frozen=True, slots=True)
class JointPath:
    """Knots of a path: time_s (k,), q_rad (k, 6), qd_rad_s (k, 6). speed: multiple of the recorded speed."""

    time_s: Array
    q_rad: Array
    qd_rad_s: Array
    speed: float = 1.0

    @property
    def duration_s(self) -> float:
        """Duration of the whole path [s]."""
        return float(self.time_s[-1])

    @property
    def start_rad(self) -> tuple[float, ...]:
        """Joint angles at the start (6,) [rad]."""
        return tuple(self.q_rad[0].tolist())

    def points(self) -> list[TrajectoryPoint]:
        """The trajectory points after the start."""
        knots = zip(self.q_rad[1:].tolist(), self.qd_rad_s[1:].tolist(), np.diff(self.time_s).tolist(), strict=True)
        return [points.spline(q, qd, duration_s) for q, qd, duration_s in knots]

    def check(self, arm: ConfigurationData) -> None:
        """Check the path against the limits that a robot reports.

        Raises OutOfReachError for angles, MotionError for speeds and accelerations.
        """
        Reach(arm, (0.0,) * 6, self.start_rad).check(_DOING, self.points())
        begin, end = self._accelerations()
        self._check("rad/s", np.abs(self._speeds()), arm.qd_max, 1.0)
        self._check("rad/s2", np.maximum(np.abs(begin), np.abs(end)), arm.qdd_max, 0.5)

    def _check(self, unit: str, most: Array, limits: Sequence[float], power: float) -> None:
        """most: largest value in each segment (k - 1, 6). power: exponent that turns the excess into a speed factor."""
        excess = most / np.maximum(np.array(limits), 1e-9)
        segment, joint = divmod(int(np.argmax(excess)), excess.shape[1])
        if (worst := float(excess[segment, joint])) > 1.0:
            raise MotionError(
                _DOING,
                f"{JOINT_LABELS[joint]} would need {most[segment, joint]:.2f} {unit} at {self.time_s[segment]:.2f} s, "
                f"above its limit of {limits[joint]:.2f} {unit}: try --speed {_round_down(self.speed * worst**-power)}",
            )

    def _speeds(self) -> Array:
        """The highest speed in each segment, which is at an end or where the acceleration is zero."""
        begin, end = self._accelerations()
        h = np.diff(self.time_s)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(begin * end < 0.0, begin / (begin - end), 0.0)
        middle = self.qd_rad_s[:-1] + h * share * (begin + share * (end - begin) / 2.0)
        ends = np.maximum(np.abs(self.qd_rad_s[:-1]), np.abs(self.qd_rad_s[1:]))
        result: Array = np.maximum(ends, np.abs(middle))
        return result

    def _accelerations(self) -> tuple[Array, Array]:
        """Accelerations at the start and the end of each segment; they are linear in between."""
        h = np.diff(self.time_s)[:, None]
        mean = np.diff(self.q_rad, axis=0) / h
        before, after = self.qd_rad_s[:-1], self.qd_rad_s[1:]
        return (6.0 * mean - 4.0 * before - 2.0 * after) / h, (2.0 * before + 4.0 * after - 6.0 * mean) / h

    def at(self, time_s: Array) -> Array:
        """Joint angles (n, 6) at times (n,) within the path."""
        index = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2)
        h = np.diff(self.time_s)[index][:, None]
        s = (time_s - self.time_s[index])[:, None] / h
        q0, q1, v0, v1 = self.q_rad[index], self.q_rad[index + 1], self.qd_rad_s[index], self.qd_rad_s[index + 1]
        result: Array = (
            (1 + 2 * s) * (1 - s) ** 2 * q0 + s**2 * (3 - 2 * s) * q1 + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
        )
        return result


def joint_path(recording: Recording, speed: float = 1.0) -> JointPath:
    """The joint path of a recording: target angles if recorded, otherwise measured ones.

    speed: multiple of the recorded speed. Raises RecordingError if the recording has no usable path: it is too short,
    or the arm moved during a gap.
    """
    q = np.asarray(recording["target_q" if "target_q" in recording else "actual_q"], float)
    time_s = recording.time_s
    kept = np.concatenate(([True], np.diff(time_s) > 0.0))
    qd = _speeds(recording)
    time_s, q, qd = time_s[kept] - time_s[kept][0], q[kept], None if qd is None else qd[kept]
    if len(time_s) < 3:
        raise RecordingError(f"{len(time_s)} states are too few for a path: record at least a second of motion")
    if not np.isfinite(q).all():
        raise RecordingError("some recorded joint angles are not numbers")
    _check_gaps(time_s, q, 0.0 if qd is None else _GAP_S)
    path = _dense_path(time_s, q, np.gradient(q, time_s, axis=0) if qd is None else qd)
    return JointPath(path.time_s / speed, path.q_rad, path.qd_rad_s * speed, speed)


def _check_gaps(time_s: Array, q: Array, allowed_s: float) -> None:
    steps = np.diff(time_s)
    moved = np.max(np.abs(np.diff(q, axis=0)), axis=1)
    gaps = np.flatnonzero((steps > max(_GAP * float(np.median(steps)), allowed_s)) & (moved > _MOVED_RAD))
    if len(gaps):
        first = int(gaps[0])
        raise RecordingError(
            f"states are missing for {steps[first]:.2f} s from {time_s[first]:.2f} s on, while the arm moved by "
            f"{moved[first]:.3f} rad on an unknown path: record it again"
        )


def _speeds(recording: Recording) -> Array | None:
    """Target speeds, if recorded. Differences of angles would be jerky where states are missing."""
    if "target_q" not in recording or "target_qd" not in recording:
        return None
    qd = np.array(recording["target_qd"], float)
    return qd if np.isfinite(qd).all() else None


def _dense_path(time_s: Array, q: Array, qd: Array) -> JointPath:
    qd[[0, -1]] = 0.0
    stride = max(1, round(_KNOTS_S / float(np.median(np.diff(time_s)))))
    while True:
        knots = np.unique(np.append(np.arange(0, len(time_s), stride), len(time_s) - 1))
        path = JointPath(time_s[knots], q[knots], qd[knots])
        if stride == 1 or _deviation(path, time_s, q) <= _TOLERANCE_RAD:
            return path
        stride = max(1, stride // 2)


def _deviation(path: JointPath, time_s: Array, q: Any) -> float:
    return float(np.max(np.abs(path.at(time_s) - q)))


def _round_down(speed: float) -> float:
    """Round down to two digits."""
    digits = 1 - math.floor(math.log10(speed))
    return math.floor(speed * 10.0**digits) / 10.0**digits
