"""Simplified shapes of an arm's links.

One capsule per link is used for contacts of an emulated arm, descriptions and drawings. Its radius is that of the
housing of the link's first joint; the real tube between the joints is a fifth thinner, and the capsule's ends protrude.

Up to three cylinders per link are used to keep clear of an arm: they contain all of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Final

from urproto.robots.calibration import chain_of
from urproto.robots.model import RobotModel, Span
from urproto.vectors import ZERO3, Vector3, add3, scaled3

_MIN_LENGTH_M: Final = 0.01

Segment = tuple[Vector3, Vector3]


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
