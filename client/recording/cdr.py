"""CDR, the serialisation of ROS 2 messages, driven by message definitions in ROS's own language.

A definition has the format of a ``ros2msg`` schema: one field per line, followed by the types it uses, each after a
line of equals signs. The encoding is plain CDR version 1, little endian: a header of four bytes, then the values, with
every number aligned to its size as counted from the end of the header. Source: OMG DDSI-RTPS 10.5 and the interface
definitions of ROS 2.
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from client.errors import RecordingError
from urproto.text import readable

_HEADER: Final = b"\x00\x01\x00\x00"
_LITTLE_ENDIAN: Final = 1
_NUMBERS: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_SHORT_NAMES: Final = {
    "Header": "std_msgs/Header",
    "time": "builtin_interfaces/Time",
    "duration": "builtin_interfaces/Duration",
}
_FIELD: Final = re.compile(
    r"(?P<type>[A-Za-z]\w*(/\w+)*)(<=\d+)?(?P<array>\[(?P<count>(<=)?\d*)\])?\s+(?P<name>\w+)(\s*=|.*)"
)
_CONSTANT: Final = re.compile(r"\S+\s+\w+\s*=")
_SEPARATOR: Final = re.compile(r"^=+\s*\n\s*MSG:\s*(\S+)\s*\n", re.MULTILINE)

Put = Callable[[bytearray, Any], None]
Get = Callable[["_Cursor"], Any]


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field of a message. type: a number type, ``string``, or another message type.

    count: None for a single value, 0 for an array of variable length, otherwise the length of the array.
    """

    name: str
    type: str
    count: int | None


class MessageType:
    """A message type.

    name: as in ROS 2, such as ``sensor_msgs/msg/JointState``. definition: its ``ros2msg`` schema. names: its fields.
    structs: the fields of this type, which comes first, and of the types it uses, by short name
    (``sensor_msgs/JointState``). Raises RecordingError for an invalid definition.
    """

    def __init__(self, name: str, definition: str) -> None:
        self.name = name
        self.definition = definition
        parts = _SEPARATOR.split(definition)
        own = name.replace("/msg/", "/")
        texts = {own: parts[0]} | dict(zip(_short_names(parts[1::2]), parts[2::2], strict=True))
        self.structs = {name: tuple(_fields(text, name)) for name, text in texts.items()}
        self._put, self._get = self._codec(own, ())
        self.names = tuple(field.name for field in self.structs[own])

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Encode a message; fields left out are zero or empty."""
        out = bytearray()
        self._put(out, values)
        return _HEADER + bytes(out)

    def decode(self, data: bytes) -> dict[str, Any]:
        """Decode the fields of a message. Raises RecordingError if it does not match the definition."""
        if len(data) < len(_HEADER) or data[0] != 0 or data[1] > _LITTLE_ENDIAN:
            raise RecordingError(f"a message of type {self.name} is not plain CDR")
        cursor = _Cursor(data[len(_HEADER) :], "<" if data[1] == _LITTLE_ENDIAN else ">")
        try:
            fields: dict[str, Any] = self._get(cursor)
        except (struct.error, UnicodeDecodeError) as error:
            raise RecordingError(f"a message of type {self.name} does not match its definition: {error}") from error
        return fields

    def _codec(self, type_name: str, parent: tuple[str, ...]) -> tuple[Put, Get]:
        """Encoder and decoder of a message type."""
        if type_name not in self.structs or type_name in parent:
            raise RecordingError(f"the definition of {self.name} does not define {type_name}")
        fields = {
            field.name: self._field(field.type, field.count, (*parent, type_name)) for field in self.structs[type_name]
        }

        def put(out: bytearray, values: Mapping[str, Any]) -> None:
            for name, (put_field, _) in fields.items():
                put_field(out, values.get(name))

        def get(cursor: "_Cursor") -> dict[str, Any]:
            return {name: get_field(cursor) for name, (_, get_field) in fields.items()}

        return lambda out, values: put(out, values or {}), get

    def _field(self, kind: str, count: int | None, parent: tuple[str, ...]) -> tuple[Put, Get]:
        if kind in _NUMBERS:
            return _number(_NUMBERS[kind]) if count is None else _numbers(_NUMBERS[kind], count)
        put, get = (_put_string, _get_string) if kind == "string" else self._codec(kind, parent)
        return (put, get) if count is None else _sequence_codec(put, get, count)


class Message(NamedTuple):
    """An encoded message, and the name of its topic."""

    topic: str
    type: MessageType
    data: bytes


class _Cursor:
    """A read position in a message."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data = data
        self.order = order
        self.at = 0

    def take(self, letter: str, count: int = 1) -> tuple[Any, ...]:
        """Read numbers of one type. Raises struct.error past the end."""
        size = struct.calcsize(letter)
        start = -(-self.at // size) * size
        if start + count * size > len(self.data):
            raise struct.error(f"{count} values of {size} bytes at byte {start} of {len(self.data)}")
        values = struct.unpack_from(f"{self.order}{count}{letter}", self.data, start)
        self.at = start + count * size
        return values


def _short_names(names: list[str]) -> Iterator[str]:
    return (name.replace("/msg/", "/") for name in names)


def _fields(text: str, parent: str) -> Iterator[MessageField]:
    """The fields in the definition of the type ``parent``."""
    for line in text.splitlines():
        line = line.split("#")[0].strip()
        if not line or _CONSTANT.match(line):
            continue
        match = _FIELD.fullmatch(line)
        if match is None:
            raise RecordingError(f"invalid line in a message definition: {line!r}")
        count = match["count"] or ""
        fixed = int(count) if count.isdigit() else 0
        yield MessageField(match["name"], _resolved(match["type"], parent), fixed if match["array"] else None)


def _resolved(kind: str, parent: str) -> str:
    """A type's full name; without a package, the type belongs to the same package."""
    kind = _SHORT_NAMES.get(kind, kind.replace("/msg/", "/"))
    if "/" in kind or kind in _NUMBERS or kind == "string":
        return kind
    return f"{parent.split('/')[0]}/{kind}"


def _align(out: bytearray, size: int) -> None:
    out.extend(bytes(-len(out) % size))


def _number(letter: str) -> tuple[Put, Get]:
    packer = struct.Struct(f"<{letter}")

    def put(out: bytearray, value: Any) -> None:
        _align(out, packer.size)
        out.extend(packer.pack(value or 0))

    return put, lambda cursor: cursor.take(letter)[0]


def _numbers(letter: str, count: int) -> tuple[Put, Get]:
    size = struct.calcsize(letter)

    def put(out: bytearray, values: Any) -> None:
        values = (0,) * count if values is None else values
        if not count:
            _put_length(out, len(values))
        elif len(values) != count:
            raise RecordingError(f"an array of {count} numbers got {len(values)}")
        if isinstance(values, bytes):  # an image has hundreds of thousands of bytes: much faster than unpacking them
            out.extend(values)
        elif len(values):
            _align(out, size)
            out.extend(struct.pack(f"<{len(values)}{letter}", *values))

    def get(cursor: _Cursor) -> tuple[Any, ...]:
        length = count or cursor.take("I")[0]
        return cursor.take(letter, length) if length else ()

    return put, get


def _sequence_codec(put_one: Put, get_one: Get, count: int) -> tuple[Put, Get]:
    def put(out: bytearray, values: Any) -> None:
        values = values or ()
        if count:
            values = [*values, *[None] * (count - len(values))]
        else:
            _put_length(out, len(values))
        for value in values:
            put_one(out, value)

    def get(cursor: _Cursor) -> list[Any]:
        length = count or cursor.take("I")[0]
        if length > len(cursor.data):  # every element has at least one byte
            raise struct.error(f"{length} elements in {len(cursor.data)} bytes")
        return [get_one(cursor) for _ in range(length)]

    return put, get


def _put_length(out: bytearray, length: int) -> None:
    _align(out, 4)
    out.extend(length.to_bytes(4, "little"))


def _put_string(out: bytearray, value: Any) -> None:
    data = readable(value or "").encode() + b"\0"
    _put_length(out, len(data))
    out.extend(data)


def _get_string(cursor: _Cursor) -> str:
    (length,) = cursor.take("I")
    return b"".join(cursor.take("c", length)).rstrip(b"\0").decode() if length else ""
