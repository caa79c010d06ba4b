"""The text protocol of the Robotiq gripper software on the controller (TCP 63352).

Requests are ``GET POS`` or ``SET POS 255 SPE 100``; responses are values or ``ack``. The port supports two dialects. A
request that ends with a line feed is answered with the name: ``POS 3`` and a line feed. The manufacturer's older
programs send ``GET STA`` without a line end and read only the value, by its number of digits, so nothing may follow it.
``ack`` never has a line end.

Sources: programs and clients published by the gripper's manufacturer and by ur_rtde.
"""

import re
from dataclasses import dataclass
from typing import Final

from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, number, strip

PORT: Final = 63352
ACK: Final = b"ack"
NACK: Final = b"nack"  # guess: the response to an invalid request
UNKNOWN: Final = "?"  # the value while the gripper does not answer, as ur_rtde expects it
_MAX_LINE: Final = 1024  # bytes (guess)
_GET: Final = re.compile(r"GET\s+([A-Z]{3})", re.ASCII)
_SET: Final = re.compile(r"SET((?:\s+[A-Z]{3}\s+\S+)+)", re.ASCII)
_VALUE: Final = re.compile(r"([A-Z]{3})\s+(\S+)", re.ASCII)


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


def encode_value(request: Get, text: str) -> bytes:
    """The response to a ``GET``."""
    return (f"{request.name} {text}\n" if request.named else text).encode("ascii")


def _parse(text: str) -> Request:
    if found := _GET.fullmatch(text):
        return Get(found[1])
    if found := _SET.fullmatch(text):
        values = [(name, _parse_whole_number(word)) for name, word in _VALUE.findall(found[1])]
        assigned = tuple((name, value) for name, value in values if value is not None)
        if len(assigned) == len(values):
            return Set(assigned)
    return InvalidRequest(text)


def _parse_whole_number(word: str) -> int | None:
    """Parse a whole number; programs also send it as a float."""
    try:
        value = number(word)
    except ValueError:
        return None
    return int(value) if value.is_integer() else None
