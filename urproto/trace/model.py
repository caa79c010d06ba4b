"""What happened in a run: curves, and lanes of states and events, whatever it was recorded by.

    trace = Trace("run.journal", "UR5e, PolyScope 5.22", model)
    for state in states:
        trace.add(state["timestamp"], state)
    trace.event("Log", 12.4, "C153A0 protective stop")

The values of a state have the names of RTDE outputs; those that are missing have no curve and no lane.
"""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Any, Final, NamedTuple

from urproto.compat import IntEnum
from urproto.errors import URError
from urproto.joints import JOINT_TITLES
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_name
from urproto.robots.model import RobotModel
from urproto.signals import SIGNALS, digital_signal

PERIOD_S: Final = 0.008
"""Time between two samples of the curves, at least."""

_MODES: Final[tuple[tuple[str, str, type[IntEnum]], ...]] = (
    ("Safety mode", "safety_mode", SafetyMode),
    ("Robot mode", "robot_mode", RobotMode),
    ("Program", "runtime_state", RuntimeState),
)
_ALARMS: Final = ("STOP", "VIOLATION", "FAULT", "RECOVERY")  # in the names of safety modes
_SIGNALS: Final = {"Inputs": ("actual_digital_input_bits", "I"), "Outputs": ("actual_digital_output_bits", "O")}
_REGISTERS: Final = ("output_int_register", "output_double_register")
_ORDER: Final = (*(lane for lane, _, _ in _MODES), "Program line", "Thread", "Speed slider", "Faults", "Log", *_SIGNALS)
_SETUP: Final = {"tcp_offset": "TCP", "payload": "payload [kg]", "payload_cog": "centre of gravity [m]"}
_DIGITS: Final = 6
_MAX_ENTRIES: Final = 20_000  # of a lane; guess: half a megabyte of a page
_SHOWN: Final = 100  # characters of a line
_CARTESIAN: Final = ("X", "Y", "Z")


class TraceError(URError, ValueError):
    """A file of which no trace can be made."""


class Curves(NamedTuple):
    """Curves that are drawn together. actual, target: RTDE outputs, "" for none; first: the first of their elements."""

    title: str
    unit: str
    actual: str
    target: str
    parts: tuple[str, ...]
    first: int = 0


CURVES: Final = (
    Curves("Joint positions", "rad", "actual_q", "target_q", JOINT_TITLES),
    Curves("Joint speeds", "rad/s", "actual_qd", "target_qd", JOINT_TITLES),
    Curves("Joint currents", "A", "actual_current", "target_current", JOINT_TITLES),
    Curves("Joint torques", "Nm", "actual_current_as_torque", "target_moment", JOINT_TITLES),
    Curves("TCP position", "m", "actual_TCP_pose", "target_TCP_pose", _CARTESIAN),
    Curves("TCP rotation", "rad", "actual_TCP_pose", "target_TCP_pose", ("RX", "RY", "RZ"), 3),
    Curves("TCP speed", "m/s", "actual_TCP_speed", "target_TCP_speed", _CARTESIAN),
    Curves("TCP force", "N", "actual_TCP_force", "", _CARTESIAN),
    Curves("Speed scaling", "", "speed_scaling", "", ("Scaling",)),
    Curves("Speed slider", "", "target_speed_fraction", "", ("Slider",)),
)
_FIELDS: Final = tuple(dict.fromkeys(name for curves in CURVES for name in (curves.actual, curves.target)))


class Entry(NamedTuple):
    """An event, or the beginning of a state. level: "", "warning" or "error". detail: the complete text, if longer.

    place: of a program's line, the number of the program in `Trace.programs` and the line.
    """

    time_s: float
    text: str
    level: str = ""
    detail: str = ""
    place: tuple[int, int] | None = None


@dataclass
class Lane:
    """A row of the timeline. states: an entry lasts until the next one, and one without text is a pause."""

    name: str
    states: bool = False
    entries: list[Entry] = field(default_factory=list)

    def add(self, entry: Entry) -> None:
        """Add an entry; of states, only if it is another one."""
        if self.states and self.entries and self.entries[-1][1:] == entry[1:]:
            return
        if len(self.entries) < _MAX_ENTRIES:
            self.entries.append(entry)
        elif len(self.entries) == _MAX_ENTRIES:
            self.entries.append(Entry(entry.time_s, f"{_MAX_ENTRIES} entries: the rest is left out", "warning"))


@dataclass
class Trace:
    """A run. title, about: what it is of. model: the arm, None if it is not known.

    times: of the samples [s], uptime of the robot. columns: of each RTDE output, an array for each element. objects:
    around the arm, as in world files; the columns of their poses are named "object NAME".
    """

    title: str
    about: str
    model: RobotModel | None = None
    times: "array[float]" = field(default_factory=lambda: array("d"))
    columns: dict[str, "list[array[float]]"] = field(default_factory=dict)
    lanes: dict[str, Lane] = field(default_factory=dict)
    programs: list[str] = field(default_factory=list)
    objects: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    _seen: dict[str, Any] = field(default_factory=dict)
    _next_s: float = -1.0

    def add(self, time_s: float, state: Mapping[str, Any]) -> bool:
        """Add a state, the same time or later than the one before. Returns whether it has become a sample."""
        for lane, name, names in _MODES:
            if name in state and self._changed(name, state[name]):
                mode = mode_name(names, state[name])
                alarm = name == "safety_mode" and any(word in mode for word in _ALARMS)
                self.state(lane, time_s, mode, "error" if alarm else "")
        for lane, (name, letter) in _SIGNALS.items():
            before = self._seen.get(name)
            if name in state and self._changed(name, state[name]) and before is not None:
                self.event(lane, time_s, ", ".join(_signals(before, state[name], letter)))
        for name in _REGISTERS:
            values = f"{name}s"
            before = self._seen.get(values)
            if values in state and self._changed(values, state[values]) and before is not None:
                pairs = enumerate(zip(before, state[values], strict=True))
                texts = [f"{name}_{number} = {new:.{_DIGITS}g}" for number, (old, new) in pairs if old != new]
                self.event("Registers", time_s, ", ".join(texts))
        for name, title in _SETUP.items():
            if name in state and self._changed(name, state[name]):
                self.event("Setup", time_s, f"{title}: {_shown(state[name])}")
        self._add_slider(time_s, state.get("target_speed_fraction"))
        if time_s < self._next_s:
            return False
        self._next_s = time_s + PERIOD_S - 1e-6
        self.times.append(time_s)
        for name in _FIELDS:
            if name in state:
                self._sample(name, state[name])
        return True

    def place(self, name: str, description: Mapping[str, Any], pose: Sequence[float]) -> None:
        """Add the pose of an object in the sample that was just added."""
        self.objects[name] = description
        self._sample(f"object {name}", pose)

    def event(self, lane: str, time_s: float, text: str, level: str = "", detail: str = "") -> None:
        """Add an event to a lane."""
        self._lane(lane, states=False).add(Entry(time_s, text, level, "" if detail == text else detail))

    def state(self, lane: str, time_s: float, text: str, level: str = "", place: tuple[int, int] | None = None) -> None:
        """Add the beginning of a state to a lane, unless it has begun already."""
        self._lane(lane, states=True).add(Entry(time_s, text, level, "", place))

    def line(self, lane: str, time_s: float, source: str, line: int) -> None:
        """Add the line of a program that the thread of a lane is executing; 0 if it is over."""
        if not self._changed(f"line of {lane}", (source, line)):
            return
        if not line:
            self.state(lane, time_s, "")
            return
        if source not in self.programs:
            self.programs.append(source)
        number = self.programs.index(source)
        text = source.split("\n")[line - 1].strip()[:_SHOWN]
        self.state(lane, time_s, f"{line}: {text}", "", (number, line))

    def finish(self) -> None:
        """Complete the columns of what is no longer there, and put the events in order."""
        for column in self.columns.values():
            self._fill(column, len(self.times))
        for lane in self.lanes.values():
            lane.entries.sort(key=lambda entry: entry.time_s)
        self.lanes = dict(sorted(self.lanes.items(), key=lambda lane: _place_of(lane[0])))

    def _lane(self, name: str, *, states: bool) -> Lane:
        return self.lanes.setdefault(name, Lane(name, states))

    def _changed(self, name: str, value: Any) -> bool:
        if self._seen.get(name) == value:
            return False
        self._seen[name] = value
        return True

    def _add_slider(self, time_s: float, fraction: float | None) -> None:
        """A slider moves over some periods: it has a new place once it stays there."""
        if fraction is not None and not self._changed("target_speed_fraction", fraction):
            self.state("Speed slider", time_s, f"{fraction:.0%}", "warning" if fraction < 1.0 else "")

    def _sample(self, name: str, value: Any) -> None:
        values = value if isinstance(value, Sequence) else (value,)
        columns = self.columns.setdefault(name, [array("f") for _ in values])
        self._fill(columns, len(self.times) - 1)
        for column, number in zip(columns, values, strict=True):
            column.append(number)

    @staticmethod
    def _fill(columns: "list[array[float]]", samples: int) -> None:
        for column in columns:
            column.extend([nan] * (samples - len(column)))


def _place_of(lane: str) -> int:
    name = "Thread" if lane.startswith("Thread ") else lane
    return _ORDER.index(name) if name in _ORDER else len(_ORDER)


def _signals(before: int, now: int, letter: str) -> Iterator[str]:
    """Names of the digital signals that have changed, with their levels: DO3 high."""
    for number in range(SIGNALS):
        if (before ^ now) >> number & 1:
            group, index = digital_signal(number)
            yield f"{group.letter}{letter}{index} {'high' if now >> number & 1 else 'low'}"


def _shown(value: Any) -> str:
    if isinstance(value, Sequence):
        return f"[{', '.join(f'{number:.{_DIGITS}g}' for number in value)}]"
    return f"{value:.{_DIGITS}g}"
