"""Split a byte stream into messages of the primary interface; its chunks may be of any size."""

from dataclasses import dataclass

from urproto.errors import RemoteProtocolError
from urproto.primary._wire import MESSAGE_HEADER, PROGRAM_STATE, ROBOT_MESSAGE, ROBOT_STATE
from urproto.primary.messages import RobotMessage, VersionMessage, decode_robot_message
from urproto.primary.program_state import (
    GlobalVariableNames,
    GlobalVariableValues,
    UnknownProgramState,
    VariableMessage,
    decode_program_state,
)
from urproto.primary.state import RobotStateData, decode_robot_state
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

MAX_MESSAGE_SIZE = 1 << 20  # bytes; guess: ample, since the longest message in any capture has 1471


@dataclass(frozen=True, slots=True)
class OtherMessage:
    """A message of another type, or one that cannot be decoded; then ``error`` gives the reason."""

    type: int
    payload: bytes
    error: str | None = None


PrimaryMessage = (
    RobotStateData
    | RobotMessage
    | GlobalVariableNames
    | GlobalVariableValues
    | VariableMessage
    | UnknownProgramState
    | OtherMessage
)


class PrimaryDecoder:
    """Splits a stream into messages and decodes them.

    version: the sender's. It is taken from the version message, which is the first one on every connection; before
    that, the newest version is assumed.
    """

    def __init__(self, version: PolyscopeVersion = DEFAULT_VERSION[Series.E]) -> None:
        self.version = version
        self._buffer = bytearray()
        self.error: RemoteProtocolError | None = None

    def feed(self, data: bytes) -> list[PrimaryMessage]:
        """Add bytes; returns the messages they complete.

        An impossible size ends the stream: messages before it are still returned, and this call, or the next one if
        there were any, raises RemoteProtocolError; ``error`` is set immediately. A message with a valid size but an
        invalid payload is returned as an OtherMessage.
        """
        messages: list[PrimaryMessage] = []
        self._buffer += data
        while self.error is None and (framed := self._next()):
            messages.append(self._read(*framed))
        if self.error is not None:
            self._buffer.clear()
            if not messages:
                raise self.error
        return messages

    def _next(self) -> tuple[int, bytes] | None:
        if len(self._buffer) < MESSAGE_HEADER.size:
            return None
        size, kind = MESSAGE_HEADER.unpack_from(self._buffer)
        if not MESSAGE_HEADER.size <= size <= MAX_MESSAGE_SIZE:
            self.error = RemoteProtocolError(f"a primary interface message cannot have {size} bytes")
            return None
        if len(self._buffer) < size:
            return None
        payload = bytes(self._buffer[MESSAGE_HEADER.size : size])
        del self._buffer[:size]
        return kind, payload

    def _read(self, kind: int, payload: bytes) -> PrimaryMessage:
        try:
            if kind == ROBOT_STATE:
                return decode_robot_state(payload)
            if kind == PROGRAM_STATE:
                return decode_program_state(payload, self.version)
            if kind == ROBOT_MESSAGE:
                return self._read_robot_message(payload)
        except RemoteProtocolError as error:
            return OtherMessage(kind, payload, str(error))
        return OtherMessage(kind, payload)

    def _read_robot_message(self, payload: bytes) -> RobotMessage:
        message = decode_robot_message(payload, self.version)
        if isinstance(message, VersionMessage):
            self.version = message.version
        return message
