"""Definitions of the ROS 2 messages in recordings.

`definitions.msg` has them as in common_interfaces, tf2_msgs, control_msgs (Jazzy), ur_msgs and ur_dashboard_msgs.
Recordings include them, so none of these packages needs to be installed.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

from client.recording.cdr import Message, MessageType
from urproto.rtde.fields import OUTPUT_FIELDS

RTDE_TYPE: Final = "ur_client_msgs/msg/RTDEState"
"""Type of the topic with every recorded variable; its fields are those variables."""

_SEPARATOR: Final = "=" * 80
_HEAD: Final = "MSG: "
_STAMPED: Final = "std_msgs/Header header"
_ROS_TYPES: Final = {
    "BOOL": "bool",
    "UINT8": "uint8",
    "UINT32": "uint32",
    "UINT64": "uint64",
    "INT32": "int32",
    "DOUBLE": "float64",
    "VECTOR3D": "float64[3]",
    "VECTOR6D": "float64[6]",
    "VECTOR6INT32": "int32[6]",
    "VECTOR6UINT32": "uint32[6]",
}


@cache
def _fields() -> Mapping[str, tuple[str, ...]]:
    """The lines of each message type, by its name."""
    text = files("client.recording").joinpath("definitions.msg").read_text("utf-8")
    parts = (part.splitlines() for part in text.split(f"{_SEPARATOR}\n"))
    return {head.removeprefix(_HEAD): tuple(fields) for head, *fields in parts}


@cache
def message_type(name: str) -> MessageType:
    """Look up a message type by name, such as ``sensor_msgs/msg/JointState``."""
    return _complete(name, _fields()[name.replace("/msg/", "/")])


def message(topic: str, type_name: str, values: Mapping[str, Any]) -> Message:
    """Encode a message; fields left out are zero or empty."""
    kind = message_type(type_name)
    return Message(topic, kind, kind.encode(values))


def xyz(values: Sequence[float]) -> dict[str, float]:
    """The fields of a geometry_msgs/Point or Vector3."""
    return dict(zip("xyz", values, strict=True))


def xyzw(values: Sequence[float]) -> dict[str, float]:
    """The fields of a geometry_msgs/Quaternion."""
    return dict(zip("xyzw", values, strict=True))


def rtde_type(names: Iterable[str]) -> MessageType:
    """The message type with these RTDE variables as fields."""
    fields = (f"{_ROS_TYPES[OUTPUT_FIELDS[name].type.name]} {ros_name(name)}{_comment(name)}" for name in names)
    return _complete(RTDE_TYPE, (_STAMPED, *fields))


def ros_name(name: str) -> str:
    """The field name of an RTDE variable; ROS allows no capital letters."""
    return name.lower()


def _comment(name: str) -> str:
    field = OUTPUT_FIELDS[name]
    unit = f" [{field.unit}]" if field.unit else ""
    return f"  # {name}{unit}: {field.doc}"


def _complete(name: str, fields: Iterable[str]) -> MessageType:
    own = tuple(fields)
    parts = ["\n".join(own)]
    for used in _used(own):
        parts.append("\n".join((_SEPARATOR, f"{_HEAD}{used}", *_fields()[used])))
    return MessageType(name, "\n".join(parts) + "\n")


def _used(fields: Iterable[str]) -> tuple[str, ...]:
    """All message types used by the fields, recursively, each once."""
    found: dict[str, None] = {}
    for field in fields:
        kind = field.split()[0].split("[")[0]
        if kind in _fields():
            found |= dict.fromkeys((kind, *_used(_fields()[kind])))
    return tuple(found)
