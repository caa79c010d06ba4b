"""Python arithmetic for operands that are known to be numbers.

Calling `urscript.operators` for every operation, which checks the types of both operands, made a loop of scalar
arithmetic fourteen times as slow as in Python. The generated code therefore uses Python's operators, with inline tests
where the language differs: ints wrap at 32 bits, ``%`` takes the sign of the dividend, and division by zero is not an
error. Where such a test fails, it calls `urscript.operators`, which implements all rules.
"""

import ast
from typing import Final

from urscript.inference import FLOAT, INT, KindSet
from urscript.pycode import STORE, Place, call, constant, load
from urscript.syntax import Binary, Constant, Expression, Name

ARITHMETIC_HELPERS: Final = {"+": "_add", "-": "_sub", "*": "_mul", "/": "_div", "%": "_mod"}
"""The functions that perform an operation on operands of any kind, by their names in compiled code."""

ROUNDING: Final = {"floor": "_floor", "ceil": "_ceil"}
"""Built-ins that Python has, too, and their names in compiled code."""

_PYTHON: Final[dict[str, type[ast.operator]]] = {"+": ast.Add, "-": ast.Sub, "*": ast.Mult, "/": ast.Div, "%": ast.Mod}
_RESULT: Final = "_n"

_QUICK: Final = 2**30 - 1
"""Up to here Python compares ints in one step. `_wrap` looks at larger ones, few of which need a wrap."""


def number_arithmetic(node: Binary, kind: KindSet, left: ast.expr, right: ast.expr, place: Place) -> ast.expr:
    """The Python code for an operation on two numbers; `kind` is the kind of its result."""
    operator = node.operator
    plain = ast.BinOp(left=left, op=_PYTHON[operator](), right=right, **place)
    if operator == "/":
        return _divide(node, plain, place)
    if operator == "%":
        return _modulo(node, kind, plain, place)
    return plain if kind == FLOAT else _wrapped(node, plain, place)


def rounded(name: str, argument: ast.expr, place: Place) -> ast.expr:
    """The Python code for a function of `ROUNDING`, whose argument is a number: infinite and large ones need a call."""
    number, again = _keep(argument, place)
    bounds = [number, constant(_QUICK, place)]
    test = ast.Compare(left=constant(-_QUICK, place), ops=[ast.LtE(), ast.LtE()], comparators=bounds, **place)
    quick = call(ROUNDING[name], place, again)
    return ast.IfExp(test=test, body=quick, orelse=call(f"u_{name}", place, again), **place)


def _divide(node: Binary, plain: ast.BinOp, place: Place) -> ast.expr:
    if _is_positive(node.right):
        return plain
    if isinstance(node.left, (Name, Constant)) and isinstance(node.right, Name):
        general = call("_div", place, plain.left, plain.right)
        return ast.IfExp(test=plain.right, body=plain, orelse=general, **place)
    return call("_div", place, plain.left, plain.right)


def _modulo(node: Binary, kind: KindSet, plain: ast.BinOp, place: Place) -> ast.expr:
    """The Python code for ``%``: Python's operator equals that of C when neither operand is negative, or -0.0."""
    positive = _is_positive(node.right)
    if not positive and not isinstance(node.right, Name):
        return call("_mod", place, plain.left, plain.right)
    first, again = kept(node.left, plain.left, place)
    ops: list[ast.cmpop] = [ast.GtE() if kind == INT else ast.Gt(), *([] if positive else [ast.Lt()])]
    bounds = [constant(0, place), *([] if positive else [plain.right])]
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
    (result, again), low, high = _keep(plain, place), constant(-_QUICK, place), constant(_QUICK, place)
    if node.operator != "*" and _is_positive(node.right):
        bound, compare = (high, ast.LtE()) if node.operator == "+" else (low, ast.GtE())
        test = ast.Compare(left=result, ops=[compare], comparators=[bound], **place)
    else:
        test = ast.Compare(left=low, ops=[ast.LtE(), ast.LtE()], comparators=[result, high], **place)
    return ast.IfExp(test=test, body=again, orelse=call("_wrap", place, again), **place)


def within(position: ast.expr, value: ast.expr, place: Place) -> ast.expr:
    """The Python test whether a position is one of a list."""
    length = call("_len", place, value)
    if isinstance(position, ast.Constant):  # never negative
        return ast.Compare(left=position, ops=[ast.Lt()], comparators=[length], **place)
    return ast.Compare(left=constant(0, place), ops=[ast.LtE(), ast.Lt()], comparators=[position, length], **place)


def kept(node: Expression, code: ast.expr, place: Place) -> tuple[ast.expr, ast.expr]:
    """The Python code of a node for its first use, and for the uses right after it: it is evaluated only once."""
    if isinstance(node, (Name, Constant)):
        return code, code
    return _keep(code, place)


def _keep(value: ast.expr, place: Place) -> tuple[ast.expr, ast.expr]:
    """The Python code for a value, and for the same value right after it."""
    return ast.NamedExpr(ast.Name(_RESULT, STORE, **place), value, **place), load(_RESULT, place)


def _is_positive(node: Expression) -> bool:
    return isinstance(node, Constant) and node.value.__class__ in (int, float) and bool(node.value > 0)
