"""The header of all messages of the primary interface, and the types of their fields.

A field of a message has a type that names its form on the wire: a struct layout, ``short`` for text preceded by a
length byte, or ``text`` for text up to the end.
"""

import struct
from typing import Annotated, TypeAlias

from urproto.vectors import Vector3, Vector6

Layout: TypeAlias = tuple[tuple[str, str], ...]
"""Names of fields and their forms."""

Flag: TypeAlias = Annotated[bool, "?"]
Int8: TypeAlias = Annotated[int, "b"]
UInt8: TypeAlias = Annotated[int, "B"]
Int32: TypeAlias = Annotated[int, "i"]
UInt32: TypeAlias = Annotated[int, "I"]
UInt64: TypeAlias = Annotated[int, "Q"]
Float: TypeAlias = Annotated[float, "f"]
Double: TypeAlias = Annotated[float, "d"]
ThreeDoubles: TypeAlias = Annotated[Vector3, "3d"]
SixDoubles: TypeAlias = Annotated[Vector6, "6d"]
ShortText: TypeAlias = Annotated[str, "short"]
Text: TypeAlias = Annotated[str, "text"]

MESSAGE_HEADER = struct.Struct(">iB")  # total size, message type

# Message types; others (modbus info, safety setup, ...) are skipped by their size.
ROBOT_STATE = 16
ROBOT_MESSAGE = 20
PROGRAM_STATE = 25


def frame(message_type: int, payload: bytes) -> bytes:
    """A complete message: size, type, payload."""
    return MESSAGE_HEADER.pack(MESSAGE_HEADER.size + len(payload), message_type) + payload
