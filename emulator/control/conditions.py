"""Conditions on the state of a robot, as text: comparisons, joined by ``and``."""

import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from emulator.snapshot import NAMES, Snapshot
from urproto.compat import IntEnum
from urproto.text import number

_COMPARISONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
_TERM: Final = re.compile(r"(\w+(?:\.\w+)?)(?:\[([0-9]{1,9})\])?\s*(==|!=|<=|>=|<|>)\s*(.+)")
_WORDS: Final = {"true": True, "false": False}
_FIELDS: Final = Snapshot()  # an example: every snapshot has values of the same types
_MISSING: Final = object()

Read = Callable[[Snapshot], Any]
Outside = Callable[[str], Read | None]
"""Finds what a name with a dot stands for; None for a name that is not known."""


@dataclass(frozen=True)
class Comparison:
    """A value of the state, compared with another one."""

    read: Read
    sign: str
    wanted: Any

    def __call__(self, snapshot: Snapshot) -> bool:
        value = self.read(snapshot)
        return value is not _MISSING and bool(_COMPARISONS[self.sign](value, self.wanted))

    def margin(self, snapshot: Snapshot) -> float:
        """By how much it is true, or false if negative: a distance for an order of numbers, else 1 or -1."""
        value = self.read(snapshot)
        if self.sign in ("==", "!=") or not isinstance(value, int | float):
            return 1.0 if self(snapshot) else -1.0
        distance = float(self.wanted - value)
        return distance if self.sign.startswith("<") else -distance


@dataclass(frozen=True)
class Condition:
    """Comparisons that must all be true. text: as it was written."""

    text: str
    terms: tuple[Comparison, ...]

    def __call__(self, snapshot: Snapshot) -> bool:
        return all(term(snapshot) for term in self.terms)

    def margin(self, snapshot: Snapshot) -> float:
        return min(term.margin(snapshot) for term in self.terms)


def parse_condition(text: str, outside: Outside = lambda name: None) -> Condition:
    """Comparisons of published fields with numbers, mode names or texts, joined by ``and``.

    outside: finds values that are not fields. Raises ValueError, which says what is wrong and what is possible.
    """
    return Condition(text, tuple(_term(part.strip(), outside) for part in re.split(r"\sand\s", text)))


def _term(text: str, outside: Outside) -> Comparison:
    match = _TERM.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a condition: write a field, ==, !=, <, <=, > or >=, and a value")
    name, index, sign, value = match.groups()
    if "." not in name:
        if name not in NAMES:
            raise _unknown(name)
        example = _value_of(_FIELDS, name, index)
        return Comparison(lambda snapshot: _value_of(snapshot, name, index), sign, _constant(value.strip(), example))
    if (read := outside(name)) is None:
        raise ValueError(f"there is no {name} here: the verb state lists the fields")
    return Comparison(_element(read, index), sign, _constant(value.strip(), 0.0))


def _element(read: Read, index: str | None) -> Read:
    """A value from outside, or an element of it; missing as long as it does not exist."""

    def value(snapshot: Snapshot) -> Any:
        found = read(snapshot)
        if index is None or found is None:
            return _MISSING if found is None else found
        try:
            return found[int(index)]
        except (TypeError, IndexError):
            return _MISSING

    return value


def _value_of(snapshot: Snapshot, name: str, index: str | None) -> Any:
    try:
        value = getattr(snapshot, name)
        return value if index is None else value[int(index)]
    except (TypeError, IndexError):
        raise _unknown(name if index is None else f"{name}[{index}]") from None


def _unknown(place: str) -> ValueError:
    return ValueError(f"there is no field {place}: the verb state lists the fields")


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
        raise ValueError(f"{text!r} is not a value to compare with: give a number{names}") from None
