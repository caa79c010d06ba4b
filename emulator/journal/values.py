"""Values in journals: JSON, with objects for what JSON lacks.

A key ``@`` names the class of an object whose fields follow; ``@b`` is bytes in base64, ``@e`` an enum's class and
name, ``@l`` a list (a plain array is a tuple), ``@m`` a mapping, ``@n`` an object that is known by its number, ``@o``
an operation of the Robot API, ``@x`` an exception's text. Functions are left out: answers go nowhere in a replay.
"""

import dataclasses
import sys
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Any, Final, get_args, get_type_hints

import msgspec

from emulator.devices.gripper_requests import GripperSession
from emulator.mailbox import Command
from emulator.robotapi.endpoints import OPERATIONS, Operation

_OPERATIONS: Final = {(one.endpoint.method, one.endpoint.path): one for one in OPERATIONS}
_PLAIN: Final = frozenset({bool, int, float, str, type(None)})


class JournalValueError(ValueError):
    """A value that a journal cannot contain, or that this version does not know."""


class Numbers:
    """Numbers of objects whose identity matters: the sessions of the gripper's clients."""

    def __init__(self) -> None:
        self._numbers: dict[GripperSession, int] = {}
        self._sessions: dict[int, GripperSession] = {}

    def number(self, session: GripperSession) -> int:
        """The number of an object."""
        return self._numbers.setdefault(session, len(self._numbers))

    def session(self, number: int) -> GripperSession:
        """The object with a number."""
        return self._sessions.setdefault(number, GripperSession())


def encode(value: Any, numbers: Numbers) -> Any:
    """The JSON form of a value. Raises JournalValueError."""
    kind: Any = type(value)
    if kind in _PLAIN:  # first of all: most values of a stream of setpoints
        return value
    if kind is tuple:
        return [encode(item, numbers) for item in value]
    if isinstance(value, Enum):
        return {"@e": [kind.__name__, value.name]}
    if isinstance(value, bytes | bytearray):
        return {"@b": b64encode(value).decode()}
    if isinstance(value, list):
        return {"@l": [encode(item, numbers) for item in value]}
    if isinstance(value, Mapping):
        return {"@m": [[key, encode(item, numbers)] for key, item in value.items()]}
    if isinstance(value, GripperSession):
        return {"@n": numbers.number(value)}
    if isinstance(value, Operation):
        return {"@o": [value.endpoint.method, value.endpoint.path]}
    if isinstance(value, BaseException):
        return {"@x": f"{type(value).__name__}: {value}"}
    if (names := _fields(kind)) is not None:
        return {"@": kind.__name__} | {name: encode(getattr(value, name), numbers) for name in names}
    if callable(value):
        return None
    raise JournalValueError(f"a journal cannot contain a {type(value).__name__}: {value!r:.100}")


def decode(value: Any, numbers: Numbers) -> Any:
    """The value of a JSON form. Raises JournalValueError."""
    try:
        return _decode(value, numbers)
    except (TypeError, ValueError, KeyError, LookupError) as error:
        raise JournalValueError(f"unknown value {value!r:.100}: {error}") from error


def _decode(value: Any, numbers: Numbers) -> Any:
    if isinstance(value, list):
        return tuple(_decode(item, numbers) for item in value)
    if not isinstance(value, dict):
        return value
    ((kind, content), *fields) = value.items()
    if kind == "@":
        made = _classes()[content]
        hints = _hints(made)
        return made(**{name: _nobody if _is_function(hints[name]) else _decode(item, numbers) for name, item in fields})
    if kind == "@b":
        return b64decode(content)
    if kind == "@e":
        return _classes()[content[0]][content[1]]  # type: ignore[index]
    if kind == "@l":
        return [_decode(item, numbers) for item in content]
    if kind == "@m":
        return {key: _decode(item, numbers) for key, item in content}
    if kind == "@n":
        return numbers.session(content)
    if kind == "@o":
        return _OPERATIONS[tuple(content)]
    if kind == "@x":
        return RuntimeError(content)
    raise ValueError(f"there is no kind {kind}")


def _nobody(*_: object) -> None:
    """Takes answers to clients that are not there."""


@cache
def _fields(kind: Any) -> tuple[str, ...] | None:
    """Names of the fields of a class whose objects are their fields; None for another class."""
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind) if field.init)
    if issubclass(kind, msgspec.Struct):
        return tuple(kind.__struct_fields__)
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return tuple(kind._fields)
    return None


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _is_function(hint: Any) -> bool:
    return getattr(hint, "__origin__", None) is Callable


@cache
def _classes() -> dict[str, type]:
    """Every class of the commands and of what they consist of, by name. Nothing else is ever created from a journal."""
    found: dict[str, type] = {}
    waiting: list[Any] = [*commands()]
    waiting += [operation.body for operation in OPERATIONS if operation.body is not None]
    while waiting:
        hint = waiting.pop()
        waiting += get_args(hint)
        if not isinstance(hint, type) or found.get(hint.__name__) is hint:
            continue
        names = _fields(hint)
        if issubclass(hint, Enum) or names is not None:
            found[hint.__name__] = hint
        if names is not None:
            waiting += _hints(hint).values()
    return found


def commands() -> Iterator[type[Command]]:
    """Every class of commands that has fields of its own."""
    waiting = Command.__subclasses__()
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        # a class with slots is a copy of the one that was written, which stays among the subclasses
        if dataclasses.is_dataclass(kind) and getattr(sys.modules[kind.__module__], kind.__name__) is kind:
            yield kind
