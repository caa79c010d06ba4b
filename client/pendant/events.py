"""The log: what a robot's primary interface says, as lines with a severity."""

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final, Literal, NamedTuple

from client.scripts import mode_name
from urproto.errorcodes import error_text
from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_PAUSED,
    PROGRAM_RESUMED,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    ErrorCodeMessage,
    KeyMessage,
    PopupMessage,
    RequestValueMessage,
    RobotMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
    VersionMessage,
)

__all__ = ["SEVERITIES", "Event", "EventLog", "Severity"]

Severity = Literal["info", "warning", "error"]
SEVERITIES: Final[tuple[Severity, ...]] = ("info", "warning", "error")
_KEPT: Final = 10_000
_DEVELOPER: Final = ReportLevel.DEVELOPER_DEBUG  # levels from there on mean the same as those before
_LEVELS: Final[dict[int, Severity]] = {
    ReportLevel.WARNING: "warning",
    ReportLevel.VIOLATION: "error",
    ReportLevel.FAULT: "error",
    ReportLevel.CRITICAL_FAULT: "error",
}
_OF_PROGRAMS: Final = {
    PROGRAM_STARTED: "started",
    PROGRAM_STOPPED: "stopped",
    PROGRAM_PAUSED: "paused",
    PROGRAM_RESUMED: "resumed",
}


@dataclass(frozen=True, slots=True)
class Event:
    """number counts from 1. uptime_s: the controller's, None if it did not say. time_s: when it was heard, since the
    epoch. code: ``C<code>A<argument>``, empty for what has none."""

    number: int
    time_s: float
    uptime_s: float | None
    severity: Severity
    source: str
    code: str
    text: str


class EventLog:
    """The last ten thousand events, oldest first. count: how many there were ever."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=_KEPT)
        self.count = 0

    def since(self, number: int) -> list[Event]:
        """Those after the one with this number, as far as they are kept."""
        return list(islice(reversed(self.events), max(0, self.count - number)))[::-1]

    def latest(self) -> Iterator[Event]:
        """All that are kept, newest first."""
        return reversed(self.events)

    def note(self, text: str, severity: Severity = "warning") -> None:
        """Something the pendant itself has to say; what it said last is not repeated."""
        last = self.events[-1] if self.events else None
        if last is None or (last.source, last.text) != ("pendant", text):
            self._add(_Told("pendant", severity, text), None)

    def hear(self, message: object) -> None:
        """Keep what a person wants to read."""
        if not isinstance(message, RobotMessage):
            return
        told = _told(message)
        if told is not None:
            self._add(told, None if message.timestamp_us == NO_TIMESTAMP_US else message.timestamp_us / 1e6)

    def _add(self, told: "_Told", uptime_s: float | None) -> None:
        self.count += 1
        self.events.append(Event(self.count, time.time(), uptime_s, told.severity, told.source, told.code, told.text))


class _Told(NamedTuple):
    source: str
    severity: Severity
    text: str
    code: str = ""


def _told(message: RobotMessage) -> _Told | None:
    match message:
        case ErrorCodeMessage():
            severity = _LEVELS.get(message.level % _DEVELOPER, "info")
            text = message.text.strip() or error_text(message.code, message.argument)
            return _Told("controller", severity, text, message.label)
        case RuntimeExceptionMessage():
            return _Told("program", "error", f"line {message.line}, column {message.column}: {message.text}")
        case SafetyModeMessage():
            return _of_safety(message.safety_mode)
        case TextMessage():
            return _Told("program", "info", message.text)
        case KeyMessage():
            return _of_key(message)
        case PopupMessage():
            severity = "error" if message.error else "warning" if message.warning else "info"
            return _Told("dialogue", severity, f"{message.title}: {message.text}")
        case RequestValueMessage():
            return _Told("dialogue", "info", f"Question: {message.text}")
        case VersionMessage():
            return _Told("controller", "info", f"Connected to {message.project} {message.version}")
        case _:
            return None


def _of_safety(mode: int) -> _Told:
    name = mode_name(SafetyMode, mode).replace("_", " ").lower()
    return _Told("safety", _SAFETY_SEVERITY.get(mode, "warning"), f"Safety mode changed to {name}")


_SAFETY_SEVERITY: Final[dict[int, Severity]] = {
    SafetyMode.NORMAL: "info",
    SafetyMode.REDUCED: "info",
    SafetyMode.VIOLATION: "error",
    SafetyMode.FAULT: "error",
}


def _of_key(message: KeyMessage) -> _Told:
    happened = _OF_PROGRAMS.get(message.title)
    if happened is not None:
        return _Told("program", "info", f"Program {message.text or 'without a name'} {happened}")
    severity: Severity = "error" if "EXCEPTION" in message.title else "info"
    return _Told("program", severity, f"{message.title} {message.text}".rstrip())
