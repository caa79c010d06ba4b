"""What a peer on a socket answers to a message: replies by pattern, with a state, or those of a Python function."""

import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from emulator.peers.log import Pattern, PeerLog
from urproto.text import from_bytes, strip, to_bytes

_VARIABLE: Final = re.compile(r"\$\{(\w+)\}")


@dataclass(frozen=True)
class Reply:
    """What a peer sends: `data`, after `delay_s` of robot time. close: it disconnects then."""

    data: bytes = b""
    delay_s: float = 0.0
    close: bool = False


class Answerer(Protocol):
    """Decides what a peer answers. Its state belongs to the peer, whatever connection a message comes from."""

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        """Take complete messages off a buffer. idle: nothing was sent for a control period."""
        ...

    def answer(self, message: bytes) -> Reply:
        """The answer to a message."""
        ...


def cut_at(delimiter: bytes, buffer: bytearray) -> Iterator[bytes]:
    """Take the messages that end at a delimiter off a buffer."""
    while (end := buffer.find(delimiter)) >= 0:
        yield bytes(buffer[:end])
        del buffer[: end + len(delimiter)]


def cut_size(size: int, buffer: bytearray) -> Iterator[bytes]:
    """Take the messages of a fixed size [bytes] off a buffer."""
    while len(buffer) >= size:
        yield bytes(buffer[:size])
        del buffer[:size]


def cut_all(buffer: bytearray) -> Iterator[bytes]:
    """Take everything off a buffer, as one message."""
    if buffer:
        yield bytes(buffer)
        buffer.clear()


@dataclass(frozen=True)
class TextCode:
    """How messages are written in a file of peers: as text or, for binary ones, as hexadecimal bytes."""

    binary: bool = False

    def read(self, message: bytes) -> str:
        """The form in which patterns and the log show a message."""
        return message.hex() if self.binary else strip(from_bytes(message))

    def write(self, text: str) -> bytes:
        """The bytes of an answer. Raises ValueError if it is not hexadecimal."""
        return bytes.fromhex(text) if self.binary else to_bytes(text)


@dataclass(frozen=True)
class ReplyTemplate:
    """A reply in whose text ``${NAME}`` stands for a variable of the peer. changes: variables that it sets."""

    text: str
    delay_s: float = 0.0
    close: bool = False
    changes: Mapping[str, str] = field(default_factory=dict)

    @property
    def variables(self) -> set[str]:
        return {name for text in (self.text, *self.changes.values()) for name in _VARIABLE.findall(text)}

    def fill(self, state: MutableMapping[str, str], code: TextCode) -> Reply:
        """Set the variables and return the reply."""
        for name, value in self.changes.items():
            state[name] = _filled(value, state)
        return Reply(code.write(_filled(self.text, state)), self.delay_s, self.close)


def _filled(text: str, state: Mapping[str, str]) -> str:
    return _VARIABLE.sub(lambda found: state[found[1]], text)


@dataclass
class Dialogue:
    """Answers messages by their patterns; a message that is written like a pattern itself comes first.

    cutter: takes messages off a buffer. state: variables, which named groups of the patterns set. rows: for each
    pattern, the replies one after the other, of which the last one repeats.
    """

    log: PeerLog
    code: TextCode
    cutter: Callable[[bytearray, bool], Iterator[bytes]]
    state: dict[str, str]
    rows: list[tuple[Pattern, Iterator[ReplyTemplate]]]

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        return self.cutter(buffer, idle)

    def answer(self, message: bytes) -> Reply:
        text = self.code.read(message)
        self.log.add(text)
        for pattern, replies in sorted(self.rows, key=lambda row: row[0].text != text):
            if found := pattern.match(text):
                self.state.update({name: value or "" for name, value in found.groupdict().items()})
                return next(replies).fill(self.state, self.code)
        return Reply()


@dataclass
class Computed:
    """Answers what a Python function returns for a message: bytes, text, a number, or None for no answer."""

    log: PeerLog
    code: TextCode
    cutter: Callable[[bytearray, bool], Iterator[bytes]]
    function: Callable[[bytes], Any]

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        return self.cutter(buffer, idle)

    def answer(self, message: bytes) -> Reply:
        self.log.add(self.code.read(message))
        value = self.function(message)
        if value is None:
            return Reply()
        return Reply(value if isinstance(value, bytes) else to_bytes(str(value)))
