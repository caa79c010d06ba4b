"""Helpers that create Python syntax tree nodes with a URScript position."""

import ast
import sys
from collections.abc import Collection
from itertools import islice
from types import CodeType
from typing import TypedDict

from urscript.syntax import Node

LOAD, STORE = ast.Load(), ast.Store()


class Place(TypedDict):
    """The position of a node as stored in the Python code; read it with ``script_position`` or
    ``instruction_position``."""

    lineno: int
    col_offset: int
    end_lineno: int
    end_col_offset: int


if sys.version_info >= (3, 11):

    def place_of(node: Node) -> Place:
        """The place of a URScript node."""
        line, column = node.line, node.column
        return {"lineno": line, "col_offset": column - 1, "end_lineno": line, "end_col_offset": column}

    def script_position(place: Place) -> tuple[int, int]:
        """Line and column of the URScript node."""
        return place["lineno"], place["col_offset"] + 1

    def script_line(lineno: int) -> int:
        """The line of the script that a line number of the Python code encodes."""
        return lineno

    def instruction_position(code: CodeType, instruction: int) -> tuple[int, int]:
        """Line and column (from 1) of an instruction; column 1 when Python runs without column tables."""
        line, _, column, _ = next(islice(code.co_positions(), instruction // 2, None))
        return line or 0, (column or 0) + 1

else:  # Python 3.10 code has no columns: they are encoded in the line numbers, as far as those reach
    _COLUMNS = 1024
    _LINES = 2**31 // _COLUMNS  # a line number has 32 bits

    def place_of(node: Node) -> Place:
        number = min(node.line, _LINES - 1) * _COLUMNS + min(node.column, _COLUMNS - 1)
        return {"lineno": number, "col_offset": 0, "end_lineno": number, "end_col_offset": 1}

    def script_position(place: Place) -> tuple[int, int]:
        return divmod(place["lineno"], _COLUMNS)

    def script_line(lineno: int) -> int:
        return lineno // _COLUMNS

    def instruction_position(code: CodeType, instruction: int) -> tuple[int, int]:
        numbers = (number for begin, end, number in code.co_lines() if begin <= instruction < end)
        return divmod(next(numbers, None) or 0, _COLUMNS)


def constant(value: object, place: Place) -> ast.expr:
    return ast.Constant(value=value, **place)  # type: ignore[arg-type]  # typeshed narrows what a constant may be


def load(name: str, place: Place) -> ast.expr:
    return ast.Name(name, LOAD, **place)  # keyword arguments take twice as long, for thousands of nodes


def call(name: str, place: Place, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, LOAD, **place), list(arguments), [], **place)


def attribute(value: ast.expr, name: str, place: Place) -> ast.expr:
    return ast.Attribute(value, name, LOAD, **place)


def item(mapping: str, key: str, context: ast.expr_context, place: Place) -> ast.expr:
    """``mapping["key"]``, to read or to assign to."""
    return ast.Subscript(value=load(mapping, place), slice=constant(key, place), ctx=context, **place)


def assign(name: str, value: ast.expr, place: Place) -> ast.stmt:
    return ast.Assign(targets=[ast.Name(id=name, ctx=STORE, **place)], value=value, **place)


def subscript(value: ast.expr, position: int, place: Place) -> ast.expr:
    return ast.Subscript(value=value, slice=constant(position, place), ctx=LOAD, **place)


def yield_from(value: ast.expr, place: Place) -> ast.expr:
    return ast.YieldFrom(value=value, **place)


def charge(units: int, place: Place, *, park: bool) -> list[ast.stmt]:
    """``_meter.left -= units``; with `park` also ``if _meter.left < 0: yield True``."""
    target = ast.Attribute(value=load("_meter", place), attr="left", ctx=STORE, **place)
    cost = constant(units, place)
    if not park:
        return [ast.AugAssign(target=target, op=ast.Sub(), value=cost, **place)]
    rest = ast.BinOp(left=attribute(load("_meter", place), "left", place), op=ast.Sub(), right=cost, **place)
    draw = ast.Assign(targets=[target, ast.Name(id="_left", ctx=STORE, **place)], value=rest, **place)
    empty = ast.Compare(left=load("_left", place), ops=[ast.Lt()], comparators=[constant(0, place)], **place)
    pause = ast.Expr(value=ast.Yield(value=constant(True, place), **place), **place)
    return [draw, ast.If(test=empty, body=[pause], orelse=[], **place)]


def function(
    name: str, parameters: list[str], body: list[ast.stmt], used_globals: Collection[str], place: Place
) -> ast.stmt:
    """``def name(parameters, _meter=_meter): body`` in a function whose parameters are the global variables it uses.

    They are therefore free variables, which Python accesses almost as fast as local ones: `code_of` finds the code, and
    the runtime supplies their cells.
    """
    names = sorted(used_globals)
    shared = [ast.Nonlocal(names=names, **place)] if names else []
    inner = _def(name, [*parameters, "_meter"], [*shared, *body], place)
    return _def("_", names, [ast.Global(names=[name], **place), inner], place)  # global: it may call itself


def code_of(module: CodeType) -> CodeType:
    """The code of a function in a compiled module that contains nothing but what `function` created."""
    for _ in range(2):
        module = next(constant for constant in module.co_consts if isinstance(constant, CodeType))
    return module


def _def(name: str, parameters: list[str], body: list[ast.stmt], place: Place) -> ast.stmt:
    arguments = ast.arguments(
        posonlyargs=[],
        args=[ast.arg(arg=parameter, **place) for parameter in parameters],
        kwonlyargs=[],
        kw_defaults=[],
        defaults=[],
    )
    node = ast.FunctionDef(name=name, args=arguments, body=body, decorator_list=[], returns=None, **place)
    if "type_params" in node._fields:  # a required field from Python 3.12 on
        setattr(node, "type_params", [])  # noqa: B010  # unknown to the type checker before 3.12
    return node
