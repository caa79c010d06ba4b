"""The signals that can be plotted, and the plots of one browser."""

import asyncio
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from client.pendant.feeds import Feed, Feeds
from client.recording.tables import CsvWriter
from urproto.joints import JOINT_TITLES
from urproto.rtde.fields import OUTPUT_FIELDS, Field, FieldType, available_fields
from urproto.signals import DIGITAL_GROUPS
from urproto.versions import PolyscopeVersion

RATES_HZ: Final = (10, 25, 50, 125)
WINDOWS_S: Final = (5, 10, 20, 30, 60, 120)
MAX_PANES: Final = 4
_LINGER_S: Final = 120.0  # states are still collected after the screen was left, for instance to jog
_NUMBERS_PER_MESSAGE: Final = 20_000
_MAX_SERIES: Final = 24  # in one pane
_POSE_ELEMENTS: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_INERTIA_ELEMENTS: Final = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_MIXED_UNITS: Final = (
    "m rad",
    "m/s rad/s",
    "m/s2 rad/s2",
    "N Nm",
)  # three elements have the first unit, three the second
_SCREEN_UNITS: Final = {  # unit -> unit in PolyScope, and conversion factor
    "rad": ("°", 57.29577951308232),
    "rad/s": ("°/s", 57.29577951308232),
    "rad/s2": ("°/s²", 57.29577951308232),
    "m": ("mm", 1000.0),
    "m/s": ("mm/s", 1000.0),
    "m/s2": ("m/s²", 1.0),
    "degC": ("°C", 1.0),
    "kg m2": ("kg m²", 1.0),
}
_DIGITAL_SIGNALS: Final = tuple(  # of the words of digital signals: name, number of signals
    (f"{group.letter}{{}}{index}", group.bit(index)) for group in DIGITAL_GROUPS for index in range(group.count)
)
_DIGITAL_WORDS: Final = {"actual_digital_input_bits": "I", "actual_digital_output_bits": "O"}


@dataclass(frozen=True, slots=True)
class Series:
    """One number over time: element ``index`` of an RTDE output, or one ``bit`` of it.

    unit: in RTDE. shown_unit: on a screen, converted by ``factor``.
    """

    field: str
    index: int
    label: str
    unit: str
    shown_unit: str
    factor: float
    doc: str
    bit: int | None = None
    steps: bool = False

    @property
    def key(self) -> str:
        """Name as in Python: ``actual_q[2]``; ``actual_digital_output_bits>>3`` for a bit."""
        if self.bit is not None:
            return f"{self.field}>>{self.bit}"
        return f"{self.field}[{self.index}]" if OUTPUT_FIELDS[self.field].type.count > 1 else self.field


def catalogue(version: PolyscopeVersion | None) -> dict[str, Series]:
    """All signals of a controller of this version, by key; of any version if it is unknown."""
    fields = OUTPUT_FIELDS if version is None else available_fields(OUTPUT_FIELDS, version)
    return {series.key: series for field in fields.values() for series in _split(field)}


def series(*keys: str) -> list[Series]:
    """The signals with these keys. Raises KeyError."""
    return [_ALL[key] for key in keys]


def _split(field: Field) -> Iterator[Series]:
    count, steps = field.type.count, field.type.letter != "d"
    names = _element_names(field)
    for index in range(count):
        unit = _unit(field, index)
        shown, factor = _SCREEN_UNITS.get(unit, (unit, 1.0))
        label = f"{field.name} {names[index]}" if count > 1 else field.name
        yield Series(field.name, index, label, unit, shown, factor, field.doc, steps=steps)
    for pattern, bit in _DIGITAL_SIGNALS if field.name in _DIGITAL_WORDS else ():
        name = pattern.format(_DIGITAL_WORDS[field.name])
        yield Series(field.name, 0, name, "", "", 1.0, f"digital signal {name}", bit, steps=True)


def _unit(field: Field, index: int) -> str:
    if field.unit in _MIXED_UNITS:
        return field.unit.split(" ")[index // 3]
    return field.unit


def _element_names(field: Field) -> tuple[str, ...]:
    if field.type is FieldType.VECTOR3D or field.unit in _MIXED_UNITS:
        return _POSE_ELEMENTS
    return _INERTIA_ELEMENTS if field.name == "payload_inertia" else JOINT_TITLES


_ALL: Final = catalogue(None)


def _vector(name: str, count: int = 6) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for index in range(count))


PRESETS: Final[dict[str, tuple[str, ...]]] = {
    "Joint angles": _vector("actual_q"),
    "Joint speeds": _vector("actual_qd"),
    "Joint currents": _vector("actual_current"),
    "Joint temperatures": _vector("joint_temperatures"),
    "TCP position": _vector("actual_TCP_pose", 3),
    "TCP speed": _vector("actual_TCP_speed", 3),
    "TCP force": _vector("actual_TCP_force", 3),
    "TCP torque": _vector("actual_TCP_force")[3:],
    "Speed": ("speed_scaling", "target_speed_fraction"),
    "Digital outputs": tuple(f"actual_digital_output_bits>>{bit}" for bit in range(8)),
    "Digital inputs": tuple(f"actual_digital_input_bits>>{bit}" for bit in range(8)),
}
"""Common selections of signals: name -> keys."""


@dataclass(slots=True, eq=False)
class Pane:
    """One diagram. auto: the vertical range follows the visible values."""

    series: list[Series] = field(default_factory=list)
    auto: bool = True


class Plots:
    """The diagrams of a browser. feed: the states, None before the screen was shown for the first time.

    panes, window_s, rate_hz, paused, si: the settings that the user chose; call ``changed`` after changing them.
    """

    def __init__(self, feeds: Feeds) -> None:
        self.panes = [Pane(series(*PRESETS["Joint angles"])), Pane(series(*PRESETS["TCP force"]))]
        self.window_s = 30
        self.rate_hz = 50
        self.paused = False
        self.si = False
        self.feed: Feed | None = None
        self.version = 0  # counts the changes of the settings
        self._feeds = feeds
        self._visible = False
        self._subscribed_feed: Feed | None = None  # the feed, while the screen is visible
        self._columns: tuple[Series, ...] = ()
        self._fresh = True
        self._sent = 0  # number of rows that the browser has
        self._cleared_at = 0  # earlier rows are not shown any more

    # settings

    def changed(self) -> None:
        self.version += 1
        if self._visible:
            self._subscribe()

    def choose(self, pane: Pane, chosen: list[Series]) -> None:
        """Choose the signals of a diagram. Raises ValueError if there are too many to distinguish."""
        if len(chosen) > _MAX_SERIES:
            raise ValueError(f"{len(chosen)} signals in one diagram: choose {_MAX_SERIES} at most, or add a diagram")
        pane.series = chosen
        self.changed()

    def clear(self) -> None:
        if self.feed is not None:
            self._cleared_at = self.feed.end
            self._fresh = True

    # visibility

    def show(self) -> None:
        if not self._visible:
            self._visible = True
            self._subscribe()

    def hide(self, closing: bool = False) -> None:
        """The screen is no longer visible. closing: the page is closed, so states need not be collected any longer."""
        self._visible = False
        if self._subscribed_feed is not None:
            self._feeds.unsubscribe(self._subscribed_feed, 0.0 if closing else _LINGER_S)
            self._subscribed_feed = None

    def _subscribe(self) -> None:
        columns = dict.fromkeys(signal for pane in self.panes for signal in pane.series)
        self._columns = tuple(columns)
        self._fresh = True
        names = {"timestamp", *(signal.field for signal in columns)}
        previous, self._subscribed_feed = (
            self._subscribed_feed,
            self._feeds.subscribe(names, float(self.rate_hz), keep_rows=True, predecessor=self.feed),
        )
        self.feed = self._subscribed_feed
        if previous is not None:
            self._feeds.unsubscribe(previous)

    # updates of the browser

    @property
    def count(self) -> int:
        """Number of states in an export."""
        feed = self.feed
        return 0 if feed is None else feed.end - max(feed.begin, self._cleared_at)

    def next_update(self, fresh: bool) -> Any:
        """What the browser does not have yet: [keys of the columns, None if unchanged; numbers row by row]."""
        feed = self.feed
        if feed is None or not self._visible:
            return None
        keys = None
        if fresh or self._fresh:
            self._fresh = False
            keys = ["timestamp", *(signal.key for signal in self._columns)]
            self._sent = self._first_row(feed)
        first = max(self._sent, feed.begin)
        last = min(feed.end, first + max(_NUMBERS_PER_MESSAGE // feed.width, 1))
        if keys is None and first >= last:
            return None
        self._sent = last
        return [keys, self._flatten(feed, first, last)]

    def _first_row(self, feed: Feed) -> int:
        """The first row in the longest window."""
        if feed.end == feed.begin:
            return feed.end
        newest = feed.rows(feed.end - 1, feed.end)[feed.column("timestamp")]
        return max(feed.row_at(newest - WINDOWS_S[-1]), self._cleared_at)

    def _flatten(self, feed: Feed, first: int, last: int) -> list[float | None]:
        rows, width = feed.rows(first, last), feed.width
        columns = [(feed.column(signal.field, signal.index), signal.bit) for signal in self._columns]
        time = feed.column("timestamp")
        numbers = list[float | None]()
        for start in range(0, len(rows), width):
            numbers.append(rows[start + time])
            for column, bit in columns:
                value = rows[start + column]
                if not math.isfinite(value):
                    numbers.append(None)
                else:
                    numbers.append(value if bit is None else int(value) >> bit & 1)
        return numbers

    # files

    async def csv(self) -> bytes:
        """All collected states in the format of `client.recording`. Raises ValueError if there are none."""
        if self.feed is None or not self.count:
            raise ValueError("no data has been collected yet: is the robot connected?")
        return await asyncio.to_thread(_csv, self.feed.copy(), self._cleared_at)


def _csv(feed: Feed, first_row: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "plots.csv")
        writer = CsvWriter(path, feed.names)
        for state in feed.states(first_row):
            writer.write(state)
        writer.close()
        return path.read_bytes()
