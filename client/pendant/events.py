"""The log: what a robot's primary interface says, as lines with a severity."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Final, Literal

from client.scripts import mode_name
from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import (
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

__all__ = ["Event", "EventLog", "Severity"]

Severity = Literal["info", "warning", "error"]
_KEPT: Final = 1000
_LEVELS: Final[dict[int, Severity]] = {
    ReportLevel.WARNING: "warning",
    ReportLevel.VIOLATION: "error",
    ReportLevel.FAULT: "error",
    ReportLevel.CRITICAL_FAULT: "error",
}


@dataclass(frozen=True, slots=True)
class Event:
    """number counts from 1. uptime_s: the controller's, 0 if unknown. time_s: when it was heard, since the epoch."""

    number: int
    time_s: float
    uptime_s: float
    severity: Severity
    source: str
    text: str


class EventLog:
    """The last events, oldest first."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=_KEPT)
        self.count = 0

    def since(self, number: int) -> list[Event]:
        """Those after the one with this number."""
        return [event for event in self.events if event.number > number]

    def note(self, text: str, severity: Severity = "warning") -> None:
        """Something the pendant itself has to say; what it said last is not repeated."""
        last = self.events[-1] if self.events else None
        if last is None or (last.source, last.text) != ("pendant", text):
            self._add("pendant", severity, text, 0.0)

    def hear(self, message: object) -> None:
        """Keep what a person wants to read."""
        if not isinstance(message, RobotMessage):
            return
        told = _told(message)
        if told is not None:
            source, severity, text = told
            self._add(source, severity, text, message.timestamp_us / 1e6)

    def _add(self, source: str, severity: Severity, text: str, uptime_s: float) -> None:
        self.count += 1
        self.events.append(Event(self.count, time.time(), uptime_s, severity, source, text))


def _told(message: RobotMessage) -> tuple[str, Severity, str] | None:
    match message:
        case ErrorCodeMessage():
            return "controller", _LEVELS.get(message.level, "info"), f"{message.label} {message.text}".rstrip()
        case RuntimeExceptionMessage():
            return "program", "error", f"line {message.line}, column {message.column}: {message.text}"
        case SafetyModeMessage():
            mode = mode_name(SafetyMode, message.safety_mode)
            return "safety", "info" if message.safety_mode == SafetyMode.NORMAL else "warning", f"safety mode {mode}"
        case TextMessage():
            return "program", "info", message.text
        case KeyMessage():
            return "program", "info", f"{message.title} {message.text}".rstrip()
        case PopupMessage():
            return "dialogue", "error" if message.error else "warning" if message.warning else "info", message.text
        case RequestValueMessage():
            return "dialogue", "info", message.text
        case VersionMessage():
            return "controller", "info", f"{message.project} {message.version}"
        case _:
            return None
