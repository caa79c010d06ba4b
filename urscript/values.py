"""The values of the language, and the annotations for declaring built-ins.

| URScript | Python            |
|----------|-------------------|
| none     | ``None``          |
| bool     | ``bool``          |
| number   | ``int`` (32 bit, signed) or ``float`` |
| string   | ``str``           |
| pose     | ``Pose``, a list of six floats: x, y, z [m], rotation vector [rad] |
| list     | ``list``          |
| matrix   | ``Matrix``        |
| struct   | ``Struct``        |
| thread handle | ``int``      |

No value that somebody else refers to is modified: ``a[0] = 1`` creates a new list and binds ``a`` to it, unless only
``a`` refers to the old one (`urscript.operators.set_item`). Assignment and argument passing thus have the semantics of
a copy without copying. A built-in must therefore neither modify its arguments nor keep a list that it modifies later.

Strings are byte strings on the controller. Here they are text in the representation of `urproto.text`, always in the
form that `from_bytes` returns, so that equal bytes are equal strings: joining two strings also joins a character whose
bytes were split between them.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from urproto.text import from_bytes, to_bytes
from urscript.errors import RuntimeFault
from urscript.meter import METER, charge

Value: TypeAlias = Any
"""Any value of the language; see the table above."""

MAX_STRING = 1023
"""Longest string a program can build [bytes] (Script Manual, str_cat)."""

MAX_ELEMENTS = 10_000
"""Maximum number of elements in a list, matrix or struct, all levels together. A guess: the real limit is memory."""

MAX_NESTING = 16
"""Maximum nesting of lists and structs. A guess."""

INT_MIN, INT_MAX = -(2**31), 2**31 - 1

_CHUNK_WORK = 15
"""Work per piece of the text of a list [meter units]."""

MAX_PHYSICAL = 1e12
"""Largest physical number in a pose or list, in any unit; its square can still be computed. A guess."""


class Pose(list[float]):
    """Six floats: position x, y, z [m] and rotation vector rx, ry, rz [rad]. Equal only to a pose."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return other.__class__ is Pose and list.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other


class BoundedList(list[Any]):
    """A list whose capacity differs from its length (PolyScope 5.15 on: make_list, pop, clear)."""

    __slots__ = ("capacity",)

    def __init__(self, items: Iterable[Value], capacity: int) -> None:
        super().__init__(items)
        self.capacity = capacity


def list_with_capacity(items: list[Value], capacity: int) -> list[Value]:
    """A list that can grow to `capacity` elements. A full one is a plain list: Python accesses those twice as fast."""
    return items if len(items) == capacity else BoundedList(items, capacity)


@dataclass(frozen=True, slots=True)
class Matrix:
    """Rows of numbers, all of the same length."""

    rows: tuple[tuple[Value, ...], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return len(self.rows), len(self.rows[0])


@dataclass(frozen=True, slots=True)
class Struct:
    """Named members in the order of their definition."""

    members: dict[str, Value]


def copy_value(value: Value) -> Value:
    """An equal value that shares no list with the original, for a host that modifies lists itself."""
    if isinstance(value, BoundedList):
        return BoundedList(map(copy_value, value), value.capacity)
    if isinstance(value, Pose):
        return Pose(value)
    if isinstance(value, list):
        return [copy_value(item) for item in value]
    if isinstance(value, Struct):
        return Struct({name: copy_value(item) for name, item in value.members.items()})
    return value


def is_number(value: object) -> bool:
    """True for int and float, but not for bool."""
    return value.__class__ is float or value.__class__ is int


TYPE_NAMES: dict[type, str] = {
    type(None): "None",
    bool: "Bool",
    int: "Int",
    float: "Float",
    str: "Const String",
    Pose: "Pose",
    list: "List",
    BoundedList: "List",
    Matrix: "Matrix",
    Struct: "Struct",
}


def type_name(value: object) -> str:
    """The controller's name for the type of a value (``Int``, ``Const String`` and ``List`` seen, others guessed)."""
    known = TYPE_NAMES.get(value.__class__)
    return known if known is not None else str(getattr(value, "type_title", value.__class__.__name__))


# text


def as_string(text: str) -> str:
    """The string that two joined ones are, given the text of both; raises RuntimeFault beyond 1023 bytes."""
    size = len(text)
    if not text.isascii():
        data = to_bytes(text)
        text, size = from_bytes(data), len(data)  # two halves of a character become one
    if size > MAX_STRING:
        raise RuntimeFault(f"String exceeds maximum length ({MAX_STRING} Bytes).")
    return text


def _float_text(value: float) -> str:
    text = f"{value:.6f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _scalar_text(value: Value, message: bool) -> str:
    if value.__class__ is float:
        return f"{value:g}" if message else _float_text(value)
    return str(value)


def _between(parts: Iterable[Iterator[str]], separator: str) -> Iterator[str]:
    for number, part in enumerate(parts):
        if number:
            yield separator
        yield from part


def _chunks(value: Value, message: bool, inner: bool) -> Iterator[str]:
    """The text in pieces, so that the caller can stop at a limit."""
    separator = "," if message else ", "
    if isinstance(value, list):
        yield "p[" if value.__class__ is Pose else "["
        yield from _between((_chunks(item, message, True) for item in value), separator)
        yield "]"
    elif isinstance(value, Matrix):
        yield from _chunks([list(row) for row in value.rows], message, True)
    elif isinstance(value, Struct):
        yield "struct("
        yield from _between((_member_chunks(*item, message) for item in value.members.items()), separator)
        yield ")"
    elif value.__class__ is str and inner:
        yield f'"{value}"'
    else:
        yield _scalar_text(value, message)


def _member_chunks(name: str, value: Value, message: bool) -> Iterator[str]:
    yield f"{name}="
    yield from _chunks(value, message, True)


def to_text(value: Value, *, message: bool = False, limit: int = MAX_STRING) -> str:
    """The text of a value.

    The default is the form of to_str and str_cat: floats with up to six decimals, ``", "``
    between elements (Script Manual). ``message=True`` is the form of textmsg: six significant
    digits and no blanks (``p[0.605825,-0.720087,...]``, seen on a real log). Struct and nested
    string forms are guesses.

    Raises RuntimeFault when the text is longer than `limit` bytes.
    """
    if value.__class__ is int:  # the most frequent one, and always short
        METER.left -= _CHUNK_WORK
        return str(value)
    text = _text(value, message, limit)
    if (len(text) if text.isascii() else len(to_bytes(text))) > limit:
        raise RuntimeFault(f"String exceeds maximum length ({limit} Bytes).")
    return text


def cut_text(value: Value, limit: int) -> str:
    """The text of a value in the form of textmsg, cut at `limit` bytes.

    The work is limited to that many bytes, whatever the value.
    """
    return from_bytes(to_bytes(_text(value, True, limit)[:limit])[:limit])


def _text(value: Value, message: bool, limit: int) -> str:
    """The text of a value; if it is longer than `limit`, at least that much of it."""
    if value.__class__ is str:
        return str(value)
    if not isinstance(value, (list, Matrix, Struct)):
        METER.left -= _CHUNK_WORK
        return _scalar_text(value, message)
    pieces: list[str] = []
    length = 0
    for piece in _chunks(value, message, False):
        pieces.append(piece)
        length += len(piece)
        if length > limit:
            break
    charge(_CHUNK_WORK * len(pieces))
    return "".join(pieces)


# annotations of built-ins


class KindMismatchError(Exception):
    """A value is not of the kind that a parameter expects."""


@dataclass(frozen=True)
class Kind:
    """The kind of value that a built-in's parameter accepts. `title` is the type name in error messages."""

    title: str

    def accept(self, value: Value) -> Value:
        """The value as passed to the built-in; raises KindMismatchError."""
        return value

    @property
    def as_is(self) -> frozenset[type]:
        """The classes of values that are all passed as they are."""
        return frozenset()


class NotPhysicalError(KindMismatchError):
    """A number of the right kind that is meaningless as a physical quantity."""


def _is_moderate(items: list[Value]) -> bool:
    """Whether a list certainly holds no number beyond `MAX_PHYSICAL`: then its length as a vector is not, either."""
    try:
        return math.hypot(*items) <= MAX_PHYSICAL
    except (TypeError, OverflowError):  # not only numbers
        return False


@dataclass(frozen=True)
class PhysicalKind(Kind):
    """Restricts another kind to finite numbers, which in lists and poses do not exceed `MAX_PHYSICAL`."""

    kind: Kind

    @property
    def as_is(self) -> frozenset[type]:
        return self.kind.as_is & {int, bool, str}

    def accept(self, value: Value) -> Value:
        accepted = self.kind.accept(value)
        if accepted.__class__ is float:
            if not math.isfinite(accepted):
                raise NotPhysicalError
        elif isinstance(accepted, list) and not _is_moderate(accepted):
            for item in accepted:
                if item.__class__ is float and not -MAX_PHYSICAL <= item <= MAX_PHYSICAL:
                    raise NotPhysicalError
        return accepted


class _IntKind(Kind):
    @property
    def as_is(self) -> frozenset[type]:
        return frozenset([int])

    # Accepts floats: the official control script passes the integer arguments of force_mode as floats.
    def accept(self, value: Value) -> Value:
        if value.__class__ is int:
            return value
        if value.__class__ is float and value.is_integer() and INT_MIN <= value <= INT_MAX:
            return int(value)
        raise KindMismatchError


@dataclass(frozen=True)
class _ClassKind(Kind):
    classes: frozenset[type]

    @property
    def as_is(self) -> frozenset[type]:
        return self.classes

    def accept(self, value: Value) -> Value:
        if value.__class__ in self.classes:
            return value
        raise KindMismatchError


class _JointsKind(Kind):
    def accept(self, value: Value) -> Value:
        if value.__class__ in (list, BoundedList) and len(value) == 6 and all(map(is_number, value)):
            return value
        raise KindMismatchError


class _PoseOrJointsKind(_JointsKind):
    def accept(self, value: Value) -> Value:
        return value if value.__class__ is Pose else super().accept(value)


ANY = Kind("any")
NUMBER = _ClassKind("Num", frozenset([float, int]))
INT = _IntKind("Int")
BOOL = _ClassKind("Bool", frozenset([bool]))
STRING = _ClassKind("Const String", frozenset([str]))
POSE = _ClassKind("Pose", frozenset([Pose]))
LIST = _ClassKind("List", frozenset([list, BoundedList]))
MATRIX = _ClassKind("Matrix", frozenset([Matrix]))
JOINTS = _JointsKind("List of 6 numbers")
POSE_OR_JOINTS = _PoseOrJointsKind("Pose or List of 6 numbers")

Num = Annotated[float, NUMBER]
"""int or float."""
Int = Annotated[int, INT]
"""int, or a float without a fraction (passed as int)."""
Bool = Annotated[bool, BOOL]
Str = Annotated[str, STRING]
PoseArg = Annotated[Pose, POSE]
Joints = Annotated[list[float], JOINTS]
"""A list of six numbers."""
PoseOrJoints = Annotated[list[float], POSE_OR_JOINTS]
"""A pose, or a list of six numbers; tell them apart with ``isinstance(value, Pose)``."""
ListArg = Annotated[list[Any], LIST]
Any_ = Annotated[Any, ANY]

PLAIN_KINDS: dict[Any, Kind] = {
    float: NUMBER,
    int: INT,
    bool: BOOL,
    str: STRING,
    Pose: POSE,
    Matrix: MATRIX,
    Any: ANY,
    object: ANY,
}
"""Bare annotations, read as their aliases."""
