"""What peers answer: replies by pattern, with a state, or those of a Python function; XML-RPC over HTTP; a gripper."""

import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Protocol, TypeAlias
from xmlrpc.client import Fault, dumps, loads

from msgspec import Meta, Struct, field

from emulator.devices.gripper_requests import GripperSession
from emulator.devices.robotiq import Gripper
from emulator.peers.log import Pattern, PeerLog
from urproto.robotiq import RequestDecoder
from urproto.text import from_bytes, strip, to_bytes

Text: TypeAlias = str | int | float
Seconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9)]

_VARIABLE: Final = re.compile(r"\$\{(\w+)\}")
Method: TypeAlias = Callable[..., Any]


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


class GripperPeer:
    """The gripper of ``--gripper``: the software on the controller that programs talk to on TCP port 63352.

    A request with a line end is answered in another form than one without.
    """

    def __init__(self, log: PeerLog, gripper: Gripper) -> None:
        self.log, self._gripper, self._session = log, gripper, GripperSession()

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        while (end := buffer.find(b"\n") + 1) > 0:
            yield bytes(buffer[:end])
            del buffer[:end]
        if idle:
            yield from cut_all(buffer)

    def answer(self, message: bytes) -> Reply:
        self.log.add(strip(from_bytes(message)))
        decoder = RequestDecoder()
        return Reply(self._session.answer(self._gripper, (*decoder.feed(message), *decoder.flush())))


@dataclass
class XmlRpcMethods:
    """The methods of a server; one that is missing, or raises an error, answers with a fault."""

    log: PeerLog
    methods: Mapping[str, Method] | Any  # or an object whose public methods they are

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        """Take complete HTTP requests off the buffer."""
        while (head := buffer.find(b"\r\n\r\n") + 4) > 3:
            end = head + _content_length(bytes(buffer[:head]))
            if len(buffer) < end:
                return
            yield bytes(buffer[head:end])
            del buffer[:end]

    def answer(self, message: bytes) -> Reply:
        arguments, name = loads(message)
        self.log.add(f"{name}({', '.join(map(str, arguments))})")
        body = dumps(self._call(str(name), arguments), methodresponse=True, allow_none=True).encode()
        return Reply(b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body))

    def _call(self, name: str, arguments: tuple[Any, ...]) -> tuple[Any] | Fault:
        public = None if name.startswith("_") else name
        found = (
            self.methods.get(name) if isinstance(self.methods, Mapping) else getattr(self.methods, public or "", None)
        )
        if found is None:
            return Fault(1, f"the peer {self.log.name} has no method {name}")
        try:
            return (found(*arguments),)
        except Fault as fault:
            return fault
        except Exception as error:
            return Fault(1, f"{name}: {error}")


def _content_length(head: bytes) -> int:
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            return int(value)
    return 0
