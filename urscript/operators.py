"""The operations of compiled programs on values. Every function raises RuntimeFault for operands of the wrong type.

Rules, whose sources are in docs/reference/urscript_rules.md: ``/`` is always real division, ``+ - *`` of ints give ints
that wrap at 32 bits, ``%`` takes the sign of the dividend, floats follow IEEE 754, lists combine element by element,
and poses do not combine.
"""

import math
import operator
import struct
import sys
import sysconfig
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from urscript.errors import RuntimeFault
from urscript.meter import METER, charge
from urscript.values import (
    INT_MAX,
    INT_MIN,
    MAX_ELEMENTS,
    MAX_NESTING,
    BoundedList,
    Matrix,
    Pose,
    Struct,
    Value,
    as_string,
    is_number,
    type_name,
)

_SCALARS: frozenset[Any] = frozenset([type(None), bool, int, float, str])
_NUMBERS: frozenset[Any] = frozenset([int, float])
_ORDERED: frozenset[Any] = frozenset([bool, int, float])
_LISTS: frozenset[Any] = frozenset([list, BoundedList])
_OPERANDS: frozenset[Any] = frozenset([int, float, Matrix])  # types that matrix arithmetic accepts

Operator = Callable[[Any, Any], Any]

_MAX_PRODUCTS = 100_000
"""Maximum number of multiplications in one matrix operation, so that it fits into a few control periods (46 by 46
elements)."""

_COPIED_PER_UNIT = 8
"""Elements of a list that are copied per unit of work."""


def fault(message: str) -> NoReturn:
    """Stop the program with this message."""
    raise RuntimeFault(message)


# numbers


def wrap32(value: int) -> int:
    """Two's complement at 32 bits. A guess: the manual only says that ints have 32 bits."""
    return (value - INT_MIN) % 2**32 + INT_MIN


def wrap(value: float) -> float:
    """The result of an operation: an int is wrapped at 32 bits, a float is unchanged."""
    return value if value.__class__ is float else wrap32(int(value))


def whole(value: Value, what: str) -> int:
    """Convert a number without a fraction to an int; `what` names it in the error message."""
    if value.__class__ is int:
        return int(value)
    if value.__class__ is float and value.is_integer():
        return int(value)
    raise RuntimeFault(f"Type error: {what} must be a whole number, not '{type_name(value)}'")


def _divide(left: float, right: float) -> float:
    if right == 0:
        # A guess: IEEE 754. The official control script can divide a list by a remaining time of zero.
        if left == 0 or math.isnan(left):
            return math.nan
        return math.copysign(math.inf, left) * math.copysign(1.0, right)
    return left / right


def _modulo(left: float, right: float) -> float:
    if left.__class__ is int and right.__class__ is int:
        if right == 0:
            raise RuntimeFault("Division by zero: the right operand of % is the integer 0")
        return int(math.fmod(left, right))
    if right == 0 or math.isinf(left):
        return math.nan
    return math.fmod(left, right)


def add(left: Value, right: Value) -> Value:
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        result = left + right
        return result if result.__class__ is float or INT_MIN <= result <= INT_MAX else wrap32(result)
    if left.__class__ is str and right.__class__ is str:
        return as_string(left + right)
    return _elementwise(_ADD, left, right)


def sub(left: Value, right: Value) -> Value:
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        result = left - right
        return result if result.__class__ is float or INT_MIN <= result <= INT_MAX else wrap32(result)
    return _elementwise(_SUB, left, right)


def mul(left: Value, right: Value) -> Value:
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        result = left * right
        return result if result.__class__ is float or INT_MIN <= result <= INT_MAX else wrap32(result)
    if left.__class__ is Matrix and right.__class__ in (Matrix, list, BoundedList):
        return _product(left, right)
    return _elementwise(_MUL, left, right)


def div(left: Value, right: Value) -> Value:
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        return left / right if right else _divide(left, right)
    return _elementwise(_DIV, left, right)


def mod(left: Value, right: Value) -> Value:
    if left.__class__ is int and right.__class__ is int and left >= 0 and right > 0:  # Python's % is the same here
        return left % right
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        return _modulo(left, right)
    return _elementwise(_MOD, left, right)


@dataclass(frozen=True, slots=True)
class _Arithmetic:
    sign: str
    general: Operator
    floats: Operator  # the same for two floats; raises ZeroDivisionError where Python's operator differs


_ADD = _Arithmetic("+", add, operator.add)
_SUB = _Arithmetic("-", sub, operator.sub)
_MUL = _Arithmetic("*", mul, operator.mul)
_DIV = _Arithmetic("/", div, operator.truediv)
_MOD = _Arithmetic("%", mod, _modulo)


def neg(value: Value) -> Value:
    if value.__class__ in _NUMBERS:
        return -value if value != INT_MIN else value
    return mul(value, -1) if value.__class__ in _LISTS or value.__class__ is Matrix else _refuse("-", value)


def pos(value: Value) -> Value:
    return value if value.__class__ in _NUMBERS else _refuse("+", value)


def _refuse(sign: str, *operands: Value) -> NoReturn:
    found = " and ".join(f"'{type_name(operand)}'" for operand in operands)
    texts = sum(operand.__class__ is str for operand in operands)
    joined = sign == "+" and texts == 1 and all(operand.__class__ in _SCALARS for operand in operands)
    hint = "; str_cat() joins any two values" if joined else ""
    raise RuntimeFault(f"Type error: operator {sign} cannot be used with {found}{hint}")


_only_floats = frozenset([float]).issuperset


def _elementwise(operation: _Arithmetic, left: Value, right: Value) -> Value:
    """Apply an operation to two lists, or to a list and a number, element by element."""
    left_list, right_list = left.__class__ in _LISTS, right.__class__ in _LISTS
    if left_list and right_list:
        if len(left) != len(right):
            sign = operation.sign
            raise RuntimeFault(f"Lists of different lengths ({len(left)} and {len(right)}) with operator {sign}")
        floats = _only_floats(map(type, left)) and _only_floats(map(type, right))
    elif left_list and right.__class__ in _NUMBERS:
        floats = right.__class__ is float and _only_floats(map(type, left))
        right = (right,) * len(left)
    elif right_list and left.__class__ in _NUMBERS:
        floats = left.__class__ is float and _only_floats(map(type, right))
        left = (left,) * len(right)
    elif left_list or right_list:
        _refuse(operation.sign, left, right)
    else:
        return _matrix_elementwise(operation, left, right)
    METER.left -= 10 + 5 * len(left)
    if floats:
        try:
            return list(map(operation.floats, left, right))
        except ZeroDivisionError:
            pass
    return [_scalar(operation.sign, operation.general, a, b) for a, b in zip(left, right, strict=True)]


def _scalar(sign: str, operation: Operator, left: Value, right: Value) -> Value:
    if left.__class__ in _NUMBERS and right.__class__ in _NUMBERS:
        return operation(left, right)
    _refuse(sign, left, right)


# matrices


def _matrix_elementwise(kind: _Arithmetic, left: Value, right: Value) -> Matrix:
    sign, operation = kind.sign, kind.general
    if left.__class__ not in _OPERANDS or right.__class__ not in _OPERANDS:
        _refuse(sign, left, right)
    if left.__class__ in _NUMBERS:
        return _matrix_map(right, lambda item: operation(left, item))
    if right.__class__ in _NUMBERS:
        return _matrix_map(left, lambda item: operation(item, right))
    if left.shape != right.shape:
        raise RuntimeFault(f"Matrices of different shapes {left.shape} and {right.shape} with operator {sign}")
    charge(20 + 5 * len(left.rows) * len(left.rows[0]))
    rows = zip(left.rows, right.rows, strict=True)
    return Matrix(tuple(tuple(map(operation, a, b)) for a, b in rows))


def _matrix_map(matrix: Matrix, operation: Callable[[Value], Value]) -> Matrix:
    charge(20 + 5 * len(matrix.rows) * len(matrix.rows[0]))
    return Matrix(tuple(tuple(map(operation, row)) for row in matrix.rows))


def _product(left: Matrix, right: Value) -> Value:
    if right.__class__ is not Matrix:
        return [_dot(row, right) for row in left.rows]
    check_product_size(left.shape[0] * left.shape[1] * right.shape[1])
    columns = list(zip(*right.rows, strict=True))
    return Matrix(tuple(tuple(_dot(row, column) for column in columns) for row in left.rows))


def check_product_size(multiplications: int) -> None:
    """Raise RuntimeFault when a matrix operation takes too many multiplications."""
    if multiplications > _MAX_PRODUCTS:
        raise RuntimeFault(f"The matrices are too large: at most {_MAX_PRODUCTS} multiplications in one operation")


def _dot(row: tuple[Value, ...], column: Value) -> Value:
    if len(row) != len(column) or not all(map(is_number, column)):
        raise RuntimeFault(f"Matrix product: {len(row)} columns on the left do not match {len(column)} on the right")
    charge(25 + 3 * len(row))
    total = sum(map(operator.mul, row, column))
    return total if total.__class__ is float else wrap32(int(total))


# comparison


def truth(value: Value) -> bool:
    """The truth value of a condition: numbers as in C; an empty string is False (Script Manual, socket_read_string)."""
    if value.__class__ is bool or value.__class__ in _NUMBERS or value.__class__ is str:
        return bool(value)
    raise RuntimeFault(f"Type error: a condition expected type 'Bool' but found '{type_name(value)}'")


def eq(left: Value, right: Value) -> bool:
    if left.__class__ is str:
        charge(len(left) // 64)
    elif left.__class__ not in _SCALARS and right.__class__ not in _SCALARS:
        charge(2 * _size(left))
    return bool(left == right)


def ne(left: Value, right: Value) -> bool:
    return not eq(left, right)


def _ordering(sign: str, compare: Operator) -> Operator:
    def ordered(left: Value, right: Value) -> bool:
        if left.__class__ in _ORDERED and right.__class__ in _ORDERED:
            return bool(compare(left, right))
        _refuse(sign, left, right)

    return ordered


lt = _ordering("<", operator.lt)
le = _ordering("<=", operator.le)
gt = _ordering(">", operator.gt)
ge = _ordering(">=", operator.ge)


# building


def list_literal(*items: Value) -> Value:
    """``[a, b]``: a list, or a matrix when every item is a list of numbers of one length."""
    for item in items:
        if item.__class__ not in _SCALARS:
            return _nested(list(items))
    return list(items)


def list_without_texts(*items: Value) -> Value:
    """Like `list_literal`, for versions before 5.15, which have no lists of strings."""
    for item in items:
        if item.__class__ is str:
            raise RuntimeFault("Type error: a list cannot hold a 'Const String' before PolyScope 5.15")
    return list_literal(*items)


def _nested(items: list[Value]) -> Value:
    check_size(items)
    first = items[0]
    if first.__class__ in _LISTS and first:
        fits = (item.__class__ in _LISTS and len(item) == len(first) and all(map(is_number, item)) for item in items)
        if all(fits):
            return Matrix(tuple(map(tuple, items)))
    return items


def number_list(layout: str, data: bytes) -> list[float]:
    """Unpack a long list of numbers; `layout` is a format of the struct module."""
    METER.left -= 2 * len(layout)
    return list(struct.unpack(layout, data))


def pose_literal(*items: Value) -> Pose:
    """``p[x, y, z, rx, ry, rz]``."""
    for item in items:
        if item.__class__ not in _NUMBERS:
            raise RuntimeFault(f"Type error: a pose holds numbers, not '{type_name(item)}'")
    return Pose(map(float, items))


def make_struct(names: tuple[str, ...], *values: Value) -> Struct:
    """``struct(a=1, b=2)``."""
    check_size(list(values))
    return Struct(dict(zip(names, values, strict=True)))


def check_size(value: Value) -> Value:
    """Return the value unchanged; raise RuntimeFault when it is too large."""
    charge(_size(value))
    return value


def _size(value: Value, budget: int = MAX_ELEMENTS, levels: int = MAX_NESTING) -> int:
    """The number of elements of a value, all levels together."""
    if value.__class__ in _SCALARS:
        return 1
    items: Collection[Value]
    if isinstance(value, list):
        items = value
    elif isinstance(value, Struct):
        items = value.members.values()
    else:
        return len(value.rows) * len(value.rows[0]) if isinstance(value, Matrix) else 1
    if levels == 0:
        raise RuntimeFault(f"The value has more than {MAX_NESTING} levels of lists and structs")
    total = 1 + len(items)
    _check_elements(total, budget)
    for item in items:
        if item.__class__ not in _SCALARS:
            total += _size(item, budget + 1 - total, levels - 1) - 1
            _check_elements(total, budget)
    return total


def _check_elements(count: int, budget: int) -> None:
    if count > budget:
        raise RuntimeFault(f"The value has more than {MAX_ELEMENTS} elements")


# access


def index(value: Value, position: Value) -> Value:
    """``value[position]`` of a list, a pose, a matrix (a row), or a struct (a member, e-Series manual of 5.19)."""
    if isinstance(value, list):
        if position.__class__ is int and 0 <= position < len(value):  # the usual case
            return value[position]
        return value[_within(position, len(value))]
    if value.__class__ is Matrix:
        return list(value.rows[_within(position, len(value.rows))])
    if value.__class__ is Struct:
        return list(value.members.values())[_within(position, len(value.members))]
    raise RuntimeFault(f"Type error: '{type_name(value)}' cannot be indexed")


def cell(value: Value, row: Value, column: Value) -> Value:
    """``value[row, column]`` of a matrix."""
    if value.__class__ is not Matrix:
        raise RuntimeFault(f"Type error: '{type_name(value)}' cannot be indexed by row and column")
    rows, columns = value.shape
    return value.rows[_within(row, rows)][_within(column, columns)]


def _within(position: Value, length: int) -> int:
    if position.__class__ is not int:
        position = whole(position, "an index")
    if 0 <= position < length:
        return int(position)
    raise RuntimeFault(f"Index out of bounds: {position}, the length is {length}")


def member(value: Value, name: str) -> Value:
    """``value.name`` of a struct."""
    if value.__class__ is not Struct:
        raise RuntimeFault(f"Type error: '{type_name(value)}' has no member '{name}'")
    if name not in value.members:
        raise RuntimeFault(f"The struct has no member '{name}'; it has {', '.join(value.members)}")
    return value.members[name]


Key = Any  # str: a member; a number: an index; a pair: a matrix cell


references: Callable[[Any], int] = getattr(sys, "getrefcount", lambda _: -1)


def _references_when_unshared(count: str, variable: str = "v_a") -> int:
    """The references that an expression counts for a list that only a variable of a program refers to; 0 if that says
    nothing.

    The number depends on how Python passes arguments, so it is measured by a function compiled like those of programs.
    """
    if sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
        return 0
    names = {"_set_item": lambda value, key, item: references(value), "references": references}
    namespace: dict[str, Any] = {**names, "_locals": {}}
    exec(f"def count():\n  {variable} = [0]\n  v_n = {count}\n  return v_n", namespace)
    return int(namespace["count"]())


_UNSHARED: Final = _references_when_unshared("_set_item(v_a, 0, 1)")
UNSHARED_LOCAL: Final = _references_when_unshared("references(v_a)")
"""What `references` returns in compiled code for a list to which only a local variable refers."""
UNSHARED_ITEM: Final = _references_when_unshared('references(_locals["a"])', '_locals["a"]')
"""The same for a global, or an item of ``_locals``."""


def _copied(value: list[Value]) -> list[Value]:
    """A copy of a list, to write an element of it."""
    METER.left -= len(value) // _COPIED_PER_UNIT
    return BoundedList(value, value.capacity) if isinstance(value, BoundedList) else value.copy()


def set_item(value: Value, key: Key, item: Value) -> Value:
    """`value` with `item` as its element `key`.

    It is a copy, unless `value` is a list to which only the assigned variable refers: nobody can tell the difference
    then, and in a loop over a long list, the copies would take most of the time.
    """
    result: Value
    if isinstance(value, list) and value.__class__ is not Pose and key.__class__ is int and 0 <= key < len(value):
        if references(value) == _UNSHARED and item.__class__ in _SCALARS:
            value[key] = item
            return value
        result = _copied(value)
        result[key] = item
    elif key.__class__ is str:
        result = Struct({**value.members, key: retype(member(value, key), item)})  # it keeps its type: manual of 5.19
    elif key.__class__ is tuple:
        cell(value, *key)
        result = _with_cell(value, int(key[0]), int(key[1]), item)
    elif value.__class__ is Pose:
        result = list(value)
        result[_within(key, 6)] = item
        return pose_literal(*result)
    elif isinstance(value, list):
        return set_item(value, _within(key, len(value)), item)
    else:
        raise RuntimeFault(f"Type error: '{type_name(value)}' cannot be indexed")
    return result if item.__class__ in _SCALARS else check_size(result)


def _with_cell(value: Matrix, row: int, column: int, item: Value) -> Matrix:
    if item.__class__ not in _NUMBERS:
        raise RuntimeFault(f"Type error: a matrix holds numbers, not '{type_name(item)}'")
    rows = list(value.rows)
    rows[row] = (*rows[row][:column], item, *rows[row][column + 1 :])
    charge(len(rows) + len(rows[0]))
    return Matrix(tuple(rows))


def set_path(value: Value, path: tuple[Key, ...], item: Value) -> Value:
    """A copy of `value` in which the element at the end of `path` is `item`."""
    if len(path) == 1:
        return set_item(value, path[0], item)
    key = path[0]
    if value.__class__ is Matrix and len(path) == 2 and key.__class__ is not tuple:
        return set_item(value, (key, path[1]), item)
    inner = member(value, key) if key.__class__ is str else index(value, key)
    return set_item(value, key, set_path(inner, path[1:], item))


# assignment to globals


def retype(old: Value, new: Value) -> Value:
    """Check the new value of a global when its Python type differs from that of the old one; return it.

    Raises RuntimeFault when the URScript types differ. int and float count as one type, because production programs
    rely on it; none can be assigned to any variable (a guess). A list takes the members of a struct, if they have the
    type of its elements (e-Series manual of 5.19).
    """
    if old is None or new is None:
        return new
    if old.__class__ in _NUMBERS and new.__class__ in _NUMBERS:
        return new
    expected, found = type_name(old), type_name(new)
    if expected == found:
        return new
    if isinstance(old, list) and new.__class__ is Struct and expected == "List":
        members = list(new.members.values())
        if len({_element_type(value) for value in (*old, *members)}) <= 1:
            return check_size(members)
    # "exected" is the controller's spelling.
    raise RuntimeFault(f"Type error: left-hand side of the expression exected type '{expected}' but found '{found}'")


def _element_type(value: Value) -> str:
    return "number" if value.__class__ in _NUMBERS else type_name(value)


def retype_fixed(old: Value, new: Value) -> Value:
    """Like `retype`, for versions before 5.15, where a list variable keeps its length."""
    if old.__class__ is list and new.__class__ is list and len(old) != len(new):
        raise RuntimeFault("Resizing of 'List' is not supported")
    return new if old.__class__ is new.__class__ else retype(old, new)
