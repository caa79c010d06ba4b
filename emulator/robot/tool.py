"""The tool at the end of a control period, and how it moves; all of it is computed when it is read."""

from typing import Final

from emulator.on_demand import on_demand
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_trans
from urproto.vectors import ZERO3, ZERO6, Matrix3, Vector3, Vector6, rate, sub3


class ToolState:
    """Pose and speed of the TCP and position of the elbow, in the base frame, at these joint angles and speeds."""

    def __init__(
        self, kinematics: Kinematics, elbow_offset_m: float, q: Vector6, qd: Vector6, tcp_offset: Pose
    ) -> None:
        self.q: Final = q
        self.qd: Final = qd
        self.tcp_offset: Final = tcp_offset
        self._kinematics = kinematics
        self._elbow_offset = elbow_offset_m

    @on_demand
    def _flange(self) -> tuple[Vector3, Matrix3]:
        return self._kinematics.flange_axes(self.q)

    @property
    def flange_axes(self) -> Matrix3:
        """Axes of the tool flange, row by row."""
        return self._flange[1]

    @on_demand
    def flange_pose(self) -> Pose:
        """Pose of the tool flange."""
        (x, y, z), axes = self._flange
        return (x, y, z, *matrix_to_rotvec(axes))

    @on_demand
    def pose(self) -> Pose:
        """Pose of the TCP."""
        return self.flange_pose if self.tcp_offset == ZERO6 else pose_trans(self.flange_pose, self.tcp_offset)

    @on_demand
    def speed(self) -> Vector6:
        """Velocity of the TCP [m/s, rad/s]."""
        return ZERO6 if self.qd == ZERO6 else self._kinematics.twist_at(self.q, self.qd, self.pose)

    @on_demand
    def elbow_position(self) -> Vector3:
        """Position of the elbow that the controller monitors."""
        return self._kinematics.elbow_position(self.q, self._elbow_offset)


class ToolMotion:
    """The tool now, and its change since the period before. before: now, where nothing earlier is known."""

    def __init__(self, now: ToolState, before: ToolState, period_s: float) -> None:
        self.now: Final = now
        self.before: Final = before
        self._period_s = period_s

    @property
    def settled(self) -> bool:
        """Whether the tool neither accelerates, nor did in this period."""
        now, before = self.now, self.before
        return now.qd == before.qd and (now.qd == ZERO6 or now.q == before.q)

    @on_demand
    def acceleration(self) -> Vector6:
        """Acceleration of the TCP [m/s2, rad/s2]."""
        now, before = self.now.speed, self.before.speed
        return ZERO6 if now == before else rate(now, before, self._period_s)

    @on_demand
    def elbow_velocity(self) -> Vector3:
        """Velocity of the elbow [m/s]."""
        if self.now.qd == ZERO6:
            return ZERO3
        x, y, z = sub3(self.now.elbow_position, self.before.elbow_position)
        return (x / self._period_s, y / self._period_s, z / self._period_s)
