"""What a peer on a socket answers to a message: replies by pattern, with a state, or those of a Python function."""

import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Protocol, TypeAlias

from msgspec import Meta, Struct, field

from emulator.peers.log import Pattern, PeerLog
from urproto.text import from_bytes, strip, to_bytes

Text: TypeAlias = str | int | float
Seconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9)]

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

    def answer(self, message: bytes) -> Reply: ...


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


class ReplyTemplate(Struct, frozen=True, forbid_unknown_fields=True):
    """A reply in whose text ``${NAME}`` stands for a variable of the peer. changes: variables that it sets."""

    reply: Text = ""
    delay: Seconds = 0.0
    close: bool = False
    changes: dict[str, Text] = field(name="set", default_factory=dict)

    @property
    def variables(self) -> set[str]:
        return {name for text in (self.reply, *self.changes.values()) for name in _VARIABLE.findall(str(text))}

    def fill(self, state: MutableMapping[str, Text], code: TextCode) -> Reply:
        """Set the variables and return the reply."""
        for name, value in self.changes.items():
            state[name] = _filled(value, state)
        return Reply(code.write(_filled(self.reply, state)), self.delay, self.close)


def _filled(text: Text, state: Mapping[str, Text]) -> str:
    return _VARIABLE.sub(lambda found: str(state[found[1]]), str(text))


@dataclass
class Replies:
    """Replies by the patterns of messages; a message that is written like a pattern itself comes first.

    state: variables, which named groups of the patterns set. rows: for each pattern, the replies one after the other.
    """

    code: TextCode
    state: dict[str, Text]
    rows: list[tuple[Pattern, Iterator[ReplyTemplate]]]

    def __call__(self, _message: bytes, text: str) -> Reply:
        for pattern, replies in sorted(self.rows, key=lambda row: row[0].text != text):
            if found := pattern.match(text):
                self.state.update({name: value or "" for name, value in found.groupdict().items()})
                return next(replies).fill(self.state, self.code)
        return Reply()


@dataclass
class Computed:
    """What a Python function returns for a message: bytes, text, a number, or None for no answer."""

    function: Callable[[bytes], Any]

    def __call__(self, message: bytes, _text: str) -> Reply:
        value = self.function(message)
        return Reply(value if isinstance(value, bytes) else b"" if value is None else to_bytes(str(value)))


@dataclass
class Dialogue:
    """Answers messages on a socket. cut: see `Answerer`. reply: finds the reply to a message and its text."""

    log: PeerLog
    code: TextCode
    cut: Callable[[bytearray, bool], Iterator[bytes]]
    reply: Callable[[bytes, str], Reply]

    def answer(self, message: bytes) -> Reply:
        text = self.code.read(message)
        self.log.add(text)
        return self.reply(message, text)
