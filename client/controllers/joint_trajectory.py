"""Joint trajectory controllers, which follow trajectories setpoint by setpoint."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, ClassVar, Final

from client.controllers.controller import Interfaces, Topic, controller_type
from client.controllers.goals import (
    ErrorCode,
    Feedback,
    FollowJointTrajectory,
    GoalController,
    GoalHandle,
    JointTrajectory,
    JointTrajectoryPoint,
    Tolerance,
)
from client.controllers.parameters import BY_NAME, without_effect
from client.controllers.trajectory import Path, Sample, blended, filled
from client.controllers.validation import ToleranceError, Tolerances, TrajectoryRules, violation, with_goal
from urproto.text import quoted

_EVERY_CYCLE: Final = "states and results are reported in the cycle in which they occur"
_COMMANDS: Final = ("position", "velocity", "effort")
_STATES: Final = ("position", "velocity", "acceleration")
_PREEMPTED: Final = "Current goal preempted by new incoming action."


@dataclass(frozen=True, slots=True)
class Gains:
    """PID gains of one joint, and the share of the planned velocity that is added (feedforward).

    Clamps limit the integral term (i) and the sum of all terms (u).
    """

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    ff_velocity_scale: float = 0.0
    i_clamp_max: float = inf
    i_clamp_min: float = -inf
    u_clamp_max: float = inf
    u_clamp_min: float = -inf


class Pid:
    """PID controller of one joint; errors are desired minus actual [rad, rad/s]."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self._integral = 0.0

    def reset(self) -> None:
        self._integral = 0.0

    def command(self, error: float, error_rate: float, period_s: float) -> float:
        """Compute the output for an error."""
        gains = self.gains
        part = self._integral + gains.i * error * period_s
        self._integral = min(max(part, gains.i_clamp_min), gains.i_clamp_max)
        total = gains.p * error + self._integral + gains.d * error_rate
        return min(max(total, gains.u_clamp_min), gains.u_clamp_max)


def deceleration(
    q_rad: Sequence[float], qd_rad_s: Sequence[float], limits_rad_s2: Sequence[float]
) -> list[JointTrajectoryPoint]:
    """Points of a stopping trajectory on which each joint (n,) decelerates constantly at its own limit.

    There is a point wherever a joint comes to rest; cubic interpolation between the points is exact.
    """
    moments = sorted({0.0, *(abs(v) / a for v, a in zip(qd_rad_s, limits_rad_s2, strict=True))})
    return [_after(t, q_rad, qd_rad_s, limits_rad_s2) for t in moments]


def _after(
    t: float, q_rad: Sequence[float], qd_rad_s: Sequence[float], limits_rad_s2: Sequence[float]
) -> JointTrajectoryPoint:
    positions, speeds = [], []
    for q, v, a in zip(q_rad, qd_rad_s, limits_rad_s2, strict=True):
        stop_s = abs(v) / a
        share = 1.0 - min(t, stop_s) / stop_s if stop_s > 0.0 else 0.0  # share of the initial speed that is left
        positions.append(q + v * stop_s * (1.0 - share * share) / 2.0)
        speeds.append(v * share)
    return JointTrajectoryPoint(tuple(positions), tuple(speeds), time_from_start_s=t)


def _limited_speed(speed: float, than: float) -> float:
    """Limit a speed to another one; 0 if they have opposite signs."""
    return math.copysign(min(abs(speed), abs(than)), speed) if speed * than > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class JointConstraints:
    """Tolerances of one joint [rad], and its maximum deceleration [rad/s2]; 0 means none."""

    trajectory: float = 0.0
    goal: float = 0.0
    max_deceleration_on_cancel: float = 0.0


@dataclass(frozen=True, slots=True)
class Constraints:
    """goal_time [s]: how late the arm may arrive, 0 for no limit; stopped_velocity_tolerance [rad/s] at the end."""

    stopped_velocity_tolerance: float = 0.01
    goal_time: float = 0.0
    decelerate_on_cancel: bool = False
    joints: dict[str, JointConstraints] = field(default_factory=dict, metadata=BY_NAME)


@dataclass(frozen=True, slots=True)
class GainsByJoint:
    """Gains for controllers that command velocities or torques."""

    joints: dict[str, Gains] = field(default_factory=dict, metadata=BY_NAME)


@dataclass(frozen=True, slots=True)
class SpeedScaling:
    """Source of the speed scaling factor; with state_interface "" it stays unchanged."""

    initial_scaling_factor: float = 1.0
    state_interface: str = ""
    command_interface: str = without_effect("", "the speed slider is moved by io_and_status_controller")


@dataclass(frozen=True, slots=True)
class JointTrajectoryParameters:
    """Parameters as in ros2_controllers; topics that ROS 2 publishes at separate rates are published every cycle."""

    joints: tuple[str, ...]
    command_interfaces: tuple[str, ...]
    state_interfaces: tuple[str, ...]
    command_joints: tuple[str, ...] = ()
    allow_partial_joints_goal: bool = False
    allow_trajectory_replacement: bool = True
    interpolate_from_desired_state: bool = False
    allow_integration_in_goal_trajectories: bool = False
    allow_nonzero_velocity_at_trajectory_end: bool = False
    set_last_command_interface_value_as_state_on_activation: bool = True
    interpolation_method: str = "splines"
    cmd_timeout: float = 0.0
    constraints: Constraints = field(default_factory=Constraints)
    gains: GainsByJoint = field(default_factory=GainsByJoint)
    speed_scaling: SpeedScaling = field(default_factory=SpeedScaling)
    state_publish_rate: float = without_effect(50.0, _EVERY_CYCLE, unless=(100.0,))  # as in the official file
    action_monitor_rate: float = without_effect(20.0, _EVERY_CYCLE)
    update_rate: int = without_effect(0, "it is updated with each state of the robot", unless=(125, 500))


@dataclass(frozen=True, slots=True)
class ScaledJointTrajectoryParameters(JointTrajectoryParameters):
    """Adds the name of the state interface with the scaling factor."""

    speed_scaling_interface_name: str = "speed_scaling/speed_scaling_factor"


@dataclass(frozen=True, slots=True)
class ControllerState:
    """State of one cycle: reference, feedback, error and output (n,) in the order of joint_names."""

    time_s: float
    joint_names: tuple[str, ...]
    reference: JointTrajectoryPoint
    feedback: JointTrajectoryPoint
    error: JointTrajectoryPoint
    output: JointTrajectoryPoint
    speed_scaling_factor: float


@controller_type("joint_trajectory_controller/JointTrajectoryController")
class JointTrajectoryController(GoalController[JointTrajectoryParameters]):
    """Follows trajectories: linear, cubic or quintic, with tolerances; holds the arm in between.

    `send_goal` takes a goal that ends with a result, `command` a trajectory without one. Commands positions, or
    velocities or torques through PID control. state_topic: one message per cycle.
    """

    def __init__(self, name: str, parameters: JointTrajectoryParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.joints = parameters.joints
        self.state_topic: Topic[ControllerState] = Topic()
        self.scaling = parameters.speed_scaling.initial_scaling_factor
        self._now_s = 0.0
        self._pending: JointTrajectory | None = None
        self._path: Path | None = None
        self._path_s = 0.0
        self._holding = True
        self._old_points = 0  # of the path's points, before those of the goal
        self._pids: list[Pid] = []
        self._parts: list[Interfaces | None] = []  # of the states, by kind
        self._defaults = self._tolerances = Tolerances((), ())
        self._actual = self._commanded = JointTrajectoryPoint()
        self._commanded_s: float | None = None

    # the life cycle

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return self._names(self.parameters.command_interfaces)

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        scaling = self._scaling_interface
        return self._names(self.parameters.state_interfaces) + ((scaling,) if scaling else ())

    @property
    def _scaling_interface(self) -> str:
        return self.parameters.speed_scaling.state_interface

    @property
    def _command(self) -> str:
        return self.parameters.command_interfaces[0]

    def _names(self, kinds: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(f"{joint}/{kind}" for kind in kinds for joint in self.joints)

    def on_configure(self) -> None:
        given = self.parameters
        self._check_parameters()
        limits = [given.constraints.joints.get(joint, JointConstraints()) for joint in self.joints]
        stopped = given.constraints.stopped_velocity_tolerance
        self._defaults = self._tolerances = Tolerances(
            tuple(Tolerance(limit.trajectory) for limit in limits),
            tuple(Tolerance(limit.goal, stopped) for limit in limits),
            given.constraints.goal_time,
        )
        self._pids = [Pid(given.gains.joints.get(joint, Gains())) for joint in self.joints]

    def _check_parameters(self) -> None:
        given = self.parameters
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise self.error("joints must list each joint once")
        if given.command_joints not in ((), self.joints):
            raise self.error("command_joints that differ from joints are not supported: leave them out")
        if len(given.command_interfaces) != 1 or self._command not in _COMMANDS:
            raise self.error(
                f"command_interfaces is one of {', '.join(_COMMANDS)}, not {quoted(given.command_interfaces)}"
            )
        if "position" not in given.state_interfaces or not set(given.state_interfaces) <= set(_STATES):
            raise self.error(f"state_interfaces must include position, and may include others of {', '.join(_STATES)}")
        if self._command != "position" and "velocity" not in given.state_interfaces:
            raise self.error(f"a controller that commands {self._command} needs the state interface velocity")
        if given.interpolation_method not in ("splines", "none"):
            raise self.error(f"interpolation_method is splines or none, not {quoted(given.interpolation_method)}")
        named = {*given.constraints.joints, *given.gains.joints}
        if unknown := sorted(named - set(self.joints)):
            raise self.error(f"constraints or gains are given for {unknown[0]}, which is not one of its joints")
        braking = given.constraints.joints
        if given.constraints.decelerate_on_cancel and not all(
            joint in braking and braking[joint].max_deceleration_on_cancel > 0.0 for joint in self.joints
        ):
            raise self.error("decelerate_on_cancel needs a max_deceleration_on_cancel above 0 for every joint")
        if given.constraints.decelerate_on_cancel and "velocity" not in given.state_interfaces:
            raise self.error("decelerate_on_cancel needs the state interface velocity")

    def on_activate(self, time_s: float) -> None:
        self._now_s = time_s
        self._pending, self._path, self._commanded_s = None, None, None
        for pid in self._pids:
            pid.reset()
        self._parts = [self._part(kind) for kind in _STATES]
        self._read()
        standing = self._last_command() or self._actual.positions
        self._commanded = JointTrajectoryPoint(tuple(standing))
        self._hold(self._commanded)

    def _part(self, kind: str) -> Interfaces | None:
        return self.states.lend(self._names((kind,))) if kind in self.parameters.state_interfaces else None

    def _last_command(self) -> list[float] | None:
        if self._command != "position" or not self.parameters.set_last_command_interface_value_as_state_on_activation:
            return None
        values = self.commands.get()
        return None if any(value != value for value in values) else values

    def on_deactivate(self) -> None:
        self._abort_goal("Current goal cancelled during deactivate transition.")
        if self._command != "position":
            self.commands.fill(0.0)
        self._path = self._pending = None

    # goals

    def send_goal(self, goal: FollowJointTrajectory | JointTrajectory) -> GoalHandle:
        """Start a goal; a goal that is under way is aborted.

        Raises GoalRejectedError, or ControllerError while the controller is not active.
        """
        if isinstance(goal, JointTrajectory):
            goal = FollowJointTrajectory(goal)
        self.check_active()
        self.check(goal.trajectory)
        try:
            tolerances = with_goal(self._defaults, goal, self.joints)
        except ToleranceError as error:
            raise self._rejected(str(error)) from None
        self._abort_goal(_PREEMPTED)
        self._tolerances, self._pending = tolerances, goal.trajectory
        return self._accept(goal)

    def command(self, trajectory: JointTrajectory) -> None:
        """Follow a trajectory without a result, as from the topic ~/joint_trajectory; raises like `send_goal`."""
        self.check_active()
        self.check(trajectory)
        self._abort_goal(_PREEMPTED)
        self._tolerances, self._pending = self._defaults, trajectory

    def sampled(self, time_s: float) -> JointTrajectoryPoint:
        """State of the present trajectory at the robot's time ``time_s``, assuming the present speed scaling.

        Raises ControllerError without a trajectory, and for times before its start or after its end.
        """
        self.check_active()
        if self._holding or self._pending is not None or self._path is None or not self._path.begun:
            raise self.error("it follows no trajectory now")
        sample = self._path.sample(self._path_s + (time_s - self._now_s) * self._pace)
        if sample is None:
            raise self.error("the requested time is before the start of the trajectory")
        if sample.index == self._path.size:
            raise self.error("the requested time is after the end of the trajectory")
        return sample.point

    def set_scaling(self, factor: float) -> None:
        """Set how fast the time of trajectories passes, until the robot's speed scaling, if it is read, replaces it.

        Raises ControllerError for a factor below 0, and if the controller does not command positions.
        """
        if not 0.0 <= factor < math.inf:
            raise self.error(f"a speed scaling factor is 0 or more, not {factor}")
        if self._command != "position":
            raise self.error("its speed cannot be scaled, because it does not command positions")
        self.scaling = factor

    def on_halt(self, reason: str) -> None:
        self._read()
        self._stop_and_abort(reason)
        self._hold(JointTrajectoryPoint(self._actual.positions))

    def cancel(self) -> None:
        """Stop the arm; the goal under way is canceled."""
        self.check_active()
        self._stop()
        self._cancel_goal()

    @property
    def progress(self) -> float:
        """Elapsed share of the present trajectory's time, 0 to 1; 1 while holding."""
        if self._pending is not None:
            return 0.0
        if self._holding or self._path is None or not self._path.begun:
            return 1.0 if self._holding else 0.0
        length_s = self._path.points[-1].time_from_start_s
        return min(max((self._path_s - self._path.start_s) / length_s, 0.0), 1.0) if length_s > 0.0 else 1.0

    def check(self, trajectory: JointTrajectory) -> None:
        """Check that a trajectory would be accepted if the controller were active. Raises GoalRejectedError if not."""
        given = self.parameters
        TrajectoryRules(
            self.name,
            self.joints,
            given.allow_partial_joints_goal,
            given.allow_integration_in_goal_trajectories,
            given.allow_nonzero_velocity_at_trajectory_end,
            self._command == "effort",
        ).check(trajectory, self._now_s)

    # a cycle

    def update(self, time_s: float, period_s: float) -> None:
        self._now_s = time_s
        self._read()
        self._accept_pending(time_s, period_s)
        path = self._path
        assert path is not None  # since the activation
        first = not path.begun
        if first:
            self._begin(path, time_s)
        else:
            self._path_s += period_s * self._pace
        desired = path.sample(self._path_s)
        ahead = path.sample(self._path_s + 1.0 / self.update_rate_hz)
        if desired is None or ahead is None:
            return
        error = self._error(desired.point)
        broken, missed, late = self._check_tolerances(error, ahead, first)
        if not broken and not late:
            self._write_command(ahead.point, error, period_s)
            self._commanded_s = time_s
        self._publish_state(time_s, desired, error)
        self._finish_goal(broken, missed, late, ahead)

    @property
    def _pace(self) -> float:
        """How fast the path's time passes; a stopping trajectory is planned in the robot's own time."""
        return 1.0 if self._holding and self.scaling > 0.0 else self.scaling

    def _read(self) -> None:
        q, qd, qdd = (tuple(part.get()) if part else () for part in self._parts)
        self._actual = JointTrajectoryPoint(q, qd, qdd)
        if self._scaling_interface:
            factor = self.states[self._scaling_interface]
            self.scaling = factor if factor == factor else self.scaling

    def _accept_pending(self, time_s: float, period_s: float) -> None:
        if (new := self._pending) is None:
            return
        self._pending, old = None, self._path
        joined = None
        if self.parameters.allow_trajectory_replacement and not self._holding and old and old.begun:
            wait_s = new.stamp_s - time_s if new.stamp_s else 0.0
            cursor_s = self._path_s + period_s * self._pace
            begin_s = cursor_s + wait_s * (self.scaling if wait_s > 0.0 else 1.0)
            joined = blended(new, self.joints, old, cursor_s, begin_s)
        if joined is None:
            hold = self._last_command() or self._actual.positions
            self._path, self._old_points = self._new_path(filled(new, self.joints, hold), new.stamp_s), 0
        else:
            self._path, self._old_points = self._new_path(joined[0]), joined[1]
        self._holding = False

    def _new_path(self, points: list[JointTrajectoryPoint], stamp_s: float = 0.0) -> Path:
        return Path(points, stamp_s, splines=self.parameters.interpolation_method == "splines")

    def _begin(self, path: Path, time_s: float) -> None:
        self._path_s = time_s
        if self.parameters.interpolate_from_desired_state and self._commanded_s is not None:
            path.begin(time_s, self._commanded, self._commanded_s)
        else:
            path.begin(time_s, self._actual)

    def _error(self, desired: JointTrajectoryPoint) -> JointTrajectoryPoint:
        """Desired minus actual; for velocities only if velocities or torques are commanded."""
        actual = self._actual
        positions = tuple(a - b for a, b in zip(desired.positions, actual.positions, strict=True))
        if self._command == "position":
            return JointTrajectoryPoint(positions)
        speeds = tuple(a - b for a, b in zip(desired.velocities, actual.velocities, strict=True))
        return JointTrajectoryPoint(positions, speeds)

    def _check_tolerances(
        self, error: JointTrajectoryPoint, ahead: Sample, first: bool
    ) -> tuple[str | None, str | None, bool]:
        """Return the violated path tolerance, the violated goal tolerance, and whether the goal's time is over."""
        if self._holding:
            return None, None, False
        assert self._path is not None
        at_end = ahead.index == self._path.size
        limits = self._tolerances
        broken = violation(error, limits.path, self.joints) if first or not at_end else None
        missed = violation(error, limits.goal, self.joints) if at_end else None
        since_s = ahead.since_s - 1.0 / self.update_rate_hz
        timeout_s = self.parameters.cmd_timeout
        if at_end and timeout_s > limits.goal_time_s and since_s > timeout_s:
            if self.goal is None:
                self._stop()
            missed = None  # from now on the arm holds, and a goal under way counts as reached, as in ros2_controllers
        return broken, missed, bool(missed) and 0.0 < limits.goal_time_s < since_s

    def _write_command(self, point: JointTrajectoryPoint, error: JointTrajectoryPoint, period_s: float) -> None:
        self._commanded = point
        if self._command == "position":
            self.commands.put(point.positions)
            return
        effort = point.effort if self._command == "effort" and point.effort else (0.0,) * len(self.joints)
        self.commands.put(
            [
                pid.gains.ff_velocity_scale * speed + added + pid.command(off, off_rate, period_s)
                for pid, speed, added, off, off_rate in zip(
                    self._pids, point.velocities, effort, error.positions, error.velocities, strict=True
                )
            ]
        )

    def _publish_state(self, time_s: float, desired: Sample, error: JointTrajectoryPoint) -> None:
        self.state_topic.publish(
            ControllerState(time_s, self.joints, desired.point, self._actual, error, self._output(), self.scaling)
        )
        if self.goal is not None:
            index = max(0, desired.index - self._old_points)
            self.goal.publish_feedback(Feedback(time_s, desired.point, self._actual, error, index))

    def _output(self) -> JointTrajectoryPoint:
        """Values of the command interfaces, which are of one kind; the rest is empty, as in ros2_controllers."""
        values = tuple(self.commands.get())
        if self._command == "position":
            return JointTrajectoryPoint(values)
        return JointTrajectoryPoint((), values) if self._command == "velocity" else JointTrajectoryPoint(effort=values)

    def _finish_goal(self, broken: str | None, missed: str | None, late: bool, ahead: Sample) -> None:
        if self._holding:
            return
        assert self._path is not None
        if broken:
            text = f"Aborted due to path tolerance violation ({broken})"
            self._stop_and_abort(text, ErrorCode.PATH_TOLERANCE_VIOLATED)
        elif late:
            exceeded_s = ahead.since_s - 1.0 / self.update_rate_hz
            text = f"Aborted due to goal_time_tolerance exceeding by {exceeded_s:f} seconds ({missed})"
            self._stop_and_abort(text, ErrorCode.GOAL_TOLERANCE_VIOLATED)
        elif self.goal is not None and ahead.index == self._path.size and not missed:
            self._hold(self._path.last())
            self.goal.succeed("Goal successfully reached!")

    def _stop_and_abort(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        self._stop(from_actual=True)
        self._abort_goal(text, code)

    # rest

    def _stop(self, from_actual: bool = False) -> None:
        """Hold the arm's position, or bring the arm to rest and hold that position.

        from_actual: the arm is not where it was commanded. It then decelerates from its actual position, as in
        ros2_controllers. Otherwise it decelerates from the commanded position, which is ahead of it while it moves, but
        never from a speed above the actual one, because a path may command any speed.
        """
        self._pending = None
        constraints, sent, actual = self.parameters.constraints, self._commanded, self._actual
        if not constraints.decelerate_on_cancel or not sent.velocities or self._holding:
            self._hold(JointTrajectoryPoint(actual.positions))
            return
        limits = [constraints.joints[joint].max_deceleration_on_cancel for joint in self.joints]
        if from_actual:
            begin, speeds = actual.positions, list(actual.velocities)
        else:
            begin = sent.positions
            speeds = [
                _limited_speed(speed * self.scaling, real)
                for speed, real in zip(sent.velocities, actual.velocities, strict=True)
            ]
        self._path = Path(deceleration(begin, speeds, limits))
        self._holding = True

    def _hold(self, point: JointTrajectoryPoint) -> None:
        self._path = Path([JointTrajectoryPoint(point.positions, point.velocities, point.accelerations)])
        self._holding = True


@controller_type("ur_controllers/ScaledJointTrajectoryController")
class ScaledJointTrajectoryController(JointTrajectoryController):
    """Joint trajectory controller that follows the robot's speed scaling: a slower robot stretches the trajectory."""

    parameters_type: ClassVar[type[Any]] = ScaledJointTrajectoryParameters
    parameters: ScaledJointTrajectoryParameters

    @property
    def _scaling_interface(self) -> str:
        return self.parameters.speed_scaling_interface_name
