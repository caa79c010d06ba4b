"""Six-vectors as plain tuples: what the generators need, without numpy's cost per call."""

from collections.abc import Iterable, Sequence
from math import isfinite, sqrt

from urproto.robots.pose import rotvec_to_matrix

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


Axes = tuple[Vec3, Vec3, Vec3]

_NO_LENGTH = 1e-9


def of_rotation(pose: Sequence[float]) -> Axes:
    """The axes of a pose's orientation."""
    m = rotvec_to_matrix(*pose[3:])
    return (m[0], m[3], m[6]), (m[1], m[4], m[7]), (m[2], m[5], m[8])


def into6(axes: Axes, screw: Joints) -> Joints:
    """A base-frame (linear, angular) pair in the axes."""
    x, y, z = axes
    lin, ang = screw[:3], screw[3:]
    return (dot(lin, x), dot(lin, y), dot(lin, z), dot(ang, x), dot(ang, y), dot(ang, z))


def out_of(axes: Axes, v: Vec3) -> Vec3:
    """A vector given in the axes, in the base frame."""
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


def out_of6(axes: Axes, screw: Joints) -> Joints:
    """As out_of, for a (linear, angular) pair."""
    return (*out_of(axes, screw[:3]), *out_of(axes, screw[3:]))


def unit(v: Vec3, otherwise: Vec3) -> Vec3:
    """The direction of v; ``otherwise`` when it has none."""
    size = norm3(*v)
    return (v[0] / size, v[1] / size, v[2] / size) if size > _NO_LENGTH else otherwise


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
