"""Features of an installation file: points, lines and planes a program can move relative to."""

import math
from typing import Final

from urproto.robots.pose import Pose, matrix_to_rotvec, rotvec_to_matrix
from urproto.vectors import ZERO6, Vector3, cross, sub3
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.numbers import numbers

BASE_VARIABLE: Final = "Base"  # the base as a feature that programs use as a variable

_POINT: Final = "GeomPoseNode"
_LINE: Final = "GeomLineNode"
_PLANE: Final = "GeomPlaneNode"
_BASE: Final = ZERO6


class _DegenerateError(Exception):
    """The points coincide or are collinear. PolyScope does not offer such a feature to programs (guess)."""


def read_features(root: Element) -> tuple[dict[str, Pose], frozenset[str]]:
    """Pose of each feature in the base frame by name, and the names that programs may use as variables."""
    features: dict[str, Pose] = {}
    variables = set()
    tree = root.child("Features", "GeomFeatures")
    for element in tree.walk() if tree else ():
        if element.tag == "BaseView" and element.get("isVariable") == "true":
            features[BASE_VARIABLE] = _BASE
            variables.add(BASE_VARIABLE)
        name = element.get("name")
        try:
            pose = _pose(element) if name else None
        except _DegenerateError:
            continue
        if pose is None:
            continue
        features[name] = pose
        if element.get("isVariable") == "true":
            variables.add(name)
    return features, frozenset(variables)


def _pose(element: Element) -> Pose | None:
    """Pose of a feature in the base frame; None for an element that is not a feature."""
    if element.tag == _POINT and element.child("toolPosition"):
        return (*_vector(element, "toolPosition"), *_vector(element, "toolAxisAngle"))
    if element.tag == _LINE and element.child("firstPoint"):
        return _line(element)
    if element.tag == _PLANE and element.child("firstPoint"):
        return _plane(element)
    return None


def _point(element: Element, tag: str) -> Pose:
    """The point in <firstPoint> and so on: itself, or below it."""
    holder = element.child(tag)
    point = holder if holder is None or holder.child("toolPosition") else holder.child(_POINT)
    pose = _pose(point) if point is not None else None
    if pose is None:
        raise DocumentError(f"the feature {element.get('name')} lacks its <{tag}>")
    return pose


def _line(element: Element) -> Pose:
    """y from the first point to the second, z as close as possible to the first point's z (Software Manual)."""
    first, second = _point(element, "firstPoint"), _point(element, "secondPoint")
    matrix = rotvec_to_matrix(*first[3:])
    return _frame(first, sub3(second, first), cross(sub3(second, first), (matrix[2], matrix[5], matrix[8])))


def _plane(element: Element) -> Pose:
    """y from the first point to the second, z normal to the plane (Software Manual).

    Since about PolyScope 5.9, the first point has the pose of the plane, and the taught points are stored separately
    (the result equals PolyScope's in its files).
    """
    first = _point(element, "firstPoint")
    if element.child("userFirstPoint"):
        return first
    y = sub3(_point(element, "secondPoint"), first)
    normal = cross(y, sub3(_point(element, "thirdPoint"), first))
    return _frame(first, y, cross(y, normal))


def _frame(origin: Pose, y: Vector3, x: Vector3) -> Pose:
    x, y = _unit(x), _unit(y)
    z = cross(x, y)
    return (*origin[:3], *matrix_to_rotvec((x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])))


def _vector(element: Element, tag: str) -> Vector3:
    child = element.child(tag)
    values = numbers(child.get("value")) if child else []
    if len(values) != 3:
        raise DocumentError(f"the feature {element.get('name')} lacks its <{tag}>")
    return (values[0], values[1], values[2])


def _unit(vector: Vector3) -> Vector3:
    length = math.hypot(*vector)
    if length == 0.0:
        raise _DegenerateError
    return (vector[0] / length, vector[1] / length, vector[2] / length)
