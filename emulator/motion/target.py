"""Where the arm is told to be: the target of the present control period, which controllers publish as target_q."""

from math import inf

from emulator.motion.reach import Reach
from urproto.robots.calibrated import kinematics_of
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six, scaled, sub


class ArmTarget:
    """Target angles, speeds and accelerations of the joints [rad, rad/s, rad/s2], and the arm that is to get there.

    All parts of `Motion` read it. Only `Motion` changes it, once a period.
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.model = model
        self.period_s = period_s
        self.q: Joints = as_six(q)
        self.qd: Joints = ZERO6
        self.qdd: Joints = ZERO6
        self.standing_s = inf  # for how long it has stood
        self._kinematics = kinematics_of(model)
        self.reach = Reach(model, self._kinematics, ZERO6)  # with the TCP of new movements

    def use_tcp(self, offset: Pose) -> None:
        """Flange to TCP. Movements in progress keep the `Reach` that they began with, so this makes another one."""
        if as_six(offset) != self.reach.tcp_offset:
            self.reach = Reach(self.model, self._kinematics, as_six(offset))

    def advance(self, q: Joints, *, standing: bool) -> None:
        """One period later, the target is q.

        ``standing``: the arm has arrived in this period. The speed is then 0 and not the last bit of way over the
        period, since nothing would take it to 0 afterwards.
        """
        qd = ZERO6 if standing else scaled(sub(q, self.q), 1.0 / self.period_s)
        self.qdd = scaled(sub(qd, self.qd), 1.0 / self.period_s)
        self.q, self.qd = q, qd
        self.standing_s = self.standing_s + self.period_s if qd == ZERO6 else 0.0

    def rest(self) -> bool:
        """One period later, nothing has moved it. False when it is not at rest: `advance` has to say where it is."""
        if self.qd != ZERO6 or self.qdd != ZERO6:
            return False
        self.standing_s += self.period_s
        return True

    def put(self, q: Joints) -> None:
        """The arm is elsewhere, and stands there as before."""
        self.q = q

    def halt(self) -> None:
        """Stand still at once."""
        self.qd = self.qdd = ZERO6
