"""Values as readable text. Nothing that a peer sent reaches a terminal unescaped."""

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from urproto import modes
from urproto.compat import IntEnum
from urproto.primary.messages import NO_TIMESTAMP_US
from urproto.text import readable

_ENUMS: Mapping[str, type[IntEnum]] = {
    "control_mode": modes.ControlMode,
    "controller_box": modes.ControllerBox,
    "data_type": modes.ReportDataType,
    "joint_mode": modes.JointMode,
    "mode": modes.JointMode,
    "level": modes.ReportLevel,
    "requested_type": modes.RequestedType,
    "robot_mode": modes.RobotMode,
    "robot_type": modes.RobotType,
    "runtime_state": modes.RuntimeState,
    "safety_mode": modes.SafetyMode,
    "safety_status": modes.SafetyStatus,
    "source": modes.MessageSource,
    "sub_type": modes.RobotSubType,
    "tool_mode": modes.ToolMode,
}
_MAX_BYTES = 64  # shown of binary data


def quoted(text: str) -> str:
    """Text in quotes; control characters are escaped."""
    return f'"{escaped(text).replace(chr(34), chr(92) + chr(34))}"'


def escaped(text: str) -> str:
    """Text on one line; control characters are escaped."""
    return "".join(map(_character, text))  # invalid UTF-8 as in `urproto.text.readable`


def _character(char: str) -> str:
    if char == "\\":
        return "\\\\"
    if char == "\t" or char.isprintable():
        return char
    shown = readable(char)
    return shown if shown != char else char.encode("unicode_escape").decode("ascii")


def value(item: Any, name: str = "") -> str:
    """One value as text. name: selects the enumeration to which a number belongs."""
    if isinstance(item, bool) or item is None:
        return str(item).lower()
    if isinstance(item, int | float):
        return _number(item, name)
    if isinstance(item, str):
        return quoted(item)
    if isinstance(item, bytes):
        return _bytes(item)
    if isinstance(item, tuple | list):
        return "[" + ", ".join(value(part, name) for part in item) + "]"
    return f"({message(item)})" if is_dataclass(item) else str(item)


def _number(number: float, name: str) -> str:
    if name in _ENUMS:
        return modes.mode_name(_ENUMS[name], number)
    if name == "timestamp_us" and number == NO_TIMESTAMP_US:
        return "none"
    return str(number) if isinstance(number, int) else f"{number:.9g}"


def _bytes(data: bytes) -> str:
    rest = len(data) - _MAX_BYTES
    return (data[:_MAX_BYTES].hex() or "nothing") + (f"... and {rest} bytes" if rest > 0 else "")


def pairs(items: Iterable[tuple[str, Any]]) -> str:
    """``name=value`` of each."""
    return " ".join(f"{name}={value(item, name)}" for name, item in items)


def message(item: Any) -> str:
    """The fields of a dataclass; those that are None are left out."""
    named = ((field.name, getattr(item, field.name)) for field in fields(item))
    return pairs((name, part) for name, part in named if part is not None and part != ())
