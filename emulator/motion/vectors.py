"""Six-vectors as plain tuples: what the generators need, without numpy's cost per call."""

from urproto.robots.pose import axes_of as of_rotation
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
