"""Dialogues on the teach pendant: popups, and requests for an answer."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from emulator.reporting.messages import MessageLog
from urproto.modes import RequestedType
from urproto.primary.messages import PopupMessage, RequestValueMessage
from urproto.text import lower, number, strip, to_bytes, whole_number
from urscript.values import INT_MAX, INT_MIN, MAX_STRING

_MAX_OPEN: Final = 100
"""Maximum number of open dialogues; another one closes the oldest (a guess: a program can open them in a loop)."""

_BOOLEAN_WORDS: Final = {"true": True, "yes": True, "false": False, "no": False}


@dataclass(eq=False, kw_only=True)
class Popup:
    """One dialogue. A blocking script waits while it is ``open``; ``answer`` is None until given, or if cancelled."""

    request_id: int
    text: str
    title: str = ""
    warning: bool = False
    error: bool = False
    blocking: bool = False
    requested_type: RequestedType = RequestedType.NONE
    open: bool = True
    answer: Any = None
    opened_at_s: float = 0.0


class Popups:
    """The open dialogues, oldest first.

    ``time_s`` returns the controller's uptime. ``auto_close_s``: close plain popups after
    this time as an operator would (None: never).
    """

    def __init__(self, messages: MessageLog, time_s: Callable[[], float], auto_close_s: float | None = None) -> None:
        self._messages = messages
        self._time_s = time_s
        self._auto_close_s = auto_close_s
        self._last_id = 0
        self.shown: list[Popup] = []

    def show(
        self, text: str, *, title: str = "Popup", warning: bool = False, error: bool = False, blocking: bool = False
    ) -> Popup:
        """Open a popup and report it to the primary clients."""
        popup = self._open(Popup(request_id=0, text=text, title=title, warning=warning, error=error, blocking=blocking))
        self._messages.emit(
            PopupMessage(
                request_id=popup.request_id, title=title, text=text, warning=warning, error=error, blocking=blocking
            )
        )
        return popup

    def request(self, text: str, requested_type: RequestedType) -> Popup:
        """Ask the operator for a value; the dialogue closes with the answer."""
        popup = self._open(Popup(request_id=0, text=text, blocking=True, requested_type=requested_type))
        self._messages.emit(RequestValueMessage(request_id=popup.request_id, requested_type=requested_type, text=text))
        return popup

    def close_all(self) -> None:
        """Close all plain popups, as the dashboard's ``close popup`` does; questions stay open."""
        self._close([popup for popup in self.shown if popup.requested_type is RequestedType.NONE])

    def withdraw(self, popup: Popup) -> None:
        """Close one dialogue, for example when the program that opened it has ended."""
        self._close([popup])

    def answer(self, request_id: int, value: Any) -> bool:
        """Close a dialogue with an answer; return False if no open dialogue has this id.

        None cancels a question, which ends the program that asked it. Raises ValueError for a value that does not
        have the requested type; the dialogue then stays open.
        """
        found = [popup for popup in self.shown if popup.request_id == request_id]
        for popup in found:
            popup.answer = None if value is None else _checked(value, popup.requested_type)
        self._close(found)
        return bool(found)

    @property
    def question(self) -> Popup:
        """The question that was asked last, which covers the others. Raises ValueError if none is open."""
        questions = [popup for popup in self.shown if popup.requested_type is not RequestedType.NONE]
        if not questions:
            raise ValueError("no question is open: no program is waiting for an answer")
        return questions[-1]

    def answer_typed(self, text: str) -> None:
        """Answer the question on top with a text that an operator typed. Raises ValueError."""
        question = self.question
        self.answer(question.request_id, _parse_typed(text, question.requested_type))

    def advance(self) -> None:
        """Call once per control period: close the popups whose time is over."""
        if self.shown and self._auto_close_s is not None:
            now = self._time_s()
            plain = (popup for popup in self.shown if popup.requested_type is RequestedType.NONE)
            self._close([popup for popup in plain if now - popup.opened_at_s >= self._auto_close_s])

    def _open(self, popup: Popup) -> Popup:
        self._last_id += 1
        popup.request_id = self._last_id
        popup.opened_at_s = self._time_s()
        self.shown.append(popup)
        if len(self.shown) > _MAX_OPEN:
            self._close(self.shown[:1])
        return popup

    def _close(self, popups: list[Popup]) -> None:
        for popup in popups:
            popup.open = False
        self.shown = [popup for popup in self.shown if popup.open]


def _checked(value: Any, requested: RequestedType) -> Any:
    """Return the answer as the program gets it. Raises ValueError for a value of another type."""
    kind = value.__class__
    if requested is RequestedType.NONE or (requested is RequestedType.BOOLEAN and kind is bool):
        return value
    if requested is RequestedType.INTEGER and kind is int and INT_MIN <= value <= INT_MAX:
        return value
    if requested is RequestedType.FLOAT and kind in (int, float) and abs(value) <= sys.float_info.max:
        return float(value)
    if requested is RequestedType.STRING and kind is str and len(to_bytes(value)) <= MAX_STRING:
        return value
    raise ValueError(f"{value!r:.60} is not an answer: the program expects a value of type {requested.name.lower()}")


def _parse_typed(text: str, requested: RequestedType) -> Any:
    """Convert a typed text to the requested type; a text of another type is returned unchanged."""
    text = strip(text)
    try:
        if requested is RequestedType.INTEGER:
            return whole_number(text)
        if requested is RequestedType.FLOAT:
            return number(text)
    except ValueError:
        return text
    return _BOOLEAN_WORDS.get(lower(text), text) if requested is RequestedType.BOOLEAN else text
