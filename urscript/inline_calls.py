"""Calls of built-ins that compile to Python expressions, where the kinds of their arguments are known.

A call of a Python function takes several times as long as what these built-ins do. Each expression covers the usual
case, and calls the built-in for every other one, such as a position out of bounds.
"""

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class BuiltinCall:
    """A call of a built-in with its arguments by position. kinds, code: of the arguments, and their Python code."""

    name: str
    arguments: Sequence[Expression]
    kinds: Sequence[KindSet]
    code: Sequence[ast.expr]
    place: Place

    def general(self, *arguments: ast.expr) -> ast.expr:
        """The Python expression that calls the built-in."""
        return call(f"u_{self.name}", self.place, *arguments)

    def either(self, test: ast.expr, usual: ast.expr, general: ast.expr) -> ast.expr:
        return ast.IfExp(test=test, body=usual, orelse=general, **self.place)


_Inline = Callable[[BuiltinCall, Ranges], ast.expr | None]


def inline_call(built_in: BuiltinCall, ranges: Ranges) -> ast.expr | None:
    """The Python expression for a call of a built-in; None when there is none, and the built-in must be called."""
    inline = _INLINE.get(built_in.name)
    return None if inline is None or len(built_in.arguments) != len(built_in.code) else inline(built_in, ranges)


def _length(built_in: BuiltinCall, _: Ranges) -> ast.expr | None:
    (value,), (kind,), place = built_in.code, built_in.kinds, built_in.place
    length = call("_len", place, value)
    if is_sequence(kind):
        return length
    if kind != STRING or not isinstance(value, ast.Name):
        return None
    return built_in.either(_is_ascii(value, place), length, built_in.general(value))


def _character(built_in: BuiltinCall, ranges: Ranges) -> ast.expr | None:
    (name, position), (text, code), place = built_in.arguments, built_in.code, built_in.place
    if tuple(built_in.kinds) != (STRING, INT) or not isinstance(name, Name) or not isinstance(text, ast.Name):
        return None
    first, again = kept(position, code, place)
    inside, ascii_ = within(name, text, position, first, place, ranges), _is_ascii(text, place)
    if inside is None:
        test, again = ascii_, code
    else:
        test = ast.BoolOp(op=ast.And(), values=[inside, ascii_], **place)
    character = ast.Subscript(value=text, slice=again, ctx=LOAD, **place)
    return built_in.either(test, character, built_in.general(text, again))


def _function(built_in: BuiltinCall, _: Ranges) -> ast.expr | None:
    """A function of one number, for numbers on which Python's function is defined."""
    if not is_number(built_in.kinds[0]):
        return None
    place = built_in.place
    value, again = kept(built_in.arguments[0], built_in.code[0], place)
    if built_in.name == "sqrt":
        test = ast.Compare(left=value, ops=[ast.GtE()], comparators=[constant(0, place)], **place)
    else:
        bounds = constant(-_FINITE, place), constant(_FINITE, place)
        test = ast.Compare(left=bounds[0], ops=[ast.Lt(), ast.Lt()], comparators=[value, bounds[1]], **place)
    return built_in.either(test, call(f"_{built_in.name}", place, again), built_in.general(again))


def _text(built_in: BuiltinCall, _: Ranges) -> ast.expr | None:
    return _as_text(built_in.kinds[0], built_in.code[0], built_in.place)


def _joined_texts(built_in: BuiltinCall, _: Ranges) -> ast.expr | None:
    kinds, code, place = built_in.kinds, built_in.code, built_in.place
    left, right = (_as_text(kind, value, place) for kind, value in zip(kinds, code, strict=True))
    return None if left is None or right is None else joined(left, right, place)


def _as_text(kind: KindSet, value: ast.expr, place: Place) -> ast.expr | None:
    """The Python expression for the text of a string or an int."""
    return value if kind == STRING else call("_str", place, value) if kind == INT else None


def joined(left: ast.expr, right: ast.expr, place: Place) -> ast.expr:
    """The Python expression for two strings, one after the other."""
    text, again = keep(ast.BinOp(left, ast.Add(), right, **place), place)
    short = ast.Compare(call("_len", place, again), [ast.LtE()], [constant(MAX_STRING, place)], **place)
    test = ast.BoolOp(ast.And(), [_is_ascii(text, place), short], **place)
    return ast.IfExp(test=test, body=again, orelse=call("_as_string", place, again), **place)


def _is_ascii(text: ast.expr, place: Place) -> ast.expr:
    return ast.Call(attribute(text, "isascii", place), [], [], **place)


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
