"""Upper bounds of how fast the arm's parts move, which take less time than the speeds themselves."""

from math import hypot, inf

from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six


class MotionBounds:
    """No part of an ideal arm is faster than ``speed`` [m/s], nor its momentum larger than ``momentum`` [kg m/s].

    The bounds grow by the most that a period may have added, until somebody needs to know better and calls `lower`.
    """

    def __init__(self, model: RobotModel) -> None:
        self.speed = self.momentum = inf
        self._radii = radii(model)
        self._arm_kg = sum(link.mass_kg for link in model.links)
        self._mass = self._arm_kg
        self._tcp_offset: Pose | None = None
        self._levers = self._radii
        self._qd = ZERO6
        self._joint_speed = 0.0  # the sum of all joints'
        self._growth = 0.0  # of the speed in the last period

    def load(self, payload_kg: float) -> None:
        """The arm carries something else from the next period on."""
        self._mass = self._arm_kg + payload_kg
        self.momentum = inf

    def advance(self, qd: Joints, tcp_offset: Pose, period_s: float) -> None:
        """The arm has moved for a period, at these joint speeds."""
        before, self._qd = self._qd, qd
        if qd == ZERO6:
            self.speed = self.momentum = self._joint_speed = self._growth = 0.0
            return
        if tcp_offset is not self._tcp_offset:
            self._tcp_offset = tcp_offset
            length = hypot(*tcp_offset[:3])
            a, b, c, d, e, f = self._radii
            self._levers = a + length, b + length, c + length, d + length, e + length, f + length
            self.speed = inf
        u, v, w, x, y, z = qd
        joint_speed = abs(u) + abs(v) + abs(w) + abs(x) + abs(y) + abs(z)
        a, b, c, d, e, f = self._levers
        o, p, q, r, s, t = before
        # joints change their speeds, and turn the parts that move: their speeds change by the product of both turns
        turn = max(joint_speed, self._joint_speed)
        self._growth = growth = (
            a * abs(u - o)
            + b * abs(v - p)
            + c * abs(w - q)
            + d * abs(x - r)
            + e * abs(y - s)
            + f * abs(z - t)
            + turn * turn * a * period_s
        )
        self._joint_speed = joint_speed
        self.speed += growth
        self.momentum += growth * self._mass

    def lower(self, speed: float, momentum: float) -> None:
        """These are the largest of the speeds, as averages over the last period, and the momentum after it."""
        self.speed, self.momentum = speed + self._growth, momentum


def radii(model: RobotModel) -> Joints:
    """Upper bound of the distance from each joint's axis to any part of the arm beyond it [m]."""
    dh = model.dh
    lengths = [hypot(a, d) for a, d in zip(dh.a, dh.d, strict=True)]
    return as_six(sum(lengths[max(joint, 1) :]) for joint in range(6))
