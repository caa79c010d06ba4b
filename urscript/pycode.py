"""Small makers of Python syntax tree nodes that carry a URScript position."""

import ast
from typing import TypedDict

from urscript.syntax import Node

LOAD, STORE = ast.Load(), ast.Store()


class Place(TypedDict):
    """Where a node stands; line and column of the script are line and column of the Python code."""

    lineno: int
    col_offset: int
    end_lineno: int
    end_col_offset: int


def place_of(node: Node) -> Place:
    """The place of a URScript node."""
    line, column = node.line, node.column
    return {"lineno": line, "col_offset": column - 1, "end_lineno": line, "end_col_offset": column}


def constant(value: object, place: Place) -> ast.expr:
    return ast.Constant(value=value, **place)  # type: ignore[arg-type]  # typeshed narrows what a constant may be


def load(name: str, place: Place) -> ast.expr:
    return ast.Name(name, LOAD, **place)  # by position: by keyword it takes twice as long, and there are thousands


def call(name: str, place: Place, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, LOAD, **place), list(arguments), [], **place)


def attribute(value: ast.expr, name: str, place: Place) -> ast.expr:
    return ast.Attribute(value, name, LOAD, **place)


def item(mapping: str, key: str, context: ast.expr_context, place: Place) -> ast.expr:
    """``mapping["key"]``, to be read or assigned to."""
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


def function(name: str, parameters: list[str], body: list[ast.stmt], place: Place) -> ast.stmt:
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
