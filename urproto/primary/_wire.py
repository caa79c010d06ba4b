"""The header of all messages of the primary interface."""

import struct

MESSAGE_HEADER = struct.Struct(">iB")  # total size, message type

# Message types; others (modbus info, safety setup, ...) are skipped by their size.
ROBOT_STATE = 16
ROBOT_MESSAGE = 20
PROGRAM_STATE = 25


def frame(message_type: int, payload: bytes) -> bytes:
    """A complete message: size, type, payload."""
    return MESSAGE_HEADER.pack(MESSAGE_HEADER.size + len(payload), message_type) + payload
