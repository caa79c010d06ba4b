"""Validation of trajectories before a controller accepts them, by the rules of ros2_controllers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from client.controllers.goals import ErrorCode, FollowJointTrajectory, JointTrajectory, JointTrajectoryPoint, Tolerance
from client.errors import GoalRejectedError

_ANY: Final = -1.0
_AT_REST: Final = 1.2e-7  # rad/s: single precision, as in ros2_controllers
_FIELDS: Final = ("positions", "velocities", "accelerations", "effort")


class ToleranceError(ValueError):
    """A goal's tolerance is invalid."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Tolerances (n,), in the controller's order of joints: along the path, at the goal; goal_time_s [s] after it."""

    path: tuple[Tolerance, ...]
    goal: tuple[Tolerance, ...]
    goal_time_s: float = 0.0


def with_goal(defaults: Tolerances, goal: FollowJointTrajectory, joints: Sequence[str]) -> Tolerances:
    """The tolerances of a goal. Raises ToleranceError."""
    return Tolerances(
        _merged(defaults.path, goal.path_tolerance, joints, "path"),
        _merged(defaults.goal, goal.goal_tolerance, joints, "goal"),
        _limit(defaults.goal_time_s, goal.goal_time_tolerance_s, "goal time"),
    )


def _merged(
    defaults: Sequence[Tolerance], given: Mapping[str, Tolerance], joints: Sequence[str], kind: str
) -> tuple[Tolerance, ...]:
    if unknown := [name for name in given if name not in joints]:
        raise ToleranceError(f"the {kind} tolerance names the joint {unknown[0]}, which the controller does not have")
    return tuple(
        _merge_tolerance(default, given.get(joint, Tolerance()), f"{kind} tolerance of {joint}")
        for default, joint in zip(defaults, joints, strict=True)
    )


def _merge_tolerance(default: Tolerance, given: Tolerance, what: str) -> Tolerance:
    return Tolerance(
        _limit(default.position, given.position, what),
        _limit(default.velocity, given.velocity, what),
        _limit(default.acceleration, given.acceleration, what),
    )


def _limit(default: float, given: float, what: str) -> float:
    if given > 0.0:
        return given
    if given == _ANY:
        return 0.0
    if given == 0.0:
        return default
    raise ToleranceError(f"the {what} is {given}: give a positive number, 0 for the default or -1 for none")


def violation(error: JointTrajectoryPoint, limits: Sequence[Tolerance], joints: Sequence[str]) -> str | None:
    """Describe the first joint that violates its tolerance; None if all are within their limits."""
    for values, kind in (
        (error.positions, "position"),
        (error.velocities, "velocity"),
        (error.accelerations, "acceleration"),
    ):
        for value, limit, joint in zip(values, limits, joints, strict=False):
            allowed = getattr(limit, kind)
            if allowed > 0.0 and abs(value) > allowed:
                return f"{joint}: {kind} error {value:.4f}, tolerance {allowed:g}"
    return None


@dataclass(frozen=True, slots=True)
class TrajectoryRules:
    """Rules of one controller; see the parameters of the same names."""

    controller: str
    joints: tuple[str, ...]
    partial: bool = False
    integration: bool = False
    moving_end: bool = False
    effort: bool = False

    def check(self, trajectory: JointTrajectory, now_s: float) -> None:
        """Check a trajectory. Raises GoalRejectedError if it is invalid."""
        self._check_joints(trajectory)
        if not trajectory.points:
            raise self._invalid("the trajectory has no points")
        for number, point in enumerate(trajectory.points):
            self._check_point(point, number, len(trajectory.joint_names))
        self._check_times(trajectory, now_s)
        self._check_end(trajectory)

    def _check_joints(self, trajectory: JointTrajectory) -> None:
        names = trajectory.joint_names
        wrong = [name for name in names if name not in self.joints]
        if wrong:
            raise self._rejected(ErrorCode.INVALID_JOINTS, f"it has no joint {wrong[0]}, only {', '.join(self.joints)}")
        if not names or len(set(names)) < len(names):
            raise self._rejected(ErrorCode.INVALID_JOINTS, "the trajectory must name each joint once")
        if not self.partial and len(names) < len(self.joints):
            missing = [joint for joint in self.joints if joint not in names]
            raise self._rejected(
                ErrorCode.INVALID_JOINTS,
                f"the trajectory leaves out {', '.join(missing)}: name all joints, or set allow_partial_joints_goal",
            )

    def _check_point(self, point: JointTrajectoryPoint, number: int, count: int) -> None:
        for name in _FIELDS:
            values: Sequence[float] = getattr(point, name)
            if values and len(values) != count:
                raise self._invalid(f"point {number} has {len(values)} {name} for {count} joints")
            if not all(map(math.isfinite, values)):
                raise self._invalid(f"point {number} has {name} that are not numbers: {list(values)}")
        if not point.positions and not (self.integration and (point.velocities or point.accelerations)):
            raise self._invalid(f"point {number} has no positions (see allow_integration_in_goal_trajectories)")
        if point.effort and not self.effort:
            raise self._invalid(f"point {number} has effort, which only controllers that command effort take")

    def _check_times(self, trajectory: JointTrajectory, now_s: float) -> None:
        before = None
        for number, point in enumerate(trajectory.points):
            t = point.time_from_start_s
            if not (math.isfinite(t) and t >= 0.0) or (before is not None and t <= before):
                raise self._invalid(f"point {number} is due after {t} s: times must increase from point to point")
            before = t
        end_s = trajectory.stamp_s + trajectory.points[-1].time_from_start_s
        if trajectory.stamp_s != 0.0 and end_s < now_s:
            reason = f"the trajectory ends at {end_s:.3f} s, but the time is already {now_s:.3f} s"
            raise self._rejected(ErrorCode.OLD_HEADER_TIMESTAMP, reason)

    def _check_end(self, trajectory: JointTrajectory) -> None:
        if self.moving_end:
            return
        for name, speed in zip(trajectory.joint_names, trajectory.points[-1].velocities, strict=False):
            if abs(speed) > _AT_REST:
                raise self._invalid(
                    f"the trajectory ends with {name} at {speed} rad/s: let it end at rest, "
                    "or set allow_nonzero_velocity_at_trajectory_end"
                )

    def _invalid(self, reason: str) -> GoalRejectedError:
        return self._rejected(ErrorCode.INVALID_GOAL, reason)

    def _rejected(self, code: ErrorCode, reason: str) -> GoalRejectedError:
        return GoalRejectedError(self.controller, code, reason)
