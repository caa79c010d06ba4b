"""The arm: its position and motion, torques, currents and forces.

The motion generator provides targets; the two kinds of arm differ in how they follow them. An ideal arm is exactly at
its target, without friction or noise, like that of a simulated controller. Nothing is recomputed while neither motion
nor loads change, so everything is bit-stable at rest. A dynamic arm (``drives``) is moved by torques and follows as
well as its servo loops can.

Everything else is the same for both. Torques are calculated by the rigid-body model with the payload set by the
program, currents from the torques by one constant per joint. The TCP force is the external wrench plus the weight of
any payload that the program does not know. A dynamic arm's controller also adds what a real one adds: the inertia of
the rotors to ``target_moment``, and its friction model to ``target_current``. Its constants and noise are those of a
real arm, too (``urproto.robots.measured``).
"""

import math
from typing import TYPE_CHECKING, Final

from emulator.robot.chance import Chances
from emulator.robot.collisions import CollisionWindows
from emulator.robot.drives import Drives, TorqueCommand
from emulator.robot.installation import Installation, Payload
from emulator.robot.sensors import Sensors
from emulator.robot.staticfriction import StaticFriction
from emulator.snapshot import Snapshot
from urproto.robots import RobotModel, kinematics_of
from urproto.robots.kinematics import Kinematics
from urproto.robots.measured import drivetrain_of
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_trans
from urproto.vectors import (
    ZERO3,
    ZERO6,
    Matrix3,
    Vector3,
    Vector6,
    add,
    add3,
    cross,
    rate,
    rotate,
    rotate_back,
    sub,
    sub3,
)
from urproto.versions import Series

if TYPE_CHECKING:
    from urproto.robots.dynamics import Dynamics

_MAX_PUSH: Final = 3.0  # times a joint's torque limit: a larger external torque would break it (guess)
_LOST_RAD_S: Final = 1e4  # a body reaches this speed only if its payload has an impossible inertia
_STANDING_RAD_S: Final = 0.005  # a slower arm counts as at rest (guess)


class ToolState:
    """Poses, speeds and accelerations of the TCP in the base frame; the elbow's position and velocity."""

    def __init__(self, kinematics: Kinematics, elbow_offset_m: float) -> None:
        self._kinematics = kinematics
        self._elbow_offset = elbow_offset_m
        self.flange_pose: Pose = ZERO6
        self.flange_axes: Matrix3 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        self.pose: Pose = ZERO6
        self.speed: Vector6 = ZERO6
        self.acceleration: Vector6 = ZERO6
        self.elbow_position: Vector3 = ZERO3
        self.elbow_velocity: Vector3 = ZERO3

    def update(self, q: Vector6, qd: Vector6, tcp_offset: Pose, period_s: float, *, started: bool) -> None:
        """Advance one period. ``started``: no earlier state is known."""
        (x, y, z), self.flange_axes = self._kinematics.flange_axes(q)
        self.flange_pose = flange = (x, y, z, *matrix_to_rotvec(self.flange_axes))
        self.pose = flange if tcp_offset == ZERO6 else pose_trans(flange, tcp_offset)
        speed = self._kinematics.twist_at(q, qd, self.pose) if qd != ZERO6 else ZERO6
        changing = speed != self.speed and not started
        self.acceleration = rate(speed, self.speed, period_s) if changing else ZERO6
        self.speed = speed
        self._update_elbow(q, period_s, moving=qd != ZERO6 and not started)

    def _update_elbow(self, q: Vector6, period_s: float, *, moving: bool) -> None:
        position = self._kinematics.elbow_position(q, self._elbow_offset)
        x, y, z = sub3(position, self.elbow_position)
        self.elbow_velocity = (x / period_s, y / period_s, z / period_s) if moving else ZERO3
        self.elbow_position = position


_Motion = tuple[Vector6, Vector6, Vector6]


class Arm:
    """State of the arm after the latest ``update``; ``publish`` writes it to a snapshot.

    Torques [Nm], currents [A]; poses, speeds and wrenches in the base frame at the TCP. ``chances``: of a dynamic arm's
    noise; None for an ideal arm. q, qd, qdd, tcp_* are the actual values; measured_* are the values the controller
    reports, with delay and noise while a dynamic arm moves.
    """

    def __init__(self, model: RobotModel, *, chances: Chances | None = None) -> None:
        from urproto.robots.dynamics import (
            Dynamics,
        )  # Pinocchio is slow to import: programs without an arm, such as the script checker, need not wait for it

        self.model = model
        self.kinematics = kinematics_of(model)
        self.dynamics = Dynamics(model)
        self.drives = None if chances is None else Drives(model)
        drivetrain = drivetrain_of(model)
        self._known_friction, self._rotors = drivetrain.known_friction, drivetrain.rotor_kg_m2
        self.torque_constants = model.torque_constants if self.drives is None else drivetrain.torque_constants_Nm_A
        self._sensors = Sensors(model, chances or Chances(0))
        self._static_friction = StaticFriction(model, chances or Chances(0))
        self.target_q: Vector6 = ZERO6
        self.target_qd: Vector6 = ZERO6
        self.target_qdd: Vector6 = ZERO6
        self.q: Vector6 = ZERO6
        self.qd: Vector6 = ZERO6
        self.qdd: Vector6 = ZERO6
        self.measured_q: Vector6 = ZERO6
        self.measured_qd: Vector6 = ZERO6
        self.measured_tcp_pose: Pose = ZERO6
        self.measured_tcp_speed: Vector6 = ZERO6
        self.tcp_offset: Pose = ZERO6
        self._tool = ToolState(self.kinematics, model.elbow_offset)
        self._target_tool = self._tool if self.drives is None else ToolState(self.kinematics, model.elbow_offset)
        self.mounted: Payload | None = None  # true payload on the flange; None: the one set by the program
        self.wrench: Vector6 = ZERO6  # external, before zeroing
        self.tcp_force: Vector6 = ZERO6
        self.measured_force: Vector6 = ZERO6  # as the controller reports it: about the flange on e-Series
        self.sensor_in_flange = model.series is Series.E  # else the wrench is known at the TCP
        self.ft_raw_wrench: Vector6 = ZERO6
        self.tool_acceleration: Vector3 = ZERO3
        self.momentum = 0.0
        self.collisions = CollisionWindows()
        self.link_torque: Vector6 = ZERO6  # joint torques from contacts of the links; set before ``update``
        self.base_wrench_enabled = False  # target_base_wrench takes time to calculate, and few versions have it
        self.base_wrench: Vector6 = ZERO6
        self.target_torque: Vector6 = ZERO6
        self.actual_torque: Vector6 = ZERO6
        self.own_torque: Vector6 = ZERO6  # torque to move and hold the arm itself, as expected by the controller
        self.target_current: Vector6 = ZERO6
        self.actual_current: Vector6 = ZERO6
        self.control_output: Vector6 = ZERO6  # currents that the drives demand
        self.friction_W: Vector6 = ZERO6  # heat of friction in the joints
        self._link_torque: Vector6 = ZERO6
        self._force_bias: Vector6 = ZERO6
        self._payload_error: Vector6 = ZERO6  # weight of the true payload minus that of the known one, as a wrench
        self._payload: Payload | None = None
        self._mounted: Payload | None = None
        self._gravity: Vector3 | None = None
        self._base_acceleration: Vector3 | None = None
        self._effective_gravity: Vector3 = ZERO3  # gravity and the base's acceleration together
        self._driven = False
        self._known = False  # False until the first update
        self._force_zeroed = False
        self._released = False

    # state

    @property
    def flange_pose(self) -> Pose:
        """Actual pose of the tool flange."""
        return self._tool.flange_pose

    @property
    def tcp_pose(self) -> Pose:
        """Actual pose of the TCP."""
        return self._tool.pose

    @property
    def tcp_speed(self) -> Vector6:
        """Actual velocity of the TCP."""
        return self._tool.speed

    @property
    def tcp_acceleration(self) -> Vector6:
        """Actual acceleration of the TCP."""
        return self._tool.acceleration

    @property
    def elbow_position(self) -> Vector3:
        """Actual position of the elbow that the controller monitors."""
        return self._tool.elbow_position

    @property
    def elbow_velocity(self) -> Vector3:
        """Actual velocity of the elbow."""
        return self._tool.elbow_velocity

    @property
    def known(self) -> bool:
        """Whether the arm's position is known: not before the first ``update``."""
        return self._known

    @property
    def effective_gravity(self) -> Vector3:
        """Gravity plus the base's acceleration, base frame, with the sign of set_gravity [m/s2]."""
        return self._effective_gravity

    @property
    def following_error(self) -> Vector6:
        """Lag of each joint behind its target [rad]; zero on an ideal arm."""
        return ZERO6 if self.drives is None else sub(self.target_q, self.q)

    @property
    def standing(self) -> bool:
        """Whether the arm itself is (almost) at rest, whatever its targets do."""
        speed = self.qd if self.drives is None else self.drives.body.qd
        return max(map(abs, speed)) < _STANDING_RAD_S

    @property
    def external_torque(self) -> Vector6:
        """Joint torques [Nm] beyond those the controller expects: from external forces, or a wrong payload."""
        return sub(self.actual_torque, self.own_torque)

    def zero_force(self) -> None:
        """zero_ftsensor(): from now on, the present external wrench counts as zero."""
        self._force_bias = add(self.wrench, self._payload_error) if self._mounted is not None else self.wrench
        self._force_zeroed = True

    def released(self) -> None:
        """The arm is released from a stop, or by its brakes: what it carries in the next period is no collision."""
        self._released = True

    def torque_response(
        self, command: TorqueCommand, q: Vector6, qd: Vector6, period_s: float
    ) -> tuple[Vector6, Vector6]:
        """Position and speed of the joints after a period of direct torque.

        A dynamic arm returns its actual state, extrapolated by a period. An ideal one comes to rest: the vendor's
        simulated arm does not react to torques either (comment in the official library's example).
        """
        if self.drives is not None:
            body = self.drives.body
            return _onwards(body.q, body.qd, period_s), body.qd
        braking = _within(_onwards(ZERO6, qd, -1.0 / period_s), self.model.qdd_max)
        speed = _onwards(qd, braking, period_s)
        return _onwards(q, speed, period_s), speed

    # one period

    def update(
        self,
        motion: _Motion,
        installation: Installation,
        wrench: Vector6,
        period_s: float,
        *,
        driven: bool,
        torque: TorqueCommand | None = None,
    ) -> bool:
        """Apply one period's targets (q, qd, qdd) and loads; returns True if anything changed.

        ``wrench``: external, base frame, at the TCP. ``driven``: the motors hold the arm;
        otherwise the brakes do, and no current flows. ``torque``: of a program that commands torques.
        """
        loads_changed = self._take_loads(installation)
        news = self._moved(motion, installation.tcp, wrench, driven) or loads_changed
        if not (news or self._may_change):
            return False
        started = not self._known
        self._known, self._force_zeroed = True, False
        self.target_q, self.target_qd, self.target_qdd = motion
        self.wrench, self._driven, self.tcp_offset = wrench, driven, installation.tcp
        self._link_torque = self.link_torque
        if self.drives is None:
            self.q, self.qd, self.qdd = motion
        else:
            self._drive(self.drives, torque, period_s, started=started)
            if news:
                self._target_tool.update(self.target_q, self.target_qd, self.tcp_offset, period_s, started=started)
        self._tool.update(self.q, self.qd, self.tcp_offset, period_s, started=started)
        self._measure()
        self._update_sensors(installation)
        self._update_torques()
        if self._released:
            self._released = False
            self.collisions.accept()
        return True

    def recover(self, q: Vector6) -> None:
        """Reset to standing at q without power; the next ``update`` starts without history."""
        self.target_q = self.q = self.measured_q = q
        self.target_qd = self.target_qdd = self.qd = self.qdd = self.measured_qd = ZERO6
        self.wrench = self.link_torque = self.tcp_force = self.measured_force = self.ft_raw_wrench = ZERO6
        self.target_torque = self.actual_torque = self.own_torque = self.base_wrench = ZERO6
        self.target_current = self.actual_current = self.control_output = self.friction_W = ZERO6
        self._force_bias = self._payload_error = ZERO6
        self.collisions.clear()
        self._payload = self._gravity = None
        self._known = self._driven = False
        if self.drives is not None:
            self.drives.place(q)
            self._static_friction.forget()

    def publish(self, snapshot: Snapshot) -> None:
        """Write the results of ``update`` to a snapshot."""
        actual, target = self._tool, self._target_tool
        snapshot.target_q, snapshot.actual_q = self.target_q, self.measured_q
        snapshot.target_qd, snapshot.actual_qd = self.target_qd, self.measured_qd
        snapshot.target_qdd = self.target_qdd
        snapshot.target_TCP_pose, snapshot.actual_TCP_pose = target.pose, self.measured_tcp_pose
        snapshot.target_TCP_speed, snapshot.actual_TCP_speed = target.speed, self.measured_tcp_speed
        snapshot.target_TCP_acceleration = target.acceleration
        snapshot.actual_TCP_acceleration = actual.acceleration
        snapshot.tcp_offset = self.tcp_offset
        snapshot.actual_TCP_force, snapshot.wrench_calc_from_currents = self.measured_force, self.tcp_force
        snapshot.tcp_force_scalar = math.hypot(*self.tcp_force[:3])
        snapshot.ft_raw_wrench = self.ft_raw_wrench
        snapshot.elbow_position = actual.elbow_position
        snapshot.elbow_velocity = actual.elbow_velocity
        snapshot.actual_tool_accelerometer = self.tool_acceleration
        snapshot.actual_momentum = self.momentum
        snapshot.target_moment = self.target_torque
        snapshot.target_current, snapshot.actual_current = self.target_current, self.actual_current
        snapshot.joint_control_output = self.control_output
        snapshot.actual_current_as_torque = self.actual_torque
        snapshot.collision_detection_ratio = self.collisions.ratio
        snapshot.actual_current_window = self.collisions.windows
        snapshot.target_base_wrench = self.base_wrench

    def _take_loads(self, installation: Installation) -> bool:
        if (
            installation.payload is self._payload
            and installation.gravity is self._gravity
            and installation.base_acceleration is self._base_acceleration
            and self.mounted is self._mounted
        ):
            return False
        self._payload, self._gravity = installation.payload, installation.gravity
        self._base_acceleration, self._mounted = installation.base_acceleration, self.mounted
        self._effective_gravity = add3(self._gravity, self._base_acceleration)
        self._load(self.dynamics, self._payload)
        if self.drives is not None:
            self._load(self.drives.body.dynamics, self._mounted or self._payload)
            self.drives.wake()
        return True

    def _load(self, dynamics: "Dynamics", payload: Payload) -> None:
        dynamics.set_payload(payload.mass, payload.cog, payload.inertia)
        dynamics.set_gravity(self._effective_gravity)

    def _moved(self, motion: _Motion, tcp: Pose, wrench: Vector6, driven: bool) -> bool:
        q, qd, qdd = motion
        return (
            q != self.target_q
            or qd != self.target_qd
            or qdd != self.target_qdd
            or tcp != self.tcp_offset
            or wrench != self.wrench
            or self.link_torque != self._link_torque
            or driven is not self._driven
            or self._force_zeroed
            or self._released
            or not self._known
            or self._target_tool.acceleration is not ZERO6
        )

    @property
    def _may_change(self) -> bool:
        """Whether the state may change on its own: a dynamic arm with power, or not yet stopped by its brakes."""
        return self.drives is not None and (self._driven or not self.drives.body.standing)

    def _drive(self, drives: Drives, torque: TorqueCommand | None, period_s: float, *, started: bool) -> None:
        """Let the drives follow this period's target."""
        if started:
            drives.place(self.target_q)
        body = drives.body
        place, before = body.q, body.qd
        external = ZERO6 if started else self._limited_torque(add(self._joint_torques(self.wrench), self.link_torque))
        if not self._driven:
            drives.hold(self.target_q, external, period_s)
        elif torque is not None:
            gravity = self.dynamics.gravity_torques(body.q)
            self.target_torque = add(torque.torque, gravity)
            drives.apply_torque(self.target_q, torque, gravity, external, period_s)
        else:
            rigid = self.dynamics.inverse_dynamics(self.target_q, self.target_qd, self.target_qdd)
            self.target_torque = _with_rotors(rigid, self._rotors, self.target_qdd)
            drives.follow(self.target_q, rigid, external, period_s)
        if not sum(map(abs, body.qd)) < _LOST_RAD_S:
            body.place(place)
        self.q, self.qd = self._sensors.joints(body, period_s)
        self.qdd = ZERO6 if before == body.qd else rate(body.qd, before, period_s)
        self.friction_W = ZERO6 if body.standing else body.friction_power

    def _measure(self) -> None:
        """Update the reported angles and speeds, and the TCP pose and speed calculated from them."""
        if self.drives is None or self.qd == ZERO6:
            self.measured_q, self.measured_qd = self.q, self.qd
            self.measured_tcp_pose, self.measured_tcp_speed = self.tcp_pose, self.tcp_speed
            return
        self.measured_q, self.measured_qd = q, qd = self._sensors.reported(self.q, self.qd)
        self.measured_tcp_pose = pose = self.kinematics.forward(
            q, None if self.tcp_offset == ZERO6 else self.tcp_offset
        )
        self.measured_tcp_speed = self.kinematics.twist_at(q, qd, pose)

    def _joint_torques(self, wrench: Vector6) -> Vector6:
        """Joint torques of a wrench at the TCP, in the arm's last known configuration."""
        return ZERO6 if wrench == ZERO6 else self.kinematics.joint_torques_at(self.q, wrench, self.tcp_pose)

    def _limited_torque(self, torque: Vector6) -> Vector6:
        """Limit an external torque so that the simulated body stays within reasonable bounds."""
        if not math.isfinite(sum(torque)):
            return ZERO6
        excess = max(abs(value) / most for value, most in zip(torque, self.model.torque_max, strict=True))
        return torque if excess <= _MAX_PUSH else _onwards(ZERO6, torque, _MAX_PUSH / excess)

    def _update_sensors(self, installation: Installation) -> None:
        """Update force/torque sensor and accelerometer; both are in the flange and share its axes."""
        payload, gravity = self._mounted or installation.payload, self._effective_gravity
        axes = self._tool.flange_axes
        self.tool_acceleration = rotate_back(axes, add3(self.tcp_acceleration, gravity))
        if self.drives is not None:
            self.tool_acceleration = self._sensors.accelerometer(self.tool_acceleration)
        measured = self.wrench
        self._payload_error = ZERO6
        if self._mounted is not None and not self._mounted.has_same_weight(installation.payload):
            self._payload_error = self._weight_difference(axes, self._mounted, installation.payload)
            measured = add(measured, self._payload_error)
        if self.drives is not None and self._driven:
            measured = self._sensors.wrench(measured)
        if measured == self._force_bias == ZERO6 and not payload.mass:
            self.tcp_force = self.measured_force = self.ft_raw_wrench = ZERO6
            return
        self.tcp_force = self.measured_force = sub(measured, self._force_bias)
        if self.sensor_in_flange:
            self.measured_force = self._at_flange(self.tcp_force)
        weight = _weight(axes, payload, gravity)
        force = rotate_back(axes, self.wrench)
        lever = rotate_back(axes, sub3(self.tcp_pose, self.flange_pose))
        torque = add3(rotate_back(axes, self.wrench[3:]), add3(cross(lever, force), cross(payload.cog, weight)))
        self.ft_raw_wrench = (*add3(force, weight), *torque)

    def _weight_difference(self, axes: tuple[float, ...], mounted: Payload, known: Payload) -> Vector6:
        """Difference of the weights of two payloads, as a wrench at the TCP in base axes."""
        true, assumed = _weight(axes, mounted, self._effective_gravity), _weight(axes, known, self._effective_gravity)
        lever = rotate_back(axes, sub3(self.flange_pose, self.tcp_pose))
        force = sub3(true, assumed)
        torque = sub3(cross(add3(lever, mounted.cog), true), cross(add3(lever, known.cog), assumed))
        return (*rotate(axes, force), *rotate(axes, torque))

    def _at_flange(self, wrench: Vector6) -> Vector6:
        """Convert a wrench at the TCP to one about the flange, base axes."""
        if self.tcp_offset == ZERO6:
            return wrench
        torque = add3(wrench[3:], cross(sub3(self.tcp_pose, self.flange_pose), wrench))
        return (wrench[0], wrench[1], wrench[2], *torque)

    def _update_torques(self) -> None:
        if self.base_wrench_enabled:
            self.base_wrench = self.dynamics.base_wrench(self.target_q, self.target_qd, self.target_qdd)
        if self._driven and self.drives is None:
            self._ideal_currents()  # and the momentum with them
            return
        self.momentum = self.dynamics.linear_momentum(self.q, self.qd) if self.qd != ZERO6 else 0.0
        if self._driven and self.drives is not None:
            self._measured_currents(self.drives)
        else:
            self.target_torque = self.actual_torque = self.own_torque = ZERO6
            self.target_current = self.actual_current = self.control_output = ZERO6
            self.collisions.clear()

    def _ideal_currents(self) -> None:
        """Currents and torques of an ideal arm: those of the model plus external loads."""
        self.own_torque, self.momentum = self.dynamics.torques_and_momentum(self.q, self.qd, self.qdd)
        self.target_torque = self.actual_torque = self.own_torque
        self.target_current = self.actual_current = self._currents(self.target_torque)
        outside = self.wrench if self._mounted is None else add(self.wrench, self._payload_error)
        if outside != ZERO6 or self.link_torque != ZERO6:
            self.actual_torque = sub(self.target_torque, add(self._joint_torques(outside), self.link_torque))
            self.actual_current = self._currents(self.actual_torque)
            self.collisions.compare(sub(self.actual_current, self.target_current))
        else:
            self.collisions.clear()
        self.control_output = self._demanded(self.actual_current)

    def _measured_currents(self, drives: Drives) -> None:
        """Currents and torques of a dynamic arm in the last period, as measured by its current sensors."""
        self.own_torque = drives.feedforward
        self.target_current = self._currents(add(self.target_torque, self._known_friction(self.target_qd)))
        motors = self._currents(add(drives.torque, self._static_friction.torque(drives.body.qd)))
        self.actual_current = self._sensors.currents(motors, drives.body.qd)
        self.control_output = self._demanded(motors)
        a, b, c, d, e, f = map(float.__mul__, self.actual_current, self.torque_constants)
        self.actual_torque = (a, b, c, d, e, f)
        self.collisions.compare(sub(self.actual_current, self.target_current))

    def _demanded(self, motors: Vector6) -> Vector6:
        """The control currents that the robot reports, given those of its motors.

        A UR10 at rest reports its motors' currents. Three e-Series arms report their target currents: two at rest, and
        a UR5e also in motion while a hand pushed it (philipmarschner/dmp_project, demonstrations of May 17).
        """
        return motors if self.model.series is Series.CB3 else self.target_current

    def _currents(self, torque: Vector6) -> Vector6:
        k = self.torque_constants
        return (
            torque[0] / k[0],
            torque[1] / k[1],
            torque[2] / k[2],
            torque[3] / k[3],
            torque[4] / k[4],
            torque[5] / k[5],
        )


def _with_rotors(torque: Vector6, rotors: Vector6, qdd: Vector6) -> Vector6:
    if qdd == ZERO6:
        return torque
    a, b, c, d, e, f = [own + inertia * rate for own, inertia, rate in zip(torque, rotors, qdd, strict=True)]
    return (a, b, c, d, e, f)


def _weight(axes: tuple[float, ...], payload: Payload, gravity: Vector3) -> Vector3:
    """In flange axes [N]."""
    return rotate_back(axes, (-payload.mass * gravity[0], -payload.mass * gravity[1], -payload.mass * gravity[2]))


def _onwards(start: Vector6, rate: Vector6, time_s: float) -> Vector6:
    a, b, c, d, e, f = (at + time_s * change for at, change in zip(start, rate, strict=True))
    return (a, b, c, d, e, f)


def _within(values: Vector6, most: Vector6) -> Vector6:
    """Scale all values by the same factor so that none exceeds its limit."""
    excess = max(abs(value) / limit for value, limit in zip(values, most, strict=True))
    return values if excess <= 1.0 else _onwards(ZERO6, values, 1.0 / excess)
