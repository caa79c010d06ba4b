"""The parts binary messages are made of. All numbers on the controller's ports are big-endian."""

import struct
from functools import lru_cache
from typing import Any

from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.text import from_bytes, to_bytes

MAX_SHORT_TEXT = 255  # bytes: a title's or name's length travels in one byte


@lru_cache(maxsize=256)
def big_endian(layout: str) -> struct.Struct:
    """Compiled packer of a struct layout given without its byte-order mark."""
    return struct.Struct(">" + layout)


def pack(layout: str, *values: Any) -> bytes:
    """Pack big-endian; LocalProtocolError when a value does not fit its wire type."""
    try:
        return big_endian(layout).pack(*values)
    except (struct.error, OverflowError) as error:
        raise LocalProtocolError(f"{values!r} does not fit the layout {layout!r}: {error}") from error


def short_text(text: str) -> bytes:
    """One length byte and the text, cut where the length byte ends."""
    data = to_bytes(text)[:MAX_SHORT_TEXT]
    return bytes([len(data)]) + data


class Reader:
    """A cursor over one message's bytes; every short read is a RemoteProtocolError."""

    __slots__ = ("_data", "_name", "_offset")

    def __init__(self, data: bytes, name: str) -> None:
        self._data = data
        self._name = name
        self._offset = 0

    @property
    def remaining(self) -> int:
        """Bytes not read yet."""
        return len(self._data) - self._offset

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        if size < 0 or size > self.remaining:
            raise RemoteProtocolError(
                f"{self._name} ends too early: {size} bytes wanted at offset {self._offset}, {self.remaining} left"
            )
        start = self._offset
        self._offset = start + size
        return self._data[start : self._offset]

    def unpack(self, layout: str) -> tuple[Any, ...]:
        """The next values in a big-endian struct layout."""
        packer = big_endian(layout)
        return packer.unpack(self.take(packer.size))

    def short_text(self) -> str:
        """Text behind a length byte."""
        (size,) = self.unpack("B")
        return from_bytes(self.take(size))

    def rest(self) -> bytes:
        """Everything that is left."""
        return self.take(self.remaining)
