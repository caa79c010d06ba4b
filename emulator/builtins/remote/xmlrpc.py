"""XML-RPC without I/O: calls to XML, replies to values.

The controller's RPC is built on xmlrpc-c: its documented ``pstream`` URLs exist in that library
only. Calls therefore have that library's form (``<i4>``, CR LF, no exponents), and replies its
limit of 512 KiB. A reply is parsed as it arrives, which spreads a long one over several control
periods; invalid data costs no more than a valid reply.

| URScript | XML-RPC | back |
|----------|---------|------|
| bool, int, float, string | boolean, i4, double, string | the same |
| none | nil | none |
| pose | struct of x, y, z, rx, ry, rz (the vendor's sample server) | pose |
| list, matrix | array, array of arrays | list, list of lists |
| struct | struct | struct (from 5.15), before that an error |

base64, dateTime and integers beyond 32 bits have no counterpart in URScript and are errors (guess).
"""

import math
import re
from collections.abc import Generator, Iterator, Mapping
from decimal import Decimal
from typing import Any, Final
from xml.parsers import expat
from xml.sax.saxutils import escape
from xmlrpc.client import Fault, Unmarshaller

from urproto.text import to_bytes
from urscript.errors import RuntimeFault
from urscript.meter import charge, pay
from urscript.values import (
    INT_MAX,
    INT_MIN,
    MAX_ELEMENTS,
    MAX_NESTING,
    MAX_STRING,
    Matrix,
    Pose,
    Struct,
    Value,
    is_number,
    type_name,
)

_MAX_BYTES: Final = 512 * 1024  # XMLRPC_XML_SIZE_LIMIT_DEFAULT of xmlrpc-c
_DEEPEST: Final = 6 * (MAX_NESTING + 2)  # open elements per level: value, struct, member or value, array, data
_POSE_MEMBERS: Final = ("x", "y", "z", "rx", "ry", "rz")
_NOT_XML: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_PIECE_COST: Final = 20  # meter units: about a microsecond for a piece of XML or an element of a value
_BYTE_COST: Final = 6  # meter units: the densest markup takes 0.3 us a byte
_TITLES: Final = {"Binary": "base64 data", "DateTime": "a date", "Decimal": "a big decimal"}


class BadReplyError(Exception):
    """The server's answer is not usable; the text says why."""


# calls


def encode_call(method: str, arguments: tuple[Value, ...]) -> Generator[None, None, bytes]:
    """XML of a call, built over several frames if it is long. Raises RuntimeFault for values XML cannot carry."""
    pieces = []
    for piece in _call_pieces(method, arguments):
        pieces.append(piece)
        yield from pay(_PIECE_COST)
    return "".join(pieces).encode()


def _call_pieces(method: str, arguments: tuple[Value, ...]) -> Iterator[str]:
    yield f'<?xml version="1.0" encoding="UTF-8"?>\r\n<methodCall>\r\n<methodName>{escape(method)}</methodName>\r\n'
    yield "<params>\r\n"
    for argument in arguments:
        yield "<param>"
        yield from _value_pieces(argument)
        yield "</param>\r\n"
    yield "</params>\r\n</methodCall>\r\n"


def _value_pieces(value: Value) -> Iterator[str]:
    if isinstance(value, Pose):
        yield from _struct_pieces(dict(zip(_POSE_MEMBERS, value, strict=True)))
    elif isinstance(value, Struct):
        yield from _struct_pieces(value.members)
    elif isinstance(value, list | Matrix):
        yield "<value><array><data>\r\n"
        for item in value if isinstance(value, list) else map(list, value.rows):
            yield from _value_pieces(item)
            yield "\r\n"
        yield "</data></array></value>"
    else:
        yield f"<value>{_scalar(value)}</value>"


def _struct_pieces(members: Mapping[str, Value]) -> Iterator[str]:
    yield "<value><struct>\r\n"
    for name, value in members.items():
        yield f"<member><name>{_text(name)}</name>\r\n"
        yield from _value_pieces(value)
        yield "</member>\r\n"
    yield "</struct></value>"


def _scalar(value: Value) -> str:
    if value is None:
        return "<nil/>"
    if isinstance(value, bool):
        return f"<boolean>{value:d}</boolean>"
    if isinstance(value, int):
        return f"<i4>{value}</i4>"
    if isinstance(value, float) and math.isfinite(value):
        return f"<double>{Decimal(repr(value)):f}</double>"
    if isinstance(value, str):
        return f"<string>{_text(value)}</string>"
    what = value if isinstance(value, float) else f"a value of type '{type_name(value)}'"
    raise RuntimeFault(f"XML-RPC cannot carry {what}")


def _text(text: str) -> str:
    found = _NOT_XML.search(text)
    if found is not None:
        raise RuntimeFault(f"XML-RPC cannot carry {found[0]!r}, at {found.start()} of the string: encode it first")
    return escape(text, {"\r": "&#x0d;"})


# replies


class Reply:
    """One methodResponse, parsed as its bytes arrive. Every defect raises BadReplyError."""

    def __init__(self) -> None:
        self._size = self._depth = self._values = 0
        self._reader = Unmarshaller()
        self._reader.xml("", None)  # no encoding: it is fed text
        parser = self._parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._reader.data

    def feed(self, data: bytes) -> None:
        """Parse the next bytes and charge their cost."""
        charge(_BYTE_COST * len(data))
        self._size += len(data)
        if self._size > _MAX_BYTES:
            raise BadReplyError(f"the reply is longer than {_MAX_BYTES} bytes")
        self._parse(data, final=False)

    def close(self) -> Any:
        """The result the server returned, as `to_value` accepts it."""
        self._parse(b"", final=True)
        try:
            results = self._reader.close()
        except Fault as fault:
            raise BadReplyError(f"the server answered with fault {fault.faultCode}: {fault.faultString}") from None
        except Exception:  # no result, or a fault without its members
            raise BadReplyError("the reply contains no result") from None
        if len(results) != 1:
            raise BadReplyError(f"the reply contains {len(results)} results instead of one")
        return results[0]

    def _parse(self, data: bytes, *, final: bool) -> None:
        try:
            self._parser.Parse(data, final)
        except expat.ExpatError as error:
            raise BadReplyError(f"the reply is not XML: {error}") from None
        except BadReplyError:
            raise
        except Exception as error:  # the standard library's reader fails on odd markup in many ways
            raise BadReplyError(f"the reply is not XML-RPC: {type(error).__name__} {error}") from None

    def _doctype(self, *_: object) -> None:
        raise BadReplyError("the reply has a document type, which XML-RPC forbids")  # entities may multiply

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if not self._depth and tag != "methodResponse":
            raise BadReplyError(f"the reply is not XML-RPC: it is a {tag}")
        self._depth += 1
        self._values += tag == "value"
        if self._depth > _DEEPEST or self._values > MAX_ELEMENTS:
            raise BadReplyError(f"the reply has more than {MAX_ELEMENTS} values or {MAX_NESTING} levels")
        self._reader.start(tag, attributes)

    def _end(self, tag: str) -> None:
        self._depth -= 1
        self._reader.end(tag)


def to_value(wire: Any, *, structs: bool, depth: int = 0) -> Generator[None, None, Value]:
    """A parsed result as a URScript value, built over several frames if it is long.

    ``structs``: whether this PolyScope version has structs; if not, a struct must be a pose.
    Raises BadReplyError for values without a counterpart.
    """
    yield from pay(_PIECE_COST)
    if isinstance(wire, list | dict):
        if depth >= MAX_NESTING:
            raise BadReplyError(f"the result has more than {MAX_NESTING} levels")
        values = []
        for item in wire.values() if isinstance(wire, dict) else wire:
            values.append((yield from to_value(item, structs=structs, depth=depth + 1)))
        return _struct(dict(zip(wire, values, strict=True)), structs) if isinstance(wire, dict) else values
    return _plain(wire)


def _plain(wire: Any) -> Value:
    if wire is None or isinstance(wire, bool | float):
        return wire
    if isinstance(wire, int):
        return _integer(wire)
    if isinstance(wire, str):
        return _string(wire)
    raise BadReplyError(
        f"the result contains {_TITLES.get(type(wire).__name__, 'a value')}, for which URScript has no type"
    )


def _integer(value: int) -> int:
    if not INT_MIN <= value <= INT_MAX:
        raise BadReplyError(f"the result contains {value}, which does not fit 32 bits")
    return value


def _string(text: str) -> str:
    if len(to_bytes(text)) > MAX_STRING:
        raise BadReplyError(f"Received String exceeds maximum length ({MAX_STRING} Bytes).")
    return text


def _struct(members: dict[Any, Value], structs: bool) -> Value:
    if members.keys() == set(_POSE_MEMBERS) and all(map(is_number, members.values())):
        return Pose([float(members[name]) for name in _POSE_MEMBERS])
    if not structs:
        raise BadReplyError(f"the result has a struct that is not a pose ({', '.join(_POSE_MEMBERS)}): that needs 5.15")
    if not all(isinstance(name, str) for name in members):
        raise BadReplyError("the result contains a struct whose names are not text")
    return Struct(members)
