"""Whether parts of the arm touch each other: capsules around its links, in plain floats.

A real controller does not look after this but for the flange and the lower arm (`emulator.safety.geometry`); its
joints notice the contact. So the check is off unless asked for, and stands for what the joints would notice.

The links lie where the Denavit-Hartenberg parameters put their axes, the upper arm beside the arm's plane by d4, which
is within 6 mm of the shoulder offset of the vendor's description. Radii are guesses, from pictures.
"""

from dataclasses import dataclass
from math import cos, sin
from typing import Final

from urproto.robots.model import Joints, RobotModel
from urproto.vectors import ZERO3, Vector3, add3, dot, sub3


@dataclass(frozen=True, slots=True)
class Capsule:
    """A segment and what is within ``radius`` of it [m]."""

    a: Vector3
    b: Vector3
    radius: float


# base, upper arm, lower arm, wrist 1, wrist 2, wrist 3 with flange; neighbours touch always
_PAIRS: Final = ((0, 2), (0, 3), (0, 4), (0, 5), (1, 3), (1, 4), (1, 5), (2, 5))


class SelfCollision:
    """The least clearance between links that are no neighbours."""

    def __init__(self, model: RobotModel) -> None:
        self._d1, _, _, self._d4, self._d5, self._d6 = model.dh.d
        _, self._a2, self._a3, _, _, _ = model.dh.a
        tube = 0.035 + 0.03 * model.reach_m
        self._radii = (1.2 * tube, tube, 0.85 * tube, 0.75 * tube, 0.75 * tube, 0.6 * tube)

    def capsules(self, q: Joints) -> tuple[Capsule, ...]:
        """The links in the base frame, from base to flange."""
        q1, q2, q3, q4, q5, _ = q
        s1, c1 = sin(q1), cos(q1)
        s5, c5 = sin(q5), cos(q5)
        s, c = sin(q2 + q3 + q4), cos(q2 + q3 + q4)
        side = (s1 * self._d4, -c1 * self._d4, 0.0)
        shoulder = (0.0, 0.0, self._d1)
        elbow = add3(shoulder, (c1 * cos(q2) * self._a2, s1 * cos(q2) * self._a2, sin(q2) * self._a2))
        along = self._a3 * cos(q2 + q3)
        wrist = add3(elbow, (c1 * along, s1 * along, self._a3 * sin(q2 + q3)))
        w1 = add3(wrist, side)
        w2 = add3(w1, (c1 * s * self._d5, s1 * s * self._d5, -c * self._d5))
        z6 = (-c1 * c * s5 + s1 * c5, -s1 * c * s5 - c1 * c5, -s * s5)
        flange = add3(w2, (z6[0] * self._d6, z6[1] * self._d6, z6[2] * self._d6))
        ends = (
            (ZERO3, shoulder),
            (add3(shoulder, side), add3(elbow, side)),
            (elbow, wrist),
            (wrist, w1),
            (w1, w2),
            (w2, flange),
        )
        return tuple(Capsule(a, b, radius) for (a, b), radius in zip(ends, self._radii, strict=True))

    def clearance(self, q: Joints) -> float:
        """The least distance between surfaces [m]; negative where they overlap."""
        links = self.capsules(q)
        return min(clearance(links[one], links[other]) for one, other in _PAIRS)


def clearance(one: Capsule, other: Capsule) -> float:
    """Distance between the surfaces of two capsules [m]; negative by how deep they overlap."""
    return _segment_distance(one.a, one.b, other.a, other.b) - one.radius - other.radius


def _segment_distance(p1: Vector3, q1: Vector3, p2: Vector3, q2: Vector3) -> float:
    """Least distance of two segments: nearest points of the lines, brought back to the ends one after the other."""
    d1, d2, r = sub3(q1, p1), sub3(q2, p2), sub3(p1, p2)
    a, e, f, c, b = dot(d1, d1), dot(d2, d2), dot(d2, r), dot(d1, r), dot(d1, d2)
    denominator = a * e - b * b
    s = _share((b * f - c * e) / denominator) if denominator > 1e-12 * a * e and denominator > 0.0 else 0.0
    t = (b * s + f) / e if e > 0.0 else -1.0  # a point: as beyond the end
    if not 0.0 <= t <= 1.0:
        t = _share(t)
        s = _share((b * t - c) / a) if a > 0.0 else 0.0
    gap = (
        r[0] + d1[0] * s - d2[0] * t,
        r[1] + d1[1] * s - d2[1] * t,
        r[2] + d1[2] * s - d2[2] * t,
    )
    length: float = dot(gap, gap) ** 0.5
    return length


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))
