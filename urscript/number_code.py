"""Python arithmetic for operands that are known to be numbers or lists of numbers.

Calling `urscript.operators` for every operation, which checks the types of both operands, made a loop of scalar
arithmetic fourteen times as slow as in Python. The generated code therefore uses Python's operators, with inline tests
where the language differs: ints wrap at 32 bits, ``%`` takes the sign of the dividend, and division by zero is not an
error. Where such a test fails, it calls `urscript.operators`, which implements all rules.
"""

import ast
from typing import Final

from urscript.inference import FLOAT, FLOATS, INT, KindSet, is_number
from urscript.operators import UNSHARED
from urscript.pycode import LOAD, STORE, Place, call, constant, load
from urscript.ranges import Ranges
from urscript.syntax import Binary, Constant, Expression, Name

ARITHMETIC_HELPERS: Final = {"+": "_add", "-": "_sub", "*": "_mul", "/": "_div", "%": "_mod"}
"""The functions that perform an operation on operands of any kind, by their names in compiled code."""

_PYTHON: Final[dict[str, type[ast.operator]]] = {"+": ast.Add, "-": ast.Sub, "*": ast.Mult, "/": ast.Div, "%": ast.Mod}
_RESULT: Final = "_n"

_QUICK: Final = 2**30 - 1
"""Up to here Python compares ints in one step. `_wrap` looks at larger ones, few of which need a wrap."""


def arithmetic_helper(operator: str, left: KindSet, right: KindSet) -> str:
    """The function that performs an operation on operands of these kinds, by its name in compiled code."""
    name = ARITHMETIC_HELPERS[operator]
    if left == FLOATS:
        return f"{name}_lists" if right == FLOATS else f"{name}_by_number" if is_number(right) else name
    return f"{name}_each" if right == FLOATS and is_number(left) else name


def number_arithmetic(
    node: Binary, kind: KindSet, left: ast.expr, right: ast.expr, place: Place, ranges: Ranges
) -> ast.expr:
    """The Python code for an operation on two numbers; `kind` is the kind of its result."""
    operator = node.operator
    plain = ast.BinOp(left=left, op=_PYTHON[operator](), right=right, **place)
    if operator == "/":
        return _divide(node, plain, place)
    if operator == "%":
        return _modulo(node, kind, plain, place, ranges)
    return plain if kind == FLOAT or ranges.fits(node) else _wrapped(node, plain, place)


def element(
    sequence: Name, value: ast.expr, position: Expression, code: ast.expr, place: Place, ranges: Ranges
) -> ast.expr:
    """The Python code for the element of a list or pose variable at an int position.

    For a position out of bounds, it calls `_index`, which raises the error.
    """
    first, again = kept(position, code, place)
    test = within(sequence, value, position, first, place, ranges)
    if test is None:
        return ast.Subscript(value=value, slice=code, ctx=LOAD, **place)
    usual = ast.Subscript(value=value, slice=again, ctx=LOAD, **place)
    return ast.IfExp(test=test, body=usual, orelse=call("_index", place, value, again), **place)


def within(
    sequence: Name, value: ast.expr, position: Expression, code: ast.expr, place: Place, ranges: Ranges
) -> ast.expr | None:
    """The Python code that tests whether an int position is within a sequence or string; None where it must be."""
    not_negative = ranges.is_not_negative(position)
    if ranges.is_below_length(position, sequence.name):
        return None if not_negative else ast.Compare(code, [ast.GtE()], [constant(0, place)], **place)
    length = call("_len", place, value)
    if not_negative:
        return ast.Compare(code, [ast.Lt()], [length], **place)
    return ast.Compare(constant(-1, place), [ast.Lt(), ast.Lt()], [code, length], **place)


def write_element(variable: ast.expr, position: ast.expr, value: ast.expr, place: Place) -> ast.stmt:
    """The Python code that writes an element of a list variable."""
    written: list[ast.expr] = [ast.Subscript(value=variable, slice=position, ctx=STORE, **place)]
    return ast.Assign(targets=written, value=value, **place)


def if_shared(variable: ast.expr, then: ast.stmt, place: Place) -> ast.stmt:
    """The Python code that executes a statement if not only this variable refers to its value."""
    references = call("_references", place, variable)
    return ast.If(ast.Compare(references, [ast.NotEq()], [constant(UNSHARED, place)], **place), [then], [], **place)


def _divide(node: Binary, plain: ast.BinOp, place: Place) -> ast.expr:
    if _is_positive(node.right):
        return plain
    if isinstance(node.left, (Name, Constant)) and isinstance(node.right, Name):
        general = call("_div", place, plain.left, plain.right)
        return ast.IfExp(test=plain.right, body=plain, orelse=general, **place)
    return call("_div", place, plain.left, plain.right)


def _modulo(node: Binary, kind: KindSet, plain: ast.BinOp, place: Place, ranges: Ranges) -> ast.expr:
    """The Python code for ``%``: Python's operator equals that of C when neither operand is negative, or -0.0."""
    right = ranges.range_of(node.right)
    positive = _is_positive(node.right) or (right is not None and right[0] > 0)
    if positive and ranges.is_not_negative(node.left):
        return plain
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
    (result, again), low, high = keep(plain, place), constant(-_QUICK, place), constant(_QUICK, place)
    if node.operator != "*" and _is_positive(node.right):
        bound, compare = (high, ast.LtE()) if node.operator == "+" else (low, ast.GtE())
        test = ast.Compare(left=result, ops=[compare], comparators=[bound], **place)
    else:
        test = ast.Compare(left=low, ops=[ast.LtE(), ast.LtE()], comparators=[result, high], **place)
    return ast.IfExp(test=test, body=again, orelse=call("_wrap", place, again), **place)


def kept(node: Expression, code: ast.expr, place: Place) -> tuple[ast.expr, ast.expr]:
    """The Python code of a node for its first use, and for the uses right after it: it is evaluated only once."""
    if isinstance(node, (Name, Constant)):
        return code, code
    return keep(code, place)


def keep(value: ast.expr, place: Place) -> tuple[ast.expr, ast.expr]:
    """The Python code for a value, and for the same value right after it."""
    return ast.NamedExpr(ast.Name(_RESULT, STORE, **place), value, **place), load(_RESULT, place)


def _is_positive(node: Expression) -> bool:
    return isinstance(node, Constant) and node.value.__class__ in (int, float) and bool(node.value > 0)
