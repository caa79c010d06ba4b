"""The distance of an arm from itself and its surroundings by its URDF, as other programs read it.

Pinocchio's parser builds the arm from it, with ur_description's meshes if available, and coal measures geometries that
are built here: neither the project's checker nor its kinematics is involved.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from client.planning import Box, Plane, PlanningScene, Sphere
from urproto.robots.description import urdf

_LINKS = ("base_link_inertia", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link",
          "wrist_3_link")  # fmt: skip
# disable_collisions of ur_moveit_config's SRDF
_NEVER = {(i, i + 1) for i in range(6)} | {(4, 6)}
_PASSING = {(0, 2), (3, 5)}  # a few millimetres apart when they pass each other, in any plan
_MOVED = range(2, 7)


class Described:
    """meshes: a folder, as in `urdf`; None for simple shapes."""

    def __init__(self, scene: PlanningScene, meshes: Path | None = None) -> None:
        text = urdf(scene.model, meshes=meshes)
        self._arm = pin.buildModelFromXML(text)
        self._solids = pin.buildGeomFromUrdfString(self._arm, text, pin.GeometryType.VISUAL)
        own = {name: [self._solids.getGeometryId(g.name) for g in self._solids.geometryObjects
                      if self._arm.frames[g.parentFrame].name == name] for name in _LINKS}  # fmt: skip
        self.names: list[tuple[str, str]] = []
        self._padding_m = scene.padding_m
        base, tip = (self._arm.getFrameId(name) for name in ("base", "tool0"))
        obstacles, carried = {}, {}
        for name, obj in scene.objects.items():
            frame = self._arm.frames[tip if obj.attached else base]
            x, y, z, *turn = obj.pose
            place = frame.placement * pin.SE3(pin.exp3(np.array(turn)), np.array((x, y, z)))
            solid = pin.GeometryObject(name, frame.parentJoint, place, _solid(obj.shape))
            (carried if obj.attached else obstacles)[name] = [self._solids.addGeometryObject(solid)]
        for i, one in enumerate(_LINKS):
            for j, other in enumerate(_LINKS[i + 1 :], i + 1):
                if (i, j) not in _NEVER:
                    self._pair(one, own[one], other, own[other])
        for name, numbers in (obstacles | carried).items():
            for i in _MOVED if name in obstacles else range(4):
                self._pair(_LINKS[i], own[_LINKS[i]], name, numbers)
        for name, numbers in carried.items():
            for other, others in obstacles.items():
                self._pair(name, numbers, other, others)
        self._data, self._solids_data = self._arm.createData(), self._solids.createData()

    def _pair(self, one: str, first: Sequence[int], other: str, second: Sequence[int]) -> None:
        for a in first:
            for b in second:
                self._solids.addCollisionPair(pin.CollisionPair(a, b))
                self.names.append((one, other))

    def beyond_padding(self, q_rad: Sequence[float]) -> float:
        """How far the nearest pair is beyond the padding [m]; links next to each other must only not touch."""
        passing = {(_LINKS[i], _LINKS[j]) for i, j in _PASSING}
        return min(far - (0.0 if pair in passing else self._padding_m) for pair, far in self(q_rad).items())

    def __call__(self, q_rad: Sequence[float]) -> dict[tuple[str, str], float]:
        """The distance of each pair [m]; negative where they penetrate."""
        parts: list[float] = []
        for joint, angle in zip(self._arm.joints[1:], q_rad, strict=True):
            parts += [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        pin.computeDistances(self._arm, self._data, self._solids, self._solids_data, np.array(parts))
        found: dict[tuple[str, str], float] = {}
        for pair, result in zip(self.names, self._solids_data.distanceResults, strict=True):
            found[pair] = min(found.get(pair, np.inf), result.min_distance)
        return found


def _solid(shape: Any) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    assert isinstance(shape, Plane)
    return coal.Halfspace(np.array((0.0, 0.0, 1.0)), 0.0)
