"""The ideal arm: it is where it is told to be, and feels what physics says it must.

Actual equals target exactly. Joint torques come from the rigid-body model (gravity,
inertia, payload, external wrench; no friction), currents from the torques by one constant
a joint, the TCP force is the external wrench itself. Nothing is recomputed while neither
motion nor payload nor wrench change, so everything is bit-stable at rest.
"""

import math
from collections.abc import Sequence
from operator import sub, truediv
from typing import Final

from emulator.robot.installation import Installation, Payload
from emulator.snapshot import Snapshot, Vector3, Vector6
from urproto.robots import RobotModel
from urproto.robots.dynamics import Dynamics
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import Pose, pose_trans, rotvec_to_matrix
from urproto.versions import Series

__all__ = ["CURRENT_WINDOW_A", "Arm"]

ZERO6: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
CURRENT_WINDOW_A: Final[Vector6] = (3.0, 3.0, 3.0, 1.5, 1.5, 1.5)  # of collision detection (guess)

_Matrix3 = tuple[float, ...]  # nine numbers, row by row
_Jacobian = Sequence[Sequence[float]]


class Arm:
    """State of the arm after the latest ``update``; ``publish`` writes it to a snapshot.

    Torques [Nm], currents [A]; poses, speeds and wrenches in the base frame at the TCP.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.kinematics = Kinematics(model.dh)
        self.dynamics = Dynamics(model)
        self.q: Vector6 = ZERO6
        self.qd: Vector6 = ZERO6
        self.qdd: Vector6 = ZERO6
        self.tcp_offset: Pose = ZERO6
        self.flange_pose: Pose = ZERO6
        self.tcp_pose: Pose = ZERO6
        self.tcp_speed: Vector6 = ZERO6
        self.tcp_acceleration: Vector6 = ZERO6
        self.wrench: Vector6 = ZERO6  # external, before zeroing
        self.tcp_force: Vector6 = ZERO6
        self.measured_force: Vector6 = ZERO6  # as the controller gives it out: about the flange on e-Series
        self.sensor_in_flange = model.series is Series.E  # else the wrench is known at the TCP
        self.ft_raw_wrench: Vector6 = ZERO6
        self.elbow_position: Vector3 = (0.0, 0.0, 0.0)
        self.elbow_velocity: Vector3 = (0.0, 0.0, 0.0)
        self.tool_acceleration: Vector3 = (0.0, 0.0, 0.0)
        self.momentum = 0.0
        self.collision_ratio = 0.0  # largest share of its window by which a joint current is not the target's, to 1
        self.link_torque: Vector6 = ZERO6  # what the world does to the joints by touching links; set before ``update``
        self.base_wrench_wanted = False  # target_base_wrench costs; few versions have it
        self.base_wrench: Vector6 = ZERO6
        self.target_torque: Vector6 = ZERO6
        self.actual_torque: Vector6 = ZERO6
        self.target_current: Vector6 = ZERO6
        self.actual_current: Vector6 = ZERO6
        self._link_torque: Vector6 = ZERO6
        self._force_bias: Vector6 = ZERO6
        self._payload: Payload | None = None
        self._gravity: Vector3 | None = None
        self._base_acceleration: Vector3 | None = None
        self._felt: Vector3 = (0.0, 0.0, 0.0)  # gravity and the base's acceleration together
        self._driven = False
        self._known = False  # False until the first update
        self._force_zeroed = False

    @property
    def following_error(self) -> Vector6:
        """How far each joint is from its target [rad]: nothing, an ideal arm is where it is told to be."""
        return ZERO6

    def zero_force(self) -> None:
        """What zero_ftsensor() does: the present external wrench counts as none from now on."""
        self._force_bias = self.wrench
        self._force_zeroed = True

    def update(
        self,
        motion: tuple[Vector6, Vector6, Vector6],
        installation: Installation,
        wrench: Vector6,
        period_s: float,
        *,
        driven: bool,
    ) -> bool:
        """Take over one period's targets (q, qd, qdd) and loads; True when anything changed.

        ``wrench``: external, base frame, at the TCP. ``driven``: the motors hold the arm;
        otherwise the brakes do and no current flows.
        """
        loads_changed = self._take_loads(installation)
        if not (loads_changed or self._moved(motion, installation.tcp, wrench, driven)):
            return False
        started = not self._known
        self._known, self._force_zeroed = True, False
        self.q, self.qd, self.qdd = motion
        self.wrench, self._driven, self._link_torque = wrench, driven, self.link_torque
        jacobian = self._update_tcp(installation.tcp, period_s, started)
        self._update_elbow(period_s, started)
        self._update_sensors(installation)
        self._update_torques(jacobian)
        return True

    def publish(self, snapshot: Snapshot) -> None:
        """Write what ``update`` found to a snapshot."""
        snapshot.target_q = snapshot.actual_q = self.q
        snapshot.target_qd = snapshot.actual_qd = self.qd
        snapshot.target_qdd = self.qdd
        snapshot.target_TCP_pose = snapshot.actual_TCP_pose = self.tcp_pose
        snapshot.target_TCP_speed = snapshot.actual_TCP_speed = self.tcp_speed
        snapshot.target_TCP_acceleration = snapshot.actual_TCP_acceleration = self.tcp_acceleration
        snapshot.tcp_offset = self.tcp_offset
        snapshot.actual_TCP_force, snapshot.wrench_calc_from_currents = self.measured_force, self.tcp_force
        snapshot.tcp_force_scalar = math.hypot(*self.tcp_force[:3])
        snapshot.ft_raw_wrench = self.ft_raw_wrench
        snapshot.elbow_position = self.elbow_position
        snapshot.elbow_velocity = self.elbow_velocity
        snapshot.actual_tool_accelerometer = self.tool_acceleration
        snapshot.actual_momentum = self.momentum
        snapshot.target_moment = self.target_torque
        snapshot.target_current = self.target_current
        snapshot.actual_current = snapshot.joint_control_output = self.actual_current
        snapshot.actual_current_as_torque = self.actual_torque
        snapshot.collision_detection_ratio = self.collision_ratio
        snapshot.target_base_wrench = self.base_wrench

    def _take_loads(self, installation: Installation) -> bool:
        if (
            installation.payload is self._payload
            and installation.gravity is self._gravity
            and installation.base_acceleration is self._base_acceleration
        ):
            return False
        self._payload, self._gravity = installation.payload, installation.gravity
        self._base_acceleration = installation.base_acceleration
        self._felt = _plus3(self._gravity, self._base_acceleration)
        self.dynamics.set_payload(self._payload.mass, self._payload.cog, self._payload.inertia)
        self.dynamics.set_gravity(self._felt)
        return True

    def _moved(self, motion: tuple[Vector6, Vector6, Vector6], tcp: Pose, wrench: Vector6, driven: bool) -> bool:
        q, qd, qdd = motion
        return (
            q != self.q
            or qd != self.qd
            or qdd != self.qdd
            or tcp != self.tcp_offset
            or wrench != self.wrench
            or self.link_torque != self._link_torque
            or driven is not self._driven
            or self._force_zeroed
            or not self._known
            or self.tcp_acceleration is not ZERO6
        )

    def _update_tcp(self, tcp_offset: Pose, period_s: float, started: bool) -> _Jacobian:
        self.tcp_offset = tcp_offset
        self.flange_pose = self.kinematics.forward(self.q)
        self.tcp_pose = self.flange_pose if tcp_offset == ZERO6 else pose_trans(self.flange_pose, tcp_offset)
        jacobian = self.kinematics.jacobian_at(self.q, self.tcp_pose)
        speed = _times6(jacobian, self.qd) if self.qd != ZERO6 else ZERO6
        changing = speed != self.tcp_speed and not started
        self.tcp_acceleration = _rate6(speed, self.tcp_speed, period_s) if changing else ZERO6
        self.tcp_speed = speed
        return jacobian

    def _update_elbow(self, period_s: float, started: bool) -> None:
        position = self.kinematics.elbow_position(self.q)
        x, y, z = _minus3(position, self.elbow_position)
        moving = self.qd != ZERO6 and not started
        self.elbow_velocity = (x / period_s, y / period_s, z / period_s) if moving else (0.0, 0.0, 0.0)
        self.elbow_position = position

    def _update_sensors(self, installation: Installation) -> None:
        """Force/torque sensor and accelerometer; both sit in the flange and share its axes."""
        payload, gravity = installation.payload, self._felt
        axes = rotvec_to_matrix(*self.flange_pose[3:])
        self.tool_acceleration = _into(axes, _plus3(self.tcp_acceleration, gravity))
        if self.wrench == self._force_bias == ZERO6 and not payload.mass:
            self.tcp_force = self.measured_force = self.ft_raw_wrench = ZERO6
            return
        self.tcp_force = self.measured_force = _minus6(self.wrench, self._force_bias)
        if self.sensor_in_flange:
            self.measured_force = self._at_flange(self.tcp_force)
        weight = _into(axes, (-payload.mass * gravity[0], -payload.mass * gravity[1], -payload.mass * gravity[2]))
        force = _into(axes, self.wrench)
        lever = _into(axes, _minus3(self.tcp_pose, self.flange_pose))
        torque = _plus3(_into(axes, self.wrench[3:]), _plus3(_cross(lever, force), _cross(payload.cog, weight)))
        self.ft_raw_wrench = (*_plus3(force, weight), *torque)

    def _at_flange(self, wrench: Vector6) -> Vector6:
        """A wrench at the TCP about the flange, base axes."""
        if self.tcp_offset == ZERO6:
            return wrench
        torque = _plus3(wrench[3:], _cross(_minus3(self.tcp_pose, self.flange_pose), wrench))
        return (wrench[0], wrench[1], wrench[2], *torque)

    def _update_torques(self, jacobian: _Jacobian) -> None:
        self.momentum = self.dynamics.linear_momentum(self.q, self.qd) if self.qd != ZERO6 else 0.0
        self.collision_ratio = 0.0
        if self.base_wrench_wanted:
            self.base_wrench = self.dynamics.base_wrench(self.q, self.qd, self.qdd)
        if not self._driven:
            self.target_torque = self.actual_torque = self.target_current = self.actual_current = ZERO6
            return
        self.target_torque = self.actual_torque = self.dynamics.inverse_dynamics(self.q, self.qd, self.qdd)
        self.target_current = self.actual_current = self._currents(self.target_torque)
        if self.wrench != ZERO6 or self.link_torque != ZERO6:
            held = _times6(tuple(zip(*jacobian, strict=True)), self.wrench)
            self.actual_torque = _minus6(_minus6(self.target_torque, held), self.link_torque)
            self.actual_current = self._currents(self.actual_torque)
            excess = map(sub, self.actual_current, self.target_current)
            self.collision_ratio = min(1.0, max(map(truediv, map(abs, excess), CURRENT_WINDOW_A)))

    def _currents(self, torque: Vector6) -> Vector6:
        k = self.model.torque_constants
        return (
            torque[0] / k[0],
            torque[1] / k[1],
            torque[2] / k[2],
            torque[3] / k[3],
            torque[4] / k[4],
            torque[5] / k[5],
        )


def _times6(rows: _Jacobian, vector: Sequence[float]) -> Vector6:
    a, b, c, d, e, f = vector
    x, y, z, rx, ry, rz = [r * a + s * b + t * c + u * d + v * e + w * f for r, s, t, u, v, w in rows]
    return (x, y, z, rx, ry, rz)


def _minus6(a: Sequence[float], b: Sequence[float]) -> Vector6:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])


def _rate6(now: Vector6, before: Vector6, period_s: float) -> Vector6:
    x, y, z, u, v, w = _minus6(now, before)
    return (x / period_s, y / period_s, z / period_s, u / period_s, v / period_s, w / period_s)


def _plus3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus3(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _cross(a: Sequence[float], b: Sequence[float]) -> Vector3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _into(axes: _Matrix3, v: Sequence[float]) -> Vector3:
    """A base-frame vector (the first three of v) in the frame whose axes are the columns of the matrix."""
    x, y, z = v[0], v[1], v[2]
    return (
        axes[0] * x + axes[3] * y + axes[6] * z,
        axes[1] * x + axes[4] * y + axes[7] * z,
        axes[2] * x + axes[5] * y + axes[8] * z,
    )
