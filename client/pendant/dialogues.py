"""Popups and questions that the robot shows on its pendant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from urproto.modes import RequestedType
from urproto.primary.messages import PopupMessage, RequestValueMessage

__all__ = ["Dialogue", "Dialogues"]


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

    def hear(self, message: object) -> None:
        """Take note of one that opens."""
        if isinstance(message, PopupMessage):
            severity = "error" if message.error else "warning" if message.warning else "info"
            self._add(Dialogue(message.request_id, message.title, message.text, RequestedType.NONE, severity))
        elif isinstance(message, RequestValueMessage):
            kind = _requested_type(message.requested_type)
            self._add(
                Dialogue(message.request_id, "Popup" if kind is RequestedType.NONE else "Question", message.text, kind)
            )

    def close(self, number: int) -> None:
        """Show it no more."""
        self.open.pop(number, None)

    def close_popups(self) -> None:
        """As ``close popup`` does: questions stay."""
        self.open = {
            number: dialogue for number, dialogue in self.open.items() if dialogue.type is not RequestedType.NONE
        }

    def are(self, shown: Sequence[Mapping[str, Any]]) -> None:
        """Agree with the list of an emulator: the result of its verb ``popups``."""
        listed = {entry["id"]: entry for entry in shown}
        self.open = {number: dialogue for number, dialogue in self.open.items() if number in listed}
        for number, entry in listed.items():
            if number not in self.open:
                self._add(Dialogue(number, entry["title"], entry["text"], RequestedType[entry["type"]]))

    def _add(self, dialogue: Dialogue) -> None:
        self.open[dialogue.number] = dialogue


def _requested_type(value: int) -> RequestedType:
    try:
        return RequestedType(value)
    except ValueError:  # newer software may have more
        return RequestedType.NONE
