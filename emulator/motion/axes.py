"""Vectors in a frame's axes: three perpendicular unit vectors, given in the base frame."""

from collections.abc import Sequence

from emulator.motion.vectors import Joints, Vec3, norm3
from urproto.robots.pose import rotvec_to_matrix

__all__ = ["Axes", "cross", "dot", "into6", "of_rotation", "out_of", "out_of6", "unit"]

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
