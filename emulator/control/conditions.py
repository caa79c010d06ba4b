"""Conditions on the published state, written as text: ``robot_mode == RUNNING and actual_q[0] > 0.5``."""

import operator
import re
from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final

from emulator.snapshot import Snapshot
from urproto.text import number

__all__ = ["Condition", "parse_condition"]

_COMPARISONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
_TERM: Final = re.compile(r"(\w+)(?:\[([0-9]{1,9})\])?\s*(==|!=|<=|>=|<|>)\s*(.+)")
_WORDS: Final = {"true": True, "false": False}
_FIELDS: Final = Snapshot()  # of the types that every snapshot has

Condition = Callable[[Snapshot], bool]


def parse_condition(text: str) -> Condition:
    """Comparisons of published fields with numbers, mode names or texts, joined by ``and``.

    Raises ValueError that says what is wrong and what is possible.
    """
    terms = [_term(part.strip()) for part in re.split(r"\sand\s", text)]
    return lambda snapshot: all(term(snapshot) for term in terms)


def _term(text: str) -> Condition:
    match = _TERM.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is no condition: write a field, ==, !=, <, <=, > or >=, and a value")
    name, index, sign, value = match.groups()
    example = _value_of(_FIELDS, name, index)
    compare, wanted = _COMPARISONS[sign], _constant(value.strip(), example)
    return lambda snapshot: compare(_value_of(snapshot, name, index), wanted)


def _value_of(snapshot: Snapshot, name: str, index: str | None) -> Any:
    try:
        value = vars(snapshot)[name]
        return value if index is None else value[int(index)]
    except (KeyError, TypeError, IndexError):
        place = name if index is None else f"{name}[{index}]"
        raise ValueError(f"there is no field {place}: the fields are those of the verb state") from None


def _constant(text: str, example: Any) -> Any:
    """The text as a value of the example's kind."""
    if isinstance(example, IntEnum) and text.upper() in type(example).__members__:
        return type(example)[text.upper()]
    if isinstance(example, str):
        return text.strip("\"'")
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    try:
        return number(text)
    except ValueError:
        names = f", or one of {', '.join(type(example).__members__)}" if isinstance(example, IntEnum) else ""
        raise ValueError(f"{text!r} cannot be compared with: give a number{names}") from None
