"""Servoing: the arm follows twists, joint speeds or poses that arrive while it moves, as with MoveIt Servo.

Motion slows down near singularities, joint limits and, by the factor that somebody with a scene sets, obstacles. The
active forward controller executes it, whether it commands positions or velocities; activating one is up to the user, as
with MoveIt. Everything ends at rest: a command that is not repeated expires.

Facts: MoveIt Servo (types of commands, status codes, thresholds of condition numbers) and ur_moveit_config, whose
values are the defaults, except for the rate of collision checks.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from client.controllers.forward import ForwardCommandController
from client.controllers.manager import ControllerManager
from client.driver.endpoint import notify
from client.errors import ClientError
from urproto.joints import JOINT_NAMES
from urproto.robots import RobotModel, kinematics_of
from urproto.robots.pose import Pose, pose_sub

_Vector = npt.NDArray[np.float64]
_REST: Final = np.zeros(6)
_REST.flags.writeable = False

_COMMANDED: Final = ("position", "velocity")

ACCELERATION_RAD_S2: Final = 5.0
"""At which joints follow a command, and stop; source: joint_limits.yaml of ur_moveit_config, the same for each."""
_BRAKING: Final = 0.8  # share of the acceleration at which a joint is expected to stop before its limit
_DAMPING: Final = 1e-3  # of the pseudo-inverse
_LEAVING: Final = 0.1  # lowest factor on the way out of a singularity, so that no arm gets stuck there; guess
_PROBE_RAD: Final = 1e-3  # a motion this long tells whether it leads into a singularity or out of it
_POSE_GAIN_1_S: Final = 4.0  # from the distance of a pose to the speed towards it; guess
_LONGEST_PERIOD_S: Final = 0.02  # after a gap in the robot's states, motion goes on with this step


class CommandType(IntEnum):
    """Types of commands, numbered as in moveit_msgs/srv/ServoCommandType."""

    JOINT_JOG = 0
    TWIST = 1
    POSE = 2


class ServoStatus(IntEnum):
    """What limits the motion, numbered as in moveit_msgs/msg/ServoStatus."""

    INVALID = -1
    NO_WARNING = 0
    DECELERATE_FOR_APPROACHING_SINGULARITY = 1
    HALT_FOR_SINGULARITY = 2
    DECELERATE_FOR_LEAVING_SINGULARITY = 3
    DECELERATE_FOR_COLLISION = 4
    HALT_FOR_COLLISION = 5
    JOINT_BOUND = 6

    def __str__(self) -> str:
        return _TEXTS[self]


_TEXTS: Final = {
    ServoStatus.INVALID: "commands are not executed",
    ServoStatus.NO_WARNING: "no warnings",
    ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY: "slower because a singularity is near",
    ServoStatus.HALT_FOR_SINGULARITY: "stopped before a singularity",
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: "slower on the way out of a singularity",
    ServoStatus.DECELERATE_FOR_COLLISION: "slower because of an obstacle ahead",
    ServoStatus.HALT_FOR_COLLISION: "stopped before an obstacle",
    ServoStatus.JOINT_BOUND: "slower because a joint is near its limit",
}


@dataclass(frozen=True)
class ServoScale:
    """What a command of 1 means if commands are unitless: m/s, rad/s of a twist, rad/s of a joint.

    The first two are also the greatest speeds towards a pose.
    """

    linear: float = 0.6
    rotational: float = 0.3
    joint: float = 0.01


@dataclass(frozen=True)
class PoseTracking:
    """Distances at which a pose is reached [m, rad]."""

    linear_tolerance: float = 0.001
    angular_tolerance: float = 0.01


@dataclass(frozen=True)
class ServoParameters:
    """Parameters, with the names and units of MoveIt Servo.

    command_in_type: unitless or speed_units. incoming_command_timeout: after which a command expires [s].
    *_singularity_threshold: condition numbers of the Jacobian. joint_limit_margin: rad.
    """

    command_in_type: str = "speed_units"
    scale: ServoScale = field(default_factory=ServoScale)
    incoming_command_timeout: float = 0.1
    lower_singularity_threshold: float = 100.0
    hard_stop_singularity_threshold: float = 200.0
    leaving_singularity_threshold_multiplier: float = 2.0
    joint_limit_margin: float = 0.1
    check_collisions: bool = True
    collision_check_rate: float = 50.0  # Hz; a check takes about a millisecond
    pose_tracking: PoseTracking = field(default_factory=PoseTracking)

    def __post_init__(self) -> None:
        if self.command_in_type not in ("unitless", "speed_units"):
            raise ClientError(f"command_in_type is {self.command_in_type!r}: choose unitless or speed_units")
        if not 0.0 < self.lower_singularity_threshold < self.hard_stop_singularity_threshold:
            raise ClientError(
                "lower_singularity_threshold must be above 0 and below hard_stop_singularity_threshold "
                f"({self.hard_stop_singularity_threshold:g})"
            )
        for name in ("incoming_command_timeout", "collision_check_rate", "leaving_singularity_threshold_multiplier"):
            if not getattr(self, name) > 0.0:
                raise ClientError(f"{name} must be above 0, not {getattr(self, name):g}")


@dataclass(frozen=True)
class ServoMotion:
    """What the arm is about to do.

    q_rad: commanded configuration (6,). qd_rad_s: its joint speeds (6,) as soon as they are reached, before they are
    reduced for obstacles. status: what limits them.
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    status: ServoStatus


class Servo:
    """Moves one arm by commands; `update` is called after each control cycle.

    status: what limits the motion. on_status: called with it when it changes. model: the arm, with its calibration if
    it is known. prefix: of joint names.
    """

    def __init__(self, manager: ControllerManager, model: RobotModel, prefix: str = "") -> None:
        self.parameters = ServoParameters()
        self.status = ServoStatus.NO_WARNING
        self.on_status: list[Callable[[ServoStatus], object]] = []
        self._manager = manager
        self._kinematics = kinematics_of(model)
        self._limits = (*model.position_limits, model.qd_max)
        self._angles = manager.hardware.states.lend([f"{prefix}{joint}/position" for joint in JOINT_NAMES])
        self._scaling = manager.hardware.states.lend([f"{prefix}speed_scaling/speed_scaling_factor"])
        self._joints = [prefix + joint for joint in JOINT_NAMES]
        self._kind = CommandType.TWIST
        self._command: Sequence[float] | None = None
        self._received_s = self._updated_s = 0.0
        self._free = 1.0  # share of the speed that obstacles allow
        self._q: _Vector | None = None  # None: at rest, wherever the arm is
        self._qd = self._wanted = _REST

    def configure(self, parameters: ServoParameters) -> None:
        self.parameters = parameters

    # commands

    def jog(self, joints: Mapping[str, float]) -> None:
        """Move joints at these speeds [rad/s], all others not. Raises ClientError for a joint that does not exist."""
        if unknown := joints.keys() - set(self._joints):
            raise ClientError(f"the arm has no joint {min(unknown)!r}; it has {', '.join(self._joints)}")
        scale = self.parameters.scale.joint if self._unitless else 1.0
        self._accept(CommandType.JOINT_JOG, [scale * joints.get(name, 0.0) for name in self._joints])

    def twist(self, twist: Sequence[float]) -> None:
        """Move the flange with this velocity (6,) along the axes of the base frame [m/s, rad/s]."""
        scale = self.parameters.scale
        linear, angular = (scale.linear, scale.rotational) if self._unitless else (1.0, 1.0)
        self._accept(CommandType.TWIST, [linear * v for v in twist[:3]] + [angular * w for w in twist[3:]])

    def pose(self, pose_base_flange: Pose) -> None:
        """Move the flange towards a pose [m, rotation vector]."""
        self._accept(CommandType.POSE, pose_base_flange)

    def stop(self) -> None:
        """Come to rest."""
        self._command = None

    def limit(self, share: float) -> None:
        """Limit the speed to this share, from 0 to 1, because of obstacles ahead."""
        self._free = share

    def motion(self) -> ServoMotion:
        """What the arm is about to do."""
        q = self._angles.get() if self._q is None else self._q.tolist()
        return ServoMotion(tuple(q), tuple(self._wanted.tolist()), self.status)

    @property
    def _unitless(self) -> bool:
        return self.parameters.command_in_type == "unitless"

    def _accept(self, kind: CommandType, command: Sequence[float]) -> None:
        """Execute a command from the next cycle on. Raises ClientError if it cannot be executed."""
        if not all(map(math.isfinite, command)):
            raise ClientError(f"the command has numbers that are not finite: {list(command)}")
        if self._controller() is None:
            names = [one.name for one in self._manager.active() if one.command_interfaces]
            raise ClientError(
                "no forward controller is active that commands positions or velocities of the arm "
                f"(active: {', '.join(names) or 'none'}): activate forward_position_controller"
            )
        self._kind, self._command, self._received_s = kind, command, self._manager.time_s
        if self._q is None:
            self._wanted = self._speeds(np.array(self._angles.get()))[0]

    def _controller(self) -> ForwardCommandController | None:
        """The controller that executes commands; None if no such one is active."""
        for controller in self._manager.active():
            if (
                isinstance(controller, ForwardCommandController)
                and controller.interface_name in _COMMANDED
                and list(controller.parameters.joints) == self._joints
            ):
                return controller
        return None

    # in every cycle

    def update(self) -> None:
        """Pass the next positions or velocities to the active forward controller, unless the arm is at rest."""
        now_s, before_s = self._manager.time_s, self._updated_s
        self._updated_s = now_s
        if self._command is None and self._q is None:
            return
        before, self.status = self.status, self._move(now_s, min(max(now_s - before_s, 0.0), _LONGEST_PERIOD_S))
        if self.status is not before:
            notify(self.on_status, self.status)

    def _move(self, now_s: float, period_s: float) -> ServoStatus:
        controller = self._controller()
        angles = self._angles.get()
        scaling = self._scaling.get()[0]
        if controller is None or not all(
            map(math.isfinite, (scaling, *angles))
        ):  # it was deactivated, or the robot is gone
            self._command, self._q, self._qd, self._wanted = None, None, _REST, _REST
            return ServoStatus.INVALID
        if now_s - self._received_s > self.parameters.incoming_command_timeout:
            self._command = None
        if self._q is None:
            self._q = np.array(angles)
        self._wanted, status = self._speeds(self._q)
        self._accelerate(self._free * scaling * self._wanted, period_s)
        self._q = self._q + period_s * self._qd
        controller.command((self._q if controller.interface_name == "position" else self._qd).tolist())
        if self._command is None and not self._qd.any():
            self._q, self._qd, self._wanted = None, _REST, _REST
            self._free = 1.0
            return ServoStatus.NO_WARNING
        return status

    def _accelerate(self, wanted: _Vector, period_s: float) -> None:
        change = wanted - self._qd
        most = float(np.abs(change).max())
        step = ACCELERATION_RAD_S2 * period_s
        self._qd = wanted if most <= step else self._qd + change * (step / most)

    def _speeds(self, q: _Vector) -> tuple[_Vector, ServoStatus]:
        """The joint speeds for the command, before they are reduced for obstacles, and what limits the motion."""
        if self._command is None:
            return _REST, self.status
        if self._kind is CommandType.JOINT_JOG:
            qd, status = np.array(self._command), ServoStatus.NO_WARNING
        else:
            qd, status = self._follow(q, np.array(self._twist(q)))
        qd, bounded = self._within_limits(q, qd)
        if bounded:
            return qd, ServoStatus.JOINT_BOUND
        if self._free < 1.0 and status is ServoStatus.NO_WARNING:
            return qd, ServoStatus.DECELERATE_FOR_COLLISION if self._free else ServoStatus.HALT_FOR_COLLISION
        return qd, status

    def _twist(self, q: _Vector) -> Sequence[float]:
        assert self._command is not None
        if self._kind is CommandType.TWIST:
            return self._command
        off = pose_sub(self._command, self._kinematics.forward(q.tolist()))
        move, turn = off[:3], off[3:]
        scale, near = self.parameters.scale, self.parameters.pose_tracking
        if math.hypot(*move) < near.linear_tolerance and math.hypot(*turn) < near.angular_tolerance:
            return (0.0,) * 6
        return [*_capped(move, scale.linear), *_capped(turn, scale.rotational)]

    def _follow(self, q: _Vector, twist: _Vector) -> tuple[_Vector, ServoStatus]:
        """Joint speeds for a twist, reduced near singularities."""
        jacobian = np.array(self._kinematics.jacobian(q.tolist()))
        u, s, vt = np.linalg.svd(jacobian)
        qd: _Vector = vt.T @ ((u.T @ twist) * s / (s * s + _DAMPING * _DAMPING))
        lower, upper = self.parameters.lower_singularity_threshold, self.parameters.hard_stop_singularity_threshold
        condition = _condition(s)
        if condition <= lower or not qd.any():
            return qd, ServoStatus.NO_WARNING
        ahead = q + qd * (_PROBE_RAD / np.abs(qd).max())
        after = np.linalg.svd(np.array(self._kinematics.jacobian(ahead.tolist())), compute_uv=False)
        if _condition(after) > condition:
            share = 1.0 - (condition - lower) / (upper - lower)
            if share <= 0.0:
                return _REST, ServoStatus.HALT_FOR_SINGULARITY
            return qd * share, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
        upper = lower + (upper - lower) * self.parameters.leaving_singularity_threshold_multiplier
        share = max(_LEAVING, 1.0 - (condition - lower) / (upper - lower))
        return qd * share, ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY

    def _within_limits(self, q: _Vector, qd: _Vector) -> tuple[_Vector, bool]:
        """Speeds in the same proportion, slow enough for every joint to stop before its limit; whether they changed."""
        margin, fastest, share = self.parameters.joint_limit_margin, 1.0, 1.0
        for angle, rate, low, high, limit in zip(q.tolist(), qd.tolist(), *self._limits, strict=True):
            speed, room = abs(rate), (high - angle if rate > 0.0 else angle - low) - margin
            stoppable = math.sqrt(2.0 * _BRAKING * ACCELERATION_RAD_S2 * max(room, 0.0))
            if speed > stoppable:
                share = min(share, stoppable / speed)
            if speed > limit:
                fastest = min(fastest, limit / speed)
        return qd * min(share, fastest), share < 1.0


def _condition(singular_values: _Vector) -> float:
    return float(singular_values[0] / max(singular_values[-1], 1e-12))


def _capped(vector: Sequence[float], longest: float) -> list[float]:
    """A velocity in proportion to a distance, but no more than ``longest``."""
    length = _POSE_GAIN_1_S * math.hypot(*vector)
    factor = _POSE_GAIN_1_S * (longest / length if length > longest else 1.0)
    return [factor * part for part in vector]
