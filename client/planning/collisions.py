"""Whether an arm touches anything, and how far it is from it: by Pinocchio and coal, one capsule a link.

A motion between two joint configurations is free where its whole length is shown to be: at each place looked at, the
distance of each pair says how far the arm may go on before that pair needs another look. However thin a thing is, it
is not missed; and what is far away is looked at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any, Final

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from client.errors import SceneError
from client.planning.scene import LINKS, Box, Cylinder, Hull, Mesh, Plane, PlanningScene, SceneObject, Sphere
from urproto.joints import JOINT_LABELS
from urproto.robots.calibration import chain_of
from urproto.robots.pose import Pose, rotvec_to_matrix
from urproto.robots.shapes import Capsule, capsules
from urproto.vectors import ZERO3, Vector3, dot, sub3
from urscript.polyscope.safety_configuration import elbow_radius

# of the links: neighbours touch always, and so do the base and the upper arm, the forearm and wrist 2, wrist 1 and 3
_BESIDE: Final = 3
_OWN_PAIRS: Final = tuple((i, j) for i in range(7) for j in range(i + 2, 7) if j - i >= _BESIDE or (i, j) == (1, 3))
_MOVED: Final = range(2, 7)  # the links that things are kept from: the base stands, the shoulder turns on the spot
_FINEST_M: Final = 0.001
_SHORTEST_M: Final = 1e-9
_ELBOW: Final = 3  # the joint whose axis the elbow is on
_POINT_M: Final = 0.001  # radius of what has none
_Vector = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Nearness:
    """Two things, links or objects, and how far they are apart [m]; negative: how deep one is in the other.

    point: the middle between their nearest points [m], in the base frame. normal: from one towards the other.
    """

    one: str
    other: str
    distance_m: float
    point: Vector3 = ZERO3
    normal: Vector3 = ZERO3

    def __str__(self) -> str:
        if self.distance_m < 0.0:
            return f"{self.one} is {-1000 * self.distance_m:.1f} mm deep in {self.other}"
        return f"{self.one} is {1000 * self.distance_m:.1f} mm from {self.other}"


class CollisionChecker:
    """Of a scene as it is when it is asked."""

    def __init__(self, scene: PlanningScene) -> None:
        self.scene = scene
        self._revision = -1
        self._low, self._high = (np.array(limits) for limits in scene.model.position_limits)
        self._build()

    def is_free(self, q_rad: Sequence[float] | _Vector) -> bool:
        """Whether the arm is within its limits, and nothing nearer than the padding."""
        self._follow()
        q = np.asarray(q_rad, dtype=float)
        if (q < self._low).any() or (q > self._high).any():
            return False
        return not pin.computeCollisions(self._arm, self._data, self._geometry, self._geometry_data, q, True)

    def clearance(self, q_rad: Sequence[float] | _Vector) -> float:
        """The least distance of any pair that may not touch [m]; infinite when there is none."""
        self._follow()
        q = np.asarray(q_rad, dtype=float)
        nearest = pin.computeDistances(self._arm, self._data, self._geometry, self._geometry_data, q)
        results = self._geometry_data.distanceResults
        return float(results[nearest].min_distance) if nearest < len(results) else float("inf")

    def nearest(self, q_rad: Sequence[float]) -> list[Nearness]:
        """All pairs that may not touch, nearest first."""
        self.clearance(q_rad)
        results = self._geometry_data.distanceResults
        pairs = [_nearness(names, result) for names, result in zip(self._pairs, results, strict=True)]
        return sorted(pairs, key=lambda pair: pair.distance_m)

    def collisions(self, q_rad: Sequence[float]) -> list[Nearness]:
        """Pairs that are nearer than the padding, deepest first."""
        return [pair for pair in self.nearest(q_rad) if pair.distance_m < self.scene.padding_m]

    def objection(self, q_rad: Sequence[float]) -> str:
        """Why the arm may not be there; nothing for a free place."""
        q = np.asarray(q_rad, dtype=float)
        for name, low, angle, high in zip(JOINT_LABELS, self._low, q, self._high, strict=True):
            if not low <= angle <= high:
                return f"{name} is at {angle:.4f} rad, its limits are {low:.4f} and {high:.4f} rad"
        pairs = self.collisions(q_rad)
        kept = f", and {1000 * self.scene.padding_m:g} mm are to be kept"
        return "; ".join(map(str, pairs[:3])) + kept if pairs else ""

    def way_is_free(self, start_rad: Sequence[float] | _Vector, end_rad: Sequence[float] | _Vector) -> bool:
        """Whether the arm may go straight, in joint space, from one configuration to another."""
        start, end = np.asarray(start_rad, dtype=float), np.asarray(end_rad, dtype=float)
        way = end - start
        return self.is_free(end) and self.blocked_at(lambda share: start + share * way, abs(way)) is None

    def blocked_at(self, path: Callable[[float], _Vector], travel_rad: _Vector) -> float | None:
        """Where on a path something is too near, as a share of it from 0 to 1; None for a free one.

        travel_rad: how far each joint goes at most (6,) if the whole path is as fast as its fastest place. It is some
        such place, not the first.
        """
        self._follow()
        padding = self.scene.padding_m
        lengths = np.maximum(self._levers @ travel_rad, _SHORTEST_M).tolist()  # that the two of a pair go at most
        finest = _FINEST_M / max(lengths, default=_FINEST_M)
        parts = [(0.0, 1.0, list(range(len(lengths))))]
        while parts:
            low, high, pairs = parts.pop()
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            pin.updateGeometryPlacements(self._arm, self._data, self._geometry, self._geometry_data, path(middle))
            known, near = half, list[int]()  # how far the path is known to be free, and of which pairs no farther
            for pair in pairs:
                distance: float = pin.computeDistance(self._geometry, self._geometry_data, pair).min_distance
                if distance < padding:
                    return middle
                if (share := max((distance - padding) / lengths[pair], finest)) < half:
                    known = min(known, share)
                    near.append(pair)
            if near:
                parts += ((middle + known, high, near), (low, middle - known, near))
        return None

    # the model

    def _follow(self) -> None:
        if self._revision != self.scene.revision:
            self._build()

    def _build(self) -> None:
        scene = self.scene
        model = scene.model
        self._arm, self._geometry = pin.Model(), pin.GeometryModel()
        self._pairs: list[tuple[str, str]] = []
        self._solids: list[tuple[int, float]] = []  # what each moves with, and how far it goes from that joint [m]
        parts = capsules(model)
        own = [self._add(LINKS[0], 0, *_capsule(parts[0]))]
        joint = 0
        self._chain = chain_of(model.dh if model.calibration is None else model.calibration)
        for number, frame in enumerate(self._chain):
            placement = pin.SE3(np.array(frame.axes).reshape(3, 3), np.array(frame.position))
            joint = self._arm.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{number}")
            part = parts[number + 1]
            extent_m = max(hypot(*part.start), hypot(*part.end)) + part.radius
            own.append(self._add(LINKS[number + 1], joint, *_capsule(part), extent_m))
        carried, around = {}, {}
        for name, thing in scene.objects.items():
            if thing.attached:
                placement, solid = _placement(thing.pose), _solid(name, thing)
                carried[name] = self._add(name, joint, placement, solid, _extent(name, thing))
            else:
                around[name] = self._add(name, 0, _placement(thing.pose), _solid(name, thing))
        for i, j in _OWN_PAIRS:
            self._pair(LINKS[i], own[i], LINKS[j], own[j])
        for name, number in around.items():
            for i in _MOVED:
                self._pair(LINKS[i], own[i], name, number)
            for other, held in carried.items():
                self._pair(other, held, name, number)
        for name, number in carried.items():
            for i in range(4):  # wrist 2 and 3 are where it is mounted; wrist 1 is next to them
                self._pair(LINKS[i], own[i], name, number)
        self._add_safety(joint)
        self._data, self._geometry_data = self._arm.createData(), self._geometry.createData()
        for request in self._geometry_data.collisionRequests:
            request.security_margin = scene.padding_m
        chosen = [(self._solids[pair.first], self._solids[pair.second]) for pair in self._geometry.collisionPairs]
        self._levers = np.array([self._lever(*solids) for solids in chosen]).reshape(-1, 6)
        self._revision = scene.revision

    def _add(self, name: str, joint: int, placement: Any, shape: Any, extent_m: float = 0.0) -> int:
        self._solids.append((joint, extent_m))
        return int(self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape)))

    def _add_safety(self, last: int) -> None:
        """The planes, and balls for what they restrict, which meet nothing else."""
        safety = self.scene.safety
        if safety is None:
            return
        x, y, z, *_ = safety.tcp_offset
        spheres = [("the TCP", (x, y, z), _POINT_M)]
        spheres += [
            (f"tool sphere {n}", s.centre, s.radius) for n, s in enumerate(safety.configuration.tool_spheres, 1)
        ]
        balls = [
            (name, self._add(name, last, _at(centre), coal.Sphere(radius), hypot(*centre) + radius))
            for name, centre, radius in spheres
        ]
        radius = max(_POINT_M, elbow_radius(self.scene.model))
        elbow = ("the elbow", self._add("the elbow", _ELBOW, _at(ZERO3), coal.Sphere(radius), radius))
        for plane in safety.planes:
            name = f"safety plane {plane.name}"
            solid = coal.Halfspace(np.array(plane.normal), -plane.distance)  # beyond it
            number = self._add(name, 0, _at(ZERO3), solid)
            for one, first in [*balls, elbow] if plane.elbow else balls:
                self._pair(one, first, name, number)

    def _pair(self, one: str, first: int, other: str, second: int) -> None:
        if not self.scene.allows(one, other):
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
            self._pairs.append((one, other))

    def _lever(self, one: tuple[int, float], other: tuple[int, float]) -> _Vector:
        """How far any point of one is from the axis of each joint at most that moves it as seen from the other [m]."""
        (inner, _), (outer, far) = sorted((one, other))
        lever = np.zeros(6)
        for joint in range(outer, inner, -1):
            lever[joint - 1] = far
            far += hypot(*self._chain[joint - 1].position)
        return lever


def _nearness(names: tuple[str, str], result: Any) -> Nearness:
    x, y, z = 0.5 * (result.getNearestPoint1() + result.getNearestPoint2())
    u, v, w = result.normal
    return Nearness(*names, float(result.min_distance), (float(x), float(y), float(z)), (float(u), float(v), float(w)))


def _capsule(part: Capsule) -> tuple[Any, Any]:
    along = sub3(part.end, part.start)
    length = sqrt(dot(along, along))
    z = np.array((0.0, 0.0, 1.0))
    turn = pin.Quaternion.FromTwoVectors(z, np.array(along) / length if length else z)
    middle = 0.5 * (np.array(part.start) + np.array(part.end))
    return pin.SE3(turn.matrix(), middle), coal.Capsule(part.radius, length)


def _at(place: Vector3) -> Any:
    return _placement((*place, 0.0, 0.0, 0.0))


def _placement(pose: Pose) -> Any:
    return pin.SE3(np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3), np.array(pose[:3]))


def _solid(name: str, thing: SceneObject) -> Any:
    match thing.shape:
        case Box(size):
            return coal.Box(*size)
        case Sphere(radius):
            return coal.Sphere(radius)
        case Cylinder(radius, length):
            return coal.Cylinder(radius, length)
        case Plane():
            return coal.Halfspace(np.array((0.0, 0.0, 1.0)), 0.0)
        case Mesh(path, scale):
            return _hull(name, str(path), scale)
        case Hull(points):
            return _around(points)
    raise SceneError(f"{name} has a shape that is not known")


def _hull(name: str, path: str, scale: float) -> Any:
    try:
        mesh = coal.MeshLoader().load(path, np.full(3, scale))
        mesh.buildConvexHull(True, "Qt")
    except (RuntimeError, ValueError) as error:
        raise SceneError(f"{name}: {path} is not a mesh that can be read: {error}") from error
    return mesh.convex


def _around(points: Sequence[Sequence[float]]) -> Any:
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(np.array(point, dtype=float))
    return coal.Convex.convexHull(corners, True, "Qt")


def hull_of(mesh: Mesh) -> tuple[list[list[float]], list[list[int]]]:
    """What of a mesh is kept clear of: the corners of its convex hull [m], and its triangles by the corners' numbers.

    Raises SceneError.
    """
    hull = _hull(mesh.path.name, str(mesh.path), mesh.scale)
    triangles = [[int(hull.polygons(i)[k]) for k in range(3)] for i in range(hull.num_polygons)]
    return hull.points().tolist(), triangles


def _extent(name: str, thing: SceneObject) -> float:
    """How far its farthest point is from the flange [m]."""
    away = hypot(*thing.pose[:3])
    match thing.shape:
        case Box(size):
            return away + 0.5 * hypot(*size)
        case Sphere(radius):
            return away + radius
        case Cylinder(radius, length):
            return away + hypot(radius, 0.5 * length)
    hull = _solid(name, thing)
    hull.computeLocalAABB()
    return away + float(np.linalg.norm(hull.aabb_center)) + float(hull.aabb_radius)
