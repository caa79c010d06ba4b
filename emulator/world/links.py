"""Contacts of the arm's links with objects and with each other, using the capsules of `urproto.robots.shapes`.

Upper arm, forearm, wrist 1 and wrist 2 can touch objects: the base does not move, and wrist 3 belongs to the tool. A
link's contact is not a wrench at the TCP: it acts on the joints before the link.

A real controller does not monitor links touching each other, except for the flange and the lower arm
(`emulator.safety.geometry`); its joints detect the contact. That check is therefore off unless enabled, and represents
what the joints would detect.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import dist
from operator import mul
from typing import Any, Final

import coal
import numpy as np

from emulator.world.shapes import Box, Shape, Sphere, WorldObject, force_of
from urproto.robots import RobotModel
from urproto.robots.kinematics import Kinematics
from urproto.robots.shapes import ArmCapsules
from urproto.vectors import ZERO6, Vector3, Vector6, cross, lerp, unit

_CARRIED: Final = (1, 2, 3, 4)  # capsules that objects can touch; each is carried by this many joints plus one
# base, upper arm, forearm, wrist 1, 2 and 3; neighbours always touch
_PAIRS: Final = ((0, 2), (0, 3), (0, 4), (0, 5), (1, 3), (1, 4), (1, 5), (2, 5))
_X: Final[Vector3] = (1.0, 0.0, 0.0)
_Y: Final[Vector3] = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Touching:
    """A link in an object: ``carrying`` joints carry the link; point and outward normal in the base frame [m]."""

    carrying: int
    obj: WorldObject
    depth: float
    point: Vector3
    normal: Vector3


class Links:
    """The capsules of one arm and the objects they can touch."""

    def __init__(self, model: RobotModel) -> None:
        self._kinematics = Kinematics(model.dh)
        self._arm = ArmCapsules(model)
        lengths = [dist(*ends) for ends in self._arm.axes(ZERO6)]
        self._capsules = [coal.Capsule(radius, length) for radius, length in zip(self._arm.radii, lengths, strict=True)]
        self._objects: list[tuple[WorldObject, Any, Any]] = []
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def surround(self, objects: Iterable[WorldObject]) -> None:
        """Set the objects that the links can touch."""
        self._objects = [(obj, _geometry(obj.shape), _placement(obj)) for obj in objects]

    def clearance(self, q: Sequence[float]) -> float:
        """Smallest distance between the surfaces of links that are not neighbours [m]; negative if they overlap."""
        placed = [(capsule, _along(*ends)) for capsule, ends in zip(self._capsules, self._arm.axes(q), strict=True)]
        return min(self._distance(*placed[one], *placed[other]) for one, other in _PAIRS)

    def _distance(self, one: Any, at: Any, other: Any, there: Any) -> float:
        self._result.clear()
        distance: float = coal.distance(one, at, other, there, self._request, self._result)
        return distance

    def touches(self, q: Vector6) -> Iterator[Touching]:
        """Contacts of links with objects."""
        if not self._objects:
            return
        axes = self._arm.axes(q)
        for link in _CARRIED:
            placement = _along(*axes[link])
            for obj, geometry, place in self._objects:
                distance = self._distance(self._capsules[link], placement, geometry, place)
                if distance < 0.0:
                    px, py, pz = self._result.getNearestPoint1().tolist()
                    nx, ny, nz = self._result.normal.tolist()
                    yield Touching(link + 1, obj, -distance, (px, py, pz), (-nx, -ny, -nz))

    def torques(self, q: Vector6, qd: Vector6) -> Vector6:
        """Joint torques by contacts of the links [Nm]."""
        total = ZERO6
        for touching in self.touches(q):
            total = lerp(total, self._torque(touching, q, qd), 1.0)
        return total

    def _torque(self, at: Touching, q: Vector6, qd: Vector6) -> Vector6:
        rows = self._kinematics.jacobian_at(q, (*at.point, 0.0, 0.0, 0.0))[:3]
        vx, vy, vz = (float(sum(map(mul, row[: at.carrying], qd))) for row in rows)
        material = (at.obj.stiffness, at.obj.damping, at.obj.friction)
        force, _ = force_of(at.depth, at.normal, material, (vx, vy, vz))
        torques = [float(sum(row[i] * part for row, part in zip(rows, force, strict=True))) for i in range(at.carrying)]
        a, b, c, d, e, f = (*torques, *ZERO6)[:6]
        return (a, b, c, d, e, f)


def _geometry(shape: Shape) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    return coal.Halfspace(np.array((0.0, 0.0, 1.0)), 0.0)


def _placement(obj: WorldObject) -> Any:
    return coal.Transform3s(np.array(obj.axes).T, np.array(obj.pose[:3]))


def _along(start: Vector3, end: Vector3) -> Any:
    """A frame halfway between two points, with z pointing from one to the other."""
    z = unit((end[0] - start[0], end[1] - start[1], end[2] - start[2]), (0.0, 0.0, 1.0))
    x = unit(cross(_Y if abs(z[0]) > abs(z[1]) else _X, z), _X)
    middle = [0.5 * (a + b) for a, b in zip(start, end, strict=True)]
    return coal.Transform3s(np.array((x, cross(z, x), z)).T, np.array(middle))
