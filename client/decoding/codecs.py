"""The protocol of each port, and recognition of a protocol from its bytes."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from ipaddress import IPv4Address, IPv6Address, ip_address

from client.decoding import external, formatting, modbus, rtde, states
from client.decoding.packets import SocketAddress
from client.decoding.streams import Framing, Line, LineStream, Stream, problem
from urproto import dashboard, interpreter
from urproto.errors import RemoteProtocolError
from urproto.external_control import REQUEST_PROGRAM
from urproto.interpreter import InterpreterCommand

_MAX_LINE = 8192  # bytes; longer lines are shown in pieces
_TCP = 6
_MAX_SEGMENT = 32768  # bytes of a segment: IP's size field ends at 64 kB
_WINDOW = 0xFFFF
_NUMBERS = 1 << 32
_MACS = {True: bytes.fromhex("020000000001"), False: bytes.fromhex("020000000002")}  # locally administered
_GUESS_BYTES = 4096  # bytes after which a guess is made
_SEARCH_BYTES = 2048  # bytes that are searched if no message starts at the first byte
_FRAMINGS: dict[str, Framing] = {
    "primary": states.PRIMARY,
    "realtime": states.REALTIME,
    "rtde": rtde.FRAMING,
    "modbus": modbus.FRAMING,
    "reverse": external.REVERSE,
    "trajectory": external.TRAJECTORY,
    "script-command": external.COMMANDS,
}
_FOUND_LATER = ("primary", "realtime", "rtde")  # their headers hardly ever occur by chance


def _read(text: str) -> Iterator[Line]:
    yield Line(formatting.escaped(text))


def _read_statement(text: str) -> Iterator[Line]:
    command = InterpreterCommand.of(text)
    yield Line(f"command {command.value}" if command else f"statements: {formatting.escaped(text)}")


def _read_answer(text: str) -> Iterator[Line]:
    try:
        answer = interpreter.parse_answer(text)
    except RemoteProtocolError:
        yield problem(f"not an answer of interpreter mode: {formatting.quoted(text)}")
        return
    if answer.number is None:
        yield Line(f"discarded, {formatting.escaped(answer.reason)}: {formatting.escaped(answer.line)}")
    else:
        yield Line(formatting.escaped(text))


class BytesStream:
    """Bytes of an unknown protocol, as they arrive."""

    def __init__(self) -> None:
        self._offset = 0

    def feed(self, data: bytes) -> Iterator[Line]:
        yield problem(f"offset {self._offset}: {len(data)} bytes of no known protocol: {formatting.value(data)}")
        self._offset += len(data)

    def skip(self, size: int) -> None:
        self._offset += size

    def end(self) -> Iterator[Line]:
        yield from ()


_FIN, _SYN, _RST, _PSH, _ACK = 1, 2, 4, 8, 16


class ConnectionFrames:
    """Ethernet frames of one connection. number: distinguishes connections between the same ends."""

    def __init__(self, client: SocketAddress, server: SocketAddress, number: int = 0) -> None:
        addresses = _addresses(client.address, server.address)
        self._ends = {True: (addresses[0], client.port), False: (addresses[1], server.port)}
        self._next = {True: _first_number(2 * number), False: _first_number(2 * number + 1)}

    def open(self) -> Iterator[bytes]:
        """The handshake."""
        yield self._frame(True, _SYN)
        yield self._frame(False, _SYN | _ACK)
        yield self._frame(True, _ACK)

    def data(self, from_client: bool, data: bytes) -> Iterator[bytes]:
        """Frames with bytes of one end."""
        for start in range(0, len(data), _MAX_SEGMENT):
            yield self._frame(from_client, _PSH | _ACK, data[start : start + _MAX_SEGMENT])

    def end(self, from_client: bool) -> bytes:
        """The frame that ends the sending of one end."""
        return self._frame(from_client, _FIN | _ACK)

    def reset(self, from_client: bool) -> bytes:
        """The frame with which one end resets the connection."""
        return self._frame(from_client, _RST | _ACK)

    def _frame(self, from_client: bool, flags: int, data: bytes = b"") -> bytes:
        (source, port), (destination, other_port) = self._ends[from_client], self._ends[not from_client]
        ack = self._next[not from_client] if flags & _ACK else 0
        head = struct.pack(">2H2I2B3H", port, other_port, self._next[from_client], ack, 5 << 4, flags, _WINDOW, 0, 0)
        tcp = head + data
        self._next[from_client] = (self._next[from_client] + len(data) + bool(flags & (_FIN | _SYN))) % _NUMBERS
        pseudo = source.packed + destination.packed + struct.pack(">2I", len(tcp), _TCP)
        tcp = tcp[:16] + _checksum(pseudo + tcp) + tcp[18:]
        macs = _MACS[not from_client] + _MACS[from_client]
        if source.version == 4:
            return macs + b"\x08\x00" + _ipv4(source.packed, destination.packed, len(tcp)) + tcp
        return macs + b"\x86\xdd" + _ipv6(source.packed, destination.packed, len(tcp)) + tcp


def _addresses(client: str, server: str) -> list[IPv4Address | IPv6Address]:
    """Both addresses as IPv4, or both as IPv6 if one of them is."""
    found = [ip_address(text.partition("%")[0]) for text in (client, server)]
    if found[0].version == found[1].version:
        return found
    return [ip_address(f"::ffff:{address}") if address.version == 4 else address for address in found]


def _first_number(number: int) -> int:
    return number * 0x01000193 % _NUMBERS  # far from that of the previous connection


def _ipv4(source: bytes, destination: bytes, size: int) -> bytes:
    head = struct.pack(">2B3H2BH", 0x45, 0, 20 + size, 0, 0x4000, 64, _TCP, 0) + source + destination
    return head[:10] + _checksum(head) + head[12:]


def _ipv6(source: bytes, destination: bytes, size: int) -> bytes:
    return struct.pack(">IH2B", 6 << 28, size, _TCP, 64) + source + destination


def _checksum(data: bytes) -> bytes:
    """Checksum of IP and TCP: the complement of the ones' complement sum of all 16-bit words (RFC 1071)."""
    words = int.from_bytes(data + bytes(len(data) % 2), "big") % 0xFFFF  # 2^16 = 1 (mod 0xFFFF): the sum of the words
    return (0xFFFF - words).to_bytes(2, "big") if words else bytes(2)


class Side(Enum):
    """The sender of a stream; a driver (External Control) counts as the client."""

    ROBOT = "robot"
    CLIENT = "client"


@dataclass(frozen=True, slots=True)
class Channel:
    """The streams of one connection. unknown: a stream whose sender is recognised from the bytes."""

    from_robot: Stream
    from_client: Stream
    unknown: Stream | None = None

    def stream(self, side: Side | None, usual: Side) -> Stream:
        """The stream from one side."""
        if side is None and self.unknown is not None:
            return self.unknown
        return self.from_robot if (side or usual) is Side.ROBOT else self.from_client


@dataclass(frozen=True, slots=True)
class Codec:
    """A protocol. server: the side that listens on its ports. usual: assumed sender of a single stream."""

    name: str
    ports: tuple[int, ...]
    open: Callable[[], Channel]
    server: Side = Side.ROBOT
    usual: Side = Side.ROBOT

    def side(self, from_server: bool) -> Side:
        """The side that the server of a connection, or its other end, is."""
        return self.server if from_server else next(side for side in Side if side is not self.server)


def _both(open_conversation: Callable[[], rtde.RTDEConversation | modbus.ModbusConversation]) -> Callable[[], Channel]:
    """The streams of a conversation whose directions complete each other."""

    def open_channel() -> Channel:
        conversation = open_conversation()
        return Channel(conversation.from_robot, conversation.from_client, conversation.unknown)

    return open_channel


def _lines(read: Callable[[str], Iterator[Line]] = _read, *, unfinished: bool = False) -> LineStream:
    return LineStream(read, _MAX_LINE, unfinished=unfinished)


def _text() -> Channel:
    return Channel(_lines(), _lines())


def _answered(from_driver: Stream) -> Channel:
    return Channel(external.result_stream(), from_driver)


_DRIVER = {"server": Side.CLIENT, "usual": Side.CLIENT}

CODECS = {
    codec.name: codec
    for codec in (
        Codec("rtde", (30004,), _both(rtde.RTDEConversation)),
        Codec("primary", (30001, 30002, 30011, 30012), lambda: Channel(states.primary_stream(), _lines())),
        Codec("realtime", (30003, 30013), lambda: Channel(states.realtime_stream(), _lines())),
        Codec("dashboard", (29999,), _text),
        Codec("interpreter", (30020,), lambda: Channel(_lines(_read_answer), _lines(_read_statement))),
        Codec("modbus", (502,), _both(modbus.ModbusConversation)),
        Codec("reverse", (50001,), lambda: Channel(_lines(), external.reverse_stream()), **_DRIVER),
        Codec("script-sender", (50002,), _text, **_DRIVER),
        Codec("trajectory", (50003,), lambda: _answered(external.trajectory_stream()), **_DRIVER),
        Codec("script-command", (50004,), lambda: _answered(external.command_stream()), **_DRIVER),
        # its ``ack`` may lack a line feed: text received together is shown together
        Codec("gripper", (63352,), lambda: Channel(_lines(unfinished=True), _lines(unfinished=True))),
        Codec("text", (), _text),
        Codec("bytes", (), lambda: Channel(BytesStream(), BytesStream())),
    )
}
_BY_PORT = {port: codec for codec in CODECS.values() for port in codec.ports}


def codec_of_port(port: int) -> Codec | None:
    """The protocol that is usual on a port."""
    return _BY_PORT.get(port)


# guessing


@dataclass(frozen=True, slots=True)
class Guess:
    """The probable protocol of some bytes, and their sender; None if the bytes do not show it."""

    codec: Codec
    side: Side | None = None


def guess(data: bytes, final: bool) -> Guess | None:
    """The probable protocol of some bytes; None if more bytes are needed. final: there are no more bytes."""
    if not data:
        return Guess(CODECS["text"]) if final else None
    if _is_text(data):
        return _guess_text(data.decode("utf-8", "replace"), final or len(data) >= _GUESS_BYTES)
    fitting = [name for name, framing in _FRAMINGS.items() if _messages(framing, data)]
    fitting.sort(
        key=lambda name: not _messages(_FRAMINGS[name], data, whole=True)
    )  # those that end with the bytes first
    if fitting:
        return Guess(CODECS[fitting[0]])
    if not final and len(data) < _GUESS_BYTES:
        return None
    later = (name for start in range(1, _SEARCH_BYTES) for name in _FOUND_LATER
             if _messages(_FRAMINGS[name], data[start : start + _GUESS_BYTES]) > 1)  # fmt: skip
    return Guess(CODECS[next(later, "bytes")])


def _messages(framing: Framing, data: bytes, whole: bool = False) -> int:
    """Number of messages in these bytes, if they are messages, else 0. whole: the last one must be complete."""
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
