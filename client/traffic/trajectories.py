"""Compare two tracks of states, field by field, at the same moments."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from client.traffic.alignment import Numbers, Offset, numbers
from client.traffic.tracks import Track, base_name
from urproto.errors import LocalProtocolError
from urproto.rtde.fields import OUTPUT_FIELDS

# All guesses: several times the resolution of an arm's encoders and sensors, far less than a user would notice.
TOLERANCES: Final[Mapping[str, float]] = {
    "rad": 1e-3,
    "rad/s": 1e-2,
    "rad/s2": 0.2,
    "m": 1e-3,
    "m/s": 5e-3,
    "m/s2": 0.5,
    "N": 5.0,
    "Nm": 1.0,
    "A": 0.3,
    "V": 1.0,
    "degC": 5.0,
    "J": 10.0,
    "kg": 1e-3,
    "kg m/s": 0.5,
    "kg m2": 1e-4,
    "s": 1e-3,
    "ms": 1.0,
    "": 1e-3,
}
# counters, and fields about the controller's computer rather than the robot
IGNORED: Final = frozenset({"timestamp", "control_step", "actual_execution_time", "target_execution_time"})

_VECTORS: Final[Mapping[str, tuple[str, str]]] = {  # units of six numbers: the first three, the last three
    "m rad": ("m", "rad"),
    "m/s rad/s": ("m/s", "rad/s"),
    "m/s2 rad/s2": ("m/s2", "rad/s2"),
    "N Nm": ("N", "Nm"),
}
_UNIT_ALIASES: Final[Mapping[str, str]] = {"A or V": "V"}
_ELEMENT = re.compile(r"\[(\d+)\]$")
# of the primary interface, by the last part of the name
_PRIMARY: Final[Mapping[str, str]] = {
    "q_actual": "rad", "q_target": "rad", "qd_actual": "rad/s", "current": "A", "voltage": "V",
    "motor_temperature": "degC", "micro_temperature": "degC", "board_temperature": "degC", "tool_temperature": "degC",
    "pose_base_tcp": "m rad", "tcp_offset": "m rad", "frame": "m rad", "elbow_position": "m", "wrench": "N Nm",
    "robot_current": "A", "io_current": "A", "tool_current": "A", "robot_voltage_48V": "V", "tool_voltage_48V": "V",
    "analog_input0": "V", "analog_input1": "V", "analog_output0": "V", "analog_output1": "V",
}  # fmt: skip
# Periods of the slower track by which a change may be shifted, for smooth and for switching columns (guesses).
_SLACK_PERIODS: Final = {True: 0.5, False: 2.0}


class ComparisonTolerances:
    """Usual tolerances, with changes by the caller: ``rad=0.01`` for a unit, ``actual_q=0.01`` for a field."""

    def __init__(self, wanted: Iterable[str] = ()) -> None:
        self._wanted = dict(map(_parse, wanted))

    def of(self, column: str, *, integers: bool = False) -> float:
        """Tolerance of a column, in its unit. integers: whether its values are; without a unit, they must be equal."""
        unit = unit_of(column)
        for key in (column, base_name(column), unit):
            if key in self._wanted:
                return self._wanted[key]
        return 0.0 if integers and not unit else TOLERANCES.get(unit, TOLERANCES[""])


def _parse(text: str) -> tuple[str, float]:
    key, _, number = text.rpartition("=")
    try:
        tolerance = float(number)
    except ValueError:
        tolerance = -1.0
    if not key.strip() or not tolerance >= 0:
        raise LocalProtocolError(f"{text!r} is not a tolerance: give a field or unit and a number, as rad=0.01")
    return key.strip(), tolerance


def unit_of(column: str) -> str:
    """Unit of a column; empty if it has none."""
    base = base_name(column)
    unit = OUTPUT_FIELDS[base].unit if base in OUTPUT_FIELDS else _PRIMARY.get(base.rpartition(".")[2], "")
    if unit in _VECTORS and (element := _ELEMENT.search(column)):
        return _VECTORS[unit][int(element[1]) >= 3]
    return _UNIT_ALIASES.get(unit, unit)


@dataclass(frozen=True, slots=True)
class ValuePair:
    """Values of one column at a moment. time_s: since the start of the first recording's track [s]."""

    time_s: float
    first: float
    second: float


@dataclass(frozen=True, slots=True)
class Difference:
    """A column that differs by more than its tolerance. share: of states, 0 to 1. size: the largest difference."""

    column: str
    unit: str
    tolerance: float
    begins: ValuePair
    largest: ValuePair
    size: float
    share: float


@dataclass(frozen=True, slots=True)
class TrackPair:
    """Comparison of two tracks: numbers of compared states and columns, and columns that only one of them has."""

    first: Track
    second: Track
    offset: Offset
    states: int
    columns: int
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    differences: tuple[Difference, ...]

    @property
    def seconds(self) -> float:
        """Duration that both recordings cover."""
        begin = max(self.first.times_s[0] + self.offset.seconds, self.second.times_s[0])
        return max(0.0, min(self.first.times_s[-1] + self.offset.seconds, self.second.times_s[-1]) - begin)


def compare_tracks(first: Track, second: Track, offset: Offset, tolerances: ComparisonTolerances) -> TrackPair:
    """Compare every common column over the common time."""
    matcher = _Matcher(first, second, offset.seconds)
    shared = [name for name in first.columns if name in second.columns and base_name(name) not in IGNORED]
    differences = tuple(_differences(first, second, shared, matcher, tolerances))
    return TrackPair(
        first,
        second,
        offset,
        matcher.states,
        len(shared),
        _only_in_first(first, second),
        _only_in_first(second, first),
        differences,
    )


def _only_in_first(track: Track, other: Track) -> tuple[str, ...]:
    """Fields that the other track does not have."""
    return tuple(sorted({base_name(name) for name in track.columns if name not in other.columns}))


def _differences(
    first: Track, second: Track, names: list[str], matcher: "_Matcher", tolerances: ComparisonTolerances
) -> Iterator[Difference]:
    if not matcher.states:
        return
    for name in names:
        a, b = numbers(first.columns[name]), numbers(second.columns[name])
        integers = _are_integers(a) and _are_integers(b)
        tolerance = tolerances.of(name, integers=integers)
        gaps = matcher.gaps(a, b, smooth=not integers)
        beyond = np.flatnonzero(gaps > tolerance)
        if len(beyond):
            worst = int(np.argmax(gaps))
            begins, largest = (matcher.moment(index, a, b) for index in (int(beyond[0]), worst))
            yield Difference(
                name, unit_of(name), tolerance, begins, largest, float(gaps[worst]), len(beyond) / matcher.states
            )


def _are_integers(values: Numbers) -> bool:
    known = values[np.isfinite(values)]
    return bool((known == np.round(known)).all())


class _Matcher:
    """For each state of the first track, the states of the second at the same moment."""

    def __init__(self, first: Track, second: Track, offset_s: float) -> None:
        times, self._other = numbers(first.times_s), numbers(second.times_s)
        self._begin = float(times[0])
        moved = times + offset_s
        self._inside = (moved >= self._other[0]) & (moved <= self._other[-1])
        self._times = times[self._inside]
        self._moved = moved[self._inside]
        periods = [float(np.median(np.diff(each))) for each in (times, self._other)]
        self._slack_s = {smooth: slack * max(periods) for smooth, slack in _SLACK_PERIODS.items()}
        left = np.searchsorted(self._other, self._moved)
        reach = int(np.ceil(max(self._slack_s.values()) / max(periods[1], 1e-6))) + 1
        indices = (np.clip(left + shift, 0, len(self._other) - 1) for shift in range(-reach, reach + 1))
        self._near = [(index, np.abs(self._other[index] - self._moved)) for index in indices]

    @property
    def states(self) -> int:
        return len(self._times)

    def gaps(self, a: Numbers, b: Numbers, *, smooth: bool) -> Numbers:
        """Distance of each value of the first track from the range of the second around that moment.

        smooth: what a straight line between two states may miss counts too; at 10 Hz that is much.
        """
        values_inside = a[self._inside]
        low = high = np.interp(self._moved, self._other, b)
        missed = np.zeros(len(values_inside))
        curvature = _curvature(b) if smooth else np.zeros(len(b))
        for index, distance_s in self._near:
            is_near = distance_s <= self._slack_s[smooth]
            value = np.where(is_near, b[index], np.nan)
            low, high = np.fmin(low, value), np.fmax(high, value)
            missed = np.fmax(missed, np.where(distance_s <= self._slack_s[False], curvature[index], 0.0))
        gaps = np.maximum(0.0, np.maximum(low - values_inside, values_inside - high) - missed)
        return np.where(np.isnan(gaps), 0.0, gaps)  # one of them did not send it in this state

    def moment(self, index: int, a: Numbers, b: Numbers) -> ValuePair:
        nearest = int(np.argmin(np.abs(self._other - self._moved[index])))
        time_s = float(self._times[index]) - self._begin
        return ValuePair(time_s, float(a[self._inside][index]), float(b[nearest]))


def _curvature(values: Numbers) -> Numbers:
    """Distance of each value from the mean of its neighbours, the error that a corner between states allows (guess)."""
    curvature = np.zeros(len(values))
    curvature[1:-1] = np.abs(np.diff(values, 2)) / 2
    return curvature
