"""The collision model of a scene, in two layers of detail, and the pairs of bodies that may not touch.

In the coarse layer, each link is one capsule; in the fine layer, it is the cylinders of the arm's data file, which
contain all of the real link. Most links are far from everything most of the time, which one check of the capsule shows.
"""

from collections.abc import Iterator, Sequence
from math import hypot
from typing import Any, Final

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from client.planning.scene import LINKS, PlanningScene
from client.planning.solids import (
    at,
    capsule_around,
    extent_of,
    max_distance_of,
    placed,
    placed_capsule,
    placed_cylinder,
    solid,
)
from urproto.robots.calibration import Chain, chain_of
from urproto.robots.shapes import Capsule, capsules, cylinders
from urproto.vectors import ZERO3

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
        """Add the same geometry to both layers."""
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
