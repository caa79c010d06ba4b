"""Split a byte stream into messages of the primary interface; its chunks may be of any size."""

from dataclasses import dataclass

from urproto._wire import SizedMessageDecoder
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


class PrimaryDecoder(SizedMessageDecoder[PrimaryMessage]):
    """Splits a stream into messages and decodes them.

    A message with a valid size but an invalid payload is returned as an OtherMessage.

    version: the sender's. It is taken from the version message, which is the first one on every connection; before
    that, the newest version is assumed.
    """

    header = MESSAGE_HEADER

    def __init__(self, version: PolyscopeVersion = DEFAULT_VERSION[Series.E]) -> None:
        super().__init__()
        self.version = version

    def _size(self, *header: int) -> int:
        size = header[0]
        if not MESSAGE_HEADER.size <= size <= MAX_MESSAGE_SIZE:
            raise RemoteProtocolError(f"a primary interface message cannot have {size} bytes")
        return size

    def _decode(self, message: bytes) -> PrimaryMessage:
        kind, payload = message[MESSAGE_HEADER.size - 1], message[MESSAGE_HEADER.size :]
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
