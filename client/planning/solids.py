"""Objects and links as coal geometries: their shape, placement and extent."""

from collections.abc import Iterator, Sequence
from math import cos, hypot, pi, sin, sqrt
from typing import Any, Final

import coal
import numpy as np
import pinocchio as pin

from client.errors import SceneError
from client.planning.scene import Box, Cylinder, Hull, Mesh, Plane, SceneObject, Sphere
from urproto.robots.pose import Pose, rotvec_to_matrix
from urproto.robots.shapes import Capsule, LinkCylinder
from urproto.vectors import Vector3, add3, cross, dot, scaled3, sub3, unit

_RIM_CORNERS: Final = 24  # corners of a polygon around a cylinder's end


def placed_capsule(part: Capsule) -> tuple[Any, Any]:
    """Its placement in its link, and its geometry."""
    placement, length = _axis_frame(part.start, part.end)
    return placement, coal.Capsule(part.radius, length)


def placed_cylinder(part: LinkCylinder) -> tuple[Any, Any]:
    """Its placement in its link, and its geometry."""
    placement, length = _axis_frame(part.start, part.end)
    return placement, coal.Cylinder(part.radius, length)


def _axis_frame(start: Vector3, end: Vector3) -> tuple[Any, float]:
    along = sub3(end, start)
    length = sqrt(dot(along, along))
    z = np.array((0.0, 0.0, 1.0))
    turn = pin.Quaternion.FromTwoVectors(z, np.array(along) / length if length else z)
    return pin.SE3(turn.matrix(), 0.5 * (np.array(start) + np.array(end))), length


def capsule_around(start: Vector3, end: Vector3, parts: Sequence[LinkCylinder]) -> Capsule:
    """The thinnest capsule about this axis that contains the cylinders."""
    return Capsule(
        start, end, max(_distance_to_segment(point, start, end) for part in parts for point in _rim_points(part))
    )


def extent_of(part: LinkCylinder | Capsule) -> float:
    """Distance [m] of its farthest point from the joint that its link begins with."""
    if isinstance(part, Capsule):
        return max(hypot(*part.start), hypot(*part.end)) + part.radius
    return max(hypot(*point) for point in _rim_points(part))


def _rim_points(part: LinkCylinder) -> Iterator[Vector3]:
    """Corners of polygons around both ends. A convex shape that contains them contains the cylinder."""
    axis = unit(sub3(part.end, part.start), (0.0, 0.0, 1.0))
    across = unit(cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0)), (1.0, 0.0, 0.0))
    upright = cross(axis, across)
    radius = part.radius / cos(pi / _RIM_CORNERS)
    for k in range(_RIM_CORNERS):
        angle = 2.0 * pi * k / _RIM_CORNERS
        out = add3(scaled3(across, radius * cos(angle)), scaled3(upright, radius * sin(angle)))
        yield add3(part.start, out)
        yield add3(part.end, out)


def _distance_to_segment(point: Vector3, start: Vector3, end: Vector3) -> float:
    """Distance of a point from a line segment."""
    along, there = sub3(end, start), sub3(point, start)
    share = max(0.0, min(1.0, dot(there, along) / dot(along, along)))
    return hypot(*sub3(there, scaled3(along, share)))


def at(place: Vector3) -> Any:
    """A placement without rotation."""
    return placed((*place, 0.0, 0.0, 0.0))


def placed(pose: Pose) -> Any:
    """A pose as a Pinocchio placement."""
    return pin.SE3(np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3), np.array(pose[:3]))


def solid(name: str, obj: SceneObject) -> Any:
    """The geometry of an object. Raises SceneError."""
    match obj.shape:
        case Box(size):
            return coal.Box(*size)
        case Sphere(radius):
            return coal.Sphere(radius)
        case Cylinder(radius, length):
            return coal.Cylinder(radius, length)
        case Plane():
            return coal.Halfspace(np.array((0.0, 0.0, 1.0)), 0.0)
        case Mesh(path, scale):
            return _mesh_hull(name, str(path), scale)
        case Hull(points):
            return _hull_of_points(points)
    raise SceneError(f"{name} has an unknown shape")


def _mesh_hull(name: str, path: str, scale: float) -> Any:
    try:
        mesh = coal.MeshLoader().load(path, np.full(3, scale))
        mesh.buildConvexHull(True, "Qt")
    except (RuntimeError, ValueError) as error:
        raise SceneError(f"{name}: the mesh {path} cannot be read: {error}") from error
    return mesh.convex


def _hull_of_points(points: Sequence[Sequence[float]]) -> Any:
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(np.array(point, dtype=float))
    return coal.Convex.convexHull(corners, True, "Qt")


def hull_of(mesh: Mesh) -> tuple[list[list[float]], list[list[int]]]:
    """The convex hull that represents a mesh: its corners [m], and its triangles by corner numbers.

    Raises SceneError.
    """
    hull = _mesh_hull(mesh.path.name, str(mesh.path), mesh.scale)
    triangles = [[int(hull.polygons(i)[k]) for k in range(3)] for i in range(hull.num_polygons)]
    return hull.points().tolist(), triangles


def max_distance_of(name: str, obj: SceneObject) -> float:
    """Distance [m] of the farthest point of an attached object from the flange."""
    away = hypot(*obj.pose[:3])
    match obj.shape:
        case Box(size):
            return away + 0.5 * hypot(*size)
        case Sphere(radius):
            return away + radius
        case Cylinder(radius, length):
            return away + hypot(radius, 0.5 * length)
    hull = solid(name, obj)
    hull.computeLocalAABB()
    return away + float(np.linalg.norm(hull.aabb_center)) + float(hull.aabb_radius)
