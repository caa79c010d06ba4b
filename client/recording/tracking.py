"""How closely the joints followed their desired positions and velocities."""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from urproto.joints import JOINT_NAMES

Array = NDArray[np.float64]

_MAX_LAG_S: Final = 1.0  # guess: an arm that follows lags by less than this, normally by 0.05 s
_MAX_LEAD_S: Final = 0.1  # guess: the desired and the actual state may be a few periods apart
_GAP_S: Final = 0.5  # guess: after this long without a state, the path in between is unknown
_OLD: Final = {"reference": "desired", "feedback": "actual"}  # names of ROS 2 before Humble
_COLUMNS: Final = (("reference", "positions"), ("feedback", "positions"), ("feedback", "velocities"))


@dataclass(frozen=True, slots=True)
class Tracking:
    """Desired and actual positions and velocities of some joints over time.

    source: the controller that set the desired values. time_s (n,): since the recording's first state. The other
    arrays are (n, joints) in rad and rad/s; missing values are nan. The desired velocities of a controller are the
    rate of change of its desired positions. The velocities that it reports are not used: they refer to the
    trajectory's time, which speed scaling makes slower than the clock.
    """

    source: str
    joints: tuple[str, ...]
    time_s: Array
    desired_q: Array
    actual_q: Array
    desired_qd: Array
    actual_qd: Array

    @property
    def compared(self) -> bool:
        """Whether both desired and actual positions are known."""
        return bool(np.isfinite(self.desired_q - self.actual_q).any())

    @property
    def largest_path_deviation(self) -> float:
        """The maximum of `path_deviation` [rad]; nan without desired positions."""
        return float(np.nanmax(self.path_deviation())) if self.compared else float("nan")

    def path_deviation(self) -> Array:
        """Distance of the joints from the desired path, (n,) [rad], regardless of when they should have been there.

        It is the Euclidean distance of the joint angles from the nearest point on the last second of the path. The
        arm's lag is therefore a tracking error, but not a deviation from the path.
        """
        steps = np.diff(self.time_s)
        rate_hz = 1.0 / float(np.median(steps)) if len(steps) and np.median(steps) > 0.0 else 1.0
        changes = np.append(True, np.any(np.diff(self.desired_q, axis=0) != 0.0, axis=1))[: len(self.time_s)]
        starts, place = self.desired_q[changes], np.cumsum(changes) - 1  # a standstill adds no segment
        segments = np.diff(starts, axis=0, append=starts[-1:])
        segments[place[:-1][steps > _GAP_S]] = 0.0
        nearest: Array = np.linalg.norm(self.actual_q - self.desired_q, axis=1)
        for offset in range(-round(_MAX_LAG_S * rate_hz), round(_MAX_LEAD_S * rate_hz) + 1):
            index = np.clip(place + offset, 0, len(segments) - 1)
            np.fmin(nearest, _distance(self.actual_q, starts[index], segments[index]), out=nearest)
        return nearest


def _distance(points: Array, starts: Array, segments: Array) -> Array:
    """Distance of each point from its segment, given by its start and the vector to its end."""
    away = points - starts
    square = np.maximum(np.einsum("ij,ij->i", segments, segments), 1e-30)
    share = np.clip(np.einsum("ij,ij->i", away, segments) / square, 0.0, 1.0)
    result: Array = np.linalg.norm(away - share[:, None] * segments, axis=1)
    return result


@dataclass(slots=True)
class TrackingBuilder:
    """Collects messages of type ``control_msgs/msg/JointTrajectoryControllerState``."""

    source: str
    joints: tuple[str, ...] = ()
    _times: "array[float]" = field(default_factory=lambda: array("d"))
    _numbers: dict[tuple[str, str], "array[float]"] = field(
        default_factory=lambda: {column: array("d") for column in _COLUMNS}
    )

    def add(self, time_s: float, message: Mapping[str, Any]) -> None:
        """Add a message. Raises KeyError or ValueError if it has other fields."""
        names = tuple(message["joint_names"])
        self.joints = self.joints or names
        order = [names.index(joint) for joint in self.joints]
        self._times.append(time_s)
        for (point, kind), numbers in self._numbers.items():
            given = message[point if point in message else _OLD[point]]
            numbers.extend(_reordered(given[kind], order))

    def build(self, began_s: float) -> Tracking:
        """The collected states. began_s: start of the recording, in the time of the messages."""
        shape = (len(self._times), len(self.joints))
        columns = [self.joints.index(joint) for joint in _in_arm_order(self.joints)]
        desired_q, q, qd = (np.array(numbers).reshape(shape)[:, columns] for numbers in self._numbers.values())
        time_s = np.array(self._times) - began_s
        joints = _in_arm_order(self.joints)
        return Tracking(self.source, joints, time_s, desired_q, q, _differentiate(desired_q, time_s), qd)


def _differentiate(values: Array, time_s: Array) -> Array:
    """Rate of change of each column, as a central difference over three states."""
    rates = np.full_like(values, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates[1:-1] = (values[2:] - values[:-2]) / (time_s[2:] - time_s[:-2])[:, None]
    rates[~np.isfinite(rates)] = np.nan
    return rates


def _reordered(numbers: Sequence[float], order: Sequence[int]) -> list[float]:
    return [numbers[index] for index in order] if numbers else [float("nan")] * len(order)


def _in_arm_order(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Sort the joints from the base to wrist 3; their names may have a prefix."""
    known = [usual for usual in JOINT_NAMES if sum(joint.endswith(usual) for joint in joints) == 1]
    if len(known) != len(joints):
        return joints
    return tuple(next(joint for joint in joints if joint.endswith(usual)) for usual in known)
