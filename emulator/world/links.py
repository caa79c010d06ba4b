"""The arm's own links among the things of a world: capsules, whose touch is felt in the joints alone.

Upper arm, forearm, wrist 1 and wrist 2. The base stands where it stands, and wrist 3 belongs to the tool. Axes are
those of the model's geometry; radii are guesses. A link's contact is no wrench at the TCP: the joints before it carry
it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import cos, hypot, sin
from operator import mul
from typing import Any, Final

import coal
import numpy as np

from emulator.world.shapes import Box, Shape, Sphere, WorldObject, force_of
from urproto.robots import RobotModel
from urproto.robots.kinematics import Kinematics
from urproto.robots.shapes import tube_radius, wrist_radius
from urproto.vectors import ZERO6, Vector3, Vector6, cross, lerp, unit

_CARRYING: Final = (2, 3, 4, 5)  # how many joints carry each link
_X: Final[Vector3] = (1.0, 0.0, 0.0)
_Y: Final[Vector3] = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Touching:
    """A link in a thing: ``carrying`` joints carry the link; point and normal (the way out) in the base frame [m]."""

    carrying: int
    thing: WorldObject
    depth: float
    point: Vector3
    normal: Vector3


class Links:
    """The capsules of one arm and what they can meet."""

    def __init__(self, model: RobotModel) -> None:
        self._dh = model.dh
        self._kinematics = Kinematics(model.dh)
        self._beside = (model.links[1].com_m[2], model.links[2].com_m[2])  # of the tubes, from the arm's plane [m]
        tube, wrist = tube_radius(model), wrist_radius(model)
        lengths = [hypot(*(b - a for a, b in zip(*ends, strict=True))) for ends in self.axes((0.0,) * 6)]
        self.radii = (tube, tube, wrist, wrist)
        self._capsules = [coal.Capsule(radius, length) for radius, length in zip(self.radii, lengths, strict=True)]
        self._things: list[tuple[WorldObject, Any, Any]] = []
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def surround(self, things: Iterable[WorldObject]) -> None:
        """These are what the links can meet from now on."""
        self._things = [(thing, _geometry(thing.shape), _placement(thing)) for thing in things]

    def axes(self, q: Sequence[float]) -> tuple[tuple[Vector3, Vector3], ...]:
        """Both ends of each capsule's axis, in the base frame [m]."""
        q1, q2, q3, q4, _, _ = q
        s1, c1, (upper, fore) = sin(q1), cos(q1), self._beside

        def at(start: Vector3, angle: float, length: float) -> Vector3:
            along = length * cos(angle)
            return (start[0] + c1 * along, start[1] + s1 * along, start[2] + length * sin(angle))

        def aside(start: Vector3, distance: float) -> Vector3:
            return (start[0] + s1 * distance, start[1] - c1 * distance, start[2])

        shoulder = (0.0, 0.0, self._dh.d[0])
        elbow = at(shoulder, q2, self._dh.a[1])
        wrist = at(elbow, q2 + q3, self._dh.a[2])
        hand, down = aside(wrist, self._dh.d[3]), q2 + q3 + q4
        x, z = self._dh.d[4] * sin(down), -self._dh.d[4] * cos(down)
        return (
            (aside(shoulder, upper), aside(elbow, upper)),
            (aside(elbow, fore), aside(wrist, fore)),
            (aside(wrist, fore), hand),
            (hand, (hand[0] + c1 * x, hand[1] + s1 * x, hand[2] + z)),
        )

    def touches(self, q: Vector6) -> Iterator[Touching]:
        """Where links are in things."""
        if not self._things:
            return
        for carrying, capsule, (start, end) in zip(_CARRYING, self._capsules, self.axes(q), strict=True):
            placement = _along(start, end)
            for thing, geometry, place in self._things:
                self._result.clear()
                distance = coal.distance(capsule, placement, geometry, place, self._request, self._result)
                if distance < 0.0:
                    px, py, pz = self._result.getNearestPoint1().tolist()
                    nx, ny, nz = self._result.normal.tolist()
                    yield Touching(carrying, thing, -distance, (px, py, pz), (-nx, -ny, -nz))

    def torques(self, q: Vector6, qd: Vector6) -> Vector6:
        """What the things do to the joints by touching links [Nm]."""
        total = ZERO6
        for touching in self.touches(q):
            total = lerp(total, self._torque(touching, q, qd), 1.0)
        return total

    def _torque(self, at: Touching, q: Vector6, qd: Vector6) -> Vector6:
        rows = self._kinematics.jacobian_at(q, (*at.point, 0.0, 0.0, 0.0))[:3]
        vx, vy, vz = (float(sum(map(mul, row[: at.carrying], qd))) for row in rows)
        material = (at.thing.stiffness, at.thing.damping, at.thing.friction)
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


def _placement(thing: WorldObject) -> Any:
    return coal.Transform3s(np.array(thing.axes).T, np.array(thing.pose[:3]))


def _along(start: Vector3, end: Vector3) -> Any:
    """A frame half way between two points, z pointing from one to the other."""
    z = unit((end[0] - start[0], end[1] - start[1], end[2] - start[2]), (0.0, 0.0, 1.0))
    x = unit(cross(_Y if abs(z[0]) > abs(z[1]) else _X, z), _X)
    middle = [0.5 * (a + b) for a, b in zip(start, end, strict=True)]
    return coal.Transform3s(np.array((x, cross(z, x), z)).T, np.array(middle))
