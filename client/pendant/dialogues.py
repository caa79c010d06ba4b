"""Popups and questions that the robot shows on its pendant."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from urproto import text as wire_text
from urproto.modes import RequestedType
from urproto.primary.messages import PROGRAM_STOPPED, KeyMessage, PopupMessage, RequestValueMessage

__all__ = ["ANSWERABLE", "Dialogue", "Dialogues", "typed_answer"]

ANSWERABLE: Final = {
    RequestedType.BOOLEAN: "yes or no",
    RequestedType.INTEGER: "an integer, for example 3 or -12",
    RequestedType.FLOAT: "a number, for example 0.25 or -1e-3",
    RequestedType.STRING: "a text",
}
"""The types whose answers can be given here, and what a person is asked for."""

_INT_MAX: Final = 2**31 - 1  # of URScript's integers


@dataclass(frozen=True, slots=True)
class Dialogue:
    """type: what answer is wanted, RequestedType.NONE for a plain popup. severity: info, warning or error."""

    number: int
    title: str
    text: str
    type: RequestedType
    severity: str = "info"


class Dialogues:
    """Those that are open as far as anybody can tell: a robot tells when one opens, an emulator which ones are."""

    def __init__(self) -> None:
        self.open: dict[int, Dialogue] = {}
        self._closed = set[int]()  # here, which an older list of the emulator does not know

    @property
    def oldest(self) -> Dialogue | None:
        """The one to be shown."""
        return next(iter(self.open.values()), None)

    def hear(self, message: object) -> None:
        """Take note of one that opens, and of a program's end, which takes its questions back."""
        if isinstance(message, PopupMessage):
            severity = "error" if message.error else "warning" if message.warning else "info"
            self._add(Dialogue(message.request_id, message.title, message.text, RequestedType.NONE, severity))
        elif isinstance(message, RequestValueMessage):
            kind = _requested_type(message.requested_type)
            title = "Popup" if kind is RequestedType.NONE else "Question"
            self._add(Dialogue(message.request_id, title, message.text, kind))
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STOPPED:
            self._keep(lambda dialogue: dialogue.type is RequestedType.NONE)

    def close(self, number: int) -> None:
        """Show it no more."""
        if self.open.pop(number, None) is not None:
            self._closed.add(number)

    def close_popups(self) -> None:
        """As ``close popup`` does: questions stay."""
        self._keep(lambda dialogue: dialogue.type is not RequestedType.NONE)

    def are(self, shown: Sequence[Mapping[str, Any]]) -> None:
        """Agree with the list of an emulator: the result of its verb ``popups``."""
        listed = {entry["id"]: entry for entry in shown}
        self._closed &= listed.keys()
        self._keep(lambda dialogue: dialogue.number in listed)
        for number, entry in listed.items():
            if number not in self.open and number not in self._closed:
                title = entry["title"] or "Question"
                self.open[number] = Dialogue(number, title, entry["text"], RequestedType[entry["type"]])

    def _add(self, dialogue: Dialogue) -> None:
        self._closed.discard(dialogue.number)
        self.open[dialogue.number] = dialogue

    def _keep(self, stays: Any) -> None:
        self.open = {number: dialogue for number, dialogue in self.open.items() if stays(dialogue)}


def typed_answer(kind: RequestedType, text: str) -> int | float | str:
    """What somebody typed, as a value of the type that is asked for. Raises ValueError, which says what is wanted."""
    if kind is RequestedType.STRING:
        return text
    try:
        value = wire_text.whole_number(text) if kind is RequestedType.INTEGER else wire_text.number(text)
    except ValueError as error:
        raise ValueError(f"The program wants {ANSWERABLE[kind]}") from error
    if isinstance(value, int) and not -_INT_MAX - 1 <= value <= _INT_MAX:
        raise ValueError(f"Integers of a program are at most {_INT_MAX}")
    if not math.isfinite(value):
        raise ValueError(f"The program wants {ANSWERABLE[kind]}")
    return value


def _requested_type(value: int) -> RequestedType:
    try:
        return RequestedType(value)
    except ValueError:  # newer software may have more
        return RequestedType.NONE
