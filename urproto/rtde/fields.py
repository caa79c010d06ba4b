"""All RTDE variables; each is a row of ``outputs.csv`` or ``inputs.csv``.

The rows are transcribed from the RTDE guide and the version tables of public clients. A family of registers is one row,
``name_{first..last}``. A version with a question mark is our guess, because the RTDE guide gives none for that
variable.

The name of a row is the attribute of the controller's snapshot, except for registers, which are in one tuple per kind,
and booleans, which are the bits of one integer.
"""

import csv
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final

from urproto.facts import availability
from urproto.versions import Availability, PolyscopeVersion

AVAILABLE: Final = availability("service.rtde")
"""Versions that serve RTDE."""
MAX_TIMESTAMP_S: Final = 1e9
"""No robot has been on for so long, so a larger ``timestamp`` is not a valid time; guess."""

_WORD = 0xFFFFFFFF
_FAMILY = re.compile(r"(?P<stem>\w+)_\{(?P<first>\d+)\.\.(?P<last>\d+)\}")
_REGISTER = re.compile(r"(?P<kind>(?:in|out)put_(?:int|double|bit)_register)_(?P<index>\d+)")
_BIT_WORD = re.compile(r"(?P<attribute>(?:in|out)put_bit_registers)(?P<index>\d+)_to_\d+")
_RENAMED = {"control_step": "step"}

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


@dataclass(frozen=True, slots=True)
class Field:
    """An RTDE variable.

    attribute, index: where its value is in a snapshot: the attribute itself when index is None, the element of a tuple
    for an integer or double register, the bit (or first bit of 32) for boolean registers. version_is_guess: no document
    gives the first version.
    """

    name: str
    type: FieldType
    unit: str
    available: Availability
    version_is_guess: bool
    attribute: str
    index: int | None
    doc: str

    @property
    def is_bits(self) -> bool:
        """True when the value consists of bits of an integer with boolean registers."""
        return self.attribute in {"input_bit_registers", "output_bit_registers"}

    def read(self, source: Any) -> Any:
        """Read the variable's value from a snapshot (or any object with the same attributes)."""
        value = getattr(source, self.attribute)
        if self.index is None:
            return value
        if not self.is_bits:
            return value[self.index]
        if self.type is FieldType.BOOL:
            return bool(value >> self.index & 1)
        return value >> self.index & _WORD

    @property
    def expression(self) -> str:
        """Python source that reads the value from a snapshot called ``s``, like read()."""
        source = f"s.{self.attribute}"
        if self.index is None:
            return f"*{source}" if self.type.count > 1 else source
        if not self.is_bits:
            return f"{source}[{self.index}]"
        mask = 1 if self.type is FieldType.BOOL else _WORD
        return f"{source} >> {self.index} & {mask}"


def _attribute_and_index(name: str) -> tuple[str, int | None]:
    """Attribute and index for the name of a variable."""
    if match := _REGISTER.fullmatch(name):
        return f"{match['kind']}s", int(match["index"])
    if match := _BIT_WORD.fullmatch(name):
        return match["attribute"], int(match["index"])
    return _RENAMED.get(name, name), None


def _names(text: str) -> Iterator[str]:
    match = _FAMILY.fullmatch(text)
    if match is None:
        yield text
        return
    for number in range(int(match["first"]), int(match["last"]) + 1):
        yield f"{match['stem']}_{number}"


def _fields_of_row(row: dict[str, str]) -> Iterator[Field]:
    first = Availability.since(row["cb3"].lstrip("?") or None, row["e"].lstrip("?") or None)
    guessed = "?" in row["cb3"] + row["e"]
    for name in _names(row["name"]):
        attribute, index = _attribute_and_index(name)
        yield Field(name, FieldType[row["type"]], row["unit"], first, guessed, attribute, index, row["doc"])


def _load(file_name: str) -> Mapping[str, Field]:
    text = files("urproto.rtde").joinpath(file_name).read_text("utf-8")
    rows = csv.DictReader(text.splitlines())
    return MappingProxyType({field.name: field for row in rows for field in _fields_of_row(row)})


OUTPUT_FIELDS: Mapping[str, Field] = _load("outputs.csv")


INPUT_FIELDS: Mapping[str, Field] = _load("inputs.csv")


def available_fields(table: Mapping[str, Field], version: PolyscopeVersion) -> Mapping[str, Field]:
    """The variables that a controller of this version offers."""
    return {name: field for name, field in table.items() if field.available.covers(version)}
