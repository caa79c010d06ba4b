"""The services of ``move_group``: one function each, of a request and the arm's current configuration.

They raise RefusedError for what is not supported, and PlanningError. Those that plan may take seconds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final

from client.errors import PlanningError
from client.planning import CollisionChecker, PairDistance
from client.ros2.host import interface
from client.ros2.move_group.arm import Arm, RefusedError, pose_of, set_code
from client.ros2.move_group.requests import (
    PLANNERS,
    PlanResult,
    ScalingFactors,
    ik_solutions,
    is_empty,
    path_constraints,
    plan_motion,
    plan_motion_sequence,
    planner_for,
    refusal,
    scaling,
)
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.description import urdf
from urproto.robots.pose import pose_inv, pose_trans


@dataclass(frozen=True)
class RequestContext:
    """The state that a request is answered with. q_rad: the arm's current configuration."""

    arm: Arm
    state: SceneState
    q_rad: Sequence[float]


def compute_ik(now: RequestContext, message: Any, response: Any) -> None:
    """The configuration that reaches a pose, nearest to the robot state of the request."""
    request, arm = message.ik_request, now.arm
    arm.check_group(request.group_name)
    if request.ik_link_names or request.pose_stamped_vector:
        raise RefusedError("INVALID_LINK_NAME", "an arm has only one tip: give ik_link_name and pose_stamped")
    seed = arm.angles(request.robot_state, now.q_rad)
    state = now.state.with_attached(request.robot_state.attached_collision_objects, seed)
    link_offset = arm.flange_to_link(request.ik_link_name or arm.tip)
    stamped = request.pose_stamped
    frame = arm.frame(stamped.header.frame_id, seed, state.frames(seed))
    flange = pose_trans(pose_trans(frame, pose_of(stamped.pose)), pose_inv(link_offset))
    found = [q for q in ik_solutions(arm, flange, seed) if _satisfies_joint_constraints(arm, request.constraints, q)]
    if not found:
        raise RefusedError("NO_IK_SOLUTION", "no configuration within limits and constraints reaches the pose")
    if request.avoid_collisions:
        checker = CollisionChecker(state.scene())
        free = [q for q in found if checker.is_free(q)]
        if not free:
            why = "; ".join(map(str, checker.collisions(found[0])[:3]))
            raise RefusedError(
                "NO_IK_SOLUTION", f"all {len(found)} configurations are in collision; the nearest: {why}"
            )
        found = free
    response.solution = arm.state_message(found[0])
    response.solution.attached_collision_objects = state.attached_messages()


def _satisfies_joint_constraints(arm: Arm, constraints: Any, q_rad: Joints) -> bool:
    """Whether a configuration satisfies joint constraints. Raises RefusedError for other constraints."""
    if not is_empty(constraints) and not constraints.joint_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "only joint constraints are supported")
    angles = dict(zip(arm.joints, q_rad, strict=True))
    for one in constraints.joint_constraints:
        if one.joint_name not in angles:
            raise RefusedError("INVALID_GOAL_CONSTRAINTS", f"the arm has no joint {one.joint_name!r}")
        away = angles[one.joint_name] - one.position
        if not -one.tolerance_below <= away <= one.tolerance_above:
            return False
    return True


def compute_fk(now: RequestContext, request: Any, response: Any) -> None:
    """The poses of links, or of objects in the scene."""
    arm = now.arm
    q = arm.angles(request.robot_state, now.q_rad)
    others = now.state.with_attached(request.robot_state.attached_collision_objects, q).frames(q)
    known = {*arm.links, *others}
    names = [name for name in request.fk_link_names if name in known]
    frame = arm.frame(request.header.frame_id, q, others)
    for name in names:
        stamped = interface("geometry_msgs/msg/PoseStamped")()
        arm.stamp(stamped.header, request.header.frame_id)
        stamped.pose = arm.pose_message(arm.frame(name, q, others), frame)
        response.pose_stamped.append(stamped)
    response.fk_link_names = names
    if not names or len(names) < len(request.fk_link_names):
        unknown = [name for name in request.fk_link_names if name not in known]
        raise RefusedError("INVALID_LINK_NAME", f"unknown link {unknown[0]!r}" if unknown else "name at least one link")


def check_state_validity(now: RequestContext, request: Any, response: Any) -> None:
    """Whether a configuration is valid: joint limits, padding and joint constraints."""
    _check_state(now, request, request.robot_state, response)


def check_multi_state_validity(now: RequestContext, request: Any, response: Any) -> None:
    """The same for several configurations, up to the first invalid one."""
    kind = interface("moveit_msgs/msg/RobotState")
    response.valid = True
    for joints in request.joint_states:
        state = kind(joint_state=joints)
        state.attached_collision_objects = request.robot_state.attached_collision_objects
        _check_state(now, request, state, response)
        if not response.valid:
            return


def _check_state(now: RequestContext, request: Any, state: Any, response: Any) -> None:
    arm = now.arm
    if request.group_name:  # MoveIt takes an empty name for the whole robot, which the arm is
        arm.check_group(request.group_name)
    q = arm.angles(state, now.q_rad)
    scene = now.state.with_attached(state.attached_collision_objects, q)
    checker = CollisionChecker(scene.scene())
    near = checker.collisions(q)
    response.contacts = [_contact(scene, arm, one) for one in near]
    response.valid = checker.is_free(q) and _satisfies_joint_constraints(arm, request.constraints, q)


def _contact(state: SceneState, arm: Arm, pair: PairDistance) -> Any:
    """A contact between two bodies nearer than the padding, as if each link had the padding around it."""
    message = interface("moveit_msgs/msg/ContactInformation")()
    arm.stamp(message.header)
    message.depth = state.padding_m - pair.distance_m
    message.position = arm.pose_message((*pair.point, 0.0, 0.0, 0.0)).position
    root = arm.frame("", (0.0,) * 6)
    x, y, z = pose_trans(pose_inv((0.0, 0.0, 0.0, *root[3:])), (*pair.normal, 0.0, 0.0, 0.0))[:3]
    message.normal.x, message.normal.y, message.normal.z = x, y, z
    for number, name in ((1, pair.one), (2, pair.other)):
        body = state.body_of(name)
        kind = message.ROBOT_LINK
        if body in state.bodies:
            kind = message.ROBOT_ATTACHED if state.bodies[body].link else message.WORLD_OBJECT
        setattr(message, f"contact_body_{number}", body if body in state.bodies else arm.description_name(name))
        setattr(message, f"body_type_{number}", kind)
    return message


def get_planning_scene(now: RequestContext, request: Any, response: Any) -> None:
    response.scene = now.state.message(now.q_rad, request.components.components)


def query_planner_interface(now: RequestContext, request: Any, response: Any) -> None:
    kind = interface("moveit_msgs/msg/PlannerInterfaceDescription")
    response.planner_interfaces = [
        kind(name=name, pipeline_id=name, planner_ids=list(names)) for name, names in PLANNERS.items()
    ]


def get_urdf(now: RequestContext, request: Any, response: Any) -> None:
    """The description: the group is the whole arm."""
    now.arm.check_group(request.group_name)
    response.urdf_string = urdf(now.arm.model, prefix=now.arm.prefix)


def plan_kinematic_path(now: RequestContext, request: Any, response: Any) -> PlanResult:
    answer, wanted = response.motion_plan_response, request.motion_plan_request
    answer.group_name = wanted.group_name
    plan = plan_motion(now.arm, now.state, wanted, now.q_rad)
    answer.trajectory_start = now.arm.state_message(plan.start_rad)
    answer.trajectory = now.arm.trajectory_message(plan.trajectory)
    answer.planning_time = plan.time_s
    return plan


def plan_sequence_path(now: RequestContext, request: Any, response: Any) -> PlanResult | None:
    """Plan motions that blend, as one trajectory."""
    answer = response.response
    if not request.request.items:
        return None
    plan = plan_motion_sequence(now.arm, now.state, request.request, now.q_rad)
    fill_sequence_response(now.arm, answer, plan)
    return plan


def fill_sequence_response(arm: Arm, answer: Any, plan: PlanResult) -> None:
    """Fill a moveit_msgs/MotionSequenceResponse with a plan."""
    answer.sequence_start = arm.state_message(plan.start_rad)
    answer.planned_trajectories = [arm.trajectory_message(plan.trajectory)]
    answer.planning_time = plan.time_s


def compute_cartesian_path(now: RequestContext, request: Any, response: Any) -> PlanResult | None:
    """Move a link straight from waypoint to waypoint, as far as possible."""
    arm = now.arm
    arm.check_group(request.group_name)
    link = request.link_name or arm.tip
    link_offset = arm.flange_to_link(link)
    start = arm.angles(request.start_state, now.q_rad)
    response.start_state = arm.state_message(start)
    if not request.waypoints:
        return None
    state = now.state.with_attached(request.start_state.attached_collision_objects, start)
    frame = request.header.frame_id.lstrip("/")
    poses = map(pose_of, request.waypoints)
    if frame == link:  # each is relative to the one before, as in MoveIt
        at_start = pose_trans(arm.kinematics.forward(start), link_offset)
        waypoints = list(accumulate(poses, pose_trans, initial=at_start))[1:]
    else:
        base = arm.frame(frame, start, state.frames(start))
        waypoints = [pose_trans(base, pose) for pose in poses]
    planner = planner_for(arm, state, request, start)
    kept = path_constraints(arm, state, request.path_constraints, start)
    given = hasattr(request, "max_velocity_scaling_factor")  # since Jazzy
    shares = scaling(request) if given else ScalingFactors(velocity_scaling=1.0, acceleration_scaling=1.0)
    try:
        found = planner.compute_cartesian_path(
            start,
            waypoints,
            float(request.max_step),
            float(request.jump_threshold),
            revolute_jump_threshold_rad=float(request.revolute_jump_threshold),
            avoid_collisions=request.avoid_collisions,
            tcp_offset=link_offset,
            path_constraints=kept,
            **shares,
        )
    except PlanningError as error:
        raise refusal(arm, error, start) from None
    response.solution = arm.trajectory_message(found.plan.trajectory)
    response.fraction = float(found.fraction)
    return PlanResult(start, found.plan.trajectory, found.plan.search_s + found.plan.parameterisation_s)


@dataclass(frozen=True)
class PlanningService:
    """A service. answer: fills the response, and returns the plan if it made one."""

    name: str
    type: str
    answer: Callable[[RequestContext, Any, Any], PlanResult | None]


SERVICES: Final = (
    PlanningService("compute_ik", "moveit_msgs/srv/GetPositionIK", compute_ik),
    PlanningService("compute_fk", "moveit_msgs/srv/GetPositionFK", compute_fk),
    PlanningService("check_state_validity", "moveit_msgs/srv/GetStateValidity", check_state_validity),
    PlanningService("check_multi_state_validity", "moveit_msgs/srv/GetMultiStateValidity", check_multi_state_validity),
    PlanningService("get_planning_scene", "moveit_msgs/srv/GetPlanningScene", get_planning_scene),
    PlanningService("get_urdf", "moveit_msgs/srv/GetGroupUrdf", get_urdf),
    PlanningService("query_planner_interface", "moveit_msgs/srv/QueryPlannerInterfaces", query_planner_interface),
)
"""The services that neither plan, nor change or move anything."""

PLANS: Final = (
    PlanningService("plan_kinematic_path", "moveit_msgs/srv/GetMotionPlan", plan_kinematic_path),
    PlanningService("plan_sequence_path", "moveit_msgs/srv/GetMotionSequence", plan_sequence_path),
    PlanningService("compute_cartesian_path", "moveit_msgs/srv/GetCartesianPath", compute_cartesian_path),
)
"""Those that plan."""


def answer_request(
    row: PlanningService, now: RequestContext, request: Any, response: Any
) -> tuple[PlanResult | None, str]:
    """Fill a response and its code, if it has one; return the plan, if any, and the reason for a failure."""
    code, reason, plan = "SUCCESS", "", None
    try:
        plan = row.answer(now, request, response)
    except RefusedError as error:
        code, reason = error.code, str(error)
    except PlanningError as error:
        code, reason = "FAILURE", str(error)
    set_response_code(response, code, reason)
    return plan, reason


def set_response_code(response: Any, code: str, reason: str) -> None:
    for holder in (response, *(getattr(response, name, None) for name in ("motion_plan_response", "response"))):
        if hasattr(holder, "error_code"):
            set_code(holder.error_code, code, reason)
