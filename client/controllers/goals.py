"""Trajectories, motion primitives, goals and results, as trajectory_msgs and control_msgs have them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from client.driver.endpoint import tell
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
    """Of a goal that was accepted. Source: action_msgs/GoalStatus."""

    EXECUTING = 2
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@dataclass(frozen=True, slots=True)
class JointTrajectoryPoint:
    """Where the joints are at a time: [rad], [rad/s], [rad/s2], [Nm], each in the order of the joint names or empty."""

    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    time_from_start_s: float = 0.0


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """Points to pass; stamp_s: the robot's time at which it begins, 0 for now."""

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
        """Of samples (n,) and (n, joints), the first of which is where the arm stands and is left out."""
        rows = zip(q_rad[1:], qd_rad_s[1:], qdd_rad_s2[1:], times_s[1:], strict=True)
        points = (JointTrajectoryPoint(tuple(q), tuple(qd), tuple(qdd), (), time_s) for q, qd, qdd, time_s in rows)
        return cls(joint_names, tuple(points))


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a joint may be off [rad, rad/s, rad/s2]: 0 is the controller's default, -1 is any distance."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class FollowJointTrajectory:
    """A trajectory and how well it has to be followed: tolerances by joint name.

    goal_time_tolerance_s: how much later than planned the arm may be there; 0 is the controller's default, -1 any time.
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

    Poses are base to TCP [m, rotation vector]; what a type does not need is empty. blend_radius_m: how far from its
    end the next one may begin. velocity, acceleration: the leading joint's [rad/s, rad/s2] or the tool's [m/s, m/s2];
    a move_time_s above 0 replaces both, but for arcs.
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
    """Of a goal under way, once a cycle: joints (n,) in the controller's order.

    index: the point that comes next, as many as there are points after the last one.
    """

    time_s: float
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    index: int


@dataclass(frozen=True, slots=True)
class Result:
    """How a goal ended, in the words of ROS 2."""

    error_code: ErrorCode
    error_string: str


_NONE: Final = Result(ErrorCode.SUCCESSFUL, "")


class GoalHandle:
    """A goal that a controller took.

    result: None until it ended. feedback: of the last cycle. on_end, on_feedback: called with it.
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
        """True when it has ended, however."""
        return self.result is not None

    def tell(self, feedback: Feedback) -> None:
        """How it goes."""
        self.feedback = feedback
        tell(self.on_feedback, feedback)

    def succeed(self, text: str) -> None:
        """The arm is there."""
        self._end(GoalStatus.SUCCEEDED, Result(ErrorCode.SUCCESSFUL, text))

    def abort(self, code: ErrorCode, text: str) -> None:
        """The controller gave up."""
        self._end(GoalStatus.ABORTED, Result(code, text))

    def cancel(self) -> None:
        """Somebody asked for it."""
        self._end(GoalStatus.CANCELED, _NONE)

    def _end(self, status: GoalStatus, result: Result) -> None:
        if self.done:
            return
        self.status, self.result = status, result
        tell(self.on_end, result)
