"""Ranges of int variables, known from the conditions of loops: sums that cannot exceed 32 bits need no wrap there."""

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

from urscript.inference import assigned_names
from urscript.syntax import Binary, Constant, Expression, Name, Statement, While
from urscript.values import INT_MAX, INT_MIN

Range: TypeAlias = tuple[int, int]
"""The smallest and the largest value that a variable may have."""

_ANY: Final[Range] = (INT_MIN, INT_MAX)
_MIRRORED: Final = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


class Ranges:
    """The known ranges at one place of a body, by the names of local variables that can only be ints."""

    def __init__(self, known: Mapping[str, Range] | None = None) -> None:
        self._known = dict(known or {})

    def fits(self, node: Binary) -> bool:
        """Whether the sum or difference of a variable and an int literal has at most 32 bits."""
        left, right = node.left, node.right
        if not isinstance(left, Name) or not isinstance(right, Constant) or right.value.__class__ is not int:
            return False
        low, high = self._known.get(left.name, _ANY)
        step = {"+": right.value, "-": -right.value}.get(node.operator)
        return step is not None and low + step >= INT_MIN and high + step <= INT_MAX

    def forget_changed(self, statement: Statement) -> None:
        """A statement may give its variables other values."""
        if self._known:
            for name in assigned_names(statement):
                self._known.pop(name, None)

    def within(self, loop: While, is_counter: Callable[[str], bool], is_int: Callable[[Expression], bool]) -> "Ranges":
        """The ranges at the beginning of each pass of a loop.

        is_counter: whether a name is a local variable that can only be an int.
        """
        ranges = Ranges(self._known)
        for name in filter(is_counter, assigned_names(loop)):
            ranges._known[name] = _while_true(loop.condition, name, is_int)
        return ranges


def _while_true(condition: Expression, name: str, is_int: Callable[[Expression], bool]) -> Range:
    """The range of an int variable while a condition holds."""
    if not isinstance(condition, Binary):
        return _ANY
    left, right, operator = condition.left, condition.right, condition.operator
    if operator == "and":
        one, other = _while_true(left, name, is_int), _while_true(right, name, is_int)
        return max(one[0], other[0]), min(one[1], other[1])
    if isinstance(right, Name) and right.name == name:
        left, right, operator = right, left, _MIRRORED.get(operator, "")
    if not isinstance(left, Name) or left.name != name or operator not in _MIRRORED or not is_int(right):
        return _ANY
    low, high = (int(right.value or 0),) * 2 if isinstance(right, Constant) else _ANY
    match operator:
        case "<":
            return INT_MIN, high - 1
        case "<=":
            return INT_MIN, high
        case ">":
            return low + 1, INT_MAX
        case _:
            return low, INT_MAX
