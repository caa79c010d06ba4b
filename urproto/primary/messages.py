"""Robot messages (type 20) of the primary interface: events with their time and source.

Each message is a dataclass with the fields of its body in their order. Messages of an unknown kind decode to
UnknownMessage, which keeps all their bytes.

Sources of the layouts: the vendor's client interface documents as interpreted by several public clients. Where each
kind of message comes from (``source``): captures of a 5.4 simulator and of a live 5.11 arm, tests of the official C++
client.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

from urproto._wire import (
    Flag,
    Int32,
    Layout,
    Reader,
    ShortText,
    Text,
    UInt8,
    UInt32,
    decode_item,
    encode_item,
    marked_fields,
    pack,
)
from urproto.compat import Self
from urproto.errors import RemoteProtocolError
from urproto.facts import availability
from urproto.modes import MessageSource, ReportDataType, ReportLevel, RequestedType
from urproto.primary._wire import ROBOT_MESSAGE, frame
from urproto.text import from_bytes, to_bytes
from urproto.versions import PolyscopeVersion

# Titles of the key messages about a program; its name is the text.
PROGRAM_STARTED = "PROGRAM_XXX_STARTED"
PROGRAM_STOPPED = "PROGRAM_XXX_STOPPED"
PROGRAM_PAUSED = "PROGRAM_XXX_PAUSED"  # in two public clients
PROGRAM_RESUMED = "PROGRAM_XXX_RESUMED"  # guess, by analogy with the three above

# Timestamp of messages that do not belong to a control cycle: version messages, compile errors and program states have
# it in captures of 3.10, 5.4, 5.11 and 5.12 controllers.
NO_TIMESTAMP_US = 2**64 - 1

# From some 3.x on, popups have a request id and type, and are sent as request value messages of no type. A note in the
# vendor's document of 5.9 says so, and two public clients that show an arm's popups read them there (one of them first
# searched for the documented kind 2). That both changes came with the same version is a guess.
_LONG_POPUP = availability("primary.long_popup")
_SHORT_POPUP = ("warning", "error", "title", "text")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotMessage:
    """Base class of all robot messages.

    timestamp_us counts from the controller's start [us]; 0 if not yet set.
    source is a MessageSource value, or any other number sent by a peer.
    """

    kind: ClassVar[int]
    timestamp_us: int = 0
    source: int = MessageSource.ROBOT_INTERFACE

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The complete message as sent by a controller of this version.

        Titles and names are cut at 255 bytes, the maximum of their length byte.
        Raises LocalProtocolError for a number that does not fit its field.
        """
        header = pack("QbB", self.timestamp_us, self.source, self._kind(version))
        return frame(ROBOT_MESSAGE, header + self._body(version))

    def _kind(self, version: PolyscopeVersion) -> int:
        return self.kind

    @classmethod
    def _layout(cls) -> Layout:
        kind: Any = cls  # which mypy does not take to be hashable
        return tuple((name, marks[0]) for name, marks in marked_fields(kind))

    @classmethod
    def _layout_for(cls, version: PolyscopeVersion) -> Layout:
        return cls._layout()

    def _body(self, version: PolyscopeVersion) -> bytes:
        return b"".join(encode_item(how, getattr(self, name)) for name, how in self._layout_for(version))

    @classmethod
    def _read(cls, reader: Reader, version: PolyscopeVersion, timestamp_us: int, source: int) -> Self:
        values = {name: decode_item(how, reader) for name, how in cls._layout_for(version)}
        return cls(timestamp_us=timestamp_us, source=source, **values)


@dataclass(frozen=True, slots=True, kw_only=True)
class TextMessage(RobotMessage):
    """A line for the log, as written by ``textmsg()``."""

    kind: ClassVar[int] = 0

    source: int = MessageSource.RT_MACHINE
    text: Text


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramLabelMessage(RobotMessage):
    """The program reached a labelled line (old controllers)."""

    kind: ClassVar[int] = 1

    label_id: Int32
    text: Text


@dataclass(frozen=True, slots=True, kw_only=True)
class PopupMessage(RobotMessage):
    """A dialog on the teach pendant; requested_type is a RequestedType.

    Newer software sends it with the kind of a request value message that requests nothing.
    """

    kind: ClassVar[int] = 2

    request_id: UInt32 = 0
    requested_type: UInt32 = RequestedType.NONE
    warning: Flag = False
    error: Flag = False
    blocking: Flag = False
    title: ShortText
    text: Text

    def _kind(self, version: PolyscopeVersion) -> int:
        as_request = _LONG_POPUP.covers(version) and self.requested_type == RequestedType.NONE
        return RequestValueMessage.kind if as_request else self.kind

    @classmethod
    def _layout_for(cls, version: PolyscopeVersion) -> Layout:
        layout = cls._layout()
        return layout if _LONG_POPUP.covers(version) else tuple(item for item in layout if item[0] in _SHORT_POPUP)


@dataclass(frozen=True, slots=True, kw_only=True)
class VersionMessage(RobotMessage):
    """The sender's version: the first message on every connection."""

    kind: ClassVar[int] = 3

    timestamp_us: int = NO_TIMESTAMP_US
    project: ShortText = "URControl"
    major: UInt8
    minor: UInt8
    bugfix: Int32
    build: Int32
    build_date: Text  # for example "04-10-2025, 00:25:33"

    @classmethod
    def of(cls, version: PolyscopeVersion, build_date: str, build: int = 0) -> Self:
        """The message sent by a controller of this version; date and build number are those of its URControl."""
        return cls(major=version.major, minor=version.minor, bugfix=version.bugfix, build=build, build_date=build_date)

    @property
    def version(self) -> PolyscopeVersion:
        """The version as a comparable value."""
        return PolyscopeVersion(self.major, self.minor, self.bugfix, self.build)


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyModeMessage(RobotMessage):
    """The safety mode changed; safety_mode is a SafetyMode."""

    kind: ClassVar[int] = 5

    source: int = MessageSource.RT_MACHINE
    code: Int32 = 0
    argument: Int32 = 0
    safety_mode: UInt8
    data_type: UInt32 = ReportDataType.UINT32
    data: UInt32 = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCodeMessage(RobotMessage):
    """An entry of the error log, displayed as ``C<code>A<argument>``.

    level is a ReportLevel; data is the raw 32-bit word, to be interpreted according to data_type.
    """

    kind: ClassVar[int] = 6

    source: int = MessageSource.RT_MACHINE
    code: Int32
    argument: Int32 = 0
    level: Int32 = ReportLevel.INFO
    data_type: UInt32 = ReportDataType.NONE
    data: UInt32 = 0
    text: Text = ""

    @property
    def label(self) -> str:
        """The code as displayed in the log."""
        return f"C{self.code}A{self.argument}"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyMessage(RobotMessage):
    """A fixed title with a free text, such as the start of a program (see PROGRAM_STARTED)."""

    kind: ClassVar[int] = 7

    source: int = MessageSource.RT_MACHINE
    code: Int32 = 0
    argument: Int32 = 0
    title: ShortText
    text: Text


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestValueMessage(RobotMessage):
    """The program asks the operator for a value; requested_type is a RequestedType."""

    kind: ClassVar[int] = 9

    request_id: UInt32
    requested_type: UInt32
    text: Text


@dataclass(frozen=True, slots=True, kw_only=True)
class RuntimeExceptionMessage(RobotMessage):
    """A script did not compile or failed while running; line and column count from 1."""

    kind: ClassVar[int] = 10

    source: int = MessageSource.RT_MACHINE
    line: Int32
    column: Int32
    text: Text


@dataclass(frozen=True, slots=True)
class ProgramThread:
    """Position of a thread of the running program."""

    label_id: int
    label: str
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramThreadsMessage(RobotMessage):
    """Positions of all threads of the running program."""

    kind: ClassVar[int] = 14

    threads: tuple[ProgramThread, ...]

    def _body(self, version: PolyscopeVersion) -> bytes:
        return b"".join(
            pack("i", thread.label_id) + _long_text(thread.label) + _long_text(thread.name) for thread in self.threads
        )

    @classmethod
    def _read(cls, reader: Reader, version: PolyscopeVersion, timestamp_us: int, source: int) -> Self:
        threads = []
        while reader.remaining:
            (label_id,) = reader.unpack("i")
            threads.append(ProgramThread(label_id, _read_long_text(reader), _read_long_text(reader)))
        return cls(timestamp_us=timestamp_us, source=source, threads=tuple(threads))


def _long_text(text: str) -> bytes:
    data = to_bytes(text)
    return pack("i", len(data)) + data


def _read_long_text(reader: Reader) -> str:
    (size,) = reader.unpack("i")
    return from_bytes(reader.take(size))


@dataclass(frozen=True, slots=True, kw_only=True)
class UnknownMessage(RobotMessage):
    """A message of an unknown kind, kept unchanged."""

    kind: ClassVar[int] = -1

    message_kind: int
    body: bytes

    def _kind(self, version: PolyscopeVersion) -> int:
        return self.message_kind

    def _body(self, version: PolyscopeVersion) -> bytes:
        return self.body


_KINDS: dict[int, type[RobotMessage]] = {
    cls.kind: cls
    for cls in (
        TextMessage,
        ProgramLabelMessage,
        PopupMessage,
        VersionMessage,
        SafetyModeMessage,
        ErrorCodeMessage,
        KeyMessage,
        RequestValueMessage,
        RuntimeExceptionMessage,
        ProgramThreadsMessage,
    )
}


def decode_robot_message(payload: bytes, version: PolyscopeVersion) -> RobotMessage:
    """Decode the payload of a type 20 message (everything after size and type).

    version: the sender's, from its version message. Bytes after a fixed layout are ignored, because newer versions
    append fields. Raises RemoteProtocolError when a known kind is shorter than its layout.
    """
    reader = Reader(payload, "robot message")
    timestamp_us, source, kind = reader.unpack("QbB")
    known = _KINDS.get(kind)
    if known is None:
        return UnknownMessage(timestamp_us=timestamp_us, source=source, message_kind=kind, body=reader.rest())
    message = known._read(reader, version, timestamp_us, source)
    if isinstance(message, RequestValueMessage) and message.requested_type == RequestedType.NONE:
        return _as_popup(payload, version) or message
    return message


def _as_popup(payload: bytes, version: PolyscopeVersion) -> PopupMessage | None:
    """Decode a request value message without a request as a popup; None if it cannot be one."""
    if not _LONG_POPUP.covers(version):
        return None
    reader = Reader(payload, "popup")
    timestamp_us, source, _ = reader.unpack("QbB")
    try:
        return PopupMessage._read(reader, version, timestamp_us, source)
    except RemoteProtocolError:
        return None
