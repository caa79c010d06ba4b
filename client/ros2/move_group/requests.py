"""A MotionPlanRequest, planned: its goals, its planner, and what of it cannot be had.

Goals are the middles of the regions that constraints allow. A goal that leaves joints out has them stay.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final, TypedDict

from client.errors import PlanningError, SceneError
from client.planning import (
    CartesianLimits,
    CircGoal,
    Goal,
    GoalUnreachableError,
    JointGoal,
    MotionSequenceItem,
    NoPathError,
    Planner,
    PlannerName,
    PoseGoal,
    StartInCollisionError,
    Trajectory,
)
from client.ros2.move_group.arm import Arm, RefusedError, pose_of
from client.ros2.move_group.constraints import is_empty, orientation_of, path_constraints
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.kinematics import unwind
from urproto.robots.pose import pose_inv, pose_trans
from urproto.vectors import ZERO6, Vector3

OMPL: Final = "ompl"
PILZ: Final = "pilz_industrial_motion_planner"
PLANNERS: Final[dict[str, dict[str, PlannerName]]] = {
    OMPL: {f"{name}{suffix}": name for suffix in ("", "kConfigDefault") for name in ("RRTConnect", "RRTstar", "PRM")},
    PILZ: {"PTP": "PTP", "LIN": "LIN", "CIRC": "CIRC"},
}
"""By pipeline: the names in ur_moveit_config's OMPL configuration and OMPL's own, and those of Pilz' planner."""
_DEFAULT_TIME_S: Final = 1.0  # MoveIt's, for a request that gives none

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Planned:
    """What came of a request. start_rad: where it begins. time_s: that it took."""

    start_rad: Joints
    trajectory: Trajectory
    time_s: float


def planned(arm: Arm, state: SceneState, request: Any, q_rad: Sequence[float]) -> Planned:
    """Plan what a moveit_msgs/MotionPlanRequest asks for. q_rad: where the arm stands. Raises RefusedError."""
    began_s = time.perf_counter()
    start, state = begun(arm, state, request, q_rad)
    planner = planner_in(arm, state, request, start)
    name = _planner(request)
    limit_s, shares = time_limit(request), scaling(request)
    kept = None if name == "CIRC" else path_constraints(arm, state, request.path_constraints, start)
    for target in goals(arm, state, request, start, name):
        try:
            trajectory = planner.plan(
                start, target, planner=name, time_limit_s=limit_s, path_constraints=kept, **shares
            ).trajectory
        except PlanningError as error:
            refused = refusal(arm, error, start, target)
        else:
            return Planned(start, trajectory, time.perf_counter() - began_s)
    raise refused


def planned_sequence(arm: Arm, state: SceneState, message: Any, q_rad: Sequence[float]) -> Planned:
    """Plan a moveit_msgs/MotionSequenceRequest: motions that blend, as one. Raises RefusedError."""
    began_s = time.perf_counter()
    first = message.items[0].req
    start, state = begun(arm, state, first, q_rad)
    if any(one.req.start_state.joint_state.name for one in message.items[1:]):
        raise RefusedError("INVALID_ROBOT_STATE", "of a sequence, the first motion alone has a start state")
    items = [_item(arm, state, one, start) for one in message.items]
    planner = planner_in(arm, state, first, start)
    try:
        trajectory = planner.plan_sequence(start, items, time_limit_s=time_limit(first)).trajectory
    except PlanningError as error:
        raise refusal(arm, error, start) from None
    return Planned(start, trajectory, time.perf_counter() - began_s)


def _item(arm: Arm, state: SceneState, message: Any, start: Joints) -> MotionSequenceItem:
    """Joints that a goal leaves out stay where the sequence begins."""
    _check(arm, message.req)
    name = _planner(message.req)
    if name != "CIRC" and not is_empty(message.req.path_constraints):
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "path constraints: a sequence does not keep to any")
    targets = goals(arm, state, message.req, start, name)
    if len(targets) > 1:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "a motion of a sequence has one goal")
    try:
        return MotionSequenceItem(targets[0], name, float(message.blend_radius), **scaling(message.req))
    except PlanningError as error:
        raise RefusedError("INVALID_MOTION_PLAN", str(error)) from None


def begun(arm: Arm, state: SceneState, request: Any, q_rad: Sequence[float]) -> tuple[Joints, SceneState]:
    """Where a request begins, and in which scene. Raises RefusedError for one that cannot be had."""
    _check(arm, request)
    start = arm.angles(request.start_state, q_rad)
    return start, state.with_attached(request.start_state.attached_collision_objects, start)


def planner_in(arm: Arm, state: SceneState, request: Any, start: Joints) -> Planner:
    """Of a scene, with the limits that a request gives. Raises RefusedError."""
    speed = float(request.max_cartesian_speed) if hasattr(request, "max_cartesian_speed") else 0.0
    try:
        limits = CartesianLimits(velocity_m_s=min(speed, CartesianLimits().velocity_m_s)) if speed > 0.0 else None
        return Planner(state.scene(), cartesian_limits=limits)
    except PlanningError as error:
        raise refusal(arm, error, start) from None


def _check(arm: Arm, request: Any) -> None:
    arm.check_group(request.group_name)
    if request.pipeline_id not in ("", *PLANNERS):
        raise RefusedError(
            "FAILURE", f"there is no planning pipeline {request.pipeline_id!r}; there are {' and '.join(PLANNERS)}"
        )
    if request.trajectory_constraints.constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "trajectory constraints are not kept here: leave them out")
    if _planner(request) not in PLANNERS[PILZ] and request.max_cartesian_speed > 0.0:
        raise RefusedError("FAILURE", "the Cartesian speed is limited on lines and arcs alone: scale the velocity")


def _planner(request: Any) -> PlannerName:
    names = PLANNERS[request.pipeline_id or OMPL]
    if request.planner_id in names:
        return names[request.planner_id]
    if request.pipeline_id == PILZ:
        raise RefusedError("FAILURE", f"{PILZ} has no planner {request.planner_id!r}; it has {', '.join(names)}")
    if request.planner_id:  # as MoveIt
        _logger.warning("there is no planner %r: RRTConnect is used", request.planner_id)
    return "RRTConnect"


def time_limit(request: Any) -> float:
    """Of a request [s]."""
    limit_s = float(request.allowed_planning_time)
    return limit_s if 0.0 < limit_s < float("inf") else _DEFAULT_TIME_S


class Shares(TypedDict):
    """Of the limits, above 0 to 1."""

    velocity_scaling: float
    acceleration_scaling: float


def scaling(request: Any) -> Shares:
    """Of a request; what is no share is 1, as MoveIt takes it (0 is «not given»)."""
    return Shares(
        velocity_scaling=_share(request.max_velocity_scaling_factor),
        acceleration_scaling=_share(request.max_acceleration_scaling_factor),
    )


def _share(value: Any) -> float:
    return float(value) if 0.0 < value <= 1.0 else 1.0


# goals


def goals(arm: Arm, state: SceneState, request: Any, start: Joints, planner: str) -> list[Goal]:
    """Any of which will do. Raises RefusedError for constraints that are none, or are not kept here."""
    if not request.goal_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "the request has no goal")
    found = [goal for one in request.goal_constraints for goal in _goals(arm, state, one, start)]
    if planner == "CIRC":
        circ = _circ(arm, state, request.path_constraints, start)
        return [CircGoal(goal.pose, **circ, tcp_offset=goal.tcp_offset) for goal in map(_tool_goal(arm), found)]
    return list(map(_tool_goal(arm), found)) if planner == "LIN" else found


def _tool_goal(arm: Arm) -> Callable[[Goal], PoseGoal]:
    """Lines and arcs lead to poses; of joint angles, to that of the tip, as by Pilz' planner."""

    def tool_goal(goal: Goal) -> PoseGoal:
        if isinstance(goal, PoseGoal):
            return goal
        assert isinstance(goal, JointGoal)
        return PoseGoal(arm.kinematics.forward(goal.q_rad), ZERO6)

    return tool_goal


def _circ(arm: Arm, state: SceneState, constraints: Any, start: Joints) -> dict[str, Vector3]:
    """The point that makes an arc, where Pilz' planner has it: in the path constraints, which it names."""
    places = constraints.position_constraints
    if constraints.name not in ("interim", "center") or len(places) != 1:
        raise RefusedError(
            "INVALID_MOTION_PLAN",
            "an arc has path constraints of the name interim or center, with one position; these are "
            f"{constraints.name!r} with {len(places)}",
        )
    region = places[0].constraint_region.primitive_poses
    if len(region) != 1:
        raise RefusedError("INVALID_MOTION_PLAN", f"the {constraints.name} point is one pose, not {len(region)}")
    frame = arm.frame(places[0].header.frame_id, start, state.frames(start))
    return {constraints.name: pose_trans(frame, pose_of(region[0]))[:3]}


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
    turned = orientation_of(arm, state, turn, start)
    offset = place.target_point_offset
    frame = arm.frame(place.header.frame_id, start, state.frames(start))
    region = place.constraint_region
    if region.meshes or not region.primitive_poses:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "a position is a region of solid primitives")
    for middle in region.primitive_poses:
        x, y, z = pose_trans(frame, pose_of(middle))[:3]
        link = pose_trans((x, y, z, *turned), (-offset.x, -offset.y, -offset.z, 0.0, 0.0, 0.0))
        yield PoseGoal(link, beyond)


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
        case GoalUnreachableError(), PoseGoal(pose, offset):
            flange = pose_trans(pose, pose_inv(offset or ZERO6))
            return "GOAL_IN_COLLISION" if reaching(arm, flange, start) else "NO_IK_SOLUTION"
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
