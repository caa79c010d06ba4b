"""Plans a MotionPlanRequest: reads its goals, its path constraints and its planner, and refuses what is not supported.

The goal is the centre of each region that constraints allow. Joints that a goal leaves out keep their position. Path
constraints are an orientation, a box for a position, or both, of one link.
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
    OrientationConstraint,
    PathConstraints,
    Planner,
    PlannerName,
    PoseGoal,
    PositionConstraint,
    StartInCollisionError,
    Trajectory,
)
from client.ros2.move_group.arm import Arm, RefusedError, pose_of
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.kinematics import unwind
from urproto.robots.pose import pose_inv, pose_trans, quaternion_to_rotvec
from urproto.vectors import ZERO6, Vector3, as_six

OMPL: Final = "ompl"
PILZ: Final = "pilz_industrial_motion_planner"
PLANNERS: Final[dict[str, dict[str, PlannerName]]] = {
    OMPL: {f"{name}{suffix}": name for suffix in ("", "kConfigDefault") for name in ("RRTConnect", "RRTstar", "PRM")},
    PILZ: {"PTP": "PTP", "LIN": "LIN", "CIRC": "CIRC"},
}
"""By pipeline: the names in ur_moveit_config's OMPL configuration and in OMPL, and those of Pilz' planner."""
_DEFAULT_TIME_S: Final = 1.0  # MoveIt's, for a request that gives none

_logger = logging.getLogger(__name__)
_ZERO = 1e-6  # a quaternion this short has not been set


@dataclass(frozen=True)
class PlanResult:
    """The plan for a request. start_rad: the start configuration. time_s: planning time."""

    start_rad: Joints
    trajectory: Trajectory
    time_s: float


def plan_motion(arm: Arm, state: SceneState, request: Any, q_rad: Sequence[float]) -> PlanResult:
    """Plan a moveit_msgs/MotionPlanRequest. q_rad: the arm's current configuration. Raises RefusedError."""
    began_s = time.perf_counter()
    start, state = start_of(arm, state, request, q_rad)
    planner = planner_for(arm, state, request, start)
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
            return PlanResult(start, trajectory, time.perf_counter() - began_s)
    raise refused


def plan_motion_sequence(arm: Arm, state: SceneState, message: Any, q_rad: Sequence[float]) -> PlanResult:
    """Plan a moveit_msgs/MotionSequenceRequest: motions that blend, as one trajectory. Raises RefusedError."""
    began_s = time.perf_counter()
    first = message.items[0].req
    start, state = start_of(arm, state, first, q_rad)
    if any(one.req.start_state.joint_state.name for one in message.items[1:]):
        raise RefusedError("INVALID_ROBOT_STATE", "only the first motion of a sequence may have a start state")
    items = [_item(arm, state, one, start) for one in message.items]
    planner = planner_for(arm, state, first, start)
    try:
        trajectory = planner.plan_sequence(start, items, time_limit_s=time_limit(first)).trajectory
    except PlanningError as error:
        raise refusal(arm, error, start) from None
    return PlanResult(start, trajectory, time.perf_counter() - began_s)


def _item(arm: Arm, state: SceneState, message: Any, start: Joints) -> MotionSequenceItem:
    """Joints that a goal leaves out keep the position that they have at the start of the sequence."""
    _check(arm, message.req)
    name = _planner(message.req)
    if name != "CIRC" and not is_empty(message.req.path_constraints):
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "path constraints: not supported in sequences")
    targets = goals(arm, state, message.req, start, name)
    if len(targets) > 1:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "a motion of a sequence must have exactly one goal")
    try:
        return MotionSequenceItem(targets[0], name, float(message.blend_radius), **scaling(message.req))
    except PlanningError as error:
        raise RefusedError("INVALID_MOTION_PLAN", str(error)) from None


def start_of(arm: Arm, state: SceneState, request: Any, q_rad: Sequence[float]) -> tuple[Joints, SceneState]:
    """The start configuration of a request, and its scene. Raises RefusedError for what is not supported."""
    _check(arm, request)
    start = arm.angles(request.start_state, q_rad)
    return start, state.with_attached(request.start_state.attached_collision_objects, start)


def planner_for(arm: Arm, state: SceneState, request: Any, start: Joints) -> Planner:
    """A planner for a scene, with the limits of a request. Raises RefusedError."""
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
            "FAILURE", f"unknown planning pipeline {request.pipeline_id!r}: choose {' or '.join(PLANNERS)}"
        )
    if request.trajectory_constraints.constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "trajectory constraints are not supported: leave them out")
    if _planner(request) not in PLANNERS[PILZ] and request.max_cartesian_speed > 0.0:
        raise RefusedError(
            "FAILURE", "max_cartesian_speed is supported for LIN and CIRC only: scale the velocity instead"
        )


def _planner(request: Any) -> PlannerName:
    names = PLANNERS[request.pipeline_id or OMPL]
    if request.planner_id in names:
        return names[request.planner_id]
    if request.pipeline_id == PILZ:
        raise RefusedError("FAILURE", f"{PILZ} has no planner {request.planner_id!r}; it has {', '.join(names)}")
    if request.planner_id:  # as MoveIt
        _logger.warning("unknown planner %r: RRTConnect is used", request.planner_id)
    return "RRTConnect"


def time_limit(request: Any) -> float:
    """The time limit of a request [s]."""
    limit_s = float(request.allowed_planning_time)
    return limit_s if 0.0 < limit_s < float("inf") else _DEFAULT_TIME_S


class ScalingFactors(TypedDict):
    """Shares of the limits, above 0 and up to 1."""

    velocity_scaling: float
    acceleration_scaling: float


def scaling(request: Any) -> ScalingFactors:
    """The scaling factors of a request; invalid values become 1, as in MoveIt (0 means not given)."""
    return ScalingFactors(
        velocity_scaling=_share(request.max_velocity_scaling_factor),
        acceleration_scaling=_share(request.max_acceleration_scaling_factor),
    )


def _share(value: Any) -> float:
    return float(value) if 0.0 < value <= 1.0 else 1.0


# goals


def goals(arm: Arm, state: SceneState, request: Any, start: Joints, planner: str) -> list[Goal]:
    """The goals of a request, any one of which will do. Raises RefusedError for invalid or unsupported constraints."""
    if not request.goal_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "the request has no goal")
    found = [goal for one in request.goal_constraints for goal in _goals(arm, state, one, start)]
    if planner == "CIRC":
        circ = _circ(arm, state, request.path_constraints, start)
        return [CircGoal(goal.pose, **circ, tcp_offset=goal.tcp_offset) for goal in map(_tool_goal(arm), found)]
    return list(map(_tool_goal(arm), found)) if planner == "LIN" else found


def _tool_goal(arm: Arm) -> Callable[[Goal], PoseGoal]:
    """Lines and arcs need poses; joint angles become the pose of the tip, as in Pilz' planner."""

    def tool_goal(goal: Goal) -> PoseGoal:
        if isinstance(goal, PoseGoal):
            return goal
        assert isinstance(goal, JointGoal)
        return PoseGoal(arm.kinematics.forward(goal.q_rad), ZERO6)

    return tool_goal


def _circ(arm: Arm, state: SceneState, constraints: Any, start: Joints) -> dict[str, Vector3]:
    """The interim point or centre of an arc, given as in Pilz' planner: in path constraints with that name."""
    places = constraints.position_constraints
    if constraints.name not in ("interim", "center") or len(places) != 1:
        raise RefusedError(
            "INVALID_MOTION_PLAN",
            "an arc needs path constraints named interim or center, with one position; these are "
            f"named {constraints.name!r}, with {len(places)}",
        )
    region = places[0].constraint_region.primitive_poses
    if len(region) != 1:
        raise RefusedError("INVALID_MOTION_PLAN", f"the {constraints.name} point must be one pose, not {len(region)}")
    frame = arm.frame(places[0].header.frame_id, start, state.frames(start))
    return {constraints.name: pose_trans(frame, pose_of(region[0]))[:3]}


def _goals(arm: Arm, state: SceneState, constraints: Any, start: Joints) -> Iterator[Goal]:
    joints, places, turns = (
        constraints.joint_constraints,
        constraints.position_constraints,
        constraints.orientation_constraints,
    )
    if constraints.visibility_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "visibility constraints are not supported")
    if joints and not places and not turns:
        yield JointGoal(_joint_goal(arm, joints, start))
    elif len(places) == len(turns) == 1 and not joints:
        yield from _pose_goals(arm, state, places[0], turns[0], start)
    else:
        raise RefusedError(
            "INVALID_GOAL_CONSTRAINTS",
            f"a goal must be joint constraints, or one position and one orientation; this one has {len(joints)}, "
            f"{len(places)} and {len(turns)} of them",
        )


def _joint_goal(arm: Arm, constraints: Sequence[Any], start: Joints) -> Joints:
    angles = dict(zip(arm.joints, start, strict=True))
    for one in constraints:
        if one.joint_name not in angles:
            raise RefusedError("INVALID_GOAL_CONSTRAINTS", f"the arm has no joint {one.joint_name!r}")
        if not isfinite(one.position):
            raise RefusedError(
                "INVALID_GOAL_CONSTRAINTS", f"{one.joint_name} has a position that is not finite: {one.position}"
            )
        angles[one.joint_name] = float(one.position)
    return as_six(angles.values())


def _pose_goals(arm: Arm, state: SceneState, place: Any, turn: Any, start: Joints) -> Iterator[PoseGoal]:
    if place.link_name != turn.link_name:
        raise RefusedError(
            "INVALID_GOAL_CONSTRAINTS",
            f"position and orientation must be of the same link, not of {place.link_name!r} and {turn.link_name!r}",
        )
    link_offset = arm.flange_to_link(place.link_name or arm.tip)
    turned = orientation_of(arm, state, turn, start)
    offset = place.target_point_offset
    frame = arm.frame(place.header.frame_id, start, state.frames(start))
    region = place.constraint_region
    if region.meshes or not region.primitive_poses:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "a position must be a region of solid primitives")
    for middle in region.primitive_poses:
        x, y, z = pose_trans(frame, pose_of(middle))[:3]
        link = pose_trans((x, y, z, *turned), (-offset.x, -offset.y, -offset.z, 0.0, 0.0, 0.0))
        yield PoseGoal(link, link_offset)


def ik_solutions(arm: Arm, flange: Sequence[float], seed_rad: Sequence[float]) -> list[Joints]:
    """All configurations within the limits that reach a flange pose, nearest to a seed first."""
    low, high = arm.model.position_limits
    found = [unwind(q, seed_rad, low, high) for q in arm.kinematics.inverse_all(flange, seed_rad)]
    inside = [q for q in found if all(map(isfinite, q))]
    return sorted(inside, key=lambda q: sum((one - other) ** 2 for one, other in zip(q, seed_rad, strict=True)))


def refusal(arm: Arm, error: PlanningError, start: Joints, goal: Goal | None = None) -> RefusedError:
    """The RefusedError, with MoveIt's code, for an error of client.planning. goal: the goal that was not reached."""
    return RefusedError(_code(arm, error, start, goal), str(error))


def _code(arm: Arm, error: PlanningError, start: Joints, goal: Goal | None) -> str:
    match error, goal:
        case StartInCollisionError(), _:
            return "START_STATE_IN_COLLISION" if _is_inside(arm, start) else "START_STATE_INVALID"
        case GoalUnreachableError(), PoseGoal(pose, offset):
            flange = pose_trans(pose, pose_inv(offset or ZERO6))
            return "GOAL_IN_COLLISION" if ik_solutions(arm, flange, start) else "NO_IK_SOLUTION"
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


def is_empty(constraints: Any) -> bool:
    return not any(
        (
            constraints.joint_constraints,
            constraints.position_constraints,
            constraints.orientation_constraints,
            constraints.visibility_constraints,
        )
    )


def path_constraints(arm: Arm, state: SceneState, message: Any, start: Joints) -> PathConstraints | None:
    """Read a moveit_msgs/Constraints; None for an empty one. start: the configuration in which frames are evaluated.

    Raises RefusedError for unsupported constraints, and for a start that violates them.
    """
    if is_empty(message):
        return None
    turns, places = message.orientation_constraints, message.position_constraints
    links = {one.link_name or arm.tip for one in (*turns, *places)}
    others = message.joint_constraints or message.visibility_constraints
    if others or len(links) != 1 or max(len(turns), len(places)) > 1:
        raise _refused(
            "give one orientation, one position, or both, of one link; joint and visibility constraints are not "
            "supported"
        )
    link_offset = arm.flange_to_link(links.pop())
    try:
        found = PathConstraints(
            _orientation(arm, state, turns[0], start) if turns else None,
            _position(arm, state, places[0], start) if places else None,
            link_offset,
        )
        broken = found.violation(pose_trans(arm.kinematics.forward(start), link_offset))
    except PlanningError as error:
        raise _refused(str(error)) from None
    if broken:
        raise RefusedError("START_STATE_VIOLATES_PATH_CONSTRAINTS", f"at the start of the motion, {broken}")
    return found


def orientation_of(arm: Arm, state: SceneState, message: Any, start: Joints) -> tuple[float, float, float]:
    """The rotation vector of a moveit_msgs/OrientationConstraint, in base. Raises RefusedError."""
    q = message.orientation
    parts = (q.x, q.y, q.z, q.w)
    if not all(map(isfinite, parts)) or max(map(abs, parts)) < _ZERO:
        raise RefusedError(
            "INVALID_GOAL_CONSTRAINTS", "the orientation must be a quaternion of finite numbers that is not zero"
        )
    frame = arm.frame(message.header.frame_id, start, state.frames(start))
    return pose_trans(frame, (0.0, 0.0, 0.0, *quaternion_to_rotvec(*parts)))[3:]


def _orientation(arm: Arm, state: SceneState, message: Any, start: Joints) -> OrientationConstraint:
    if message.parameterization != message.XYZ_EULER_ANGLES:
        raise _refused("the tolerances of an orientation must be XYZ_EULER_ANGLES")
    tolerances = (
        float(message.absolute_x_axis_tolerance),
        float(message.absolute_y_axis_tolerance),
        float(message.absolute_z_axis_tolerance),
    )
    return OrientationConstraint(orientation_of(arm, state, message, start), tolerances)


def _position(arm: Arm, state: SceneState, message: Any, start: Joints) -> PositionConstraint:
    region, offset = message.constraint_region, message.target_point_offset
    solids = region.primitives
    if region.meshes or len(solids) != 1 or solids[0].type != solids[0].BOX or len(solids[0].dimensions) != 3:
        raise _refused("the region of a position must be one box")
    if any((offset.x, offset.y, offset.z)):
        raise _refused("the position must be that of the link itself, without a target_point_offset")
    x, y, z = map(float, solids[0].dimensions)
    frame = arm.frame(message.header.frame_id, start, state.frames(start))
    middle = pose_of(region.primitive_poses[0]) if region.primitive_poses else (0.0,) * 6
    return PositionConstraint((x, y, z), pose_trans(frame, middle))


def _refused(reason: str) -> RefusedError:
    return RefusedError("INVALID_GOAL_CONSTRAINTS", f"path constraints: {reason}")
