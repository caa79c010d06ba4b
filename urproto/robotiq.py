"""The text protocol of the Robotiq gripper software on the controller (TCP 63352).

``GET POS`` and ``SET POS 255 SPE 100`` in, values and ``ack`` out. Two dialects live on one
port. A request that ends with a line feed is answered by name: ``POS 3`` and a line feed.
The maker's older programs send ``GET STA`` without a line end and read the value alone, by
its number of digits, so that nothing may follow it. ``ack`` never has a line end.

Facts: the programs and clients that the gripper's maker and ur_rtde published.
"""

import re
from dataclasses import dataclass
from typing import Final

from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, number, strip

PORT: Final = 63352
ACK: Final = b"ack"
NACK: Final = b"nack"  # guess: what is not understood is not acknowledged
UNKNOWN: Final = "?"  # the value while the gripper does not answer, as ur_rtde expects it
_LONGEST_LINE: Final = 1024  # bytes (guess)
_GET: Final = re.compile(r"GET\s+([A-Z]{3})", re.ASCII)
_SET: Final = re.compile(r"SET((?:\s+[A-Z]{3}\s+\S+)+)", re.ASCII)
_VALUE: Final = re.compile(r"([A-Z]{3})\s+(\S+)", re.ASCII)


@dataclass(frozen=True, slots=True)
class Get:
    """The value of one variable is wanted. ``named``: the answer repeats the name and ends its line."""

    name: str
    named: bool = True


@dataclass(frozen=True, slots=True)
class Set:
    """Variables and the numbers they shall have, all or none."""

    values: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Unclear:
    """A line that is neither."""

    text: str


Request = Get | Set | Unclear


class RequestDecoder:
    """Bytes of one client to requests, in any split.

    A ``GET`` without its line end is complete when nothing follows it for a while: call
    ``flush`` then.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Request]:
        """The requests that ended. Raises RemoteProtocolError for a line beyond any request's length."""
        self._buffer += data
        *lines, rest = bytes(self._buffer).split(b"\n")
        self._buffer = bytearray(rest)
        if max(map(len, (*lines, rest))) > _LONGEST_LINE:
            raise RemoteProtocolError(f"a request to the gripper is longer than {_LONGEST_LINE} bytes")
        texts = (strip(from_bytes(line)) for line in lines)
        return [_parse(text) for text in texts if text]

    def flush(self) -> list[Request]:
        """The request that has no line end, if it can be one."""
        if not self._buffer:
            return []
        found = _GET.fullmatch(from_bytes(self._buffer))
        if found is None:
            return []
        self._buffer.clear()
        return [Get(found[1], named=False)]


def encode_value(request: Get, text: str) -> bytes:
    """The answer to a ``GET``."""
    return (f"{request.name} {text}\n" if request.named else text).encode("ascii")


def _parse(text: str) -> Request:
    if found := _GET.fullmatch(text):
        return Get(found[1])
    if found := _SET.fullmatch(text):
        values = [(name, _whole(word)) for name, word in _VALUE.findall(found[1])]
        wanted = tuple((name, value) for name, value in values if value is not None)
        if len(wanted) == len(values):
            return Set(wanted)
    return Unclear(text)


def _whole(word: str) -> int | None:
    """Programs also send whole numbers as floats."""
    try:
        value = number(word)
    except ValueError:
        return None
    return int(value) if value.is_integer() else None
