"""Building blocks of binary messages. All numbers on the controller's ports are big-endian."""

import struct
from functools import lru_cache
from typing import Any

from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.text import from_bytes, to_bytes

MAX_SHORT_TEXT = 255  # bytes: the length of a title or name is sent in one byte


@lru_cache(maxsize=256)
def big_endian(layout: str) -> struct.Struct:
    """A compiled struct for a layout given without byte order."""
    return struct.Struct(">" + layout)


def pack(layout: str, *values: Any) -> bytes:
    """Pack values big-endian. Raises LocalProtocolError when one does not fit its wire type."""
    try:
        return big_endian(layout).pack(*values)
    except (struct.error, OverflowError) as error:
        raise LocalProtocolError(f"{values!r} does not fit the layout {layout!r}: {error}") from error


def short_text(text: str) -> bytes:
    """A length byte followed by the text, which is cut at 255 bytes."""
    data = to_bytes(text)[:MAX_SHORT_TEXT]
    return bytes([len(data)]) + data


class Reader:
    """A cursor over the bytes of a message; reading past the end raises RemoteProtocolError."""

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
                f"{self._name} ends too early: {size} bytes expected at offset {self._offset}, {self.remaining} left"
            )
        start = self._offset
        self._offset = start + size
        return self._data[start : self._offset]

    def unpack(self, layout: str) -> tuple[Any, ...]:
        """The next values in a big-endian struct layout."""
        packer = big_endian(layout)
        return packer.unpack(self.take(packer.size))

    def short_text(self) -> str:
        """Text preceded by a length byte."""
        (size,) = self.unpack("B")
        return from_bytes(self.take(size))

    def rest(self) -> bytes:
        """All remaining bytes."""
        return self.take(self.remaining)
