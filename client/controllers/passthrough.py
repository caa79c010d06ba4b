"""Controller that passes whole trajectories to the robot, which interpolates them itself.

The controller sets one point at a time on the command interfaces, and the hardware takes it. Once the hardware has all
points, it executes them. `Transfer` shows whose turn it is. Source of interfaces and states: ur_controllers.
"""

from dataclasses import dataclass
from typing import Final

from client.controllers.controller import NO_COMMAND, controller_type
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
from client.controllers.trajectory import filled
from client.controllers.validation import ToleranceError, Tolerances, TrajectoryRules, violation, with_goal
from urproto.compat import IntEnum
from urproto.joints import JOINT_NAMES

PASSTHROUGH: Final = "trajectory_passthrough"
POINT: Final = ("setpoint_positions", "setpoint_velocities", "setpoint_accelerations")
PASSTHROUGH_COMMANDS: Final = tuple(
    f"{PASSTHROUGH}/{name}"
    for name in (
        *(f"{part}_{joint}" for part in POINT for joint in range(len(JOINT_NAMES))),
        *("abort", "transfer_state", "time_from_start", "trajectory_size"),
    )
)


class Transfer(IntEnum):
    """State of the transfer, which shows whose turn it is."""

    IDLE = 0
    WAITING_FOR_POINT = 1  # set by the hardware: it expects the next point
    TRANSFERRING = 2  # set by the controller: the point is on the interfaces
    TRANSFER_DONE = 3  # set by the controller: there are no more points
    IN_MOTION = 4
    DONE = 5  # set by the hardware: the arm is at rest again
    NEW_TRAJECTORY = 6


@dataclass(frozen=True, slots=True)
class PassthroughParameters:
    """speed_scaling_interface_name: state interface with the robot's speed scaling."""

    joints: tuple[str, ...]
    state_interfaces: tuple[str, ...] = ("position", "velocity")
    tf_prefix: str = ""
    speed_scaling_interface_name: str = "speed_scaling/speed_scaling_factor"


@controller_type("ur_controllers/PassthroughTrajectoryController")
class PassthroughTrajectoryController(GoalController[PassthroughParameters]):
    """Lets the robot itself execute trajectories, as splines: smooth regardless of network delays.

    It takes one goal at a time. The goal succeeds if the arm is within its tolerances at the end.
    """

    def __init__(self, name: str, parameters: PassthroughParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.joints = parameters.joints
        self._points: list[JointTrajectoryPoint] = []
        self._next = self._passed = 0  # number of points handed over, and passed by the arm
        self._elapsed_s = 0.0
        self._limits = Tolerances((), ())
        self._now_s = 0.0

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(self.parameters.tf_prefix + name for name in PASSTHROUGH_COMMANDS)

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        given = self.parameters
        names = tuple(f"{joint}/{kind}" for kind in given.state_interfaces for joint in self.joints)
        return (*names, given.speed_scaling_interface_name)

    def _name(self, interface: str) -> str:
        return f"{self.parameters.tf_prefix}{PASSTHROUGH}/{interface}"

    def on_configure(self) -> None:
        if len(self.joints) != 6 or len(set(self.joints)) != 6:
            raise self.error("joints must list the robot's six joints")
        if "position" not in self.parameters.state_interfaces:
            raise self.error("state_interfaces must include position")

    def on_activate(self, time_s: float) -> None:
        self._now_s = time_s
        self._set("transfer_state", Transfer.IDLE)
        self._set("abort", 0.0)

    def on_deactivate(self) -> None:
        self._set("abort", 1.0)
        self._abort_goal("Aborting current goal, since the controller is being deactivated.")

    def on_halt(self, reason: str) -> None:
        self._abort_goal(reason)

    def send_goal(self, goal: FollowJointTrajectory | JointTrajectory) -> GoalHandle:
        """Start a goal. Raises GoalRejectedError, also while another one is under way, and ControllerError."""
        if isinstance(goal, JointTrajectory):
            goal = FollowJointTrajectory(goal)
        self.check_active()
        if self.goal is not None:
            raise self._rejected("a trajectory is under way: wait for its end, or cancel it")
        self.check(goal.trajectory)
        unlimited = (Tolerance(),) * len(self.joints)
        try:
            self._limits = with_goal(Tolerances(unlimited, unlimited), goal, self.joints)
        except ToleranceError as error:
            raise self._rejected(str(error)) from None
        self._points = filled(goal.trajectory, self.joints, ())
        self._next, self._passed, self._elapsed_s = 0, 0, 0.0
        return self._accept(goal)

    def check(self, trajectory: JointTrajectory) -> None:
        """Check that a trajectory would be accepted by the active, idle controller. Raises GoalRejectedError if not."""
        TrajectoryRules(self.name, self.joints).check(trajectory, self._now_s)
        if trajectory.stamp_s != 0.0:
            raise self._rejected("the robot starts immediately: leave out the trajectory's start time")
        kinds = {(bool(point.velocities), bool(point.accelerations)) for point in trajectory.points}
        if len(kinds) > 1:
            raise self._rejected("either all points have velocities (accelerations), or none")

    def cancel(self) -> None:
        """Stop the arm; the goal under way is canceled."""
        self.check_active()
        self._cancel_goal()

    @property
    def progress(self) -> float:
        """Elapsed share of the present goal's time, 0 to 1; 1 without a goal."""
        if self.goal is None:
            return 1.0
        return min(self._elapsed_s / max(self._points[-1].time_from_start_s, 1e-9), 1.0)

    def update(self, time_s: float, period_s: float) -> None:
        self._now_s = time_s
        state = self.commands[self._name("transfer_state")]
        if self.goal is None:
            self._clean_up(state)
        elif self.commands[self._name("abort")] == 1.0:
            self._set("transfer_state", Transfer.IDLE)
            self._set("abort", 0.0)
            self._abort_goal("Trajectory aborted by hardware.")
        elif state == Transfer.IDLE:
            self._set("trajectory_size", len(self._points))
            self._set("transfer_state", Transfer.NEW_TRAJECTORY)
        elif state == Transfer.WAITING_FOR_POINT:
            self._send_point()
        elif state == Transfer.IN_MOTION:
            factor = self.states[self.parameters.speed_scaling_interface_name]
            self._elapsed_s += period_s * (factor if factor == factor else 1.0)
            self._publish_feedback(time_s)
        elif state == Transfer.DONE:
            self._set("transfer_state", Transfer.IDLE)
            self._conclude()

    def _clean_up(self, state: float) -> None:
        """Handle the hardware's state after the goal has ended."""
        if state == Transfer.DONE:
            self._set("transfer_state", Transfer.IDLE)
            self._set("abort", 0.0)
        elif state != Transfer.IDLE:
            self._set("abort", 1.0)

    def _send_point(self) -> None:
        if self._next == len(self._points):
            self._set("transfer_state", Transfer.TRANSFER_DONE)
            return
        point = self._points[self._next]
        self._next += 1
        self._set("time_from_start", point.time_from_start_s)
        for part, values in zip(POINT, (point.positions, point.velocities, point.accelerations), strict=True):
            for joint in range(len(self.joints)):
                self._set(f"{part}_{joint}", values[joint] if values else NO_COMMAND)
        self._set("transfer_state", Transfer.TRANSFERRING)

    def _publish_feedback(self, time_s: float) -> None:
        assert self.goal is not None
        while self._passed < len(self._points) and self._points[self._passed].time_from_start_s <= self._elapsed_s:
            self._passed += 1
        desired = self._points[min(self._passed, len(self._points) - 1)]
        actual = JointTrajectoryPoint(self._positions())
        self.goal.publish_feedback(Feedback(time_s, desired, actual, self._error(desired), self._passed))

    def _positions(self) -> tuple[float, ...]:
        return tuple(self.states[f"{joint}/position"] for joint in self.joints)

    def _error(self, desired: JointTrajectoryPoint) -> JointTrajectoryPoint:
        return JointTrajectoryPoint(tuple(a - b for a, b in zip(desired.positions, self._positions(), strict=True)))

    def _conclude(self) -> None:
        late_s = self._elapsed_s - self._points[-1].time_from_start_s - self._limits.goal_time_s
        missed = violation(self._error(self._points[-1]), self._limits.goal, self.joints)
        if missed:
            text = f"Robot not within tolerances at end of trajectory. ({missed})"
            self._abort_goal(text, ErrorCode.GOAL_TOLERANCE_VIOLATED)
        elif self._limits.goal_time_s > 0.0 and late_s > 0.0:
            text = f"Goal not reached within time tolerance. Missed goal time by {late_s:f} seconds."
            self._abort_goal(text, ErrorCode.GOAL_TOLERANCE_VIOLATED)
        else:
            assert self.goal is not None
            self.goal.succeed(f"Trajectory executed successfully in {self._elapsed_s:f} (scaled) seconds!")

    def _set(self, name: str, value: float) -> None:
        self.commands[self._name(name)] = float(value)
