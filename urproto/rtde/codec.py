"""The packages in both directions, and splitting a byte stream into them.

A package is ``uint16 size | uint8 type | payload``. The meaning of a payload depends on its sender and on the protocol
version active at that point in the stream. Decoding therefore has two steps: RTDEDecoder splits the stream into
packages, and decode_request (on the controller's side) or decode_reply (on the client's side) decodes a package. A
connection uses protocol 1 until a request for version 2 is accepted.

Source: the RTDE guide, checked against the official Python and C++ clients.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar, get_args

from urproto._wire import (
    TO_THE_END,
    Flag,
    Layout,
    Names,
    Reader,
    Rest,
    ShortText,
    SizedMessageDecoder,
    UInt8,
    UInt16,
    decode_item,
    encode_item,
    marked_fields,
    pack,
)
from urproto.compat import IntEnum, Self
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.rtde.recipes import Recipe
from urproto.text import from_bytes, to_bytes
from urproto.versions import PolyscopeVersion

KNOWN_PROTOCOLS = (1, 2)
_HEADER = struct.Struct(">HB")
_MAX_SIZE = 65535


class PackageType(IntEnum):
    """The type byte: an ASCII letter."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_URCONTROL_VERSION = ord("v")
    TEXT_MESSAGE = ord("M")
    DATA_PACKAGE = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class MessageLevel(IntEnum):
    """Level of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class Package(NamedTuple):
    """A package as received; ``type`` may be a number that is not a PackageType."""

    type: int
    payload: bytes

    def encode(self) -> bytes:
        """The package on the wire. Raises LocalProtocolError over 65535 bytes."""
        size = _HEADER.size + len(self.payload)
        if size > _MAX_SIZE:
            raise LocalProtocolError(f"an RTDE package has at most {_MAX_SIZE} bytes, not {size}")
        return _HEADER.pack(size, self.type) + self.payload


class RTDEDecoder(SizedMessageDecoder[Package]):
    """Splits a stream into packages; its chunks may be of any size. A size below 3 is impossible."""

    header = _HEADER

    def _size(self, *header: int) -> int:
        size = header[0]
        if size < _HEADER.size:
            raise RemoteProtocolError(f"an RTDE package cannot have size {size}, its header alone has 3 bytes")
        return size

    def _decode(self, message: bytes) -> Package:
        return Package(message[_HEADER.size - 1], message[_HEADER.size :])


@cache
def _layout_of(kind: Any, protocol: int) -> Layout:
    """The fields in their order on the wire: what goes up to the end of a package comes last."""
    there = [(name, form) for name, (form, *since) in marked_fields(kind) if protocol >= max(since, default=1)]
    return tuple(sorted(there, key=lambda item: item[1] in TO_THE_END))


class _Message:
    """A package of a known type. Fields that an early protocol does not have are marked with the first one that has."""

    __slots__ = ()

    package_type: ClassVar[PackageType]

    @classmethod
    def _layout(cls, protocol: int) -> Layout:
        kind: Any = cls  # which mypy does not take to be hashable
        return _layout_of(kind, protocol)

    def payload(self, protocol: int) -> bytes:
        return b"".join([encode_item(form, getattr(self, name)) for name, form in self._layout(protocol)])

    def encode(self, protocol: int) -> bytes:
        return Package(self.package_type, self.payload(protocol)).encode()

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(**{name: decode_item(form, reader) for name, form in cls._layout(protocol)})


_AnyMessage = TypeVar("_AnyMessage", bound=_Message)


@dataclass(frozen=True, slots=True)
class _Answer(_Message):
    accepted: Flag


@dataclass(frozen=True, slots=True)
class RequestProtocol(_Message):
    """The client requests another protocol version."""

    package_type = PackageType.REQUEST_PROTOCOL_VERSION
    version: UInt16


@dataclass(frozen=True, slots=True)
class ProtocolReply(_Answer):
    """Whether the requested protocol version is now active."""

    package_type = PackageType.REQUEST_PROTOCOL_VERSION


@dataclass(frozen=True, slots=True)
class GetVersion(_Message):
    """The client requests the controller's version."""

    package_type = PackageType.GET_URCONTROL_VERSION


@dataclass(frozen=True, slots=True)
class VersionReply(_Message):
    """The controller's version."""

    package_type = PackageType.GET_URCONTROL_VERSION
    version: PolyscopeVersion

    def payload(self, protocol: int) -> bytes:
        version = self.version
        return pack("4I", version.major, version.minor, version.bugfix, version.build)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(PolyscopeVersion(*reader.unpack("4I")))


@dataclass(frozen=True, slots=True)
class SetupOutputs(_Message):
    """The client chooses output variables and, from protocol 2 on, their frequency [Hz]."""

    package_type = PackageType.SETUP_OUTPUTS
    names: Names
    frequency_hz: Annotated[float | None, "d", 2] = None

    def payload(self, protocol: int) -> bytes:
        if protocol != 1 and self.frequency_hz is None:
            raise LocalProtocolError("protocol 2 requires a frequency in an output recipe")
        return _Message.payload(self, protocol)


@dataclass(frozen=True, slots=True)
class SetupOutputsReply(_Message):
    """A type (or NOT_FOUND) for each requested name; protocol 1 has no recipe id."""

    package_type = PackageType.SETUP_OUTPUTS
    types: Names
    recipe_id: Annotated[UInt8, 2] = 1


@dataclass(frozen=True, slots=True)
class SetupInputs(_Message):
    """The client chooses input variables to write."""

    package_type = PackageType.SETUP_INPUTS
    names: Names


@dataclass(frozen=True, slots=True)
class SetupInputsReply(_Message):
    """A type, NOT_FOUND or IN_USE for each name; recipe id 0 when the recipe is refused."""

    package_type = PackageType.SETUP_INPUTS
    types: Names
    recipe_id: UInt8


@dataclass(frozen=True, slots=True)
class Start(_Message):
    """The client requests that output data be sent."""

    package_type = PackageType.START


@dataclass(frozen=True, slots=True)
class StartReply(_Answer):
    """Whether output data is sent from now on."""

    package_type = PackageType.START


@dataclass(frozen=True, slots=True)
class Pause(_Message):
    """The client requests that output data stop."""

    package_type = PackageType.PAUSE


@dataclass(frozen=True, slots=True)
class PauseReply(_Answer):
    """Whether output data has stopped."""

    package_type = PackageType.PAUSE


@dataclass(frozen=True, slots=True)
class InputData(_Message):
    """Values written by a client; Recipe.unpack decodes ``data``."""

    package_type = PackageType.DATA_PACKAGE
    recipe_id: UInt8
    data: Rest


@dataclass(frozen=True, slots=True)
class OutputData(_Message):
    """Values sent by the controller; protocol 1 has no recipe id."""

    package_type = PackageType.DATA_PACKAGE
    data: Rest
    recipe_id: Annotated[UInt8, 2] = 1


@dataclass(frozen=True, slots=True)
class ClientMessage(_Message):
    """A client's message for the controller's log; text and source are each cut at 255 bytes."""

    package_type = PackageType.TEXT_MESSAGE
    text: ShortText
    source: ShortText = ""
    level: UInt8 = MessageLevel.INFO


@dataclass(frozen=True, slots=True)
class TextMessage(_Message):
    """A message from the controller. In protocol 1, it has no source, and its text may be longer than 255 bytes."""

    package_type = PackageType.TEXT_MESSAGE
    text: ShortText
    source: ShortText = ""
    level: UInt8 = MessageLevel.INFO

    def payload(self, protocol: int) -> bytes:
        if protocol != 1:
            return _Message.payload(self, protocol)
        return pack("B", self.level) + to_bytes(self.text)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        if protocol != 1:
            return cls(reader.short_text(), reader.short_text(), *reader.unpack("B"))
        (level,) = reader.unpack("B")
        return cls(from_bytes(reader.rest()), "", level)


Request = RequestProtocol | GetVersion | SetupOutputs | SetupInputs | Start | Pause | InputData | ClientMessage
Reply = (
    ProtocolReply
    | VersionReply
    | SetupOutputsReply
    | SetupInputsReply
    | StartReply
    | PauseReply
    | OutputData
    | TextMessage
)

_REQUESTS: dict[int, type[Request]] = {kind.package_type: kind for kind in get_args(Request)}
_REPLIES: dict[int, type[Reply]] = {kind.package_type: kind for kind in get_args(Reply)}


def output_packer(recipe: Recipe, protocol: int, recipe_id: int = 1) -> Callable[[Any], bytes]:
    """A function that converts a snapshot to a complete data package, for use in every control period."""
    head = b"" if protocol == 1 else pack("B", recipe_id)
    size = _HEADER.size + len(head) + recipe.size
    return recipe.packer(pack("HB", size, PackageType.DATA_PACKAGE) + head)


def decode_request(package: Package, protocol: int) -> Request:
    """Decode a package sent by a client while this protocol version was active.

    Bytes after a fixed layout are ignored. Raises RemoteProtocolError for an unknown type or a payload that is too
    short; the stream itself stays usable.
    """
    return _decode(package, protocol, _REQUESTS, "request")


def decode_reply(package: Package, protocol: int) -> Reply:
    """Decode a package sent by a controller; otherwise like decode_request."""
    return _decode(package, protocol, _REPLIES, "reply")


def _decode(package: Package, protocol: int, kinds: Mapping[int, type[_AnyMessage]], what: str) -> _AnyMessage:
    kind = kinds.get(package.type)
    if kind is None:
        raise RemoteProtocolError(f"no RTDE package has type {package.type}")
    return kind.read(Reader(package.payload, f"RTDE {what} {kind.package_type.name}"), protocol)
