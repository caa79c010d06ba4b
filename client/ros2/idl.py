"""Types for CycloneDDS, made of the definitions that encode the messages."""

from functools import cache
from typing import Any, Final

from cyclonedds.idl import make_idl_struct, types

from client.recording.cdr import Field, MessageType
from client.ros2.names import dds_type

__all__ = ["idl_type"]

_NUMBERS: Final[dict[str, Any]] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "int8": types.int8,
    "uint8": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
    "string": str,
}


@cache
def idl_type(kind: MessageType) -> Any:
    """What CycloneDDS has to know of a type, as one of its classes: its name on DDS and its fields."""
    return _struct(kind, next(iter(kind.structs)))


def _struct(kind: MessageType, name: str) -> Any:
    fields = {field.name: _field(kind, field) for field in kind.structs[name]}
    # CycloneDDS writes the colons itself
    return make_idl_struct(name.rpartition("/")[2], dds_type(name).replace("::", "."), fields)


def _field(kind: MessageType, field: Field) -> Any:
    one = _NUMBERS[field.type] if field.type in _NUMBERS else _struct(kind, field.type)
    if field.count is None:
        return one
    return types.array[one, field.count] if field.count else types.sequence[one]
