"""Numbers, vectors and matrices (Script Manual, module urmath)."""

import math
from collections.abc import Callable

from urproto.robots.pose import pose_inv
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.operators import check_product_size, wrap32
from urscript.values import (
    INT_MAX,
    INT_MIN,
    MAX_PHYSICAL,
    Any_,
    Int,
    ListArg,
    Matrix,
    Num,
    Pose,
    Value,
    is_number,
    type_name,
)

LIBRARY = Library("urmath")

_BITS = 32


def _rounded(rounding: Callable[[float], int], value: float) -> float:
    """An int if it fits into 32 bits; otherwise a float (a guess)."""
    try:
        whole = rounding(value)
    except (OverflowError, ValueError):  # infinite, or not a number
        return value
    return whole if INT_MIN <= whole <= INT_MAX else float(whole)


def _domain(name: str, allowed: bool, needs: str, value: float) -> None:
    if not allowed:
        raise RuntimeFault(f"{name}: the argument must be {needs}, not {value:g}")


@LIBRARY.builtin()
def acos(f: Num) -> float:
    """Arc cosine [rad] of `f` in -1..1."""
    _domain("acos", -1 <= f <= 1, "in -1..1", f)
    return math.acos(f)


@LIBRARY.builtin()
def asin(f: Num) -> float:
    """Arc sine [rad] of `f` in -1..1."""
    _domain("asin", -1 <= f <= 1, "in -1..1", f)
    return math.asin(f)


@LIBRARY.builtin()
def atan(f: Num) -> float:
    """Arc tangent [rad] of `f`."""
    return math.atan(f)


@LIBRARY.builtin()
def atan2(x: Num, y: Num) -> float:
    """Arc tangent [rad] of `x` / `y` in the right quadrant: `x` is the ordinate, whatever its name says."""
    return math.atan2(x, y)


@LIBRARY.builtin()
def cos(f: Num) -> float:
    """Cosine of `f` [rad]."""
    return math.cos(f) if math.isfinite(f) else math.nan


@LIBRARY.builtin()
def sin(f: Num) -> float:
    """Sine of `f` [rad]."""
    return math.sin(f) if math.isfinite(f) else math.nan


@LIBRARY.builtin()
def tan(f: Num) -> float:
    """Tangent of `f` [rad]."""
    return math.tan(f) if math.isfinite(f) else math.nan


@LIBRARY.builtin()
def d2r(d: Num) -> float:
    """Degrees to radians."""
    return math.radians(d)


@LIBRARY.builtin()
def r2d(r: Num) -> float:
    """Radians to degrees."""
    return math.degrees(r)


@LIBRARY.builtin()
def ceil(f: Num) -> float:
    """The smallest int that is not less than `f`."""
    return _rounded(math.ceil, f)


@LIBRARY.builtin()
def floor(f: Num) -> float:
    """The largest int that is not greater than `f`."""
    return _rounded(math.floor, f)


@LIBRARY.builtin()
def log(b: Num, f: Num) -> float:
    """Logarithm of `f` to the base `b`."""
    _domain("log", f > 0, "positive", f)
    _domain("log", b > 0 and b != 1, "a positive base other than 1", b)
    return math.log(f) / math.log(b)


@LIBRARY.builtin()
def pow_(base: Num, exponent: Num) -> float:
    """`base` to the power of `exponent`, as a float; infinite when too large for one."""
    _domain("pow", base >= 0 or float(exponent).is_integer(), "non-negative for a fractional exponent", base)
    _domain("pow", base != 0 or exponent >= 0, "non-zero for a negative exponent", base)
    try:
        return math.pow(base, exponent)
    except OverflowError:
        return -math.inf if base < 0 and exponent % 2 == 1 else math.inf


@LIBRARY.builtin()
def sqrt(f: Num) -> float:
    """Square root of `f`."""
    _domain("sqrt", f >= 0, "non-negative", f)
    return math.sqrt(f)


# vectors


def _numbers(name: str, value: Value) -> list[float]:
    if not isinstance(value, list) or not all(map(is_number, value)):
        raise RuntimeFault(f"Type error: {name} expected numbers but found '{type_name(value)}'")
    charge(2 * len(value))
    return value


@LIBRARY.builtin()
def norm(a: Any_) -> Value:
    """Euclidean length of a list or pose; the absolute value of a number."""
    if is_number(a):
        return wrap32(abs(a)) if a.__class__ is int else abs(a)
    return math.hypot(*_numbers("norm", a))


@LIBRARY.builtin(cb3="3.10", e="5.9")  # Script Manual CB3 3.10
def normalize(v: Any_) -> list[float]:
    """The list `v` scaled to length 1."""
    items = _numbers("normalize", v)
    length = math.hypot(*items)
    _domain("normalize", length > 0, "a vector longer than 0", length)
    scaled = [item / length for item in items]
    return Pose(scaled) if isinstance(v, Pose) else scaled


# bits


@LIBRARY.builtin()
def binary_list_to_integer(l: ListArg) -> int:  # noqa: E741  # the manual's keyword name
    """The 32 bit signed int whose bits are the booleans of `l`, the lowest first."""
    if len(l) > _BITS:
        raise RuntimeFault(f"binary_list_to_integer: takes at most {_BITS} booleans, not {len(l)}")
    if not all(item.__class__ is bool for item in l):
        raise RuntimeFault("Type error: binary_list_to_integer expected a list of booleans")
    return wrap32(sum(1 << bit for bit, item in enumerate(l) if item))


@LIBRARY.builtin()
def integer_to_binary_list(x: Int) -> list[bool]:
    """The 32 bits of `x` as booleans, the lowest first."""
    return [bool(x >> bit & 1) for bit in range(_BITS)]


# matrices


@LIBRARY.builtin(cb3="3.14", e="5.9")
def transpose(m: Any_) -> Value:
    """`m` with rows and columns exchanged. A list of numbers is one row: it becomes a column, and a column a list."""
    if isinstance(m, Matrix):
        charge(len(m.rows) * len(m.rows[0]))
        if m.shape[1] == 1:
            return [row[0] for row in m.rows]
        return Matrix(tuple(zip(*m.rows, strict=True)))
    if isinstance(m, list) and not isinstance(m, Pose) and m and all(map(is_number, m)):
        charge(2 * len(m))
        return Matrix(tuple((item,) for item in m))
    raise RuntimeFault(f"Type error: argument 'm' of transpose expected type 'Matrix' but found '{type_name(m)}'")


@LIBRARY.builtin(cb3="3.14", e="5.9")
def inv(m: Any_) -> Value:
    """The inverse of a square matrix, or of a pose."""
    if isinstance(m, Pose):
        if not all(-MAX_PHYSICAL <= value <= MAX_PHYSICAL for value in m):
            raise RuntimeFault(f"inv: a pose must be finite, with no number beyond {MAX_PHYSICAL:g}")
        return Pose(pose_inv(m))
    if not isinstance(m, Matrix) or m.shape[0] != m.shape[1]:
        raise RuntimeFault("inv: the argument must be a square matrix")
    return _inverse(m)


def _inverse(matrix: Matrix) -> Matrix:
    """Gauss-Jordan elimination with row pivoting."""
    size = len(matrix.rows)
    check_product_size(size**3)
    charge(100 + 5 * size**3)
    work = [[*map(float, row), *(float(i == j) for j in range(size))] for i, row in enumerate(matrix.rows)]
    for column in range(size):
        pivot = max(range(column, size), key=lambda row: abs(work[row][column]))
        if work[pivot][column] == 0:
            raise RuntimeFault("inv: the matrix is singular")
        work[column], work[pivot] = work[pivot], work[column]
        scale = work[column][column]
        work[column] = [item / scale for item in work[column]]
        for row in range(size):
            factor = work[row][column]
            if row != column and factor:
                work[row] = [a - factor * b for a, b in zip(work[row], work[column], strict=True)]
    return Matrix(tuple(tuple(row[size:]) for row in work))


@LIBRARY.builtin(cb3="3.14", e="5.9")
def size(v: Any_) -> Value:
    """Rows and columns of a matrix as a list, otherwise the number of elements."""
    if isinstance(v, Matrix):
        return list(v.shape)
    if isinstance(v, (list, str)):
        return len(v)
    raise RuntimeFault(f"Type error: size expected type 'List' but found '{type_name(v)}'")
