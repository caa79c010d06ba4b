"""Which port speaks what, and what bytes of an unknown port look like."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from client.decoding import external, modbus, rtde, states, texts
from client.decoding.streams import Framing, Stream
from urproto import dashboard, interpreter
from urproto.errors import RemoteProtocolError
from urproto.external_control import REQUEST_PROGRAM
from urproto.interpreter import InterpreterCommand

__all__ = ["CODECS", "Channel", "Codec", "Guess", "Side", "codec_of_port", "guess"]


class Side(Enum):
    """Who sent a stream; the driver of External Control counts as the client."""

    ROBOT = "robot"
    CLIENT = "client"


@dataclass(frozen=True, slots=True)
class Channel:
    """The streams of one connection. ``unknown`` is for one whose sender is to be found out from the bytes."""

    robot: Stream
    client: Stream
    unknown: Stream | None = None

    def stream(self, side: Side | None, usual: Side) -> Stream:
        """What a side sends."""
        if side is None and self.unknown is not None:
            return self.unknown
        return self.robot if (side or usual) is Side.ROBOT else self.client


@dataclass(frozen=True, slots=True)
class Codec:
    """A protocol: its usual ports, who listens there, who sends what a lone stream is taken for."""

    name: str
    ports: tuple[int, ...]
    open: Callable[[], Channel]
    server: Side = Side.ROBOT
    usual: Side = Side.ROBOT


def _rtde() -> Channel:
    conversation = rtde.Conversation()
    return Channel(conversation.robot, conversation.client, conversation.unknown)


def _modbus() -> Channel:
    conversation = modbus.Conversation()
    return Channel(conversation.robot, conversation.client, conversation.unknown)


def _lines() -> Channel:
    return Channel(texts.line_stream(), texts.line_stream())


_DRIVER = Side.CLIENT

CODECS = {
    codec.name: codec
    for codec in (
        Codec("rtde", (30004,), _rtde),
        Codec("primary", (30001, 30002, 30011, 30012), lambda: Channel(states.primary_stream(), texts.line_stream())),
        Codec("realtime", (30003, 30013), lambda: Channel(states.realtime_stream(), texts.line_stream())),
        Codec("dashboard", (29999,), _lines),
        Codec("interpreter", (30020,), lambda: Channel(texts.answer_stream(), texts.statement_stream())),
        Codec("modbus", (502,), _modbus),
        Codec("reverse", (50001,), lambda: Channel(texts.line_stream(), external.reverse_stream()), _DRIVER, _DRIVER),
        Codec("script-sender", (50002,), _lines, _DRIVER, _DRIVER),
        Codec(
            "trajectory",
            (50003,),
            lambda: Channel(external.result_stream(), external.trajectory_stream()),
            _DRIVER,
            _DRIVER,
        ),
        Codec(
            "script-command",
            (50004,),
            lambda: Channel(external.result_stream(), external.command_stream()),
            _DRIVER,
            _DRIVER,
        ),
        Codec("gripper", (63352,), lambda: Channel(texts.unended_stream(), texts.unended_stream())),
        Codec("text", (), _lines),
        Codec("bytes", (), lambda: Channel(texts.BytesStream(), texts.BytesStream())),
    )
}
_BY_PORT = {port: codec for codec in CODECS.values() for port in codec.ports}


def codec_of_port(port: int) -> Codec | None:
    """The protocol that is usual on a port."""
    return _BY_PORT.get(port)


# guessing

_ENOUGH = 4096  # bytes after which there is nothing more to wait for
_SEARCHED = 2048  # bytes in which a message is looked for when none begins at the first
_FRAMINGS: dict[str, Framing] = {
    "primary": states.PRIMARY,
    "realtime": states.REALTIME,
    "rtde": rtde.FRAMING,
    "modbus": modbus.FRAMING,
    "reverse": external.REVERSE,
    "trajectory": external.TRAJECTORY,
    "script-command": external.COMMANDS,
}
_FOUND_LATER = ("primary", "realtime", "rtde")  # whose headers are rare by chance


@dataclass(frozen=True, slots=True)
class Guess:
    """What bytes look like; ``side`` None when they do not say who sent them."""

    codec: Codec
    side: Side | None = None


def guess(data: bytes, final: bool) -> Guess | None:
    """What speaks like this; None when more bytes are needed, of which there are none if ``final``."""
    if not data:
        return Guess(CODECS["text"]) if final else None
    if _is_text(data):
        return _guess_text(data.decode("utf-8", "replace"), final or len(data) >= _ENOUGH)
    fitting = [name for name, framing in _FRAMINGS.items() if _messages(framing, data)]
    fitting.sort(
        key=lambda name: not _messages(_FRAMINGS[name], data, whole=True)
    )  # those that end with the bytes first
    if fitting:
        return Guess(CODECS[fitting[0]])
    if not final and len(data) < _ENOUGH:
        return None
    later = (name for start in range(1, _SEARCHED) for name in _FOUND_LATER
             if _messages(_FRAMINGS[name], data[start : start + _ENOUGH]) > 1)  # fmt: skip
    return Guess(CODECS[next(later, "bytes")])


def _messages(framing: Framing, data: bytes, whole: bool = False) -> int:
    """How many messages these bytes may be, the last one unfinished unless ``whole``; 0 when they are none."""
    count = offset = 0
    while offset < len(data):
        header = data[offset : offset + framing.header]
        if not framing.plausible(header):
            return 0
        if len(header) < framing.header:
            break
        count += 1
        offset += framing.size(header)
    return 0 if whole and offset != len(data) else count


def _is_text(data: bytes) -> bool:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.end < len(data) or error.reason != "unexpected end of data":
            return False
        text = data[: error.start].decode("utf-8")
    return all(char.isprintable() or char in "\r\n\t" for char in text)


def _guess_text(text: str, final: bool) -> Guess | None:
    line, ended, _ = text.partition("\n")
    line = line.removesuffix("\r")
    if not ended and not final:
        return None
    if line == dashboard.GREETING:
        return Guess(CODECS["dashboard"], Side.ROBOT)
    if line == REQUEST_PROGRAM.decode().rstrip():
        return Guess(CODECS["script-sender"], Side.ROBOT)
    if InterpreterCommand.of(line):
        return Guess(CODECS["interpreter"], Side.CLIENT)
    try:
        interpreter.parse_answer(line)
    except RemoteProtocolError:
        return Guess(CODECS["text"])
    return Guess(CODECS["interpreter"], Side.ROBOT)
