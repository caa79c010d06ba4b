"""Program state messages (type 25): names and values of the running program's variables.

The names are sent once, when a program starts; values follow in the same order. Both contain the index of their first
variable, so a long list may be split. Each value has a type code; the codes changed with 3.3, and with 3.14 and 5.9.

Sources: decoders of two public clients for the value encoding, the vendor's client interface document of 5.9 for the
codes by version, a 5.4 simulator's capture for the header, and the vendor's client interface document of 5.6 for the
kinds.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from urproto._wire import Reader, big_endian, pack, short_text
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.primary._wire import PROGRAM_STATE, frame
from urproto.primary.messages import NO_TIMESTAMP_US
from urproto.text import from_bytes, to_bytes
from urproto.versions import Availability, PolyscopeVersion

_OLD_CODES = Availability.since("3.3", "5.0")
_NEW_CODES = Availability.since("3.14", "5.9")
_MAX_DEPTH = 32  # lists within lists (guess: nothing nests deeper)
_MAX_TEXT = 65535  # bytes: the length of a string is sent in two bytes
_NAMES = 0
_VALUES = 1
_VARIABLE = 2

_NONE, _CONST_STRING, _VAR_STRING = "none", "const string", "var string"
_LIST, _POSE, _BOOL, _NUM, _INT, _FLOAT, _MATRIX = "list", "pose", "bool", "num", "int", "float", "matrix"
_OLDEST_TYPES = {
    0: _NONE,
    3: _CONST_STRING,
    4: _LIST,
    9: _POSE,
    11: _BOOL,
    12: _NUM,
    13: _INT,
    14: _FLOAT,
}
_OLD_TYPES = {
    0: _NONE,
    3: _CONST_STRING,
    4: _VAR_STRING,
    5: _LIST,
    10: _POSE,
    12: _BOOL,
    13: _NUM,
    14: _INT,
    15: _FLOAT,
}
_NEW_TYPES = {
    0: _NONE,
    3: _CONST_STRING,
    4: _VAR_STRING,
    12: _POSE,
    13: _BOOL,
    14: _NUM,
    15: _INT,
    16: _FLOAT,
    17: _LIST,
    18: _MATRIX,
}


@dataclass(frozen=True, slots=True)
class PoseValue:
    """A pose: x, y, z [m], rotation vector [rad]. It is sent as 32-bit floats."""

    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MatrixValue:
    """A matrix by rows (from 3.14 and 5.9)."""

    rows: tuple[tuple["Value", ...], ...]


Value = None | bool | int | float | str | PoseValue | MatrixValue | tuple["Value", ...]


def _types(version: PolyscopeVersion) -> dict[int, str]:
    if _NEW_CODES.covers(version):
        return _NEW_TYPES
    return _OLD_TYPES if _OLD_CODES.covers(version) else _OLDEST_TYPES


def has_matrices(version: PolyscopeVersion) -> bool:
    """Whether this version has a code for matrices."""
    return _MATRIX in _types(version).values()


_Encode = Callable[[Any], bytes]


@cache
def _encoder(version: PolyscopeVersion) -> _Encode:
    """The function that encodes a value as type code and body, for one version. Cached, as it is used per element."""
    codes = {name: code for code, name in _types(version).items()}

    def number(name: str, layout: str) -> _Encode:
        pack_into, code = big_endian(f"B{layout}").pack, codes[name]
        return lambda value: pack_into(code, value)

    def text(value: str) -> bytes:
        data = to_bytes(value)[:_MAX_TEXT]
        # as in the document's example and in experiments reported in a forum; the use of the other type is not known
        return pack("BH", codes[_CONST_STRING], len(data)) + data

    def pose(value: PoseValue) -> bytes:
        return pack("B6f", codes[_POSE], *value.values)

    def items(value: tuple[Value, ...]) -> bytes:
        return pack("BH", codes[_LIST], len(value)) + b"".join([encode(item) for item in value])

    def matrix(value: MatrixValue) -> bytes:
        if _MATRIX not in codes:
            raise LocalProtocolError("this version cannot report a matrix")
        columns = len(value.rows[0]) if value.rows else 0
        if any(len(row) != columns for row in value.rows):
            raise LocalProtocolError("the rows of a matrix differ in length")
        cells = b"".join([encode(item) for row in value.rows for item in row])
        return pack("B2H", codes[_MATRIX], len(value.rows), columns) + cells

    encoders: dict[type, _Encode] = {
        type(None): lambda value: bytes([codes[_NONE]]),
        bool: number(_BOOL, "?"),
        int: number(_INT, "i"),
        float: number(_FLOAT, "f"),
        str: text,
        tuple: items,
        PoseValue: pose,
        MatrixValue: matrix,
    }

    def encode(value: Value) -> bytes:
        try:
            return encoders[value.__class__](value)
        except (struct.error, OverflowError) as error:
            raise LocalProtocolError(f"{value!r} does not fit its wire type: {error}") from error

    return encode


class _Parser:
    """Decoder of values for one version."""

    def __init__(self, version: PolyscopeVersion, reader: Reader) -> None:
        self._types = _types(version)
        self._reader = reader
        self._depth = 0
        self._bodies: dict[str, Callable[[], Value]] = {
            _NONE: lambda: None,
            _BOOL: lambda: bool(reader.unpack("?")[0]),
            _INT: lambda: int(reader.unpack("i")[0]),
            _NUM: lambda: float(reader.unpack("f")[0]),
            _FLOAT: lambda: float(reader.unpack("f")[0]),
            _CONST_STRING: self._string,
            _VAR_STRING: self._string,
            _POSE: lambda: PoseValue(reader.unpack("6f")),
            _LIST: self._list,
            _MATRIX: self._matrix,
        }

    def read(self) -> Value:
        """Decode one value. Raises RemoteProtocolError for an unknown type code."""
        (code,) = self._reader.unpack("B")
        if code not in self._types:
            raise RemoteProtocolError(f"unknown type code {code} of a program variable")
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise RemoteProtocolError(f"a program variable has lists nested deeper than {_MAX_DEPTH}")
        value = self._bodies[self._types[code]]()
        self._depth -= 1
        return value

    def _string(self) -> str:
        (size,) = self._reader.unpack("H")
        return from_bytes(self._reader.take(size))

    def _list(self) -> Value:
        (count,) = self._reader.unpack("H")
        return tuple(self.read() for _ in range(count))

    def _matrix(self) -> Value:
        rows, columns = self._reader.unpack("2H")
        return MatrixValue(tuple(tuple(self.read() for _ in range(columns)) for _ in range(rows)))


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalVariableNames:
    """Names of the variables of a program that starts; the first one has index ``start_index``."""

    timestamp_us: int = NO_TIMESTAMP_US
    start_index: int = 0
    names: tuple[str, ...]

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The complete message."""
        text = to_bytes("".join(f"{name}\n" for name in self.names))  # as in the document's example, with a final LF
        return frame(PROGRAM_STATE, pack("QBH", self.timestamp_us, _NAMES, self.start_index) + text)


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalVariableValues:
    """Values, in the order of the names; the first belongs to index ``start_index``."""

    timestamp_us: int = NO_TIMESTAMP_US
    start_index: int = 0
    values: tuple[Value, ...]

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The complete message. Raises LocalProtocolError for a value without a code in this version."""
        encode = _encoder(version)
        data = b"".join([encode(value) + b"\n" for value in self.values])
        return frame(PROGRAM_STATE, pack("QBH", self.timestamp_us, _VALUES, self.start_index) + data)


@dataclass(frozen=True, slots=True, kw_only=True)
class VariableMessage:
    """A variable as text, as sent by ``varmsg()``; deprecated according to the vendor's document."""

    timestamp_us: int = 0  # 0 if not yet set
    title: str
    text: str

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The complete message."""
        return frame(
            PROGRAM_STATE, pack("QB", self.timestamp_us, _VARIABLE) + short_text(self.title) + to_bytes(self.text)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class UnknownProgramState:
    """A program state message of another kind, kept unchanged."""

    timestamp_us: int
    kind: int
    body: bytes

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The complete message."""
        return frame(PROGRAM_STATE, pack("QB", self.timestamp_us, self.kind) + self.body)


def _read_values(reader: Reader, version: PolyscopeVersion) -> tuple[Value, ...]:
    parser = _Parser(version, reader)
    values = []
    while reader.remaining:
        values.append(parser.read())
        if reader.take(1) != b"\n":
            raise RemoteProtocolError("a program variable does not end with a line feed")
    return tuple(values)


def decode_program_state(
    payload: bytes, version: PolyscopeVersion
) -> GlobalVariableNames | GlobalVariableValues | VariableMessage | UnknownProgramState:
    """Decode the payload of a type 25 message (everything after size and type).

    version: the sender's, from its version message. Raises RemoteProtocolError.
    """
    reader = Reader(payload, "program state")
    timestamp_us, kind = reader.unpack("QB")
    if kind == _VARIABLE:
        return VariableMessage(timestamp_us=timestamp_us, title=reader.short_text(), text=from_bytes(reader.rest()))
    if kind not in (_NAMES, _VALUES):
        return UnknownProgramState(timestamp_us=timestamp_us, kind=kind, body=reader.rest())
    (start_index,) = reader.unpack("H")
    if kind == _NAMES:
        text = from_bytes(reader.rest()).removesuffix("\n")
        names = tuple(text.split("\n")) if text else ()
        return GlobalVariableNames(timestamp_us=timestamp_us, start_index=start_index, names=names)
    values = _read_values(reader, version)
    return GlobalVariableValues(timestamp_us=timestamp_us, start_index=start_index, values=values)
