"""Method calls: the list methods of PolyScope 5.15, and handles of built-ins (RPC proxies, for example).

A method is a generator function that returns a pair: the target after the call, and the result.
"""

from collections.abc import Callable, Generator
from typing import Any

from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.operators import check_size, whole
from urscript.operators import member as struct_member
from urscript.values import BoundedList, Value, list_with_capacity, to_text, type_name

MethodResult = tuple[Value, Value]


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
    if isinstance(target, list) and name in _LIST_METHODS:
        method, arity = _LIST_METHODS[name]
        if len(arguments) != arity:
            raise RuntimeFault(f"Type error: {name} takes exactly {arity} arguments ({len(arguments)} given)")
        charge(len(target) // 8)
        return method(target, *arguments)
    raise RuntimeFault(f"Type error: '{type_name(target)}' has no method '{name}'")


def refuse_list_methods(target: Value, name: str, *arguments: Value) -> Generator[None, None, MethodResult]:
    """``target.name(arguments)`` before 5.15, when lists had no methods."""
    if isinstance(target, list):
        later = " before PolyScope 5.15" if name in _LIST_METHODS else ""
        raise RuntimeFault(f"Type error: '{type_name(target)}' has no method '{name}'{later}")
    return (yield from call_method(target, name, *arguments))


def _capacity(target: list[Any]) -> int:
    # A guess: the capacity of a list that was not created by make_list is its length.
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


_LIST_METHODS: dict[str, tuple[Callable[..., MethodResult], int]] = {
    "append": (_append, 1),
    "capacity": (lambda target: (target, _capacity(target)), 0),
    "clear": (_clear, 0),
    "insert": (_insert, 2),
    "length": (lambda target: (target, len(target)), 0),
    "pop": (_pop, 0),
    "remove": (_remove, 1),
    "to_string": (lambda target: (target, to_text(target)), 0),
}

_KEEPS_ITS_SIZE = "a list keeps its size there: make it as long as needed, and count the elements in use"

METHOD_HINTS: dict[str, str] = {
    **dict.fromkeys(_LIST_METHODS, _KEEPS_ITS_SIZE),
    "length": "length(list) returns the number of elements",
    "to_string": "to_str(list) returns the text",
}
"""What to write instead of a list's methods on versions that do not have them."""
