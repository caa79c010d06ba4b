"""Interpreter mode (TCP 30020): each line of URScript statements is answered with one line.

The forms of answers and commands are from the chapter in the Script Manual. The reasons for discarded statements are
those distinguished by a public client, which was written against the vendor's simulator. The last two are from the
manual of another manufacturer, whose interpreter mode has the other reasons word for word, so they are likely but not
certain.
"""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from urproto.errors import RemoteProtocolError
from urproto.facts.tables import availability
from urproto.text import from_bytes, strip, to_bytes

AVAILABLE: Final = availability("service.interpreter")
"""Versions with interpreter mode."""

LAST_ID: Final = 65535
"""Statements are numbered from 1 to this and then from 1 again (manual: ids may wrap around; the limit is a guess)."""

MAX_LINE: Final = 16384
"""Longest line [bytes]; a limit of this implementation."""

_ANSWER: Final = re.compile(r"(ack|state): *([0-9]{1,10}): ?(.*)|discard: *([^:]*): ?(.*)", re.DOTALL)


class InterpreterCommand(Enum):
    """Commands, which are executed on arrival, ahead of waiting statements; case does not matter."""

    ABORT = "abort"
    SKIPBUFFER = "skipbuffer"
    STATE_LAST_EXECUTED = "statelastexecuted"
    STATE_LAST_INTERPRETED = "statelastinterpreted"
    STATE_LAST_CLEARED = "statelastcleared"
    STATE_UNEXECUTED = "stateunexecuted"

    @classmethod
    def of(cls, line: str) -> "InterpreterCommand | None":
        """The command in a line; None for statements."""
        return _COMMANDS.get(strip(line).lower())


_COMMANDS: Final = {command.value: command for command in InterpreterCommand}


class Reason(Enum):
    """Why a statement was not accepted."""

    INVALID_STATE = "Program is in an invalid state"  # no program is running
    SYNTAX = "Syntax error"
    COMPILE = "Compile error"
    TOO_MANY = "Too many interpreted messages"
    CLEANED_UP = "Cleaned up before interpretation"
    TOO_LONG = "Statement is too long"  # a guess


def ack(number: int, line: str) -> str:
    """The answer to an accepted line."""
    return f"ack: {number}: {line}"


def discard(reason: Reason, line: str) -> str:
    """The answer to a refused line."""
    return f"discard: {reason.value}: {line}"


def state(number: int, line: str) -> str:
    """The answer to a state command: an id, or a number of statements."""
    return f"state: {number}: {line}"


@dataclass(frozen=True, slots=True)
class InterpreterAnswer:
    """An answer. For a discarded line, ``number`` is None and ``reason`` gives the cause."""

    number: int | None
    reason: str
    line: str


def parse_answer(text: str) -> InterpreterAnswer:
    """Parse an answer without its line end. Raises RemoteProtocolError."""
    match = _ANSWER.fullmatch(text)
    if match is None:
        raise RemoteProtocolError(f"{text!r} is not an answer of interpreter mode")
    _, number, line, reason, discarded = match.groups()
    if number is None:
        return InterpreterAnswer(None, reason, discarded)
    return InterpreterAnswer(int(number), "", line)


def encode_answer(text: str) -> bytes:
    """The bytes of an answer, with the statement as it was received."""
    return to_bytes(text) + b"\n"


@dataclass(frozen=True, slots=True)
class TooLong:
    """A line over the limit; only its beginning was kept."""

    start: str


class StatementDecoder:
    """Splits a stream into lines; its chunks may be of any size; an incomplete line is never returned.

    A CR before the LF is dropped. The rest of a line over the limit is skipped.
    """

    def __init__(self, max_line: int = MAX_LINE) -> None:
        self._max_line = max_line
        self._buffer = bytearray()
        self._over = False

    @property
    def rest(self) -> int:
        """Bytes of the incomplete line at the end."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[str | TooLong]:
        """Add bytes; returns the lines they complete."""
        *ended, rest = data.split(b"\n")
        lines: list[str | TooLong] = []
        for part in ended:
            self._append(part)
            lines.append(self._line())
        self._append(rest)
        return lines

    def _append(self, part: bytes) -> None:
        self._buffer += part
        if len(self._buffer) > self._max_line:
            self._over = True
            del self._buffer[self._max_line :]

    def _line(self) -> str | TooLong:
        text = from_bytes(self._buffer.removesuffix(b"\r"))
        over, self._over = self._over, False
        self._buffer.clear()
        return TooLong(text[:60]) if over else text
