"""Wire types of RTDE variables. Values are packed without gaps, big-endian and unaligned."""

import struct
from enum import Enum

# Words that replace a type in a set-up reply.
NOT_FOUND = "NOT_FOUND"  # no such variable in this version
IN_USE = "IN_USE"  # another client controls this input


class FieldType(Enum):
    """A wire type: name in set-up replies, struct letter and number of elements."""

    BOOL = ("BOOL", "?", 1)
    UINT8 = ("UINT8", "B", 1)
    UINT32 = ("UINT32", "I", 1)
    UINT64 = ("UINT64", "Q", 1)
    INT32 = ("INT32", "i", 1)
    DOUBLE = ("DOUBLE", "d", 1)
    VECTOR3D = ("VECTOR3D", "d", 3)
    VECTOR6D = ("VECTOR6D", "d", 6)
    VECTOR6INT32 = ("VECTOR6INT32", "i", 6)
    VECTOR6UINT32 = ("VECTOR6UINT32", "I", 6)

    def __init__(self, wire_name: str, letter: str, count: int) -> None:
        self.wire_name = wire_name
        self.letter = letter
        self.count = count

    @property
    def layout(self) -> str:
        """Struct layout without byte order, for example ``6d``."""
        return f"{self.count}{self.letter}" if self.count > 1 else self.letter

    @property
    def size(self) -> int:
        """Size on the wire in bytes."""
        return struct.calcsize(">" + self.layout)


WIRE_TYPES = {kind.wire_name: kind for kind in FieldType}
"""The types by their names in set-up replies."""
