"""Python arithmetic for operands that are known to be numbers or lists of numbers.

Calling `urscript.operators` for every operation, which checks the types of both operands, made a loop of scalar
arithmetic fourteen times as slow as in Python. The generated code therefore uses Python's operators, with inline tests
where the language differs: ints wrap at 32 bits, ``%`` takes the sign of the dividend, and division by zero is not an
error. Where such a test fails, it calls `urscript.operators`, which implements all rules.
"""

import ast
from typing import Final

from urscript.inference import FLOAT, KindSet
from urscript.operators import UNSHARED
from urscript.pycode import LOAD, STORE, Place, call, constant, load
from urscript.syntax import Binary, Constant, Expression, Index, Name
from urscript.values import INT_MAX, INT_MIN

ARITHMETIC_HELPERS: Final = {"+": "_add", "-": "_sub", "*": "_mul", "/": "_div", "%": "_mod"}
"""The functions that perform an operation on operands of any kind, by their names in compiled code."""

_PYTHON: Final[dict[str, type[ast.operator]]] = {"+": ast.Add, "-": ast.Sub, "*": ast.Mult, "/": ast.Div, "%": ast.Mod}
_RESULT: Final = "_n"


def number_arithmetic(
    node: Binary, kind: KindSet, left: ast.expr, right: ast.expr, place: Place, *, fits: bool
) -> ast.expr:
    """The Python code for an operation on two numbers; `kind` is the kind of its result.

    fits: the result has at most 32 bits if it is an int.
    """
    operator = node.operator
    plain = ast.BinOp(left=left, op=_PYTHON[operator](), right=right, **place)
    if operator == "/":
        return _divide(node, plain, place)
    if operator == "%":
        return _modulo(node, plain, place)
    return plain if kind == FLOAT or fits else _wrapped(node, plain, place)


def element(node: Index, vector: ast.expr, position: ast.expr, place: Place) -> ast.expr:
    """The Python code for the element of a vector variable at an int position.

    For a position out of bounds, it calls `_index`, which raises the error.
    """
    length, within = call("_len", place, vector), node.positions[0]
    first, again = kept(within, position, place)
    if isinstance(within, Constant) and _is_positive(within):
        test = ast.Compare(left=length, ops=[ast.Gt()], comparators=[first], **place)
    else:
        test = ast.Compare(left=constant(-1, place), ops=[ast.Lt(), ast.Lt()], comparators=[first, length], **place)
    return ast.IfExp(
        test=test,
        body=ast.Subscript(value=vector, slice=again, ctx=LOAD, **place),
        orelse=call("_index", place, vector, again),
        **place,
    )


def write_element(variable: ast.expr, position: ast.expr, value: ast.expr, copy: ast.stmt, place: Place) -> ast.stmt:
    """The Python code that writes an element of a list variable; ``copy`` is executed instead where something else
    refers to the list, too, or the position is out of bounds."""
    within = ast.Compare(
        left=constant(-1, place),
        ops=[ast.Lt(), ast.Lt()],
        comparators=[position, call("_len", place, variable)],
        **place,
    )
    references = call("_references", place, variable)
    alone = ast.Compare(left=references, ops=[ast.Eq()], comparators=[constant(UNSHARED, place)], **place)
    written = ast.Subscript(value=variable, slice=position, ctx=STORE, **place)
    return ast.If(
        test=ast.BoolOp(op=ast.And(), values=[within, alone], **place),
        body=[ast.Assign(targets=[written], value=value, **place)],
        orelse=[copy],
        **place,
    )


def _divide(node: Binary, plain: ast.BinOp, place: Place) -> ast.expr:
    if _is_positive(node.right):
        return plain
    if isinstance(node.left, (Name, Constant)) and isinstance(node.right, Name):
        general = call("_div", place, plain.left, plain.right)
        return ast.IfExp(test=plain.right, body=plain, orelse=general, **place)
    return call("_div", place, plain.left, plain.right)


def _modulo(node: Binary, plain: ast.BinOp, place: Place) -> ast.expr:
    """The Python code for ``%``: Python's operator equals that of C when neither operand is negative."""
    positive = _is_positive(node.right)
    if not positive and not isinstance(node.right, Name):
        return call("_mod", place, plain.left, plain.right)
    first, again = kept(node.left, plain.left, place)
    ops: list[ast.cmpop] = [ast.GtE()] if positive else [ast.GtE(), ast.Lt()]
    bounds = [constant(0, place)] if positive else [constant(0, place), plain.right]
    return ast.IfExp(
        test=ast.Compare(left=first, ops=ops, comparators=bounds, **place),
        body=ast.BinOp(left=again, op=ast.Mod(), right=plain.right, **place),
        orelse=call("_mod", place, again, plain.right),
        **place,
    )


def _wrapped(node: Binary, plain: ast.expr, place: Place) -> ast.expr:
    """The Python code that wraps a result at 32 bits; after adding or subtracting a positive constant, it tests only
    one bound."""
    test: ast.expr
    result, low, high = _keep(plain, place), constant(INT_MIN, place), constant(INT_MAX, place)
    if node.operator != "*" and _is_positive(node.right):
        bound, compare = (high, ast.LtE()) if node.operator == "+" else (low, ast.GtE())
        test = ast.Compare(left=result, ops=[compare], comparators=[bound], **place)
    else:
        test = ast.Compare(left=low, ops=[ast.LtE(), ast.LtE()], comparators=[result, high], **place)
    again = load(_RESULT, place)
    return ast.IfExp(test=test, body=again, orelse=call("_wrap", place, again), **place)


def kept(node: Expression, code: ast.expr, place: Place) -> tuple[ast.expr, ast.expr]:
    """The Python code of a node for its first use, and for the uses right after it: it is evaluated only once."""
    if isinstance(node, (Name, Constant)):
        return code, code
    return _keep(code, place), load(_RESULT, place)


def _keep(value: ast.expr, place: Place) -> ast.expr:
    return ast.NamedExpr(target=ast.Name(id=_RESULT, ctx=STORE, **place), value=value, **place)


def _is_positive(node: Expression) -> bool:
    return isinstance(node, Constant) and node.value.__class__ in (int, float) and bool(node.value > 0)
