"""Calls of built-ins that compile to Python expressions, where the kinds of their arguments are known.

A call of a Python function takes several times as long as what these built-ins do. Each expression covers the usual
case, and calls the built-in for every other one, such as a position out of bounds.
"""

import ast
from collections.abc import Callable, Sequence
from math import cos, sin, sqrt
from typing import Any, Final

from urscript.inference import INT, STRING, KindSet, is_number, is_sequence
from urscript.number_code import keep, kept, within
from urscript.pycode import LOAD, Place, attribute, call, constant
from urscript.ranges import Ranges
from urscript.syntax import Expression, Name
from urscript.values import MAX_STRING, as_string

HELPERS: Final[dict[str, Any]] = {"_sin": sin, "_cos": cos, "_sqrt": sqrt, "_str": str, "_as_string": as_string}
"""The Python functions that the expressions call, by their names in compiled code."""

_FINITE: Final = 1e300  # the built-in itself looks at larger numbers, which may be infinite
_Inline = Callable[[str, Sequence[Expression], Sequence[KindSet], list[ast.expr], Place, Ranges], ast.expr | None]


def inline_call(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    """The Python expression for a call of a built-in, given its arguments, their kinds and their Python code.

    None when there is none: the built-in must then be called.
    """
    inline = _INLINE.get(name)
    return (
        None if inline is None or len(nodes) != len(arguments) else inline(name, nodes, kinds, arguments, place, ranges)
    )


def _length(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    (value,) = arguments
    length = call("_len", place, value)
    if is_sequence(kinds[0]):
        return length
    if kinds[0] != STRING or not isinstance(value, ast.Name):
        return None
    return _either(_is_ascii(value, place), length, call(f"u_{name}", place, value), place)


def _character(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    text, position = arguments
    if kinds[0] != STRING or kinds[1] != INT or not isinstance(nodes[0], Name) or not isinstance(text, ast.Name):
        return None
    position, again = kept(nodes[1], position, place)
    test = _is_ascii(text, place)
    if (inside := within(nodes[0], text, nodes[1], position, place, ranges)) is not None:
        test = ast.BoolOp(op=ast.And(), values=[inside, test], **place)
    else:
        again = arguments[1]
    character = ast.Subscript(value=text, slice=again, ctx=LOAD, **place)
    return _either(test, character, call(f"u_{name}", place, text, again), place)


def _function(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    """A function of one number, for numbers on which Python's function is defined."""
    if not is_number(kinds[0]):
        return None
    value, again = kept(nodes[0], arguments[0], place)
    if name == "sqrt":
        test = ast.Compare(left=value, ops=[ast.GtE()], comparators=[constant(0, place)], **place)
    else:
        bounds = constant(-_FINITE, place), constant(_FINITE, place)
        test = ast.Compare(left=bounds[0], ops=[ast.Lt(), ast.Lt()], comparators=[value, bounds[1]], **place)
    return _either(test, call(f"_{name}", place, again), call(f"u_{name}", place, again), place)


def _text(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    return _as_text(kinds[0], arguments[0], place)


def _joined_texts(
    name: str,
    nodes: Sequence[Expression],
    kinds: Sequence[KindSet],
    arguments: list[ast.expr],
    place: Place,
    ranges: Ranges,
) -> ast.expr | None:
    left, right = (_as_text(kind, value, place) for kind, value in zip(kinds, arguments, strict=True))
    return None if left is None or right is None else joined(left, right, place)


def _as_text(kind: KindSet, value: ast.expr, place: Place) -> ast.expr | None:
    """The Python expression for the text of a string or an int."""
    return value if kind == STRING else call("_str", place, value) if kind == INT else None


def joined(left: ast.expr, right: ast.expr, place: Place) -> ast.expr:
    """The Python expression for two strings, one after the other."""
    text, again = keep(ast.BinOp(left, ast.Add(), right, **place), place)
    short = ast.Compare(call("_len", place, again), [ast.LtE()], [constant(MAX_STRING, place)], **place)
    test = ast.BoolOp(ast.And(), [_is_ascii(text, place), short], **place)
    return _either(test, again, call("_as_string", place, again), place)


_INLINE: Final[dict[str, _Inline]] = {
    "length": _length,
    "get_list_length": _length,
    "str_len": _length,
    "str_at": _character,
    "str_cat": _joined_texts,
    "to_str": _text,
    "sin": _function,
    "cos": _function,
    "sqrt": _function,
}


def _is_ascii(text: ast.expr, place: Place) -> ast.expr:
    return ast.Call(attribute(text, "isascii", place), [], [], **place)


def _either(test: ast.expr, usual: ast.expr, general: ast.expr, place: Place) -> ast.expr:
    return ast.IfExp(test=test, body=usual, orelse=general, **place)
