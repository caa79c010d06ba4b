"""Robotiq 2-finger grippers: models, codes, and the text protocol of their software on the controller (TCP 63352).

Requests are ``GET POS`` or ``SET POS 255 SPE 100``; responses are values or ``ack``. The port supports two dialects. A
request that ends with a line feed is answered with the name: ``POS 3`` and a line feed. The manufacturer's older
programs send ``GET STA`` without a line end and read only the value, by its number of digits, so nothing may follow it.
``ack`` never has a line end.

Positions are the gripper's own counts: 0 open, 255 closed; the fingers stop before either.

Sources: the manufacturer's instruction manual, and programs and clients published by it and by ur_rtde.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from urproto.compat import IntEnum
from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, number, quoted, strip

PORT: Final = 63352
FULL: Final = 255
"""The greatest value of POS, SPE and FOR."""
ACK: Final = b"ack"
NACK: Final = b"nack"  # guess: the response to an invalid request
UNKNOWN: Final = "?"  # the value while the gripper does not answer, as ur_rtde expects it
_MAX_LINE: Final = 1024  # bytes (guess)
_GET: Final = re.compile(r"GET\s+([A-Z]{3})", re.ASCII)
_SET: Final = re.compile(r"SET((?:\s+[A-Z]{3}\s+\S+)+)", re.ASCII)
_VALUE: Final = re.compile(r"([A-Z]{3})\s+(\S+)", re.ASCII)
_WORDS: Final = (NACK, ACK)  # replies without a line end


@dataclass(frozen=True, kw_only=True)
class GripperModel:
    """One model of gripper.

    stroke_mm: from closed to open. slowest, fastest: finger speeds [mm/s] at SPE 0 and 255. weakest, strongest: grip
    forces [N] at FOR 0 and 255. open_stop, closed_stop: counts at the mechanical stops; the opening is linear between
    them.
    """

    title: str
    stroke_mm: float
    slowest: float
    fastest: float
    weakest: float
    strongest: float
    open_stop: int = 3  # both stops: from the maker's calibration in a program for one 2F-85
    closed_stop: int = 230

    @property
    def counts_per_mm(self) -> float:
        """Counts of one millimetre of opening."""
        return (self.closed_stop - self.open_stop) / self.stroke_mm

    def count(self, width_mm: float) -> float:
        """The count at an opening."""
        return self.closed_stop - width_mm * self.counts_per_mm

    def width_mm(self, count: float) -> float:
        """The opening at a count."""
        return (self.closed_stop - count) / self.counts_per_mm

    def spe(self, mm_per_s: float) -> int:
        """The value of SPE at a speed of the fingers, or the nearest that the gripper has."""
        return _share((mm_per_s - self.slowest) / (self.fastest - self.slowest))

    def force(self, newtons: float) -> int:
        """The same for FOR at a grip force."""
        return _share((newtons - self.weakest) / (self.strongest - self.weakest))

    def speed(self, spe: int) -> float:
        """Counts/s at a value of SPE."""
        return (self.slowest + (self.fastest - self.slowest) * spe / FULL) * self.counts_per_mm


def _share(share: float) -> int:
    return round(FULL * min(max(share, 0.0), 1.0))


MODELS: Final[Mapping[str, GripperModel]] = {  # strokes, speeds and forces: the maker's specifications
    "robotiq-2f-85": GripperModel(
        title="Robotiq 2F-85", stroke_mm=85.0, slowest=20.0, fastest=150.0, weakest=20.0, strongest=235.0
    ),
    "robotiq-2f-140": GripperModel(
        title="Robotiq 2F-140", stroke_mm=140.0, slowest=30.0, fastest=250.0, weakest=10.0, strongest=125.0
    ),
    "robotiq-hand-e": GripperModel(
        title="Robotiq Hand-E", stroke_mm=50.0, slowest=20.0, fastest=150.0, weakest=20.0, strongest=130.0
    ),
}


class Status(IntEnum):
    """``STA``."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class ObjectStatus(IntEnum):
    """``OBJ``."""

    MOVING = 0
    HELD_OPENING = 1
    HELD_CLOSING = 2
    AT_REQUEST = 3


class Fault(IntEnum):
    """``FLT``; those from UNDER_VOLTAGE on need a reset. Names and meaning: the maker's instruction manual."""

    NONE = 0x00
    ACTION_DELAYED = 0x05
    NOT_ACTIVATED = 0x07
    OVER_TEMPERATURE = 0x08
    NO_COMMUNICATION = 0x09
    UNDER_VOLTAGE = 0x0A
    RELEASING = 0x0B
    INTERNAL = 0x0C
    ACTIVATION = 0x0D
    OVER_CURRENT = 0x0E
    RELEASED = 0x0F


@dataclass(frozen=True, slots=True)
class Get:
    """A request for the value of a variable. named: the response repeats the name and has a line end."""

    name: str
    named: bool = True


@dataclass(frozen=True, slots=True)
class Set:
    """A request to set variables to numbers, all or none."""

    values: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class InvalidRequest:
    """A line that is neither a ``GET`` nor a ``SET``."""

    text: str


Request = Get | Set | InvalidRequest


@dataclass(frozen=True, slots=True)
class Value:
    """The reply to a ``GET``; text is `UNKNOWN` while the gripper does not answer its controller."""

    name: str
    text: str


Reply = Value | bytes
"""A value, or `ACK` or `NACK`."""


class RequestDecoder:
    """Decodes the byte stream of a client to requests; its chunks may be of any size.

    A ``GET`` without a line end is complete if nothing follows for a while: call ``flush`` then.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Request]:
        """Add bytes; returns the requests they complete. Raises RemoteProtocolError for a line that is too long."""
        self._buffer += data
        *lines, rest = bytes(self._buffer).split(b"\n")
        self._buffer = bytearray(rest)
        if max(map(len, (*lines, rest))) > _MAX_LINE:
            raise RemoteProtocolError(f"a request to the gripper is longer than {_MAX_LINE} bytes")
        texts = (strip(from_bytes(line)) for line in lines)
        return [_parse(text) for text in texts if text]

    def flush(self) -> list[Request]:
        """The pending request without a line end, if it is a valid one."""
        if not self._buffer:
            return []
        found = _GET.fullmatch(from_bytes(self._buffer))
        if found is None:
            return []
        self._buffer.clear()
        return [Get(found[1], named=False)]


class ReplyDecoder:
    """Decodes the byte stream of the gripper's software to replies to requests with a line end."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Reply]:
        """Add bytes; returns the replies they complete. Raises RemoteProtocolError for anything else, after these."""
        self._buffer = (self._buffer + data).lstrip()
        replies: list[Reply] = []
        try:
            while (reply := self._next()) is not None:
                replies.append(reply)
        except RemoteProtocolError:
            if not replies:  # otherwise the next call raises it
                raise
        return replies

    def _next(self) -> Reply | None:
        for word in _WORDS:
            if self._buffer.startswith(word):
                self._buffer = self._buffer[len(word) :].lstrip()
                return word
        line, end, rest = self._buffer.partition(b"\n")
        if len(line) > _MAX_LINE:
            raise RemoteProtocolError(f"this is not a gripper: it sent more than {_MAX_LINE} bytes without a line end")
        if not end:
            return None
        found = _VALUE.fullmatch(strip(from_bytes(line)))
        if found is None:
            raise RemoteProtocolError(f"this is not a gripper: it sent {quoted(from_bytes(line))}")
        self._buffer = rest.lstrip()
        return Value(found[1], found[2])


def encode_get(name: str) -> bytes:
    """Request the value of a variable."""
    return f"GET {name}\n".encode("ascii")


def encode_set(values: Mapping[str, int]) -> bytes:
    """Request that variables be set, in this order."""
    return f"SET {' '.join(f'{name} {value}' for name, value in values.items())}\n".encode("ascii")


def encode_value(request: Get, text: str) -> bytes:
    """The response to a ``GET``."""
    return (f"{request.name} {text}\n" if request.named else text).encode("ascii")


def _parse(text: str) -> Request:
    if found := _GET.fullmatch(text):
        return Get(found[1])
    if found := _SET.fullmatch(text):
        values = [(name, parse_whole_number(word)) for name, word in _VALUE.findall(found[1])]
        assigned = tuple((name, value) for name, value in values if value is not None)
        if len(assigned) == len(values):
            return Set(assigned)
    return InvalidRequest(text)


def parse_whole_number(word: str) -> int | None:
    """Parse a whole number; programs also send it as a float."""
    try:
        value = number(word)
    except ValueError:
        return None
    return int(value) if value.is_integer() else None
