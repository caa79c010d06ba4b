"""The states of a recording as columns of numbers over time, from the RTDE, realtime and primary interfaces."""

import csv
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from client.errors import FileError
from client.traffic.recording import Conversation, TrafficRecording
from client.traffic.rtde_log import RTDELog
from urproto.errors import RemoteProtocolError
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.state import RobotStateData
from urproto.primary.subpackages import JointData
from urproto.realtime import RealtimeDecoder
from urproto.rtde.fields import OUTPUT_FIELDS

_PRIMARY_PORTS = (30001, 30002, 30011, 30012)
_REALTIME_PORTS = (30003, 30013)
_RTDE_PORTS = (30004,)
_CSV_VECTOR = re.compile(r"(?P<name>.+)_(?P<index>\d+)")
_INDEX = re.compile(r"\[\d+\]")
_BOOLEANS = {"True": "1", "False": "0"}


@dataclass(slots=True)
class Track:
    """The states of one connection. source: the interface. label: the same, to display.

    times_s: robot time of each state [s], or the time since the first state if it has none. robot_time: which of them.
    columns: by name, such as ``actual_q[2]`` for the element of a vector; one number per state, nan if it was not sent.
    """

    source: str
    label: str
    robot_time: bool = True
    times_s: "array[float]" = field(default_factory=lambda: array("d"))
    columns: "dict[str, array[float]]" = field(default_factory=dict)

    def add(self, time_s: float, values: Mapping[str, float]) -> None:
        """Add a state, unless its time is not after the last: it was sent twice, or the robot's clock was reset."""
        if self.times_s and not time_s > self.times_s[-1]:
            return
        count = len(self.times_s)
        self.times_s.append(time_s)
        for name in values.keys() - self.columns.keys():
            self.columns[name] = array("d", [float("nan")] * count)
        for name, column in self.columns.items():
            column.append(values.get(name, float("nan")))


def base_name(column: str) -> str:
    """The field to which a column belongs."""
    return _INDEX.sub("", column)


def tracks_of(recording: TrafficRecording) -> list[Track]:
    """All states of a recording, in the order of its connections. Adds read errors to its ``problems``."""
    tracks: list[Track] = []
    for number, one in enumerate(recording.conversations, 1):
        for track in _tracks(one, f"connection {number}", recording.problems):
            if len(track.times_s) > 1:
                tracks.append(track)
    return tracks


def _tracks(one: Conversation, name: str, problems: list[str]) -> Iterator[Track]:
    if one.port in _RTDE_PORTS:
        yield from _rtde(one, name, problems)
    elif one.port in _REALTIME_PORTS:
        yield _decoded(one, "realtime", name, problems, RealtimeDecoder().feed, _realtime_state)
    elif one.port in _PRIMARY_PORTS:
        yield _decoded(one, "primary", name, problems, PrimaryDecoder().feed, _primary_state)


# RTDE


def _rtde(one: Conversation, name: str, problems: list[str]) -> Iterator[Track]:
    log = RTDELog(one)
    if log.problem:
        problems.append(f"{name} (RTDE): {log.problem}")
    for outputs in log.outputs:
        track = Track("rtde", f"RTDE, {name}", "timestamp" in outputs.names)
        for row in outputs.rows:
            values = outputs.unpack(row.data)
            time_s = values.pop("timestamp", (row.time_ns - outputs.rows[0].time_ns) / 1e9)
            track.add(time_s, flat(values.items()))
        yield track


# realtime and primary interface

State = tuple[float | None, dict[str, float]]


def _decoded(
    one: Conversation,
    source: str,
    name: str,
    problems: list[str],
    feed: Callable[[bytes], Iterable[Any]],
    state_of: Callable[[Any], State | None],
) -> Track:
    track = Track(source, f"{source} interface on {one.port}, {name}")
    begin_ns = one.begin_ns
    for piece in one.pieces:
        if not piece.from_server:
            continue
        try:
            states = [state for message in feed(piece.data) if (state := state_of(message)) is not None]
        except RemoteProtocolError as error:
            problems.append(f"{track.label}: {error}")
            break
        for time_s, values in states:
            track.robot_time &= time_s is not None
            track.add(time_s if time_s is not None else (piece.time_ns - begin_ns) / 1e9, values)
    return track


def _realtime_state(values: Mapping[str, Any]) -> State:
    return values["timestamp"], flat((name, value) for name, value in values.items() if name != "timestamp")


def _primary_state(message: Any) -> State | None:
    if not isinstance(message, RobotStateData):
        return None
    parts = ((part.name, getattr(message, part.name)) for part in fields(message) if part.name != "unknown")
    values = flat((name, part.joints if isinstance(part, JointData) else part) for name, part in parts)
    time_us = values.pop("mode.timestamp_us", None)
    return None if time_us is None else (time_us / 1e6, values)


def flat(items: Iterable[tuple[str, Any]]) -> dict[str, float]:
    """Numbers by name, with an entry for each element of vectors and dataclasses. Other values are left out."""
    found: dict[str, float] = {}
    for name, value in items:
        if isinstance(value, int | float):
            found[name] = float(value)
        elif isinstance(value, tuple | list):
            found |= flat((f"{name}[{index}]", part) for index, part in enumerate(value))
        elif is_dataclass(value):
            found |= flat((f"{name}.{part.name}", getattr(value, part.name)) for part in fields(value))
    return found


# tables


def tracks_of_csv(path: Path) -> list[Track]:
    """Read a table with a header and a column ``timestamp`` [s], as ``ur-client watch --csv`` writes it.

    Columns that are not entirely numbers are left out. Raises FileError.
    """
    track = Track("rtde", path.name)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            head = file.readline()
            file.seek(0)
            table = csv.DictReader(file, delimiter=max(",; \t", key=head.count))
            for row in table:
                values = {_column(name): _number(value) for name, value in row.items() if name and name != "timestamp"}
                track.add(float(row["timestamp"]), {name: value for name, value in values.items() if value is not None})
    except (OSError, csv.Error, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(path, "is not a table with a column `timestamp` of numbers [s]") from error
    if len(track.times_s) < 2:
        raise FileError(path, "has fewer than two states with rising timestamps")
    return [track]


def _column(name: str) -> str:
    """The column name ``actual_q[0]`` for ``actual_q_0`` in a table."""
    if name not in OUTPUT_FIELDS and (vector := _CSV_VECTOR.fullmatch(name)) and vector["name"] in OUTPUT_FIELDS:
        return f"{vector['name']}[{vector['index']}]"
    return name


def _number(text: str | None) -> float | None:
    try:
        return float(_BOOLEANS.get(text or "", text or ""))
    except ValueError:
        return None
