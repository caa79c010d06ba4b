"""The collision model of a scene as coal geometries, in two layers of detail, and its pairs of bodies to check.

In the coarse layer, each link is one capsule; in the fine layer, it is the cylinders of the arm's data file, which
contain all of the real link. Most links are far from everything most of the time, which one check of the capsule shows.
"""

from collections.abc import Iterator, Sequence
from math import cos, hypot, pi, sin, sqrt
from typing import Any, Final

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from client.errors import SceneError
from client.planning.scene import LINKS, Box, Cylinder, Hull, Mesh, Plane, PlanningScene, SceneObject, Sphere
from urproto.robots.calibration import Chain, chain_of
from urproto.robots.pose import Pose, rotvec_to_matrix
from urproto.robots.shapes import Capsule, LinkCylinder, capsules, cylinders
from urproto.vectors import ZERO3, Vector3, add3, cross, dot, scaled3, sub3, unit

_Vector = npt.NDArray[np.float64]

# Neighbouring links, base and upper arm, forearm and wrist 2, wrist 1 and wrist 3 are next to each other and cannot
# collide, as ur_description's meshes show.
_MIN_SEPARATION: Final = 3
SELF_COLLISION_PAIRS: Final = tuple(
    (i, j) for i in range(7) for j in range(i + 2, 7) if j - i >= _MIN_SEPARATION or (i, j) in ((1, 3), (2, 4))
)
"""Pairs of links that could collide, by their numbers in `LINKS`."""

# Checked against the objects of the scene: the base does not move, and the shoulder only turns on the spot.
_MOVING_LINKS: Final = range(2, 7)
_ARM_LINKS: Final = range(4)  # checked against attached objects, which are mounted at the wrists
_ELBOW: Final = 3  # the joint whose axis the elbow is on
_POINT_M: Final = 0.001  # radius of a sphere that stands for a point
_RIM_CORNERS: Final = 24  # corners of a polygon around a cylinder's end


def placed_capsule(part: Capsule) -> tuple[Any, Any]:
    placement, length = _axis_frame(part.start, part.end)
    return placement, coal.Capsule(part.radius, length)


def placed_cylinder(part: LinkCylinder) -> tuple[Any, Any]:
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
    along, there = sub3(end, start), sub3(point, start)
    share = max(0.0, min(1.0, dot(there, along) / dot(along, along)))
    return hypot(*sub3(there, scaled3(along, share)))


def at(place: Vector3) -> Any:
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


class GeometryLayer:
    """Geometries, and pairs of them that may not touch.

    names: of the two bodies of each pair. levers: (pairs, 6) [m], for each joint that moves one body relative to the
    other, the largest distance of a point of that body from the joint's axis.
    """

    def __init__(self, arm: Any, chain: Chain) -> None:
        self._arm = arm
        self._chain = chain
        self.geometry = pin.GeometryModel()
        self.names: list[tuple[str, str]] = []
        self._moved: list[tuple[int, float]] = []  # of each geometry: the joint it moves with, its extent [m]

    def add(self, joint: int, placement: Any, shape: Any, extent_m: float = 0.0) -> int:
        """Add a geometry that moves with a joint, 0 for none; return its number. extent_m: distance of its farthest
        point.
        """
        self._moved.append((joint, extent_m))
        name = str(len(self._moved))
        return int(self.geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape)))

    def pair(self, one: str, first: int, other: str, second: int) -> int:
        """Add a pair that may not touch; return its number."""
        self.geometry.addCollisionPair(pin.CollisionPair(first, second))
        self.names.append((one, other))
        return len(self.names) - 1

    def prepare(self, data: Any, padding_m: float) -> None:
        """Prepare for queries; nothing can be added afterwards."""
        self._joints = data
        self.data = self.geometry.createData()
        for request in self.data.collisionRequests:
            request.security_margin = padding_m
        self._results = list(self.data.collisionResults)  # updated in place
        moved = [(self._moved[pair.first], self._moved[pair.second]) for pair in self.geometry.collisionPairs]
        self.levers = np.array([self._lever_arms(*two) for two in moved]).reshape(-1, 6)

    def move(self, q_rad: _Vector) -> None:
        """Place all geometries for a configuration (6,) [rad]."""
        pin.updateGeometryPlacements(self._arm, self._joints, self.geometry, self.data, q_rad)

    def distance(self, pair: int) -> float:
        """The distance [m] of a pair as placed by `move`; if negative, the penetration depth."""
        found: float = pin.computeDistance(self.geometry, self.data, pair).min_distance
        return found

    def in_collision(self, pair: int) -> bool:
        """Whether a pair, as placed by `move`, is nearer than the padding."""
        return bool(pin.computeCollision(self.geometry, self.data, pair))

    def colliding_pairs(self, q_rad: _Vector) -> list[int]:
        """The pairs that are nearer than the padding in a configuration (6,) [rad]."""
        if not pin.computeCollisions(self._arm, self._joints, self.geometry, self.data, q_rad, False):
            return []
        return [pair for pair, result in enumerate(self._results) if result.isCollision()]

    def distances(self, q_rad: _Vector) -> Sequence[Any]:
        """coal's result for each pair in a configuration (6,) [rad]."""
        pin.computeDistances(self._arm, self._joints, self.geometry, self.data, q_rad)
        results: Sequence[Any] = self.data.distanceResults
        return results

    def _lever_arms(self, one: tuple[int, float], other: tuple[int, float]) -> _Vector:
        (inner, _), (outer, far) = sorted((one, other))
        lever = np.zeros(6)
        for joint in range(outer, inner, -1):
            lever[joint - 1] = far
            far += hypot(*self._chain[joint - 1].position)
        return lever


class CollisionModel:
    """The collision model of a scene as it is now. parts: for each pair of the coarse layer, its pairs of the fine
    layer.
    """

    def __init__(self, scene: PlanningScene) -> None:
        self._scene = scene
        model = scene.model
        chain = chain_of(model.dh if model.calibration is None else model.calibration)
        arm, joint = pin.Model(), 0
        for number, frame in enumerate(chain):
            placement = pin.SE3(np.array(frame.axes).reshape(3, 3), np.array(frame.position))
            joint = arm.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{number}")
        self.coarse, self.fine = GeometryLayer(arm, chain), GeometryLayer(arm, chain)
        self.parts: list[list[int]] = []
        self._solids: dict[str, tuple[int, list[int]]] = {}  # numbers in both layers, by name
        self._add_links()
        self._add_objects()
        self._add_safety()
        data = arm.createData()
        self.coarse.prepare(data, scene.padding_m)
        self.fine.prepare(data, scene.padding_m)

    def _add_links(self) -> None:
        model = self._scene.model
        for number, (old, parts) in enumerate(zip(capsules(model), cylinders(model), strict=True)):
            capsule = old
            if tube := model.cylinders[number].tube:
                height = model.cylinders[number].tube_height
                capsule = Capsule((-tube.low, 0.0, height), (-tube.high, 0.0, height), 0.0)
            capsule = capsule_around(capsule.start, capsule.end, parts)
            fine = [self.fine.add(number, *placed_cylinder(part), extent_of(part)) for part in parts]
            self._solids[LINKS[number]] = (
                self.coarse.add(number, *placed_capsule(capsule), extent_of(capsule)),
                fine,
            )
        for i, j in SELF_COLLISION_PAIRS:
            self._pair(LINKS[i], LINKS[j])

    def _add_objects(self) -> None:
        objects = self._scene.objects
        carried = [name for name, obj in objects.items() if obj.attached]
        for name, obj in objects.items():
            extent_m = max_distance_of(name, obj) if obj.attached else 0.0
            self._add(name, 6 if obj.attached else 0, placed(obj.pose), solid(name, obj), extent_m)
        for name in objects:
            if name in carried:
                for i in _ARM_LINKS:
                    self._pair(LINKS[i], name)
                continue
            for i in _MOVING_LINKS:
                self._pair(LINKS[i], name)
            for other in carried:
                self._pair(other, name)

    def _add_safety(self) -> None:
        """Add the safety planes, and spheres for the points they restrict, which are paired with nothing else."""
        safety = self._scene.safety
        if safety is None:
            return
        x, y, z, *_ = safety.tcp_offset
        balls = [("the TCP", (x, y, z), _POINT_M)]
        balls += [(f"tool sphere {n}", s.centre, s.radius) for n, s in enumerate(safety.configuration.tool_spheres, 1)]
        for name, centre, radius in balls:
            self._add(name, 6, at(centre), coal.Sphere(radius), hypot(*centre) + radius)
        model = self._scene.model
        radius, offset = max(_POINT_M, model.elbow_radius), model.elbow_offset
        self._add("the elbow", _ELBOW, at((0.0, 0.0, offset)), coal.Sphere(radius), offset + radius)
        for plane in safety.planes:
            name = f"safety plane {plane.name}"
            self._add(name, 0, at(ZERO3), coal.Halfspace(np.array(plane.normal), -plane.distance))  # the forbidden side
            for ball, _, _ in balls:
                self._pair(ball, name)
            if plane.elbow:
                self._pair("the elbow", name)

    def _add(self, name: str, joint: int, placement: Any, shape: Any, extent_m: float = 0.0) -> None:
        given = (joint, placement, shape, extent_m)
        self._solids[name] = (self.coarse.add(*given), [self.fine.add(*given)])

    def _pair(self, one: str, other: str) -> None:
        if self._scene.allows(one, other):
            return
        (first, firsts), (second, seconds) = self._solids[one], self._solids[other]
        self.coarse.pair(one, first, other, second)
        self.parts.append([self.fine.pair(one, a, other, b) for a in firsts for b in seconds])

    def fine_pairs(self, pairs: Sequence[int]) -> Iterator[int]:
        """The pairs of the fine layer that belong to these pairs of the coarse one."""
        for pair in pairs:
            yield from self.parts[pair]
