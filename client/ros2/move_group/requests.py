"""A MotionPlanRequest, planned: its goals, its planner, and what of it cannot be had.

Goals are the middles of the regions that constraints allow. A goal that leaves joints out has them stay.
"""

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

import numpy as np

from client.errors import PlanningError, SceneError
from client.planning import (
    Goal,
    GoalUnreachableError,
    JointGoal,
    NoPathError,
    Planner,
    PlannerName,
    PoseGoal,
    StartInCollisionError,
    TimedPath,
)
from client.ros2.move_group.arm import Arm, RefusedError, pose_of
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.kinematics import unwind
from urproto.robots.pose import pose_inv, pose_trans, quaternion_to_rotvec

PIPELINE: Final = "ompl"
PLANNERS: Final[dict[str, PlannerName]] = {
    f"{name}{suffix}": name for suffix in ("", "kConfigDefault") for name in ("RRTConnect", "RRTstar", "PRM")
}
"""By the names in ur_moveit_config's OMPL configuration, and by OMPL's own."""
_DEFAULT_TIME_S: Final = 1.0  # MoveIt's, for a request that gives none
_SAME_RAD: Final = 1e-4  # an arm that is this near is there (guess)
_ZERO: Final = 1e-6  # a quaternion this short is none

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Planned:
    """What came of a request. start_rad: where it begins. time_s: that it took."""

    start_rad: Joints
    timed: TimedPath
    time_s: float


def planned(arm: Arm, state: SceneState, request: Any, q_rad: Sequence[float]) -> Planned:
    """Plan what a moveit_msgs/MotionPlanRequest asks for. q_rad: where the arm stands. Raises RefusedError."""
    began_s = time.perf_counter()
    arm.check_group(request.group_name)
    _check(request)
    start = arm.angles(request.start_state, q_rad)
    state = state.with_attached(request.start_state.attached_collision_objects, start)
    targets, options = goals(arm, state, request, start), _options(request)
    try:
        planner = Planner(state.scene())
    except PlanningError as error:
        raise refusal(arm, error, start) from None
    if any(_is_there(arm, target, start) for target in targets):
        return Planned(start, _rest(start), time.perf_counter() - began_s)
    for target in targets:
        try:
            timed = planner.plan(start, target, **options).timed
        except PlanningError as error:
            refused = refusal(arm, error, start, target)
        else:
            return Planned(start, timed, time.perf_counter() - began_s)
    raise refused


def _is_there(arm: Arm, goal: Goal, start: Joints) -> bool:
    ends: list[Sequence[float]] = []
    if isinstance(goal, JointGoal):
        ends = [goal.q_rad]
    elif isinstance(goal, PoseGoal):
        ends = [*reaching(arm, goal.pose, start)]
    return any(max(abs(one - other) for one, other in zip(q, start, strict=True)) < _SAME_RAD for q in ends)


def _rest(q_rad: Joints) -> TimedPath:
    still = np.zeros((1, 6))
    return TimedPath(np.zeros(1), np.array([q_rad]), still, still)


def _check(request: Any) -> None:
    if request.pipeline_id not in ("", PIPELINE):
        raise RefusedError("FAILURE", f"there is no planning pipeline {request.pipeline_id!r}: there is {PIPELINE}")
    if request.trajectory_constraints.constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "trajectory constraints are not kept here: leave them out")
    if not is_empty(request.path_constraints):
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "path constraints are not kept here: leave them out")
    if request.max_cartesian_speed > 0.0:
        raise RefusedError("FAILURE", "a limit of the Cartesian speed is not kept here: scale the velocity")


def _options(request: Any) -> dict[str, Any]:
    planner = PLANNERS.get(request.planner_id)
    if planner is None:
        if request.planner_id:
            _logger.warning("there is no planner %r: RRTConnect is used", request.planner_id)
        planner = "RRTConnect"
    limit_s = float(request.allowed_planning_time)
    return {
        "planner": planner,
        "time_limit_s": limit_s if 0.0 < limit_s < float("inf") else _DEFAULT_TIME_S,
        **scaling(request),
    }


def scaling(request: Any) -> dict[str, float]:
    """Of a request; what is no share is 1, as MoveIt takes it (0 is «not given»)."""
    shares = {
        "velocity_scaling": float(request.max_velocity_scaling_factor),
        "acceleration_scaling": float(request.max_acceleration_scaling_factor),
    }
    return {name: share if 0.0 < share <= 1.0 else 1.0 for name, share in shares.items()}


def is_empty(constraints: Any) -> bool:
    """Whether a moveit_msgs/Constraints asks for nothing."""
    return not any(
        (
            constraints.joint_constraints,
            constraints.position_constraints,
            constraints.orientation_constraints,
            constraints.visibility_constraints,
        )
    )


# goals


def goals(arm: Arm, state: SceneState, request: Any, start: Joints) -> list[Goal]:
    """Any of which will do. Raises RefusedError for constraints that are none, or are not kept here."""
    if not request.goal_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "the request has no goal")
    return [goal for one in request.goal_constraints for goal in _goals(arm, state, one, start)]


def _goals(arm: Arm, state: SceneState, constraints: Any, start: Joints) -> Iterator[Goal]:
    joints, places, turns = (
        constraints.joint_constraints,
        constraints.position_constraints,
        constraints.orientation_constraints,
    )
    if constraints.visibility_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "visibility constraints are not kept here")
    if joints and not places and not turns:
        yield JointGoal(_joint_goal(arm, joints, start))
    elif len(places) == len(turns) == 1 and not joints:
        yield from _pose_goals(arm, state, places[0], turns[0], start)
    else:
        raise RefusedError(
            "INVALID_GOAL_CONSTRAINTS",
            f"a goal is either joint constraints, or one position and one orientation; this one has {len(joints)}, "
            f"{len(places)} and {len(turns)} of them",
        )


def _joint_goal(arm: Arm, constraints: Sequence[Any], start: Joints) -> Joints:
    angles = dict(zip(arm.joints, start, strict=True))
    for one in constraints:
        if one.joint_name not in angles:
            raise RefusedError("INVALID_GOAL_CONSTRAINTS", f"the arm has no joint {one.joint_name!r}")
        if not isfinite(one.position):
            raise RefusedError("INVALID_GOAL_CONSTRAINTS", f"{one.joint_name} at {one.position} is nowhere")
        angles[one.joint_name] = float(one.position)
    a, b, c, d, e, f = angles.values()
    return (a, b, c, d, e, f)


def _pose_goals(arm: Arm, state: SceneState, place: Any, turn: Any, start: Joints) -> Iterator[PoseGoal]:
    if place.link_name != turn.link_name:
        raise RefusedError(
            "INVALID_GOAL_CONSTRAINTS",
            f"position and orientation are of one link, not of {place.link_name!r} and {turn.link_name!r}",
        )
    beyond = arm.beyond_flange(place.link_name or arm.tip)
    others = state.frames(start)
    orientation = turn.orientation
    parts = (orientation.x, orientation.y, orientation.z, orientation.w)
    if not all(map(isfinite, parts)) or max(map(abs, parts)) < _ZERO:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "the orientation is a quaternion that is zero, or no numbers")
    turned = pose_trans(arm.frame(turn.header.frame_id, start, others), (0.0, 0.0, 0.0, *quaternion_to_rotvec(*parts)))[
        3:
    ]
    offset = place.target_point_offset
    frame = arm.frame(place.header.frame_id, start, others)
    region = place.constraint_region
    if region.meshes or not region.primitive_poses:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "a position is a region of solid primitives")
    for middle in region.primitive_poses:
        x, y, z = pose_trans(frame, pose_of(middle))[:3]
        link = pose_trans((x, y, z, *turned), (-offset.x, -offset.y, -offset.z, 0.0, 0.0, 0.0))
        yield PoseGoal(pose_trans(link, pose_inv(beyond)))


def reaching(arm: Arm, flange: Sequence[float], seed_rad: Sequence[float]) -> list[Joints]:
    """All joint angles within the limits that put the flange there, nearest to a seed first."""
    low, high = arm.model.position_limits
    found = [unwind(q, seed_rad, low, high) for q in arm.kinematics.inverse_all(flange, seed_rad)]
    inside = [q for q in found if all(map(isfinite, q))]
    return sorted(inside, key=lambda q: sum((one - other) ** 2 for one, other in zip(q, seed_rad, strict=True)))


def refusal(arm: Arm, error: PlanningError, start: Joints, goal: Goal | None = None) -> RefusedError:
    """An error of client.planning with MoveIt's code. goal: what could not be reached."""
    return RefusedError(_code(arm, error, start, goal), str(error))


def _code(arm: Arm, error: PlanningError, start: Joints, goal: Goal | None) -> str:
    match error, goal:
        case StartInCollisionError(), _:
            return "START_STATE_IN_COLLISION" if _is_inside(arm, start) else "START_STATE_INVALID"
        case GoalUnreachableError(), PoseGoal(pose):
            return "GOAL_IN_COLLISION" if reaching(arm, pose, start) else "NO_IK_SOLUTION"
        case GoalUnreachableError(), JointGoal(q_rad):
            return "GOAL_IN_COLLISION" if _is_inside(arm, q_rad) else "GOAL_STATE_INVALID"
        case NoPathError(), _:
            return "TIMED_OUT"
        case SceneError(), _:
            return "FAILURE"
    return "PLANNING_FAILED"


def _is_inside(arm: Arm, q_rad: Sequence[float]) -> bool:
    low, high = arm.model.position_limits
    return all(a <= q <= b for a, q, b in zip(low, q_rad, high, strict=True))
