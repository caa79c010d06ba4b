"""Check calls with literal values before they are executed: wrong types, degrees for radians, millimetres for metres.

Only values written in the call itself, or in the only assignment to a variable, are checked. Problems are reported as
warnings, and no program is refused. The limits are far beyond what any arm reaches, so that no sensible program causes
a warning.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, Literal, TypeAlias

from urscript.builtins import Builtin, Parameter
from urscript.syntax import Binary, Call, Constant, Expression, ListLiteral, PoseLiteral, Unary
from urscript.values import KindMismatchError, Pose, is_number, type_name

Mistake: TypeAlias = Literal["arguments", "type", "units", "escape", "sum", "method"]

_LONGEST: Final = 20  # elements of the longest list that is checked: no built-in expects more
UNKNOWN: Final = object()
"""Stands for the value of an expression that is not a literal."""

_JOINTS: Final = frozenset(["q", "qnear", "qNear"])
_POSES: Final = frozenset(["pose", "pose_via", "pose_to", "q", "x"])
_SPEEDS: Final = frozenset(["v"])
_RADIUS: Final = "r"
_STRAIGHT: Final = frozenset(["movel", "movep", "movec", "servoc"])

SENDING: Final = frozenset(["socket_send_string", "socket_send_line"])
ESCAPE: Final = re.compile(r"\\[nrt0]")
NO_ESCAPES: Final = (
    "URScript has no escapes: a backslash and a letter are sent as these two characters; "
    "socket_send_line ends a text with a line feed, and socket_send_byte(13) sends a carriage return"
)

_MAX_RAD: Final = 4 * math.pi  # joints turn once in either direction; an unlimited wrist 3 may have turned further
_MAX_TURN_RAD: Final = 4 * math.pi  # of a rotation vector, whose length need not be more than pi
_MAX_M: Final = 5.0  # guess: several times the reach of the longest arm
_MAX_M_S: Final = 20.0  # guess: several times what a tool can do
_MAX_RAD_S: Final = 20.0  # guess: several times what a joint can do


def literal_value(node: Expression) -> Any:
    """The value of a literal, of a list or pose of literals, or of d2r() of one; else `UNKNOWN`."""
    match node:
        case Constant():
            return node.value
        case Unary(operator="-"):
            value = literal_value(node.operand)
            return -value if is_number(value) else UNKNOWN
        case Call(name="d2r", arguments=[argument], keywords=[]):
            value = literal_value(argument)
            return math.radians(value) if is_number(value) else UNKNOWN
        case PoseLiteral():
            items = [literal_value(item) for item in node.items]
            return Pose(map(float, items)) if all(map(is_number, items)) else UNKNOWN
        case ListLiteral() if len(node.items) <= _LONGEST:
            items = [literal_value(item) for item in node.items]
            nested = any(isinstance(item, list) for item in items)
            return UNKNOWN if nested or any(item is UNKNOWN for item in items) else items
    return UNKNOWN


def call_problems(
    builtin: Builtin, arguments: Sequence[Expression | None], constants: Callable[[Expression], Expression]
) -> Iterator[tuple[Mistake, str, Expression]]:
    """The problems of a call, each with its kind and the argument that causes it.

    arguments: one for each parameter, None if omitted. constants: maps a variable that never changes to its value.
    """
    for parameter, node in zip(builtin.parameters, arguments, strict=True):
        if node is None:
            continue
        if builtin.name in SENDING and any(map(ESCAPE.search, _texts(node, constants))):
            yield "escape", NO_ESCAPES, node
            continue
        value = literal_value(constants(node))
        if value is UNKNOWN:
            continue
        if problem := _mismatch(builtin, parameter, value):
            yield "type", problem, node
        elif problem := _unlikely(builtin, parameter.names[0], value):
            yield "units", problem, node


def _texts(node: Expression, constants: Callable[[Expression], Expression]) -> Iterator[str]:
    """The literal texts of which a text is put together."""
    match constants(node):
        case Constant(value=str(text)):
            yield text
        case Binary(operator="+") as sum_:
            yield from _texts(sum_.left, constants)
            yield from _texts(sum_.right, constants)
        case Call(name="str_cat") as call:
            for argument in call.arguments:
                yield from _texts(argument, constants)


def _mismatch(builtin: Builtin, parameter: Parameter, value: Any) -> str:
    if value is None and parameter.optional:
        return ""
    try:
        parameter.kind.accept(value)
    except KindMismatchError:
        found = f"'{type_name(value)}'"
        if isinstance(value, list) and all(map(is_number, value)) and "of 6" in parameter.kind.title:
            found = f"a list of {len(value)}"
        return (
            f"Type error: argument '{parameter.names[0]}' of {builtin.name} expected type "
            f"'{parameter.kind.title}' but found {found}"
        )
    return ""


def _unlikely(builtin: Builtin, name: str, value: Any) -> str:
    """A warning for a value of the right type that cannot be intended; None for any other."""
    if isinstance(value, Pose):
        if name not in _POSES:
            return ""
        if max(map(abs, value[:3])) > _MAX_M:
            return f"the position of a pose is in metres, but {_widest(value[:3])} looks like millimetres"
        if math.hypot(*value[3:]) > _MAX_TURN_RAD:
            widest = _widest(value[3:])
            return f"the rotation of a pose is a vector in radians, but {widest} looks like degrees: use d2r()"
    elif isinstance(value, list):
        if name in _JOINTS and all(map(is_number, value)) and max(map(abs, value), default=0) > _MAX_RAD:
            return f"joint angles are in radians, but {_widest(value)} looks like degrees: use d2r({_widest(value)})"
    elif is_number(value) and name == _RADIUS and value > _MAX_M:
        return f"a blend radius is in metres, but r={value:g} looks like millimetres"
    elif is_number(value) and name in _SPEEDS:
        if builtin.name in _STRAIGHT and value > _MAX_M_S:
            return f"{builtin.name} takes its speed in m/s, but v={value:g} looks like millimetres per second"
        if builtin.name == "movej" and value > _MAX_RAD_S:
            return f"movej takes its speed in rad/s, but v={value:g} looks like degrees per second: use d2r({value:g})"
    return ""


def _widest(values: Sequence[float]) -> str:
    return f"{max(values, key=abs):g}"
