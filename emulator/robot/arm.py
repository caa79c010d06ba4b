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
from copy import copy
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

from emulator.robot.chance import Chances
from emulator.robot.collisions import CollisionWindows
from emulator.robot.drives import Drives, TorqueCommand
from emulator.robot.efforts import Efforts, IdealEfforts, JointMotion, StaticFriction, currents, demanded
from emulator.robot.installation import Installation, Payload
from emulator.robot.motion_bounds import MotionBounds
from emulator.robot.sensors import Sensors
from emulator.robot.tool import FlangeSensors, ToolMotion, ToolState, weight_difference
from emulator.snapshot import Snapshot
from urproto.robots import RobotModel, kinematics_of
from urproto.robots.measured import drivetrain_of
from urproto.robots.pose import Pose
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6, add, add3, largest, lerp, rate, sub
from urproto.versions import Series

if TYPE_CHECKING:
    from urproto.robots.dynamics import Dynamics

_MAX_PUSH: Final = 3.0  # times a joint's torque limit: a larger external torque would break it (guess)
_LOST_RAD_S: Final = 1e4  # a body reaches this speed only if its payload has an impossible inertia
_ORDINARY: Final = 1e3  # in SI units: loads and TCPs beyond this are none of a robot (guess)
_STANDING_RAD_S: Final = 0.005  # a slower arm counts as at rest (guess)


class ArmState(NamedTuple):
    """The arm at the end of a control period, as it is, as it should be, and as the controller measures it.

    None of it changes, and most of it is computed when it is read.
    """

    tool: ToolMotion
    target: ToolMotion
    measured: ToolState
    sensors: FlangeSensors
    efforts: IdealEfforts | Efforts

    def measured_at(self, pose: Pose) -> "ArmState":
        """The same, reported with another pose of the TCP."""
        measured = copy(self.measured)
        measured.pose = pose
        return self._replace(measured=measured)


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
        self.tcp_offset: Pose = ZERO6
        self.mounted: Payload | None = None  # true payload on the flange; None: the one set by the program
        self.wrench: Vector6 = ZERO6  # external, before zeroing
        self.sensor_in_flange = model.series is Series.E  # else the wrench is known at the TCP
        self.collisions = CollisionWindows()
        self.bounds = MotionBounds(model)
        self.link_torque: Vector6 = ZERO6  # joint torques from contacts of the links; set before ``update``
        self.friction_W: Vector6 = ZERO6  # heat of friction in the joints
        self._target_torque: Vector6 = ZERO6  # of a dynamic arm
        self._link_torque: Vector6 = ZERO6
        self.force_bias: Vector6 = ZERO6  # external wrench that counts as zero
        self._payload_error: Vector6 = ZERO6  # weight of the true payload minus that of the known one, as a wrench
        self._payload: Payload | None = None
        self._mounted: Payload | None = None
        self._gravity: Vector3 | None = None
        self._base_acceleration: Vector3 | None = None
        self.effective_gravity: Vector3 = (
            ZERO3  # and the base's acceleration, base frame, sign as of set_gravity [m/s2]
        )
        self._ordinary_load = True
        self._driven = False
        self.known = False  # whether its position is known: not before the first update
        self._force_zeroed = False
        self._released = False
        self._tool_at = partial(ToolState, self.kinematics, model.elbow_offset)
        self.state = self._at_rest(ZERO6)

    # state

    @property
    def flange_pose(self) -> Pose:
        return self.state.tool.now.flange_pose

    @property
    def tcp_pose(self) -> Pose:
        return self.state.tool.now.pose

    @property
    def tcp_speed(self) -> Vector6:
        return self.state.tool.now.speed

    @property
    def elbow_position(self) -> Vector3:
        """Actual position of the elbow that the controller monitors."""
        return self.state.tool.now.elbow_position

    @property
    def elbow_velocity(self) -> Vector3:
        return self.state.tool.elbow_velocity

    @property
    def tcp_force(self) -> Vector6:
        """External wrench at the TCP that the controller knows of, zeroed [N, Nm]."""
        return self.state.sensors.tcp_force

    @property
    def efforts(self) -> IdealEfforts | Efforts:
        """Torques, currents and momentum."""
        return self.state.efforts

    def certainly_below(self, speed: float, momentum: float) -> bool:
        """Whether TCP and elbow are slower than ``speed`` [m/s], and the momentum is less [kg m/s], for certain.

        Usually, this takes less time than computing them. False may also mean that it is not known: then look at them.
        """
        bounds = self.bounds
        if bounds.speed <= speed and bounds.momentum <= momentum:
            return True
        if self.drives is not None:
            return False
        u, v, w, *_ = self.tcp_speed
        x, y, z = self.elbow_velocity
        bounds.lower(math.sqrt(max(u * u + v * v + w * w, x * x + y * y + z * z)), self.efforts.momentum)
        return bounds.speed <= speed and bounds.momentum <= momentum

    @property
    def ordinary(self) -> bool:
        """Whether load and TCP are such that a plausible motion has plausible torques, poses and wrenches."""
        return self._ordinary_load and (self.tcp_offset is ZERO6 or largest(self.tcp_offset) < _ORDINARY)

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
        return sub(self.efforts.actual_torque, self.efforts.own_torque)

    def zero_force(self) -> None:
        """zero_ftsensor(): from now on, the present external wrench counts as zero."""
        self.force_bias = add(self.wrench, self._payload_error) if self._mounted is not None else self.wrench
        self._force_zeroed = True

    def restore_force(self, bias: Vector6) -> None:
        """Count this wrench as zero, and forget the present external one: the surroundings are others from now on."""
        self.force_bias, self.wrench, self._force_zeroed = bias, ZERO6, True

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
            return lerp(body.q, body.qd, period_s), body.qd
        braking = _within(lerp(ZERO6, qd, -1.0 / period_s), self.model.qdd_max)
        speed = lerp(qd, braking, period_s)
        return lerp(q, speed, period_s), speed

    # one period

    def update(
        self,
        motion: JointMotion,
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
        started = not self.known
        self.known, self._force_zeroed = True, False
        self.target_q, self.target_qd, self.target_qdd = motion
        self.wrench, self._driven, self.tcp_offset = wrench, driven, installation.tcp
        self._link_torque = self.link_torque
        before = self.state
        if self.drives is None:
            self.q, self.qd, self.qdd = motion
            self.bounds.advance(self.qd, self.tcp_offset, period_s)
        else:
            self._drive(self.drives, torque, period_s, started=started)
        tool = self._moved_tool(before.tool, self.q, self.qd, period_s, started=started)
        if self.drives is None:
            target = tool
        elif news:
            target = self._moved_tool(before.target, self.target_q, self.target_qd, period_s, started=started)
        else:
            target = before.target
        measured = self._measure(tool)
        sensors = self._read_sensors(tool, installation)
        self.state = ArmState(tool, target, measured, sensors, self._efforts(tool))
        if self._released:
            self._released = False
            self.collisions.accept()
        return True

    def recover(self, q: Vector6) -> None:
        """Reset to standing at q without power; the next ``update`` starts without history."""
        self.target_q = self.q = self.measured_q = q
        self.target_qd = self.target_qdd = self.qd = self.qdd = self.measured_qd = ZERO6
        self.wrench = self.link_torque = self.friction_W = ZERO6
        self.state = self._at_rest(q)
        self.force_bias = self._payload_error = ZERO6
        self.collisions.clear()
        self._payload = self._gravity = None
        self.known = self._driven = False
        if self.drives is not None:
            self.drives.place(q)
            self._static_friction.forget()

    def _at_rest(self, q: Vector6) -> ArmState:
        """Without power and load."""
        here = self._tool_at(q, ZERO6, self.tcp_offset)
        tool = ToolMotion(here, here, 1.0)
        sensors = FlangeSensors(tool, Payload(), ZERO3)
        return ArmState(tool, tool, here, sensors, Efforts(self.dynamics, (q, ZERO6, ZERO6)))

    def publish(self, snapshot: Snapshot) -> None:
        snapshot.arm = self.state
        snapshot.target_q, snapshot.actual_q = self.target_q, self.measured_q
        snapshot.target_qd, snapshot.actual_qd = self.target_qd, self.measured_qd
        snapshot.target_qdd = self.target_qdd
        snapshot.tcp_offset = self.tcp_offset
        snapshot.wrench_calc_from_currents = force = self.tcp_force
        snapshot.tcp_force_scalar = 0.0 if force is ZERO6 else math.hypot(*force[:3])
        snapshot.collision_detection_ratio = self.collisions.ratio
        snapshot.actual_current_window = self.collisions.windows

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
        self.effective_gravity = add3(self._gravity, self._base_acceleration)
        self.dynamics = self.dynamics.copy()  # what is computed later of the periods so far has the other one
        self._load(self.dynamics, self._payload)
        self.bounds.load(self._payload.mass)
        loads = (self._payload, self._mounted or self._payload)
        numbers = (
            *self.effective_gravity,
            *(part for load in loads for part in (load.mass, *load.cog, *load.inertia)),
        )
        self._ordinary_load = largest(numbers) < _ORDINARY
        if self.drives is not None:
            self._load(self.drives.body.dynamics, self._mounted or self._payload)
            self.drives.wake()
        return True

    def _load(self, dynamics: "Dynamics", payload: Payload) -> None:
        dynamics.set_payload(payload.mass, payload.cog, payload.inertia)
        dynamics.set_gravity(self.effective_gravity)

    def _moved(self, motion: JointMotion, tcp: Pose, wrench: Vector6, driven: bool) -> bool:
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
            or not self.known
            or not self.state.target.settled
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
        external = (
            ZERO6
            if started
            else self._limited_torque(add(self._joint_torques(self.wrench, self.state.tool.now), self.link_torque))
        )
        if not self._driven:
            drives.hold(self.target_q, external, period_s)
        elif torque is not None:
            gravity = self.dynamics.gravity_torques(body.q)
            self._target_torque = add(torque.torque, gravity)
            drives.apply_torque(self.target_q, torque, gravity, external, period_s)
        else:
            rigid = self.dynamics.inverse_dynamics(self.target_q, self.target_qd, self.target_qdd)
            self._target_torque = _with_rotors(rigid, self._rotors, self.target_qdd)
            drives.follow(self.target_q, rigid, external, period_s)
        if not sum(map(abs, body.qd)) < _LOST_RAD_S:
            body.place(place)
        self.q, self.qd = self._sensors.joints(body, period_s)
        self.qdd = ZERO6 if before == body.qd else rate(body.qd, before, period_s)
        self.friction_W = ZERO6 if body.standing else body.friction_power

    def _moved_tool(self, before: ToolMotion, q: Vector6, qd: Vector6, period_s: float, *, started: bool) -> ToolMotion:
        now = self._tool_at(q, qd, self.tcp_offset)
        return ToolMotion(now, now if started else before.now, period_s)

    def _measure(self, tool: ToolMotion) -> ToolState:
        """Update the reported angles and speeds; returns the tool calculated from them."""
        if self.drives is None or self.qd == ZERO6:
            self.measured_q, self.measured_qd = self.q, self.qd
            return tool.now
        self.measured_q, self.measured_qd = self._sensors.reported(self.q, self.qd)
        return self._tool_at(self.measured_q, self.measured_qd, self.tcp_offset)

    def _joint_torques(self, wrench: Vector6, tool: ToolState) -> Vector6:
        """Joint torques of a wrench at the TCP."""
        return ZERO6 if wrench == ZERO6 else self.kinematics.joint_torques_at(tool.q, wrench, tool.pose)

    def _limited_torque(self, torque: Vector6) -> Vector6:
        """Limit an external torque so that the simulated body stays within reasonable bounds."""
        if not math.isfinite(sum(torque)):
            return ZERO6
        excess = max(abs(value) / most for value, most in zip(torque, self.model.torque_max, strict=True))
        return torque if excess <= _MAX_PUSH else lerp(ZERO6, torque, _MAX_PUSH / excess)

    def _read_sensors(self, tool: ToolMotion, installation: Installation) -> FlangeSensors:
        measured = self.wrench
        self._payload_error = ZERO6
        if self._mounted is not None and not self._mounted.has_same_weight(installation.payload):
            known, gravity = installation.payload, self.effective_gravity
            self._payload_error = weight_difference(tool.now, self._mounted, known, gravity)
            measured = add(measured, self._payload_error)
        sensors = FlangeSensors(
            tool, self._mounted or installation.payload, self.effective_gravity, self.wrench, self.sensor_in_flange
        )
        if self.drives is not None:
            sensors.acceleration = self._sensors.accelerometer(sensors.acceleration)
            if self._driven:
                measured = self._sensors.wrench(measured)
        if measured != ZERO6 or self.force_bias != ZERO6:
            sensors.tcp_force = sub(measured, self.force_bias)
        return sensors

    def _efforts(self, tool: ToolMotion) -> IdealEfforts | Efforts:
        motion = self.target_q, self.target_qd, self.target_qdd
        if self._driven and self.drives is None:
            load = self._load_on_joints(tool.now)
            efforts = IdealEfforts(self.dynamics, motion, self.model.series, self.torque_constants, load)
            if load is ZERO6:
                self.collisions.clear()
            else:
                self.collisions.compare(sub(efforts.actual_current, efforts.target_current))
            return efforts
        momentum = self.dynamics.linear_momentum(self.q, self.qd) if self.qd != ZERO6 else 0.0
        measured = Efforts(self.dynamics, motion, momentum)
        if self._driven and self.drives is not None:
            self._measure_currents(self.drives, measured)
            self.collisions.compare(sub(measured.actual_current, measured.target_current))
        else:
            self.collisions.clear()
        return measured

    def _load_on_joints(self, tool: ToolState) -> Vector6:
        """Joint torques of external loads; ZERO6 itself if there are none."""
        outside = self.wrench if self._mounted is None else add(self.wrench, self._payload_error)
        if outside == ZERO6 == self.link_torque:
            return ZERO6
        return add(self._joint_torques(outside, tool), self.link_torque)

    def _measure_currents(self, drives: Drives, efforts: Efforts) -> None:
        """Write currents and torques of a dynamic arm in the last period, as measured by its current sensors."""
        constants = self.torque_constants
        efforts.own_torque, efforts.target_torque = drives.feedforward, self._target_torque
        efforts.target_current = currents(add(self._target_torque, self._known_friction(self.target_qd)), constants)
        motors = currents(add(drives.torque, self._static_friction.torque(drives.body.qd)), constants)
        efforts.actual_current = self._sensors.currents(motors, drives.body.qd)
        efforts.control_output = demanded(self.model.series, motors, efforts.target_current)
        a, b, c, d, e, f = map(float.__mul__, efforts.actual_current, constants)
        efforts.actual_torque = (a, b, c, d, e, f)


def _with_rotors(torque: Vector6, rotors: Vector6, qdd: Vector6) -> Vector6:
    if qdd == ZERO6:
        return torque
    a, b, c, d, e, f = [own + inertia * rate for own, inertia, rate in zip(torque, rotors, qdd, strict=True)]
    return (a, b, c, d, e, f)


def _within(values: Vector6, most: Vector6) -> Vector6:
    """Scale all values by the same factor so that none exceeds its limit."""
    excess = max(abs(value) / limit for value, limit in zip(values, most, strict=True))
    return values if excess <= 1.0 else lerp(ZERO6, values, 1.0 / excess)
