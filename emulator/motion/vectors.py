"""Six-vectors as plain tuples: what the generators need, without numpy's cost per call."""

from collections.abc import Iterable, Sequence
from math import isfinite, sqrt

__all__ = ["ZERO", "Joints", "Vec3", "all_finite", "as_six", "largest", "lerp", "norm3", "scaled", "sub", "towards"]

Joints = tuple[float, float, float, float, float, float]
Vec3 = tuple[float, float, float]

ZERO: Joints = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def as_six(values: Iterable[float]) -> Joints:
    """Six floats, or ValueError."""
    a, b, c, d, e, f = values
    return (float(a), float(b), float(c), float(d), float(e), float(f))


def all_finite(values: Iterable[float]) -> bool:
    """False when any value is NaN or infinite."""
    return all(map(isfinite, values))


def sub(a: Sequence[float], b: Sequence[float]) -> Joints:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])


def lerp(a: Sequence[float], b: Sequence[float], scale: float) -> Joints:
    """a + scale * b."""
    return (
        a[0] + scale * b[0],
        a[1] + scale * b[1],
        a[2] + scale * b[2],
        a[3] + scale * b[3],
        a[4] + scale * b[4],
        a[5] + scale * b[5],
    )


def scaled(a: Sequence[float], factor: float) -> Joints:
    """factor * a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor, a[3] * factor, a[4] * factor, a[5] * factor)


def largest(values: Iterable[float]) -> float:
    """Largest magnitude."""
    return max(map(abs, values))


def norm3(x: float, y: float, z: float) -> float:
    """Euclidean length."""
    return sqrt(x * x + y * y + z * z)


def towards(now: Joints, goal: Joints, step: float) -> Joints:
    """Go from now to goal on a straight line, the leading component by at most step; ends on goal exactly."""
    change = sub(goal, now)
    size = largest(change)
    return goal if size <= step else lerp(now, change, step / size)
