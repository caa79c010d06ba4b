"""How joints followed what was asked of them."""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from urproto.joints import JOINT_NAMES

Array = NDArray[np.float64]

_BEHIND_S: Final = 1.0  # an arm that follows is not later than this; guess, its lag is 0.05 s
_AHEAD_S: Final = 0.1  # guess: states of both may be some periods apart
_GAP_S: Final = 0.5  # without a state: nobody knows the path in between; guess
_OLD: Final = {"reference": "desired", "feedback": "actual"}  # names of ROS 2 before Humble
_COLUMNS: Final = (("reference", "positions"), ("feedback", "positions"), ("feedback", "velocities"))


@dataclass(frozen=True, slots=True)
class Tracking:
    """What was desired of some joints and what they did, over time.

    source: who desired it. time_s (n,): since the recording's first state. The others (n, joints)
    in rad and rad/s; what was not told is nan. The speeds that a controller desired are those at
    which its desired angles change: the ones that it tells are in the trajectory's time, which
    speed scaling makes slower than the clock's.
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
        """True when it is known both what was desired and what was."""
        return bool(np.isfinite(self.desired_q - self.actual_q).any())

    @property
    def largest_path_deviation(self) -> float:
        """The largest of `path_deviation` [rad]; nan when nothing was desired."""
        return float(np.nanmax(self.path_deviation())) if self.compared else float("nan")

    def path_deviation(self) -> Array:
        """How far the joints are from the path that was desired, (n,) [rad], whenever they should have been there.

        The Euclidean distance of the angles from the nearest place of the path within its last second:
        the arm's lag is an error, and no deviation from the path.
        """
        steps = np.diff(self.time_s)
        rate_hz = 1.0 / float(np.median(steps)) if len(steps) and np.median(steps) > 0.0 else 1.0
        goes_on = np.append(True, np.any(np.diff(self.desired_q, axis=0) != 0.0, axis=1))[: len(self.time_s)]
        begins, place = self.desired_q[goes_on], np.cumsum(goes_on) - 1  # a path that stands is no way
        ways = np.diff(begins, axis=0, append=begins[-1:])
        ways[place[:-1][steps > _GAP_S]] = 0.0
        nearest: Array = np.linalg.norm(self.actual_q - self.desired_q, axis=1)
        for offset in range(-round(_BEHIND_S * rate_hz), round(_AHEAD_S * rate_hz) + 1):
            index = np.clip(place + offset, 0, len(ways) - 1)
            np.fmin(nearest, _distance(self.actual_q, begins[index], ways[index]), out=nearest)
        return nearest


def _distance(points: Array, begins: Array, ways: Array) -> Array:
    """Of each point from its segment, which begins there and goes that way."""
    away = points - begins
    square = np.maximum(np.einsum("ij,ij->i", ways, ways), 1e-30)
    share = np.clip(np.einsum("ij,ij->i", away, ways) / square, 0.0, 1.0)
    result: Array = np.linalg.norm(away - share[:, None] * ways, axis=1)
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
        """A message. Raises KeyError, ValueError for one that is none."""
        names = tuple(message["joint_names"])
        self.joints = self.joints or names
        order = [names.index(joint) for joint in self.joints]
        self._times.append(time_s)
        for (point, kind), numbers in self._numbers.items():
            given = message[point if point in message else _OLD[point]]
            numbers.extend(_ordered(given[kind], order))

    def built(self, began_s: float) -> Tracking:
        """All of it; began_s: when the recording began, as the messages' times."""
        shape = (len(self._times), len(self.joints))
        columns = [self.joints.index(joint) for joint in _in_usual_order(self.joints)]
        desired_q, q, qd = (np.array(numbers).reshape(shape)[:, columns] for numbers in self._numbers.values())
        time_s = np.array(self._times) - began_s
        joints = _in_usual_order(self.joints)
        return Tracking(self.source, joints, time_s, desired_q, q, _rates(desired_q, time_s), qd)


def _rates(values: Array, time_s: Array) -> Array:
    """How fast each column changes, over three states."""
    rates = np.full_like(values, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates[1:-1] = (values[2:] - values[:-2]) / (time_s[2:] - time_s[:-2])[:, None]
    rates[~np.isfinite(rates)] = np.nan
    return rates


def _ordered(numbers: Sequence[float], order: Sequence[int]) -> list[float]:
    return [numbers[index] for index in order] if numbers else [float("nan")] * len(order)


def _in_usual_order(joints: tuple[str, ...]) -> tuple[str, ...]:
    """From the base on, whatever is put before the names."""
    known = [usual for usual in JOINT_NAMES if sum(joint.endswith(usual) for joint in joints) == 1]
    if len(known) != len(joints):
        return joints
    return tuple(next(joint for joint in joints if joint.endswith(usual)) for usual in known)
