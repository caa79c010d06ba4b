"""Popups and questions of the robot, and its protective stops."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from client.pendant.events import popup_severity, report_level
from urproto import text as text_format
from urproto.modes import ReportLevel, RequestedType, SafetyMode
from urproto.primary.messages import PROGRAM_STOPPED, ErrorCodeMessage, KeyMessage, PopupMessage, RequestValueMessage

UNLOCK_AFTER_S: Final = 5.0  # dashboard manual: the robot refuses to unlock earlier
_CAUSE_WINDOW_S: Final = 1.0  # guess: a report this close to the stop is its cause
ANSWERABLE: Final = {
    RequestedType.BOOLEAN: "yes or no",
    RequestedType.INTEGER: "an integer, for example 3 or -12",
    RequestedType.FLOAT: "a number, for example 0.25 or -1e-3",
    RequestedType.STRING: "a text",
}
"""The types that can be answered here, and a description of the expected answer."""

_INT_MAX: Final = 2**31 - 1  # of URScript's integers


@dataclass(slots=True)
class ProtectiveStop:
    """A protective stop. at_s: robot time of the first state that showed it. cause: the report of its cause, if any."""

    at_s: float
    cause: ErrorCodeMessage | None = None
    hidden: bool = False


class Stops:
    """The protective stops of a robot. current: the stop that is in effect, None without one.

    All times are robot times, so that an emulator may run faster or slower than real time.
    """

    def __init__(self) -> None:
        self.current: ProtectiveStop | None = None
        self._now_s = 0.0
        self._report: ErrorCodeMessage | None = None

    @property
    def unlock_in_s(self) -> float:
        """Time until the robot accepts unlocking; 0 if it does now, or without a stop."""
        if self.current is None:
            return 0.0
        return max(0.0, self.current.at_s + UNLOCK_AFTER_S - self._now_s)

    @property
    def shown(self) -> ProtectiveStop | None:
        """The current stop, None if its dialogue has been dismissed."""
        return None if self.current is None or self.current.hidden else self.current

    def hide(self) -> None:
        """Dismiss the dialogue of the current stop."""
        if self.current is not None:
            self.current.hidden = True

    def update(self, values: Mapping[str, Any]) -> None:
        """Process a state, by RTDE name."""
        self._now_s = float(values.get("timestamp", 0.0))
        if values.get("safety_mode") != SafetyMode.PROTECTIVE_STOP:
            self.current = None
        elif self.current is None or self._now_s < self.current.at_s:  # or the controller was restarted
            self.current = ProtectiveStop(self._now_s)
            self._assign_cause()

    def handle_message(self, message: object) -> None:
        """Process an error report, which arrives before or after the state that shows the stop."""
        if isinstance(message, ErrorCodeMessage) and report_level(message) >= ReportLevel.WARNING:
            self._report = message
            self._assign_cause()

    def _assign_cause(self) -> None:
        stop, report = self.current, self._report
        if stop is None or report is None or stop.cause is not None:
            return
        if abs(report.timestamp_us / 1e6 - stop.at_s) < _CAUSE_WINDOW_S:
            stop.cause = report


@dataclass(frozen=True, slots=True)
class Dialogue:
    """One dialogue. type: of the answer, RequestedType.NONE for a plain popup. severity: info, warning or error."""

    number: int
    title: str
    text: str
    type: RequestedType
    severity: str = "info"


class Dialogues:
    """The open dialogues, as far as known: a robot only reports new ones, an emulator lists all."""

    def __init__(self) -> None:
        self.open: dict[int, Dialogue] = {}
        self._closed = set[int]()  # closed here; an older list of the emulator may still contain them

    @property
    def oldest(self) -> Dialogue | None:
        return next(iter(self.open.values()), None)

    def handle_message(self, message: object) -> None:
        """Process a dialogue that opens, and the end of a program, which withdraws its questions."""
        if isinstance(message, PopupMessage):
            kind, severity = RequestedType.NONE, popup_severity(message)
            self._add(Dialogue(message.request_id, message.title, message.text, kind, severity))
        elif isinstance(message, RequestValueMessage):
            kind = _requested_type(message.requested_type)
            title = "Popup" if kind is RequestedType.NONE else "Question"
            self._add(Dialogue(message.request_id, title, message.text, kind))
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STOPPED:
            self._retain(lambda dialogue: dialogue.type is RequestedType.NONE)

    def close(self, number: int) -> None:
        if self.open.pop(number, None) is not None:
            self._closed.add(number)

    def close_popups(self) -> None:
        """Close all popups, like ``close popup``: questions stay."""
        self._retain(lambda dialogue: dialogue.type is not RequestedType.NONE)

    def synchronise(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Adopt the list of an emulator: the result of its verb ``popups``."""
        listed = {entry["id"]: entry for entry in entries}
        self._closed &= listed.keys()
        self._retain(lambda dialogue: dialogue.number in listed)
        for number, entry in listed.items():
            if number not in self.open and number not in self._closed:
                title = entry["title"] or "Question"
                self.open[number] = Dialogue(number, title, entry["text"], RequestedType[entry["type"]])

    def _add(self, dialogue: Dialogue) -> None:
        self._closed.discard(dialogue.number)
        self.open[dialogue.number] = dialogue

    def _retain(self, predicate: Any) -> None:
        self.open = {number: dialogue for number, dialogue in self.open.items() if predicate(dialogue)}


def parse_answer(kind: RequestedType, text: str) -> int | float | str:
    """Convert a typed answer to the requested type. Raises ValueError with the expected format."""
    if kind is RequestedType.STRING:
        return text
    try:
        value = text_format.whole_number(text) if kind is RequestedType.INTEGER else text_format.number(text)
    except ValueError as error:
        raise ValueError(f"The program expects {ANSWERABLE[kind]}") from error
    if isinstance(value, int) and not -_INT_MAX - 1 <= value <= _INT_MAX:
        raise ValueError(f"Integers of a program are at most {_INT_MAX}")
    if not math.isfinite(value):
        raise ValueError(f"The program expects {ANSWERABLE[kind]}")
    return value


def _requested_type(value: int) -> RequestedType:
    try:
        return RequestedType(value)
    except ValueError:  # newer software may have more types
        return RequestedType.NONE
