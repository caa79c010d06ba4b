"""The arm's target in the present control period, which controllers publish as target_q."""

from math import inf

from emulator.motion.reach import Reach
from urproto.robots.calibrated import kinematics_of
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six, scaled_sub


class ArmTarget:
    """Target angles, speeds and accelerations of the joints [rad, rad/s, rad/s2], and the arm that follows them.

    All parts of `Motion` read it. Only `Motion` changes it, once a period.
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.model = model
        self.period_s = period_s
        self.q: Joints = as_six(q)
        self.qd: Joints = ZERO6
        self.qdd: Joints = ZERO6
        self.standing_s = inf  # time since the arm came to rest
        self._kinematics = kinematics_of(model)
        self.reach = Reach(model, self._kinematics, ZERO6)  # with the TCP of new movements

    def use_tcp(self, offset: Pose) -> None:
        """Set the TCP, relative to the flange. Movements in progress keep their `Reach`, so this creates a new one."""
        if as_six(offset) != self.reach.tcp_offset:
            self.reach = Reach(self.model, self._kinematics, as_six(offset))

    def advance(self, q: Joints, *, standing: bool) -> None:
        """Advance one period, to target q.

        ``standing``: the arm has arrived in this period. The speed is then 0 and not the last displacement over the
        period, because nothing would set it to 0 afterwards.
        """
        qd = ZERO6 if standing else scaled_sub(q, self.q, 1.0 / self.period_s)
        self.qdd = scaled_sub(qd, self.qd, 1.0 / self.period_s)
        self.q, self.qd = q, qd
        self.standing_s = self.standing_s + self.period_s if qd == ZERO6 else 0.0

    def rest(self) -> bool:
        """Advance one period at rest. Returns False if the arm is not at rest: `advance` has to be used then."""
        if self.qd != ZERO6 or self.qdd != ZERO6:
            return False
        self.standing_s += self.period_s
        return True

    def put(self, q: Joints) -> None:
        """Place the arm elsewhere; it stands still as before."""
        self.q = q

    def halt(self) -> None:
        self.qd = self.qdd = ZERO6
