"""Building blocks of binary messages. All numbers on the controller's ports are big-endian.

A field of a message has a type that names its form on the wire: a struct layout, ``short`` for text preceded by a
length byte, or, up to the end of the message, ``text``, ``names`` separated by commas, or ``bytes``.
"""

import struct
from abc import ABC, abstractmethod
from dataclasses import fields
from functools import cache, lru_cache
from typing import Annotated, Any, ClassVar, Final, Generic, TypeAlias, TypeVar

from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.text import from_bytes, to_bytes
from urproto.vectors import Vector3, Vector6

Layout: TypeAlias = tuple[tuple[str, str], ...]
"""Names of fields and their forms."""

Flag: TypeAlias = Annotated[bool, "?"]
Int8: TypeAlias = Annotated[int, "b"]
UInt8: TypeAlias = Annotated[int, "B"]
UInt16: TypeAlias = Annotated[int, "H"]
Int32: TypeAlias = Annotated[int, "i"]
UInt32: TypeAlias = Annotated[int, "I"]
UInt64: TypeAlias = Annotated[int, "Q"]
Float: TypeAlias = Annotated[float, "f"]
Double: TypeAlias = Annotated[float, "d"]
ThreeDoubles: TypeAlias = Annotated[Vector3, "3d"]
SixDoubles: TypeAlias = Annotated[Vector6, "6d"]
ShortText: TypeAlias = Annotated[str, "short"]
Text: TypeAlias = Annotated[str, "text"]
Names: TypeAlias = Annotated[tuple[str, ...], "names"]
Rest: TypeAlias = Annotated[bytes, "bytes"]

TO_THE_END: Final = ("text", "names", "bytes")

_MessageT = TypeVar("_MessageT")

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


@cache
def marked_fields(kind: Any) -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """The fields of a message that have a form on the wire: their names, and their forms with what follows these."""
    marked = ((field.name, getattr(field.type, "__metadata__", ())) for field in fields(kind))
    return tuple((name, marks) for name, marks in marked if marks)


def encode_item(form: str, value: Any) -> bytes:
    """Encode the value of a field, a single one if its form is a layout. Raises LocalProtocolError."""
    match form:
        case "text":
            return to_bytes(value)
        case "names":
            return to_bytes(",".join(value))
        case "bytes":
            return bytes(value)
        case "short":
            return short_text(value)
    return pack(form, value)


def decode_item(form: str, reader: Reader) -> Any:
    """Decode the next field. Raises RemoteProtocolError."""
    match form:
        case "text":
            return from_bytes(reader.rest())
        case "names":
            text = from_bytes(reader.rest())
            return tuple(text.removesuffix(",").split(",")) if text else ()  # ur_rtde appends a comma
        case "bytes":
            return reader.rest()
        case "short":
            return reader.short_text()
    return reader.unpack(form)[0]


class SizedMessageDecoder(ABC, Generic[_MessageT]):
    """Splits a stream into messages whose headers say how long they are, and decodes them.

    The stream's chunks may be of any size. No more than one incomplete message is kept. error: what ended the stream.
    """

    header: ClassVar[struct.Struct]

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.error: RemoteProtocolError | None = None

    def feed(self, data: bytes) -> list[_MessageT]:
        """Add bytes; returns the messages they complete.

        An invalid header ends the stream: messages before it are still returned, and this call, or the next one if
        there were any, raises RemoteProtocolError; ``error`` is set immediately.
        """
        messages: list[_MessageT] = []
        self._buffer += data
        try:
            while self.error is None and len(self._buffer) >= self.header.size:
                size = self._size(*self.header.unpack_from(self._buffer))
                if len(self._buffer) < size:
                    break
                message = bytes(self._buffer[:size])
                del self._buffer[:size]
                messages.append(self._decode(message))
        except RemoteProtocolError as error:
            self.error = error
        if self.error is not None:
            self._buffer.clear()
            if not messages:
                raise self.error
        return messages

    @abstractmethod
    def _size(self, *header: int) -> int:
        """Bytes of the whole message with this header. Raises RemoteProtocolError if there is no such message."""

    @abstractmethod
    def _decode(self, message: bytes) -> _MessageT:
        """Decode a message, with its header. Raises RemoteProtocolError, which ends the stream."""
