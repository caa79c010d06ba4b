"""Vectors of three and six numbers as plain tuples, without numpy's overhead per call, for use in the control period.

Functions without a number in their names are for six numbers (joints, or a linear and an angular part), except for
those that only make sense in space: length, products, direction. Units and frames are those of the arguments.
"""

from collections.abc import Iterable, Sequence
from math import isfinite, sqrt
from typing import Final, TypeGuard

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Matrix3 = tuple[float, float, float, float, float, float, float, float, float]
"""A 3x3 matrix, row by row."""
Axes = tuple[Vector3, Vector3, Vector3]
"""x, y and z of a frame: the columns of its rotation matrix."""

ZERO3: Final[Vector3] = (0.0, 0.0, 0.0)
ZERO6: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

_NO_LENGTH: Final = 1e-9


# of six


def as_six(values: Iterable[float]) -> Vector6:
    """Convert to six floats. Raises ValueError for another number of values."""
    a, b, c, d, e, f = values
    return (float(a), float(b), float(c), float(d), float(e), float(f))


def all_finite(values: Iterable[float]) -> bool:
    """False when any value is NaN or infinite."""
    return all(map(isfinite, values))


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value that was read is a finite number; True and False are none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False


def largest(values: Iterable[float]) -> float:
    """Largest magnitude."""
    return max(map(abs, values))


def within(low: Sequence[float], values: Sequence[float], high: Sequence[float]) -> bool:
    """Whether every value is within its bounds, inclusive."""
    return (
        low[0] <= values[0] <= high[0]
        and low[1] <= values[1] <= high[1]
        and low[2] <= values[2] <= high[2]
        and low[3] <= values[3] <= high[3]
        and low[4] <= values[4] <= high[4]
        and low[5] <= values[5] <= high[5]
    )


def add(a: Sequence[float], b: Sequence[float]) -> Vector6:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5])


def sub(a: Sequence[float], b: Sequence[float]) -> Vector6:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])


def lerp(a: Sequence[float], b: Sequence[float], scale: float) -> Vector6:
    """a + scale * b."""
    return (
        a[0] + scale * b[0],
        a[1] + scale * b[1],
        a[2] + scale * b[2],
        a[3] + scale * b[3],
        a[4] + scale * b[4],
        a[5] + scale * b[5],
    )


def scaled(a: Sequence[float], factor: float) -> Vector6:
    """factor * a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor, a[3] * factor, a[4] * factor, a[5] * factor)


def scaled_sub(a: Sequence[float], b: Sequence[float], factor: float) -> Vector6:
    """factor * (a - b)."""
    return (
        (a[0] - b[0]) * factor,
        (a[1] - b[1]) * factor,
        (a[2] - b[2]) * factor,
        (a[3] - b[3]) * factor,
        (a[4] - b[4]) * factor,
        (a[5] - b[5]) * factor,
    )


def rate(now: Vector6, before: Vector6, period_s: float) -> Vector6:
    """Change per second."""
    return (
        (now[0] - before[0]) / period_s,
        (now[1] - before[1]) / period_s,
        (now[2] - before[2]) / period_s,
        (now[3] - before[3]) / period_s,
        (now[4] - before[4]) / period_s,
        (now[5] - before[5]) / period_s,
    )


def towards(now: Vector6, goal: Vector6, step: float) -> Vector6:
    """Move from now towards goal on a straight line, the largest component by at most step; ends exactly on goal."""
    change = sub(goal, now)
    size = largest(change)
    return goal if size <= step else lerp(now, change, step / size)


def times6(rows: Sequence[Sequence[float]], vector: Sequence[float]) -> Vector6:
    """A 6x6 matrix, given by its rows, times a vector."""
    a, b, c, d, e, f = vector
    x, y, z, rx, ry, rz = [r * a + s * b + t * c + u * d + v * e + w * f for r, s, t, u, v, w in rows]
    return (x, y, z, rx, ry, rz)


# of three: the first three of the given components


def add3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled3(a: Sequence[float], factor: float) -> Vector3:
    """factor * a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def scaled_sum3(a: Sequence[float], p: float, b: Sequence[float], q: float) -> Vector3:
    """p * a + q * b."""
    return (a[0] * p + b[0] * q, a[1] * p + b[1] * q, a[2] * p + b[2] * q)


def norm3(x: float, y: float, z: float) -> float:
    """Euclidean length."""
    return sqrt(x * x + y * y + z * z)


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Sequence[float], b: Sequence[float]) -> Vector3:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(v: Sequence[float], otherwise: Vector3) -> Vector3:
    """The direction of v; ``otherwise`` when it has none."""
    size = norm3(v[0], v[1], v[2])
    return (v[0] / size, v[1] / size, v[2] / size) if size > _NO_LENGTH else otherwise


# between frames


def rotate(matrix: Sequence[float], v: Sequence[float]) -> Vector3:
    """Matrix (row by row) times vector: from the frame whose axes are its columns."""
    x, y, z = v[0], v[1], v[2]
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


def rotate_back(matrix: Sequence[float], v: Sequence[float]) -> Vector3:
    """Transposed matrix times vector, the inverse of ``rotate``: into the frame whose axes are its columns."""
    x, y, z = v[0], v[1], v[2]
    return (
        matrix[0] * x + matrix[3] * y + matrix[6] * z,
        matrix[1] * x + matrix[4] * y + matrix[7] * z,
        matrix[2] * x + matrix[5] * y + matrix[8] * z,
    )


def out_of(axes: Axes, v: Sequence[float]) -> Vector3:
    """Transform a vector from the given axes to the frame in which these axes are given."""
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


def out_of6(axes: Axes, screw: Vector6) -> Vector6:
    """Like out_of, for a (linear, angular) pair."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = axes
    a, b, c, d, e, f = screw
    return (
        xx * a + yx * b + zx * c,
        xy * a + yy * b + zy * c,
        xz * a + yz * b + zz * c,
        xx * d + yx * e + zx * f,
        xy * d + yy * e + zy * f,
        xz * d + yz * e + zz * f,
    )


def into6(axes: Axes, screw: Vector6) -> Vector6:
    """Transform a (linear, angular) pair to the given axes; the inverse of out_of6."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = axes
    a, b, c, d, e, f = screw
    return (
        a * xx + b * xy + c * xz,
        a * yx + b * yy + c * yz,
        a * zx + b * zy + c * zz,
        d * xx + e * xy + f * xz,
        d * yx + e * yy + f * yz,
        d * zx + e * zy + f * zz,
    )
