"""Trajectories, motion primitives, goals and results, as defined by trajectory_msgs and control_msgs."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from client.controllers.controller import Controller, Parameters
from client.driver.endpoint import notify
from client.errors import GoalRejectedError
from urproto.compat import IntEnum


class ErrorCode(IntEnum):
    """How a goal ended. Source: control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalStatus(IntEnum):
    """Status of an accepted goal. Source: action_msgs/GoalStatus."""

    EXECUTING = 2
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@dataclass(frozen=True, slots=True)
class JointTrajectoryPoint:
    """State of the joints at a time: [rad], [rad/s], [rad/s2], [Nm], each in the order of the joint names, or empty."""

    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    time_from_start_s: float = 0.0


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """A sequence of points; stamp_s: start time by the robot's clock [s], 0 for now."""

    joint_names: tuple[str, ...]
    points: tuple[JointTrajectoryPoint, ...]
    stamp_s: float = 0.0

    @classmethod
    def sampled(
        cls,
        joint_names: tuple[str, ...],
        times_s: Sequence[float],
        q_rad: Sequence[Sequence[float]],
        qd_rad_s: Sequence[Sequence[float]],
        qdd_rad_s2: Sequence[Sequence[float]],
    ) -> "JointTrajectory":
        """Create it from samples (n,) and (n, joints); the first one is the arm's present position and is left out."""
        rows = zip(q_rad[1:], qd_rad_s[1:], qdd_rad_s2[1:], times_s[1:], strict=True)
        points = (JointTrajectoryPoint(tuple(q), tuple(qd), tuple(qdd), (), time_s) for q, qd, qdd, time_s in rows)
        return cls(joint_names, tuple(points))


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerance of a joint [rad, rad/s, rad/s2]: 0 for the controller's default, -1 for no limit."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class FollowJointTrajectory:
    """A trajectory and its tolerances by joint name.

    goal_time_tolerance_s: how much later than planned the arm may arrive [s]; 0 for the controller's default, -1 for no
    limit.
    """

    trajectory: JointTrajectory
    path_tolerance: Mapping[str, Tolerance] = field(default_factory=dict)
    goal_tolerance: Mapping[str, Tolerance] = field(default_factory=dict)
    goal_time_tolerance_s: float = 0.0


class PrimitiveType(IntEnum):
    """How a motion primitive moves the arm. Source: control_msgs/MotionPrimitive."""

    LINEAR_JOINT = 0
    LINEAR_CARTESIAN = 50
    CIRCULAR_CARTESIAN = 51


@dataclass(frozen=True, slots=True)
class MotionPrimitive:
    """A move in joint space to ``q_rad``, along a line to ``pose_base_tcp``, or along the arc through a via pose.

    Poses are base to TCP [m, rotation vector]; fields that a type does not need are empty. blend_radius_m: distance
    from its end at which the next primitive may begin. velocity, acceleration: of the leading joint [rad/s, rad/s2] or
    of the TCP [m/s, m/s2]; a move_time_s above 0 replaces both, except for arcs.
    """

    type: PrimitiveType
    q_rad: tuple[float, ...] = ()
    pose_base_tcp: tuple[float, ...] = ()
    via_base_tcp: tuple[float, ...] = ()
    blend_radius_m: float = 0.0
    velocity: float = math.nan
    acceleration: float = math.nan
    move_time_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Feedback:
    """Feedback of a goal under way, once per cycle: joints (n,) in the controller's order.

    index: index of the next point; after the last point, the number of points.
    """

    time_s: float
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    index: int


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a goal, in the terms of ROS 2."""

    error_code: ErrorCode
    error_string: str


_NONE: Final = Result(ErrorCode.SUCCESSFUL, "")


class GoalHandle:
    """A goal that a controller accepted.

    result: None until it has ended. feedback: feedback of the last cycle. on_end, on_feedback: callbacks that receive
    them.
    """

    def __init__(self, goal: FollowJointTrajectory | tuple[MotionPrimitive, ...]) -> None:
        self.goal = goal
        self.status = GoalStatus.EXECUTING
        self.result: Result | None = None
        self.feedback: Feedback | None = None
        self.on_end: list[Callable[[Result], object]] = []
        self.on_feedback: list[Callable[[Feedback], object]] = []

    @property
    def done(self) -> bool:
        """True once it has ended, with any result."""
        return self.result is not None

    def publish_feedback(self, feedback: Feedback) -> None:
        self.feedback = feedback
        notify(self.on_feedback, feedback)

    def succeed(self, text: str) -> None:
        """End it: the goal was reached."""
        self._end(GoalStatus.SUCCEEDED, Result(ErrorCode.SUCCESSFUL, text))

    def abort(self, code: ErrorCode, text: str) -> None:
        """End it: the controller aborted."""
        self._end(GoalStatus.ABORTED, Result(code, text))

    def cancel(self) -> None:
        """End it: it was canceled on request."""
        self._end(GoalStatus.CANCELED, _NONE)

    def _end(self, status: GoalStatus, result: Result) -> None:
        if self.done:
            return
        self.status, self.result = status, result
        notify(self.on_end, result)


class GoalController(Controller[Parameters]):
    """Base class of controllers that accept goals, of which one at a time is under way."""

    def __init__(self, name: str, parameters: Parameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._goal: GoalHandle | None = None

    @property
    def goal(self) -> GoalHandle | None:
        """The goal under way."""
        return None if self._goal is None or self._goal.done else self._goal

    def _accept(self, goal: FollowJointTrajectory | tuple[MotionPrimitive, ...]) -> GoalHandle:
        self._goal = GoalHandle(goal)
        return self._goal

    def _abort_goal(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        if self.goal is not None:
            self.goal.abort(code, text)

    def _cancel_goal(self) -> None:
        if self.goal is not None:
            self.goal.cancel()

    def _rejected(self, reason: str) -> GoalRejectedError:
        return GoalRejectedError(self.name, ErrorCode.INVALID_GOAL, reason)
