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
from typing import Any, NamedTuple

from urproto._wire import Reader, pack, short_text
from urproto.compat import IntEnum
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


def _wire(kind: PackageType, payload: bytes = b"") -> bytes:
    return Package(kind, payload).encode()


@dataclass(frozen=True, slots=True)
class RequestProtocol:
    """The client requests another protocol version."""

    version: int

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.REQUEST_PROTOCOL_VERSION, pack("H", self.version))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "RequestProtocol":
        return cls(*reader.unpack("H"))


@dataclass(frozen=True, slots=True)
class ProtocolReply:
    """Whether the requested protocol version is now active."""

    accepted: bool

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.REQUEST_PROTOCOL_VERSION, pack("?", self.accepted))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "ProtocolReply":
        return cls(*reader.unpack("?"))


@dataclass(frozen=True, slots=True)
class GetVersion:
    """The client requests the controller's version."""

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.GET_URCONTROL_VERSION)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "GetVersion":
        return cls()


@dataclass(frozen=True, slots=True)
class VersionReply:
    """The controller's version."""

    version: PolyscopeVersion

    def encode(self, protocol: int) -> bytes:
        version = self.version
        numbers = pack("4I", version.major, version.minor, version.bugfix, version.build)
        return _wire(PackageType.GET_URCONTROL_VERSION, numbers)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "VersionReply":
        return cls(PolyscopeVersion(*reader.unpack("4I")))


@dataclass(frozen=True, slots=True)
class SetupOutputs:
    """The client chooses output variables and, from protocol 2 on, their frequency [Hz]."""

    names: tuple[str, ...]
    frequency_hz: float | None = None

    def encode(self, protocol: int) -> bytes:
        names = to_bytes(",".join(self.names))
        if protocol == 1:
            return _wire(PackageType.SETUP_OUTPUTS, names)
        if self.frequency_hz is None:
            raise LocalProtocolError("protocol 2 requires a frequency in an output recipe")
        return _wire(PackageType.SETUP_OUTPUTS, pack("d", self.frequency_hz) + names)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "SetupOutputs":
        frequency_hz = None if protocol == 1 else reader.unpack("d")[0]
        return cls(split_names(from_bytes(reader.rest())), frequency_hz)


@dataclass(frozen=True, slots=True)
class SetupOutputsReply:
    """A type (or NOT_FOUND) for each requested name; protocol 1 has no recipe id."""

    types: tuple[str, ...]
    recipe_id: int = 1

    def encode(self, protocol: int) -> bytes:
        head = b"" if protocol == 1 else pack("B", self.recipe_id)
        return _wire(PackageType.SETUP_OUTPUTS, head + to_bytes(",".join(self.types)))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "SetupOutputsReply":
        recipe_id = 1 if protocol == 1 else reader.unpack("B")[0]
        return cls(split_names(from_bytes(reader.rest())), recipe_id)


@dataclass(frozen=True, slots=True)
class SetupInputs:
    """The client chooses input variables to write."""

    names: tuple[str, ...]

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.SETUP_INPUTS, to_bytes(",".join(self.names)))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "SetupInputs":
        return cls(split_names(from_bytes(reader.rest())))


@dataclass(frozen=True, slots=True)
class SetupInputsReply:
    """A type, NOT_FOUND or IN_USE for each name; recipe id 0 when the recipe is refused."""

    types: tuple[str, ...]
    recipe_id: int

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.SETUP_INPUTS, pack("B", self.recipe_id) + to_bytes(",".join(self.types)))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "SetupInputsReply":
        (recipe_id,) = reader.unpack("B")
        return cls(split_names(from_bytes(reader.rest())), recipe_id)


@dataclass(frozen=True, slots=True)
class Start:
    """The client requests that output data be sent."""

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.START)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "Start":
        return cls()


@dataclass(frozen=True, slots=True)
class StartReply:
    """Whether output data is sent from now on."""

    accepted: bool

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.START, pack("?", self.accepted))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "StartReply":
        return cls(*reader.unpack("?"))


@dataclass(frozen=True, slots=True)
class Pause:
    """The client requests that output data stop."""

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.PAUSE)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "Pause":
        return cls()


@dataclass(frozen=True, slots=True)
class PauseReply:
    """Whether output data has stopped."""

    accepted: bool

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.PAUSE, pack("?", self.accepted))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "PauseReply":
        return cls(*reader.unpack("?"))


@dataclass(frozen=True, slots=True)
class InputData:
    """Values written by a client; Recipe.unpack decodes ``data``."""

    recipe_id: int
    data: bytes

    def encode(self, protocol: int) -> bytes:
        return _wire(PackageType.DATA_PACKAGE, pack("B", self.recipe_id) + self.data)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "InputData":
        return cls(reader.unpack("B")[0], reader.rest())


@dataclass(frozen=True, slots=True)
class OutputData:
    """Values sent by the controller; protocol 1 has no recipe id."""

    data: bytes
    recipe_id: int = 1

    def encode(self, protocol: int) -> bytes:
        head = b"" if protocol == 1 else pack("B", self.recipe_id)
        return _wire(PackageType.DATA_PACKAGE, head + self.data)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "OutputData":
        recipe_id = 1 if protocol == 1 else reader.unpack("B")[0]
        return cls(reader.rest(), recipe_id)


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """A client's message for the controller's log; text and source are each cut at 255 bytes."""

    text: str
    source: str = ""
    level: int = MessageLevel.INFO

    def encode(self, protocol: int) -> bytes:
        body = short_text(self.text) + short_text(self.source) + pack("B", self.level)
        return _wire(PackageType.TEXT_MESSAGE, body)

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "ClientMessage":
        return cls(reader.short_text(), reader.short_text(), *reader.unpack("B"))


@dataclass(frozen=True, slots=True)
class TextMessage:
    """A message from the controller. In protocol 1, it has no source, and its text may be longer than 255 bytes."""

    text: str
    source: str = ""
    level: int = MessageLevel.INFO

    def encode(self, protocol: int) -> bytes:
        if protocol != 1:
            return ClientMessage(self.text, self.source, self.level).encode(protocol)
        return _wire(PackageType.TEXT_MESSAGE, pack("B", self.level) + to_bytes(self.text))

    @classmethod
    def read(cls, reader: Reader, protocol: int) -> "TextMessage":
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

_REQUESTS: dict[int, Callable[[Reader, int], Request]] = {
    PackageType.REQUEST_PROTOCOL_VERSION: RequestProtocol.read,
    PackageType.GET_URCONTROL_VERSION: GetVersion.read,
    PackageType.SETUP_OUTPUTS: SetupOutputs.read,
    PackageType.SETUP_INPUTS: SetupInputs.read,
    PackageType.START: Start.read,
    PackageType.PAUSE: Pause.read,
    PackageType.DATA_PACKAGE: InputData.read,
    PackageType.TEXT_MESSAGE: ClientMessage.read,
}
_REPLIES: dict[int, Callable[[Reader, int], Reply]] = {
    PackageType.REQUEST_PROTOCOL_VERSION: ProtocolReply.read,
    PackageType.GET_URCONTROL_VERSION: VersionReply.read,
    PackageType.SETUP_OUTPUTS: SetupOutputsReply.read,
    PackageType.SETUP_INPUTS: SetupInputsReply.read,
    PackageType.START: StartReply.read,
    PackageType.PAUSE: PauseReply.read,
    PackageType.DATA_PACKAGE: OutputData.read,
    PackageType.TEXT_MESSAGE: TextMessage.read,
}


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
    read = _REQUESTS.get(package.type)
    if read is None:
        raise RemoteProtocolError(f"no RTDE package has {_describe(package.type)}")
    return read(Reader(package.payload, f"RTDE request {_describe(package.type)}"), protocol)


def decode_reply(package: Package, protocol: int) -> Reply:
    """Decode a package sent by a controller; otherwise like decode_request."""
    read = _REPLIES.get(package.type)
    if read is None:
        raise RemoteProtocolError(f"no RTDE package has {_describe(package.type)}")
    return read(Reader(package.payload, f"RTDE reply {_describe(package.type)}"), protocol)
