"""Planes, boxes and spheres: penetration depth of a small ball, and the direction that leads out.

Lengths in m; poses are x, y, z and a rotation vector, in the base frame. All formulas are closed-form, without
iteration or libraries.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import isfinite, sqrt
from typing import Final

from emulator.motion.contact import Contact
from emulator.snapshot import plausible
from urproto.compat import StrEnum
from urproto.robots.pose import Pose, axes_of, pose_trans
from urproto.vectors import ZERO3, ZERO6, Axes, Vector3, Vector6, cross, dot, out_of, out_of6

_ALMOST = 1e-9
NEAR_M: Final = 0.05  # contacts are reported from this distance on: more than any tool moves in a period
_AT_TCP: Final = ZERO6
_CREEP_M_S: Final = 1e-3  # up to this sliding speed, friction is viscous; beyond, it is Coulomb friction (guess)
_ORIGIN: Final = ZERO6
_CORNERS_TO_A_FACE: Final = 4


class Frame(StrEnum):
    """Frame in which a wrench is given."""

    BASE = "base"
    TOOL = "tool"


@dataclass(slots=True)
class Push:
    """A force [N] and torque [Nm] at the TCP. ``duration_s``: None pushes until it is released.

    Raises ValueError for a wrench that is not finite or an invalid duration.
    """

    wrench: Vector6
    frame: Frame = Frame.BASE
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if len(self.wrench) != 6 or not plausible(*self.wrench):
            raise ValueError(f"a wrench must be six finite numbers, not {list(self.wrench)}")
        if self.duration_s is not None and not (isfinite(self.duration_s) and self.duration_s > 0.0):
            raise ValueError(f"a push must last longer than 0 s, not {self.duration_s}")

    def wrench_base(self, pose_base_tcp: Pose) -> Vector6:
        """The wrench in the axes of the base frame, for a TCP pose."""
        return self.wrench if self.frame is Frame.BASE else out_of6(axes_of(pose_base_tcp), self.wrench)

    def over(self, period_s: float) -> bool:
        """Advance one period; returns True if it was the last."""
        if self.duration_s is None:
            return False
        self.duration_s -= period_s
        return self.duration_s <= _ALMOST


def contacts(tool: "WorldObject", objects: "Iterable[WorldObject]", tcp: Pose, speed: Vector6) -> Iterator[Contact]:
    """Present and imminent contacts of the tool.

    ``tool``: its pose in the frame of the TCP; its material is ignored, that of the objects counts. ``tcp``: in the
    base frame, like ``speed``, of the TCP [m/s, rad/s]. Two boxes touch with their corners; crossing edges are not
    detected.
    """
    box = tool.mounted(tcp) if isinstance(tool.shape, Box) else None
    balls = (
        _tool_spheres(tool, tcp) if box is None else [(box.place(probe.centre), probe) for probe in box.shape.probes]
    )
    for obj in objects:
        for centre, probe in balls:
            yield from _contact(obj.touch(centre, probe.radius), centre, probe, (obj, 1.0), (tcp, speed))
        if box is not None:
            for probe in obj.shape.probes:
                centre = obj.place(probe.centre)
                yield from _contact(box.touch(centre, probe.radius), centre, probe, (obj, -1.0), (tcp, speed))


def _tool_spheres(tool: "WorldObject", tcp: Pose) -> "list[tuple[Vector3, Probe]]":
    """The parts of a round tool, in the base frame."""
    centre = (tcp[0], tcp[1], tcp[2]) if tool.pose == _AT_TCP else pose_trans(tcp, tool.pose)[:3]
    return [(centre, probe) for probe in tool.shape.probes]


def _contact(
    touch: "Touch", centre: Vector3, probe: "Probe", obj: "tuple[WorldObject, float]", tool: tuple[Pose, Vector6]
) -> Iterator[Contact]:
    """Contact of a probe in a solid. ``obj``: the object, and 1 if the probe is the tool's, else -1."""
    if touch.depth < -NEAR_M:
        return
    material, sign = obj
    tcp, speed = tool
    x, y, z = touch.out
    deepest = (centre[0] - x * probe.radius, centre[1] - y * probe.radius, centre[2] - z * probe.radius)
    lever = (deepest[0] - tcp[0], deepest[1] - tcp[1], deepest[2] - tcp[2])
    normal = (sign * x, sign * y, sign * z)
    stiffness, damping = material.stiffness * probe.share, material.damping * probe.share
    force, grip = force_of(touch.depth, normal, (stiffness, damping, material.friction), velocity_at(lever, speed))
    yield Contact(lever, normal, touch.depth, stiffness, damping, grip, force)


def velocity_at(lever: Vector3, speed: Vector6) -> Vector3:
    """Velocity of a point of a body, from the body's speed at another point."""
    turn = cross((speed[3], speed[4], speed[5]), lever)
    return (speed[0] + turn[0], speed[1] + turn[1], speed[2] + turn[2])


def force_of(
    depth: float, normal: Vector3, material: tuple[float, float, float], velocity: Vector3
) -> tuple[Vector3, float]:
    """Force [N] on a body that moves with ``velocity``, and its friction per sliding speed [N s/m].

    ``material``: stiffness, damping, coefficient of friction. A contact pushes, but never pulls.
    """
    if depth <= 0.0:
        return ZERO3, 0.0
    stiffness, damping, coefficient = material
    away = dot(normal, velocity)
    push = stiffness * depth - damping * away
    if push <= 0.0:
        return ZERO3, 0.0
    slide = tuple(v - away * n for v, n in zip(velocity, normal, strict=True))
    grip = coefficient * push / max(sqrt(dot(slide, slide)), _CREEP_M_S)
    x, y, z = (push * n - grip * v for n, v in zip(normal, slide, strict=True))
    return (x, y, z), grip


@dataclass(frozen=True, slots=True)
class Probe:
    """A small ball that represents part of a shape: centre in the shape's frame, radius, fraction of the stiffness."""

    centre: Vector3
    radius: float = 0.0
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Touch:
    """Penetration depth of a ball in a solid (negative: distance outside), and the unit vector that leads out."""

    depth: float
    out: Vector3


@dataclass(frozen=True, slots=True)
class Plane:
    """A half space: everything below the x-y plane of its pose is solid."""

    @property
    def probes(self) -> tuple[Probe, ...]:
        return ()

    def touch(self, point: Vector3, radius: float) -> Touch:
        """Contact with a ball. ``point``: its centre in the shape's frame, as for all shapes."""
        return Touch(radius - point[2], (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball around the origin of its pose. A radius of 0 is a point."""

    radius: float

    def __post_init__(self) -> None:
        if not (plausible(self.radius) and self.radius >= 0.0):
            raise ValueError(f"a sphere's radius must be a length [m], not {self.radius}")

    @property
    def probes(self) -> tuple[Probe, ...]:
        return (Probe(ZERO3, self.radius),)

    def touch(self, point: Vector3, radius: float) -> Touch:
        distance = sqrt(dot(point, point))
        return Touch(self.radius + radius - distance, _over(point, distance))


@dataclass(frozen=True, slots=True)
class Box:
    """A cuboid around the origin of its pose; ``size`` along x, y, z."""

    size: Vector3

    def __post_init__(self) -> None:
        if len(self.size) != 3 or not all(plausible(edge) and edge > 0.0 for edge in self.size):
            raise ValueError(f"a box's size must be three lengths greater than 0 [m], not {list(self.size)}")

    @property
    def probes(self) -> tuple[Probe, ...]:
        """The corners. Each has a quarter of the stiffness, so a box lying on a face is as stiff as a single point."""
        x, y, z = (0.5 * edge for edge in self.size)
        corners = product((-x, x), (-y, y), (-z, z))
        return tuple(Probe(corner, 0.0, 1.0 / _CORNERS_TO_A_FACE) for corner in corners)

    def touch(self, point: Vector3, radius: float) -> Touch:
        half = [0.5 * edge for edge in self.size]
        over = [abs(at) - most for at, most in zip(point, half, strict=True)]
        nearest = max(range(3), key=over.__getitem__)
        if over[nearest] <= 0.0:  # inside: out by the nearest face
            out = [0.0, 0.0, 0.0]
            out[nearest] = -1.0 if point[nearest] < 0.0 else 1.0
            return Touch(radius - over[nearest], (out[0], out[1], out[2]))
        x, y, z = (at - min(max(at, -most), most) for at, most in zip(point, half, strict=True))
        distance = sqrt(x * x + y * y + z * z)
        return Touch(radius - distance, _over((x, y, z), distance))


Shape = Plane | Box | Sphere


@dataclass(frozen=True)
class WorldObject:
    """A solid, fixed object.

    pose: in the base frame. stiffness [N/m] and damping [N s/m] along the normal of a contact. friction: Coulomb's
    coefficient. Raises ValueError for invalid values.
    """

    shape: Shape
    pose: Pose = _ORIGIN
    stiffness: float = 20_000.0  # a bench with a clamped plate (guess)
    damping: float = 200.0  # guess
    friction: float = 0.0
    axes: Axes = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.pose) != 6 or not plausible(*self.pose):
            raise ValueError(f"a pose must be six finite numbers, not {list(self.pose)}")
        for name, value, least in (("stiffness", self.stiffness, 1.0), ("damping", self.damping, 0.0)):
            if not least <= value <= 1e7:
                raise ValueError(f"the {name} must be from {least:g} to 1e7, not {value}")
        if not 0.0 <= self.friction <= 10.0:
            raise ValueError(f"the friction must be from 0 to 10, not {self.friction}")
        object.__setattr__(self, "axes", axes_of(self.pose))

    def at(self, pose: Sequence[float]) -> "WorldObject":
        """The same object at another pose."""
        x, y, z, rx, ry, rz = pose
        return replace(self, pose=(x, y, z, rx, ry, rz))

    def mounted(self, pose_base_tcp: Pose) -> "WorldObject":
        """The same object, with its pose given in the frame of the TCP, placed in the base frame."""
        return self.at(pose_trans(pose_base_tcp, self.pose))

    def touch(self, point: Vector3, radius: float) -> Touch:
        """Contact with a ball at a point of the base frame, with the outward direction in the base frame."""
        px, py, pz = self.pose[:3]
        arm = (point[0] - px, point[1] - py, point[2] - pz)
        x, y, z = self.axes
        touch = self.shape.touch((dot(arm, x), dot(arm, y), dot(arm, z)), radius)
        return Touch(touch.depth, out_of(self.axes, touch.out))

    def place(self, point: Vector3) -> Vector3:
        """A point of the shape's own frame, in the base frame."""
        x, y, z = out_of(self.axes, point)
        return (self.pose[0] + x, self.pose[1] + y, self.pose[2] + z)


def _over(v: Vector3, length: float) -> Vector3:
    """A unit vector; upwards if the vector has no direction."""
    return (v[0] / length, v[1] / length, v[2] / length) if length > 1e-12 else (0.0, 0.0, 1.0)
