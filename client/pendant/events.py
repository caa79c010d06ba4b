"""The log: the messages of a robot's primary interface as lines with a severity."""

import csv
import io
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import islice
from typing import Any, Final, Literal, NamedTuple

from urproto.errorcodes import error_text
from urproto.modes import ReportLevel, SafetyMode, mode_name
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

MAX_SHOWN: Final = 500  # lines a browser keeps
_MAX_TEXT_LENGTH: Final = 2000  # characters of a line; downloads are complete
_CSV_HEADER: Final = ("time", "uptime_s", "severity", "source", "code", "text")
_MAX_EVENTS: Final = 10_000
_PROGRAM_VERBS: Final = {
    PROGRAM_STARTED: "started",
    PROGRAM_STOPPED: "stopped",
    PROGRAM_PAUSED: "paused",
    PROGRAM_RESUMED: "resumed",
}


class LogView:
    """The log as one browser shows it, filtered. paused: no new events are shown.

    severities, words: the events that pass the filter; words are searched for in text, code and source.
    """

    def __init__(self, log: "EventLog") -> None:
        self.severities = set(SEVERITIES)
        self.words = ""
        self.paused = False
        self._log = log
        self._cleared = 0  # number of the last event that is no longer shown
        self._sent = 0
        self._state: object = None

    def clear(self) -> None:
        """Show only events from now on; the log itself stays."""
        self._cleared = self._log.count

    @property
    def pending(self) -> int:
        """Number of events since the view was paused."""
        return self._log.count - self._sent if self.paused else 0

    def matching(self) -> "list[Event]":
        """All kept events that pass the filter, oldest first, also those cleared from view."""
        return [event for event in self._log.events if self._matches(event)]

    def next_update(self, fresh: bool) -> list[Any] | None:
        """[whether to clear the view, lines to add] since the last call, None if nothing has changed.

        fresh: the browser has nothing yet.
        """
        state = (self._cleared, self.words, frozenset(self.severities))
        if fresh or state != self._state:
            self._state, self._sent = state, self._log.count
            return [True, [_row(event) for event in self._newest()]]
        if self.paused or self._sent == self._log.count:
            return None
        rows = [_row(event) for event in self._log.since(self._sent) if self._matches(event)]
        self._sent = self._log.count
        return [len(rows) >= MAX_SHOWN, rows[-MAX_SHOWN:]] if rows else None

    def _newest(self) -> "list[Event]":
        shown = (event for event in self._log.latest() if self._matches(event) and event.number > self._cleared)
        return list(islice(shown, MAX_SHOWN))[::-1]

    def _matches(self, event: "Event") -> bool:
        if event.severity not in self.severities:
            return False
        line = f"{event.source} {event.code} {event.text}".lower()
        return all(word in line for word in self.words.lower().split())


def _row(event: "Event") -> list[Any]:
    uptime = "" if event.uptime_s is None else f"{event.uptime_s:.3f}"
    return [round(event.time_s * 1000), uptime, event.severity, event.source, event.code, event.text[:_MAX_TEXT_LENGTH]]


def as_csv(events: "Iterable[Event]") -> str:
    """A table with a header; times are UTC."""
    file = io.StringIO()
    writer = csv.writer(file)
    writer.writerow(_CSV_HEADER)
    writer.writerows(_cells(events))
    return file.getvalue()


def as_text(events: "Iterable[Event]") -> str:
    """Readable lines; times are UTC."""
    return "".join(
        f"{time} {uptime:>12} {severity:<8}{source:<11}{code:<9}{' '.join(text.splitlines())}\n"
        for time, uptime, severity, source, code, text in _cells(events)
    )


def _cells(events: "Iterable[Event]") -> Iterator[tuple[str, ...]]:
    for event in events:
        time_text = datetime.fromtimestamp(event.time_s, timezone.utc).isoformat(timespec="milliseconds")
        uptime = "" if event.uptime_s is None else f"{event.uptime_s:.3f}"
        yield time_text, uptime, event.severity, event.source, event.code, event.text


Severity = Literal["info", "warning", "error"]
SEVERITIES: Final[tuple[Severity, ...]] = ("info", "warning", "error")
_LEVELS: Final[dict[int, Severity]] = {
    ReportLevel.WARNING: "warning",
    ReportLevel.VIOLATION: "error",
    ReportLevel.FAULT: "error",
    ReportLevel.CRITICAL_FAULT: "error",
}


@dataclass(frozen=True, slots=True)
class Event:
    """One line of the log.

    number: counts from 1. uptime_s: of the controller, None if unknown. time_s: when it was received, since the epoch.
    code: ``C<code>A<argument>``, empty for an event without one.
    """

    number: int
    time_s: float
    uptime_s: float | None
    severity: Severity
    source: str
    code: str
    text: str


class EventLog:
    """The last ten thousand events, oldest first. count: number of all events so far."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self.count = 0

    def since(self, number: int) -> list[Event]:
        """The events after the one with this number, as far as they are kept."""
        return list(islice(reversed(self.events), max(0, self.count - number)))[::-1]

    def latest(self) -> Iterator[Event]:
        """All kept events, newest first."""
        return reversed(self.events)

    def note(self, text: str, severity: Severity = "warning") -> None:
        """Add an event of the pendant itself, unless it repeats the last one."""
        last = self.events[-1] if self.events else None
        if last is None or (last.source, last.text) != ("pendant", text):
            self._add(_Entry("pendant", severity, text), None)

    def handle_message(self, message: object) -> None:
        """Add an event for a message that is of interest to users."""
        if not isinstance(message, RobotMessage):
            return
        entry = _entry(message)
        if entry is not None:
            self._add(entry, None if message.timestamp_us == NO_TIMESTAMP_US else message.timestamp_us / 1e6)

    def _add(self, entry: "_Entry", uptime_s: float | None) -> None:
        self.count += 1
        self.events.append(
            Event(self.count, time.time(), uptime_s, entry.severity, entry.source, entry.code, entry.text)
        )


class _Entry(NamedTuple):
    source: str
    severity: Severity
    text: str
    code: str = ""


def _entry(message: RobotMessage) -> _Entry | None:
    match message:
        case ErrorCodeMessage():
            severity = _LEVELS.get(report_level(message), "info")
            return _Entry("controller", severity, report_text(message), message.label)
        case RuntimeExceptionMessage():
            return _Entry("program", "error", f"line {message.line}, column {message.column}: {message.text}")
        case SafetyModeMessage():
            return _safety_entry(message.safety_mode)
        case TextMessage():
            return _Entry("program", "info", message.text)
        case KeyMessage():
            return _program_entry(message)
        case PopupMessage():
            return _Entry("dialogue", popup_severity(message), f"{message.title}: {message.text}")
        case RequestValueMessage():
            return _Entry("dialogue", "info", f"Question: {message.text}")
        case VersionMessage():
            return _Entry("controller", "info", f"Connected to {message.project} {message.version}")
        case _:
            return None


def popup_severity(message: PopupMessage) -> Severity:
    return "error" if message.error else "warning" if message.warning else "info"


def report_level(message: ErrorCodeMessage) -> int:
    """The level of a report; those from DEVELOPER_DEBUG on repeat the lower ones with the same meaning."""
    return message.level % ReportLevel.DEVELOPER_DEBUG


def report_text(message: ErrorCodeMessage) -> str:
    """The text of a report; robots usually send only its code."""
    return message.text.strip() or error_text(message.code, message.argument)


def _safety_entry(mode: int) -> _Entry:
    name = mode_name(SafetyMode, mode).replace("_", " ").lower()
    return _Entry("safety", _SAFETY_SEVERITY.get(mode, "warning"), f"Safety mode changed to {name}")


_SAFETY_SEVERITY: Final[dict[int, Severity]] = {
    SafetyMode.NORMAL: "info",
    SafetyMode.REDUCED: "info",
    SafetyMode.VIOLATION: "error",
    SafetyMode.FAULT: "error",
}


def _program_entry(message: KeyMessage) -> _Entry:
    verb = _PROGRAM_VERBS.get(message.title)
    if verb is not None:
        return _Entry("program", "info", f"Program {message.text or 'without a name'} {verb}")
    severity: Severity = "error" if "EXCEPTION" in message.title else "info"
    return _Entry("program", severity, f"{message.title} {message.text}".rstrip())
