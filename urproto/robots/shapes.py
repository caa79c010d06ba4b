"""Shapes of an arm's links, simplified for collisions, and generated from its model for pictures.

One capsule per link is used for contacts of an emulated arm, descriptions and drawings. Its radius is that of the
housing of the link's first joint; the real tube between the joints is a fifth thinner, and the capsule's ends protrude.

Up to three cylinders per link are used to keep clear of an arm: they contain all of it.

Pictures show housings at the joints, tubes between them, caps and a flange, each a solid of revolution. The positions
where housings meet and the lengths of the tubes follow from the model, and the radii are measured; rims, caps and
colours are invented (guess: similar to photographs).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import Final

from urproto.robots.calibration import chain_of
from urproto.robots.model import RobotModel, Span
from urproto.vectors import ZERO3, Vector3, add3, scaled3

_MIN_LENGTH_M: Final = 0.01

Segment = tuple[Vector3, Vector3]

_LIGHT: Final = "#d9dde1"  # housings and tubes
_DARK: Final = "#59636c"  # rims, foot and flange
_BLUE: Final = "#5b9bc9"  # caps

_Y: Final[Vector3] = (0.0, 1.0, 0.0)
_Z: Final[Vector3] = (0.0, 0.0, 1.0)
_NEGATIVE_Y: Final[Vector3] = (0.0, -1.0, 0.0)
_NEGATIVE_Z: Final[Vector3] = (0.0, 0.0, -1.0)

_ROUNDING: Final = 0.12  # of a radius
_ARC_STEPS: Final = 3  # in a rounded edge
_RIM: Final = 0.07  # of a radius: half the width of the dark ring between two joints
_TUBE_RATIOS: Final = (0.80, 0.80)  # of the joints' radii: upper arm, forearm

Profile = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Capsule:
    """A capsule, with the ends of its axis in the frame that moves with the link [m]."""

    start: Vector3
    end: Vector3
    radius: float


def capsules(model: RobotModel) -> tuple[Capsule, ...]:
    """The capsules of base, shoulder, upper arm, forearm, wrist 1, 2 and 3 in the frames of ur_description's links."""
    shoulder, elbow, wrist, _ = model.housing_radii
    d1, _, _, d4, d5, d6 = model.dh.d
    upper, fore = (link.tube_height for link in model.cylinders[2:4])
    return (
        Capsule(ZERO3, (0.0, 0.0, d1 / 2), shoulder),
        Capsule((0.0, 0.0, -d1 / 2), ZERO3, shoulder),
        Capsule((0.0, 0.0, upper), (model.dh.a[1], 0.0, upper), shoulder),
        Capsule((0.0, 0.0, fore), (model.dh.a[2], 0.0, fore), elbow),
        Capsule((0.0, 0.0, fore - d4), ZERO3, wrist),
        Capsule((0.0, 0.0, -d5), ZERO3, wrist),
        Capsule((0.0, 0.0, min(-wrist, _MIN_LENGTH_M - d6)), (0.0, 0.0, -wrist), wrist),
    )


@dataclass(frozen=True, slots=True)
class LinkCylinder:
    """A cylinder, with the centres of its flat ends in the frame that moves with the link [m]."""

    start: Vector3
    end: Vector3
    radius: float


def cylinders(model: RobotModel) -> tuple[tuple[LinkCylinder, ...], ...]:
    """The cylinders of base, shoulder, upper arm, forearm, wrist 1, 2 and 3, in the frames of `capsules`; see
    `LinkCylinders`."""
    chain = chain_of(model.dh)
    found = []
    for number, link in enumerate(model.cylinders):
        parts = [_along(link.joint, ZERO3, (0.0, 0.0, 1.0))]
        if link.tube is not None:
            parts.append(_along(link.tube, (0.0, 0.0, link.tube_height), (-1.0, 0.0, 0.0)))
        if link.next is not None:
            after = chain[number]
            parts.append(_along(link.next, after.position, (after.axes[2], after.axes[5], after.axes[8])))
        found.append(tuple(parts))
    return tuple(found)


def _along(span: Span, start: Vector3, axis: Vector3) -> LinkCylinder:
    return LinkCylinder(add3(start, scaled3(axis, span.low)), add3(start, scaled3(axis, span.high)), span.radius)


class ArmCapsules:
    """The capsules of a nominal arm in its base frame: base, upper arm, forearm, wrist 1, 2 and 3.

    radii: of each [m].
    """

    def __init__(self, model: RobotModel) -> None:
        self._d1, _, _, self._d4, self._d5, self._d6 = model.dh.d
        _, self._a2, self._a3, _, _, _ = model.dh.a
        self._upper, self._fore = (link.tube_height for link in model.cylinders[2:4])
        shoulder, elbow, wrist, _ = model.housing_radii
        self.radii = (shoulder, shoulder, elbow, wrist, wrist, wrist)

    def axes(self, q_rad: Sequence[float]) -> tuple[Segment, Segment, Segment, Segment, Segment, Segment]:
        """Both ends of each capsule's axis [m]; that of wrist 3 ends inside its capsule, at the flange."""
        q1, q2, q3, q4, q5, _ = q_rad
        s1, c1, s5, c5 = sin(q1), cos(q1), sin(q5), cos(q5)

        def at(start: Vector3, angle: float, length: float) -> Vector3:
            along = length * cos(angle)
            return (start[0] + c1 * along, start[1] + s1 * along, start[2] + length * sin(angle))

        def aside(start: Vector3, distance: float) -> Vector3:
            return (start[0] + s1 * distance, start[1] - c1 * distance, start[2])

        shoulder = (0.0, 0.0, self._d1)
        elbow = at(shoulder, q2, self._a2)
        wrist = at(elbow, q2 + q3, self._a3)
        first = aside(wrist, self._d4)
        s, c = sin(q2 + q3 + q4), cos(q2 + q3 + q4)
        second = add3(first, (c1 * s * self._d5, s1 * s * self._d5, -c * self._d5))
        ahead = self._d6
        flange = add3(second, ((s1 * c5 - c1 * c * s5) * ahead, (-c1 * c5 - s1 * c * s5) * ahead, -s * s5 * ahead))
        return (
            (ZERO3, shoulder),
            (aside(shoulder, self._upper), aside(elbow, self._upper)),
            (aside(elbow, self._fore), aside(wrist, self._fore)),
            (aside(wrist, self._fore), first),
            (first, second),
            (second, flange),
        )


@dataclass(frozen=True, slots=True)
class Part:
    """A solid of revolution. profile: (radius, distance along the axis) [m]; starts and ends with radius 0.

    origin, axis: in the frame that rotates with the link, like the link frames of ur_description.
    """

    profile: Profile
    origin: Vector3
    axis: Vector3
    color: str


def link_parts(model: RobotModel) -> tuple[tuple[Part, ...], ...]:
    """The parts of base, shoulder, upper arm, forearm, wrist 1, 2 and 3."""
    return _Arm(model).links()


class _Arm:
    """Radii of the joints' housings and of the foot [m], and where the housings end.

    half: half of the distance from the plane of the upper arm to that of the forearm; the housings of the elbow meet
    there.
    """

    def __init__(self, model: RobotModel) -> None:
        self.d1, _, _, self.d4, self.d5, self.d6 = model.dh.d
        self.a2, self.a3 = model.dh.a[1:3]
        self.upper, self.fore = model.tube_offsets
        self.half = (self.upper - self.fore) / 2
        self.wrist_1 = (self.d4 - self.fore) / 2  # half of the distance from forearm to wrist 1
        self.shoulder, self.elbow, self.wrist, self.foot = model.housing_radii
        self.plate = min(max(self.d6 - self.wrist, 0.3 * self.wrist), 1.2 * self.wrist)  # thickness of wrist 3

    def links(self) -> tuple[tuple[Part, ...], ...]:
        return (
            self._base(),
            self._shoulder(),
            self._upper_arm(),
            self._forearm(),
            self._first_wrist(),
            self._second_wrist(),
            self._third_wrist(),
        )

    @property
    def _shoulder_height(self) -> float:
        """The height of the joint between base and shoulder above the table."""
        return max(self.d1 - 1.05 * self.shoulder, 0.35 * self.shoulder)

    def _base(self) -> tuple[Part, ...]:
        radius, top = self.shoulder, self._shoulder_height
        plate = min(0.3 * radius, 0.5 * top)
        return (
            _drum(self.foot, 0.0, plate, _DARK),
            _drum((radius + self.foot) / 2, 0.4 * plate, top, _LIGHT),
            _rim(radius, top),
        )

    def _shoulder(self) -> tuple[Part, ...]:
        radius = self.shoulder
        inner = self.upper - self.half  # the joint with the upper arm
        return (
            _drum(radius, self._shoulder_height - self.d1, 0.0, _LIGHT),
            *_housing(radius, -1.05 * radius, inner, _NEGATIVE_Y, caps=(True, False)),
            _rim(radius, inner, _NEGATIVE_Y),
        )

    def _upper_arm(self) -> tuple[Part, ...]:
        half, z, length = self.half, self.upper, abs(self.a2)
        end_position: Vector3 = (self.a2, 0.0, 0.0)
        tube = (_TUBE_RATIOS[0] * self.shoulder, _TUBE_RATIOS[0] * (self.shoulder + self.elbow) / 2)
        return (
            *_housing(self.shoulder, z - half, z + 1.05 * self.shoulder, _Z, caps=(False, True)),
            *_tube(*tube, length, (0.0, 0.0, z), self.shoulder),
            *_housing(self.elbow, z - half, z + 1.05 * self.elbow, _Z, end_position, caps=(False, True)),
            _rim(self.elbow, z - half, _Z, end_position),
        )

    def _forearm(self) -> tuple[Part, ...]:
        radius, z, length = self.elbow, self.fore, abs(self.a3)
        end_position: Vector3 = (self.a3, 0.0, 0.0)
        outer = z + self.wrist_1
        return (
            *_housing(radius, -z - self.half, 1.05 * radius - z, _NEGATIVE_Z, caps=(False, True)),
            *_tube(_TUBE_RATIOS[1] * radius, 0.86 * self.wrist, length, (0.0, 0.0, z), radius),
            *_housing(self.wrist, -outer, 1.1 * self.wrist - z, _NEGATIVE_Z, end_position, caps=(False, True)),
            _rim(self.wrist, outer, _Z, end_position),
        )

    def _first_wrist(self) -> tuple[Part, ...]:
        radius, seam = self.wrist, self.d5 / 2
        return (
            *_housing(radius, -self.wrist_1, 1.15 * radius, _Z, caps=(False, True)),
            _drum(radius, 0.0, seam, _LIGHT, axis=_NEGATIVE_Y),
            _rim(radius, seam, _NEGATIVE_Y),
        )

    def _second_wrist(self) -> tuple[Part, ...]:
        radius = self.wrist
        return (
            *_housing(radius, -self.d5 / 2, 1.15 * radius, _Z, caps=(False, True)),
            _drum(0.94 * radius, 0.0, self.d6 - self.plate, _LIGHT, axis=_Y),
        )

    def _third_wrist(self) -> tuple[Part, ...]:
        radius, plate = self.wrist, self.plate
        key_radius = 0.17 * radius
        return (
            _drum(0.94 * radius, -plate, -0.25 * plate, _LIGHT),
            _drum(0.84 * radius, -0.25 * plate, 0.0, _DARK),
            _drum(key_radius, 0.85 * radius, 1.06 * radius, _DARK, (0.0, 0.0, -0.6 * plate), _Y),
        )


def _housing(
    radius: float, start: float, end: float, axis: Vector3, origin: Vector3 = ZERO3, *, caps: tuple[bool, bool]
) -> tuple[Part, ...]:
    """A drum with blue caps on one side or both."""
    cap = 0.22 * radius
    low, high = start + cap * caps[0], end - cap * caps[1]
    parts = [_drum(radius, low, high, _LIGHT, origin, axis)]
    if caps[0]:
        parts.append(Part(_dome(radius, low, -cap), origin, axis, _BLUE))
    if caps[1]:
        parts.append(Part(_dome(radius, high, cap), origin, axis, _BLUE))
    return tuple(parts)


def _tube(first: float, last: float, length: float, origin: Vector3, housing: float) -> tuple[Part, ...]:
    """A tube from one housing to the next, along -x, the direction of a model's link lengths."""
    axis: Vector3 = (-1.0, 0.0, 0.0)
    collar = min(1.12 * housing, 0.3 * length)
    return (
        Part(((0.0, 0.0), (first, 0.0), (last, length), (0.0, length)), origin, axis, _LIGHT),
        _drum(1.06 * first, 0.5 * collar, collar, _LIGHT, origin, axis),
    )


def _rim(radius: float, position: float, axis: Vector3 = _Z, origin: Vector3 = ZERO3) -> Part:
    """The dark ring between two links."""
    half = _RIM * radius
    return _drum(1.015 * radius, position - half, position + half, _DARK, origin, axis, rounding=0.0)


def _drum(
    radius: float,
    start: float,
    end: float,
    color: str,
    origin: Vector3 = ZERO3,
    axis: Vector3 = _Z,
    *,
    rounding: float = _ROUNDING,
) -> Part:
    edge = min(rounding * radius, 0.5 * (end - start))
    return Part(_rounded(radius, start, end, edge), origin, axis, color)


def _rounded(radius: float, start: float, end: float, edge: float) -> Profile:
    if edge <= 0.0:
        return ((0.0, start), (radius, start), (radius, end), (0.0, end))
    inner = radius - edge
    return (
        (0.0, start),
        *_arc(inner, start + edge, edge, edge, -pi / 2, 0.0),
        *_arc(inner, end - edge, edge, edge, 0.0, pi / 2),
        (0.0, end),
    )


def _dome(radius: float, position: float, height: float) -> Profile:
    """A cap, slightly narrower than its housing, that bulges by ``height``, which may be negative."""
    edge, lid = 0.35 * radius, 0.96 * radius
    arc: Sequence[tuple[float, float]] = (
        *_arc(lid - edge, position, edge, height, 0.0, pi / 2),
        (0.0, position + 1.06 * height),
    )
    return ((0.0, position), *arc) if height > 0 else (*reversed(arc), (0.0, position))


def _arc(r: float, z: float, width: float, height: float, start: float, end: float) -> tuple[tuple[float, float], ...]:
    angles = (start + (end - start) * i / _ARC_STEPS for i in range(_ARC_STEPS + 1))
    return tuple((r + width * cos(angle), z + height * sin(angle)) for angle in angles)
