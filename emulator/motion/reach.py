"""The arm as the generators see it: limits, and the way between joints and tool poses."""

from math import cos, pi, tau

from emulator.motion.faults import unreachable
from emulator.motion.vectors import Joints, as_six
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import RobotModel
from urproto.robots.pose import Pose, pose_inv, pose_trans

__all__ = ["Reach"]


class Reach:
    """One arm with one TCP. A movement keeps the one it was planned with."""

    def __init__(self, model: RobotModel, kinematics: Kinematics, tcp_offset: Pose) -> None:
        self.model = model
        self.kinematics = kinematics
        self.tcp_offset = tcp_offset
        self._tcp_inverse = pose_inv(tcp_offset)

    def pose(self, q_rad: Joints) -> Pose:
        """TCP in the base frame."""
        return self.kinematics.forward(q_rad, self.tcp_offset)

    def joints(self, pose_base_tcp: Pose, q_near_rad: Joints) -> Joints:
        """The joint configuration for a TCP pose that continues q_near. Raises MotionFault when out of reach.

        Position limits play no part: a path is followed by continuity, and limits are judged every step.
        """
        flange = pose_trans(pose_base_tcp, self._tcp_inverse)
        solutions = self.kinematics.inverse_all(flange, q_near_rad)
        if not solutions:
            raise unreachable(pose_base_tcp)
        return _turned_near(min(solutions, key=lambda solution: _apart(solution, q_near_rad)), q_near_rad)

    def twist(self, q_rad: Joints, qd_rad_s: Joints) -> Joints:
        """TCP velocity in the base frame: m/s, rad/s."""
        rows = self.kinematics.jacobian(q_rad, self.tcp_offset)
        return as_six(sum(row[i] * qd_rad_s[i] for i in range(6)) for row in rows)


def _apart(a: Joints, b: Joints) -> float:
    """Grows with the distance of two configurations, whole turns aside."""
    return -(
        cos(a[0] - b[0]) + cos(a[1] - b[1]) + cos(a[2] - b[2]) + cos(a[3] - b[3]) + cos(a[4] - b[4]) + cos(a[5] - b[5])
    )


def _turned_near(angles: Joints, near: Joints) -> Joints:
    """Each angle by whole turns to within half a turn of near."""
    if all(-pi < angle - wanted <= pi for angle, wanted in zip(angles, near, strict=True)):
        return angles
    return as_six(angle + tau * round((wanted - angle) / tau) for angle, wanted in zip(angles, near, strict=True))
