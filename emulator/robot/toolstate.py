"""Where tool and elbow are and how they move, from joint angles and speeds."""

from emulator.robot.vectors import ZERO6, Rows, minus3, rate6, times6
from emulator.snapshot import Vector3, Vector6
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import Pose, pose_trans

__all__ = ["ToolState"]


class ToolState:
    """Poses, speeds and accelerations of the TCP in the base frame; the elbow's position and velocity."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self.flange_pose: Pose = ZERO6
        self.pose: Pose = ZERO6
        self.speed: Vector6 = ZERO6
        self.acceleration: Vector6 = ZERO6
        self.elbow_position: Vector3 = (0.0, 0.0, 0.0)
        self.elbow_velocity: Vector3 = (0.0, 0.0, 0.0)

    def update(self, q: Vector6, qd: Vector6, tcp_offset: Pose, period_s: float, *, started: bool) -> Rows:
        """One period later; the Jacobian at the TCP. ``started``: nothing was known before."""
        self.flange_pose = self._kinematics.forward(q)
        self.pose = self.flange_pose if tcp_offset == ZERO6 else pose_trans(self.flange_pose, tcp_offset)
        jacobian = self._kinematics.jacobian_at(q, self.pose)
        speed = times6(jacobian, qd) if qd != ZERO6 else ZERO6
        changing = speed != self.speed and not started
        self.acceleration = rate6(speed, self.speed, period_s) if changing else ZERO6
        self.speed = speed
        self._update_elbow(q, period_s, moving=qd != ZERO6 and not started)
        return jacobian

    def _update_elbow(self, q: Vector6, period_s: float, *, moving: bool) -> None:
        position = self._kinematics.elbow_position(q)
        x, y, z = minus3(position, self.elbow_position)
        self.elbow_velocity = (x / period_s, y / period_s, z / period_s) if moving else (0.0, 0.0, 0.0)
        self.elbow_position = position
