"""The hash by which ROS 2, from Iron on, tells versions of a message apart: RIHS01.

It is the SHA-256 of the type's description as JSON. Source: REP 2011 and 2016, type_description_interfaces/FieldType.
Nobody refuses a type for its hash; it stands in what discovery tells, and tools show and record it.
"""

import hashlib
import json
from collections.abc import Iterator
from typing import Any, Final

from client.recording.cdr import Field, MessageType

_NESTED: Final = 1
_IDS: Final = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 13,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_ARRAY: Final = 48
_SEQUENCE: Final = 144  # without a bound, which none of our types has


def type_hash(kind: MessageType) -> str:
    """``RIHS01_`` and 64 hexadecimal digits."""
    own = next(iter(kind.structs))
    used = sorted(set(_used(kind, own)) - {own}, key=_full)
    content = {
        "type_description": _description(kind, own),
        "referenced_type_descriptions": [_description(kind, name) for name in used],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(content).encode()).hexdigest()}"


def _used(kind: MessageType, name: str) -> Iterator[str]:
    for field in kind.structs[name]:
        if field.type in kind.structs:
            yield field.type
            yield from _used(kind, field.type)


def _full(name: str) -> str:
    return name.replace("/", "/msg/")


def _description(kind: MessageType, name: str) -> dict[str, Any]:
    return {"type_name": _full(name), "fields": [_field(field) for field in kind.structs[name]]}


def _field(field: Field) -> dict[str, Any]:
    many = 0 if field.count is None else _ARRAY if field.count else _SEQUENCE
    nested = "" if field.type in _IDS else _full(field.type)
    of_type = {
        "type_id": _IDS.get(field.type, _NESTED) + many,
        "capacity": field.count or 0,
        "string_capacity": 0,
        "nested_type_name": nested,
    }
    return {"name": field.name, "type": of_type}
