"""The tool at the end of a control period, how it moves, and its sensors; all of it is computed when it is read."""

from typing import Final

from emulator.on_demand import on_demand
from emulator.robot.installation import Payload
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_trans
from urproto.vectors import ZERO3, ZERO6, Matrix3, Vector3, Vector6, add3, cross, rate, rotate, rotate_back, sub3


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


class FlangeSensors:
    """Readings in one control period, computed when they are read.

    payload: the true one. gravity: as in set_gravity, with the acceleration of the base [m/s2]. wrench: external, at
    the TCP, in base axes [N, Nm]; tcp_force: the same as the controller knows it, zeroed. in_flange: whether the
    controller reports it about the flange, as e-Series with their own sensor do.
    """

    def __init__(
        self, tool: ToolMotion, payload: Payload, gravity: Vector3, wrench: Vector6 = ZERO6, in_flange: bool = False
    ) -> None:
        self._tool, self._payload, self._gravity = tool, payload, gravity
        self._wrench, self._in_flange = wrench, in_flange
        self.tcp_force: Vector6 = ZERO6

    @on_demand
    def acceleration(self) -> Vector3:
        """The accelerometer's reading [m/s2]."""
        return rotate_back(self._tool.now.flange_axes, add3(self._tool.acceleration, self._gravity))

    @on_demand
    def force(self) -> Vector6:
        """The external wrench as the controller reports it, in base axes."""
        force, now = self.tcp_force, self._tool.now
        if not self._in_flange or force == ZERO6 or now.tcp_offset == ZERO6:
            return force
        torque = add3(force[3:], cross(sub3(now.pose, now.flange_pose), force))
        return (force[0], force[1], force[2], *torque)

    @on_demand
    def raw_wrench(self) -> Vector6:
        """The sensor's own reading, with the payload's weight, in the flange's axes."""
        if self._wrench == ZERO6 and not self._payload.mass:
            return ZERO6
        now = self._tool.now
        axes, weight = now.flange_axes, weight_of(self._payload, now.flange_axes, self._gravity)
        force = rotate_back(axes, self._wrench)
        lever = rotate_back(axes, sub3(now.pose, now.flange_pose))
        torque = add3(rotate_back(axes, self._wrench[3:]), add3(cross(lever, force), cross(self._payload.cog, weight)))
        return (*add3(force, weight), *torque)


def weight_of(payload: Payload, axes: Matrix3, gravity: Vector3) -> Vector3:
    """Weight of a payload in the flange's axes [N]."""
    return rotate_back(axes, (-payload.mass * gravity[0], -payload.mass * gravity[1], -payload.mass * gravity[2]))


def weight_difference(now: ToolState, mounted: Payload, known: Payload, gravity: Vector3) -> Vector6:
    """Weight of the mounted payload minus that of the known one, as a wrench at the TCP in base axes [N, Nm]."""
    axes = now.flange_axes
    true, assumed = weight_of(mounted, axes, gravity), weight_of(known, axes, gravity)
    lever = rotate_back(axes, sub3(now.flange_pose, now.pose))
    torque = sub3(cross(add3(lever, mounted.cog), true), cross(add3(lever, known.cog), assumed))
    return (*rotate(axes, sub3(true, assumed)), *rotate(axes, torque))
