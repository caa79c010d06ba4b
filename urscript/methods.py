"""Method calls: those of lists, structs and matrices, and handles of built-ins (RPC proxies, for example).

Lists, structs and matrices have methods since PolyScope 5.15 (e-Series manual of 5.19, Lists and Structs).
A method is a generator function that returns a pair: the target after the call, and the result.
"""

from collections.abc import Callable, Generator
from typing import Any

from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.operators import check_size, index, whole
from urscript.operators import member as struct_member
from urscript.values import BoundedList, Matrix, Struct, Value, list_with_capacity, to_text, type_name

MethodResult = tuple[Value, Value]

_KEEPS_ITS_SIZE = "a list keeps its size there: make it as long as needed, and count the elements in use"


class Handle:
    """An opaque value created by a built-in; scripts can only call its methods.

    Subclass it and override `call_method`. `type_title` is its type name in error messages.
    """

    type_title = "Handle"

    def call_method(self, name: str, arguments: tuple[Value, ...]) -> Generator[None, None, Value]:
        """Execute one method call; each bare ``yield`` ends the thread's frame."""
        raise RuntimeFault(f"{self.type_title} has no method '{name}'")
        yield

    def member(self, name: str) -> Value:
        """``handle.name`` without a call, such as the first half of ``handle.system.listMethods()``."""
        raise RuntimeFault(f"Type error: {self.type_title} has no member '{name}'")


def member(value: Value, name: str) -> Value:
    """``value.name`` of a struct or a handle."""
    return value.member(name) if isinstance(value, Handle) else struct_member(value, name)


def call_method(target: Value, name: str, *arguments: Value) -> Generator[None, None, MethodResult]:
    """``target.name(arguments)``."""
    if isinstance(target, Handle):
        return target, (yield from target.call_method(name, arguments))
    if name in (methods := _methods_of(target)):
        method, arity = methods[name]
        if len(arguments) != arity:
            raise RuntimeFault(f"Type error: {name} takes exactly {arity} arguments ({len(arguments)} given)")
        charge(_elements(target) // 8)
        return method(target, *arguments)
    raise RuntimeFault(f"Type error: '{type_name(target)}' has no method '{name}'")


def refuse_list_methods(target: Value, name: str, *arguments: Value) -> Generator[None, None, MethodResult]:
    """``target.name(arguments)`` before 5.15, when values had no methods."""
    if not isinstance(target, Handle):
        later = " before PolyScope 5.15" if name in _methods_of(target) else ""
        raise RuntimeFault(f"Type error: '{type_name(target)}' has no method '{name}'{later}")
    return (yield from call_method(target, name, *arguments))


def _capacity(target: list[Any]) -> int:
    # Script Manual 5.19, Lists and Structs: length and capacity of [1, 2] are equal.
    return target.capacity if isinstance(target, BoundedList) else len(target)


def _append(target: list[Any], value: Value) -> MethodResult:
    return _insert(target, len(target), value)


def _insert(target: list[Any], position: Value, value: Value) -> MethodResult:
    at, capacity = whole(position, "an index"), _capacity(target)
    if not 0 <= at <= len(target):
        raise RuntimeFault(f"Index out of bounds: {at}, the length is {len(target)}")
    if len(target) >= capacity:
        raise RuntimeFault(f"The list is full: its capacity is {capacity}; make_list(length, value, capacity) sets it")
    return check_size(list_with_capacity([*target[:at], value, *target[at:]], capacity)), None


def _remove(target: list[Any], position: Value) -> MethodResult:
    at = whole(position, "an index")
    if not 0 <= at < len(target):
        raise RuntimeFault(f"Index out of bounds: {at}, the length is {len(target)}")
    return list_with_capacity([*target[:at], *target[at + 1 :]], _capacity(target)), target[at]


def _pop(target: list[Any]) -> MethodResult:
    return _remove(target, len(target) - 1)


def _clear(target: list[Any]) -> MethodResult:
    return list_with_capacity([], _capacity(target)), None


def _extend(target: list[Any], more: Value) -> MethodResult:
    if not isinstance(more, list):
        raise RuntimeFault(f"Type error: extend takes a list, not '{type_name(more)}'")
    capacity = _capacity(target)
    if len(target) + len(more) > capacity:
        raise RuntimeFault(f"The list is full: its capacity is {capacity}; make_list(length, value, capacity) sets it")
    return check_size(list_with_capacity([*target, *more], capacity)), None


def _slice(target: list[Any], begin: Value, end: Value) -> MethodResult:
    first, last = whole(begin, "an index"), whole(end, "an index")
    if not 0 <= first <= last <= len(target):
        raise RuntimeFault(f"Index out of bounds: {first} to {last}, the length is {len(target)}")
    return target, target[first:last]


def _column(target: Matrix, position: Value) -> MethodResult:
    at, columns = whole(position, "an index"), target.shape[1]
    if not 0 <= at < columns:
        raise RuntimeFault(f"Index out of bounds: {at}, there are {columns} columns")
    return target, [row[at] for row in target.rows]


_Methods = dict[str, tuple[Callable[..., MethodResult], int]]

_TO_STRING: _Methods = {"to_string": (lambda target: (target, to_text(target)), 0)}
_LIST: _Methods = _TO_STRING | {
    "append": (_append, 1),
    "capacity": (lambda target: (target, _capacity(target)), 0),
    "clear": (_clear, 0),
    "excess_capacity": (lambda target: (target, _capacity(target) - len(target)), 0),
    "extend": (_extend, 1),
    "insert": (_insert, 2),
    "length": (lambda target: (target, len(target)), 0),
    "pop": (_pop, 0),
    "remove": (_remove, 1),
    "slice": (_slice, 2),
}
_STRUCT: _Methods = _TO_STRING | {"length": (lambda target: (target, len(target.members)), 0)}
_MATRIX: _Methods = _TO_STRING | {
    "get_column": (_column, 1),
    "get_row": (lambda target, position: (target, index(target, position)), 1),
    "shape": (lambda target: (target, list(target.shape)), 0),
}


METHOD_HINTS: dict[str, str] = {
    **dict.fromkeys(_LIST, _KEEPS_ITS_SIZE),
    "length": "length(list) returns the number of elements",
    "to_string": "to_str(list) returns the text",
}
"""What to write instead of a list's methods on versions that do not have them."""


def _elements(target: Value) -> int:
    if target.__class__ is Matrix:
        return target.shape[0] * target.shape[1]
    return len(target.members) if target.__class__ is Struct else len(target)


def _methods_of(target: Value) -> _Methods:
    if isinstance(target, list):
        return _LIST
    return _STRUCT if target.__class__ is Struct else _MATRIX if target.__class__ is Matrix else {}
