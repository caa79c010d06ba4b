"""Messages from the robot on the primary, secondary and realtime interfaces as text."""

import struct
from collections.abc import Iterator

from client.decoding import formatting
from client.decoding.streams import FramedStream, Framing, Line
from urproto import realtime
from urproto.errors import RemoteProtocolError
from urproto.primary.framing import MAX_MESSAGE_SIZE, OtherMessage, PrimaryDecoder
from urproto.primary.messages import ErrorCodeMessage, UnknownMessage
from urproto.primary.state import RobotStateData

_HEADER = struct.Struct(">iB")
_LIKELY_SIZE = 65536  # bytes; guess: ample for a message, but less than most random sizes
# Names as in the official C++ client. Messages that are not decoded here are skipped by their size.
_OTHER_TYPES = {
    5: "modbus info",
    22: "HMC",
    23: "safety set-up",
    24: "safety compliance tolerances",
}
_KNOWN_TYPES = {16, 20, 25, *_OTHER_TYPES}
_SIZE = struct.Struct(">i")


def _primary_size(header: bytes) -> int:
    size, _ = _HEADER.unpack_from(header)
    if not _HEADER.size <= size <= MAX_MESSAGE_SIZE:
        raise RemoteProtocolError(f"no message has size {size}")
    return int(size)


def _primary_likely(header: bytes) -> bool:
    size, kind = _HEADER.unpack_from(header)
    return kind in _KNOWN_TYPES and size <= _LIKELY_SIZE


PRIMARY = Framing("primary interface", _HEADER.size, _primary_size, _primary_likely)


def primary_stream() -> FramedStream:
    """Messages of ports 30001, 30002, 30011 and 30012, from the robot."""
    decoder = PrimaryDecoder()

    def read(data: bytes) -> Iterator[Line]:
        for message in decoder.feed(data):
            if isinstance(message, OtherMessage) and message.error:
                raise RemoteProtocolError(f"type {message.type}: {message.error}")
            yield Line(_described(message))

    return FramedStream(PRIMARY, read)


def _described(message: object) -> str:
    if isinstance(message, OtherMessage):
        name = _OTHER_TYPES.get(message.type, "message")
        return f"{name} (type {message.type}): {formatting.value(message.payload)}"
    if isinstance(message, RobotStateData):
        return f"state: {formatting.message(message)}"
    name = type(message).__name__.removesuffix("Message")
    if isinstance(message, UnknownMessage):
        name = "message of unknown kind"
    label = f" {message.label}" if isinstance(message, ErrorCodeMessage) else ""
    return f"{name}{label}: {formatting.message(message)}"


# realtime


def _layouts() -> dict[int, str]:
    """The first versions of each packet size."""
    firsts = {first for column in realtime.COLUMNS for first in (column.since.cb3, column.since.e) if first}
    layouts: dict[int, list[str]] = {}
    for first in sorted(firsts):
        name = f"{first.series.value} {first.major}.{first.minor}"
        layouts.setdefault(realtime.packet_size(first), []).append(name)
    return {size: f"since {' and '.join(names)}" for size, names in layouts.items()}


_LAYOUTS = _layouts()
_NEWEST = max(_LAYOUTS)


def _realtime_size(header: bytes) -> int:
    (size,) = _SIZE.unpack_from(header)
    if size not in _LAYOUTS and not _NEWEST < size <= _LIKELY_SIZE:
        raise RemoteProtocolError(f"no packet has size {size}; known sizes are {', '.join(map(str, sorted(_LAYOUTS)))}")
    return int(size)


def _realtime_likely(header: bytes) -> bool:
    return _SIZE.unpack_from(header)[0] in _LAYOUTS


REALTIME = Framing("realtime", _SIZE.size, _realtime_size, _realtime_likely)


def realtime_stream() -> FramedStream:
    """Packets of ports 30003 and 30013, from the robot."""
    return FramedStream(REALTIME, _read_realtime)


def _read_realtime(data: bytes) -> Iterator[Line]:
    layout = _LAYOUTS.get(len(data), f"longer than any known packet, read as {_LAYOUTS[_NEWEST]}")
    yield Line(f"state of {len(data)} bytes ({layout}): {formatting.pairs(realtime.decode_realtime(data).items())}")
