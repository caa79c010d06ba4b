"""The packages in both directions, and splitting a byte stream into them.

A package is ``uint16 size | uint8 type | payload``. The meaning of a payload depends on its sender and on the protocol
version active at that point in the stream. Decoding therefore has two steps: RTDEDecoder splits the stream into
packages, and decode_request (on the controller's side) or decode_reply (on the client's side) decodes a package. A
connection uses protocol 1 until a request for version 2 is accepted.

Source: the RTDE guide, checked against the official Python and C++ clients.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, get_args

from urproto._wire import Reader, pack, short_text
from urproto.compat import IntEnum, Self
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.rtde.recipes import Recipe, split_names
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


class RTDEDecoder:
    """Splits a stream into packages; its chunks may be of any size.

    Never buffers more than one incomplete package (64 kB).
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.error: RemoteProtocolError | None = None

    def feed(self, data: bytes) -> list[Package]:
        """Add bytes; returns the packages they complete.

        A size below 3 is impossible: packages before it are still returned, and this call, or the next one if there
        were any, raises RemoteProtocolError; ``error`` is set immediately. Such a stream cannot be resumed.
        """
        packages: list[Package] = []
        if self.error is None:
            self._buffer += data
            start, end = 0, len(self._buffer)
            while end - start >= _HEADER.size:
                size, kind = _HEADER.unpack_from(self._buffer, start)
                if size < _HEADER.size:
                    self.error = RemoteProtocolError(
                        f"an RTDE package cannot have size {size}, its header alone has 3 bytes"
                    )
                    break
                if end - start < size:
                    break
                packages.append(Package(kind, bytes(self._buffer[start + _HEADER.size : start + size])))
                start += size
            del self._buffer[:start]
        if self.error is not None:
            self._buffer.clear()
            if not packages:
                raise self.error
        return packages


class _Message:
    """A package of a known type; each kind of message writes and reads its own payload."""

    __slots__ = ()

    package_type: ClassVar[PackageType]

    def payload(self, protocol: int) -> bytes:
        raise NotImplementedError

    def encode(self, protocol: int) -> bytes:
        return Package(self.package_type, self.payload(protocol)).encode()


@dataclass(frozen=True, slots=True)
class _Empty(_Message):
    def payload(self, protocol: int) -> bytes:
        return b""

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls()


@dataclass(frozen=True, slots=True)
class _Answer(_Message):
    accepted: bool

    def payload(self, protocol: int) -> bytes:
        return pack("?", self.accepted)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(*reader.unpack("?"))


@dataclass(frozen=True, slots=True)
class RequestProtocol(_Message):
    """The client requests another protocol version."""

    package_type = PackageType.REQUEST_PROTOCOL_VERSION
    version: int

    def payload(self, protocol: int) -> bytes:
        return pack("H", self.version)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(*reader.unpack("H"))


@dataclass(frozen=True, slots=True)
class ProtocolReply(_Answer):
    """Whether the requested protocol version is now active."""

    package_type = PackageType.REQUEST_PROTOCOL_VERSION


@dataclass(frozen=True, slots=True)
class GetVersion(_Empty):
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
    names: tuple[str, ...]
    frequency_hz: float | None = None

    def payload(self, protocol: int) -> bytes:
        names = to_bytes(",".join(self.names))
        if protocol == 1:
            return names
        if self.frequency_hz is None:
            raise LocalProtocolError("protocol 2 requires a frequency in an output recipe")
        return pack("d", self.frequency_hz) + names

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        frequency_hz = None if protocol == 1 else reader.unpack("d")[0]
        return cls(split_names(from_bytes(reader.rest())), frequency_hz)


@dataclass(frozen=True, slots=True)
class SetupOutputsReply(_Message):
    """A type (or NOT_FOUND) for each requested name; protocol 1 has no recipe id."""

    package_type = PackageType.SETUP_OUTPUTS
    types: tuple[str, ...]
    recipe_id: int = 1

    def payload(self, protocol: int) -> bytes:
        head = b"" if protocol == 1 else pack("B", self.recipe_id)
        return head + to_bytes(",".join(self.types))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        recipe_id = 1 if protocol == 1 else reader.unpack("B")[0]
        return cls(split_names(from_bytes(reader.rest())), recipe_id)


@dataclass(frozen=True, slots=True)
class SetupInputs(_Message):
    """The client chooses input variables to write."""

    package_type = PackageType.SETUP_INPUTS
    names: tuple[str, ...]

    def payload(self, protocol: int) -> bytes:
        return to_bytes(",".join(self.names))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(split_names(from_bytes(reader.rest())))


@dataclass(frozen=True, slots=True)
class SetupInputsReply(_Message):
    """A type, NOT_FOUND or IN_USE for each name; recipe id 0 when the recipe is refused."""

    package_type = PackageType.SETUP_INPUTS
    types: tuple[str, ...]
    recipe_id: int

    def payload(self, protocol: int) -> bytes:
        return pack("B", self.recipe_id) + to_bytes(",".join(self.types))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        (recipe_id,) = reader.unpack("B")
        return cls(split_names(from_bytes(reader.rest())), recipe_id)


@dataclass(frozen=True, slots=True)
class Start(_Empty):
    """The client requests that output data be sent."""

    package_type = PackageType.START


@dataclass(frozen=True, slots=True)
class StartReply(_Answer):
    """Whether output data is sent from now on."""

    package_type = PackageType.START


@dataclass(frozen=True, slots=True)
class Pause(_Empty):
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
    recipe_id: int
    data: bytes

    def payload(self, protocol: int) -> bytes:
        return pack("B", self.recipe_id) + self.data

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(reader.unpack("B")[0], reader.rest())


@dataclass(frozen=True, slots=True)
class OutputData(_Message):
    """Values sent by the controller; protocol 1 has no recipe id."""

    package_type = PackageType.DATA_PACKAGE
    data: bytes
    recipe_id: int = 1

    def payload(self, protocol: int) -> bytes:
        head = b"" if protocol == 1 else pack("B", self.recipe_id)
        return head + self.data

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        recipe_id = 1 if protocol == 1 else reader.unpack("B")[0]
        return cls(reader.rest(), recipe_id)


@dataclass(frozen=True, slots=True)
class ClientMessage(_Message):
    """A client's message for the controller's log; text and source are each cut at 255 bytes."""

    package_type = PackageType.TEXT_MESSAGE
    text: str
    source: str = ""
    level: int = MessageLevel.INFO

    def payload(self, protocol: int) -> bytes:
        return short_text(self.text) + short_text(self.source) + pack("B", self.level)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> Self:
        return cls(reader.short_text(), reader.short_text(), *reader.unpack("B"))


@dataclass(frozen=True, slots=True)
class TextMessage(_Message):
    """A message from the controller. In protocol 1, it has no source, and its text may be longer than 255 bytes."""

    package_type = PackageType.TEXT_MESSAGE
    text: str
    source: str = ""
    level: int = MessageLevel.INFO

    def payload(self, protocol: int) -> bytes:
        if protocol != 1:
            return ClientMessage(self.text, self.source, self.level).payload(protocol)
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


def _describe(kind: int) -> str:
    return PackageType(kind).name if kind in list(PackageType) else f"type {kind}"


def decode_request(package: Package, protocol: int) -> Request:
    """Decode a package sent by a client while this protocol version was active.

    Bytes after a fixed layout are ignored. Raises RemoteProtocolError for an unknown type or a payload that is too
    short; the stream itself stays usable.
    """
    kind = _REQUESTS.get(package.type)
    if kind is None:
        raise RemoteProtocolError(f"no RTDE package has {_describe(package.type)}")
    return kind.read(Reader(package.payload, f"RTDE request {_describe(package.type)}"), protocol)


def decode_reply(package: Package, protocol: int) -> Reply:
    """Decode a package sent by a controller; otherwise like decode_request."""
    kind = _REPLIES.get(package.type)
    if kind is None:
        raise RemoteProtocolError(f"no RTDE package has {_describe(package.type)}")
    return kind.read(Reader(package.payload, f"RTDE reply {_describe(package.type)}"), protocol)
