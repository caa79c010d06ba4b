"""Six-vectors as plain tuples: what the generators need, without numpy's cost per call."""

from collections.abc import Sequence

from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO6 as ZERO
from urproto.vectors import Axes as Axes
from urproto.vectors import Vector3 as Vec3
from urproto.vectors import Vector6 as Joints
from urproto.vectors import (
    all_finite,
    as_six,
    cross,
    dot,
    into6,
    largest,
    lerp,
    norm3,
    out_of,
    out_of6,
    scaled,
    sub,
    towards,
    unit,
)

__all__ = [
    "ZERO",
    "Axes",
    "Joints",
    "Vec3",
    "all_finite",
    "as_six",
    "cross",
    "dot",
    "into6",
    "largest",
    "lerp",
    "norm3",
    "of_rotation",
    "out_of",
    "out_of6",
    "scaled",
    "sub",
    "towards",
    "unit",
]


def of_rotation(pose: Sequence[float]) -> Axes:
    """The axes of a pose's orientation."""
    m = rotvec_to_matrix(*pose[3:])
    return (m[0], m[3], m[6]), (m[1], m[4], m[7]), (m[2], m[5], m[8])
