"""Three- and six-vectors as plain tuples: what the arm's bookkeeping needs, without numpy's cost per call."""

from collections.abc import Sequence

from emulator.snapshot import Vector3, Vector6

ZERO6: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Matrix3 = tuple[float, ...]  # nine numbers, row by row
Rows = Sequence[Sequence[float]]


def times6(rows: Rows, vector: Sequence[float]) -> Vector6:
    """Matrix times vector."""
    a, b, c, d, e, f = vector
    x, y, z, rx, ry, rz = [r * a + s * b + t * c + u * d + v * e + w * f for r, s, t, u, v, w in rows]
    return (x, y, z, rx, ry, rz)


def plus6(a: Sequence[float], b: Sequence[float]) -> Vector6:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5])


def minus6(a: Sequence[float], b: Sequence[float]) -> Vector6:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])


def rate6(now: Vector6, before: Vector6, period_s: float) -> Vector6:
    """Change per second."""
    x, y, z, u, v, w = minus6(now, before)
    return (x / period_s, y / period_s, z / period_s, u / period_s, v / period_s, w / period_s)


def plus3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def cross(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def into(axes: Matrix3, v: Sequence[float]) -> Vector3:
    """A base-frame vector (the first three of v) in the frame whose axes are the columns of the matrix."""
    x, y, z = v[0], v[1], v[2]
    return (
        axes[0] * x + axes[3] * y + axes[6] * z,
        axes[1] * x + axes[4] * y + axes[7] * z,
        axes[2] * x + axes[5] * y + axes[8] * z,
    )


def out_of(axes: Matrix3, v: Sequence[float]) -> Vector3:
    """The inverse of ``into``."""
    x, y, z = v[0], v[1], v[2]
    return (
        axes[0] * x + axes[1] * y + axes[2] * z,
        axes[3] * x + axes[4] * y + axes[5] * z,
        axes[6] * x + axes[7] * y + axes[8] * z,
    )
