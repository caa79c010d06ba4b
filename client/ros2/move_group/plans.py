"""The services of ``move_group`` that plan, which may take seconds."""

from typing import Any, Final

from client.errors import PlanningError
from client.ros2.move_group.arm import Arm, pose_of
from client.ros2.move_group.constraints import path_constraints
from client.ros2.move_group.requests import (
    PlanResult,
    ScalingFactors,
    plan_motion,
    plan_motion_sequence,
    planner_for,
    refusal,
    scaling,
)
from client.ros2.move_group.services import PlanningService, RequestContext
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_trans


def plan_kinematic_path(now: RequestContext, request: Any, response: Any) -> PlanResult:
    """Plan one motion."""
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
    waypoints = _from_pose_to_pose(now, request, start, link_offset) if frame == link else None
    if waypoints is None:
        base = arm.frame(frame, start, state.frames(start))
        waypoints = [pose_trans(base, pose_of(one)) for one in request.waypoints]
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


def _from_pose_to_pose(now: RequestContext, request: Any, start: Joints, link_offset: Pose) -> list[Pose]:
    """Waypoints in the frame of the moving link: each relative to the one before, as in MoveIt."""
    pose = pose_trans(now.arm.kinematics.forward(start), link_offset)
    found = []
    for one in request.waypoints:
        pose = pose_trans(pose, pose_of(one))
        found.append(pose)
    return found


PLANS: Final = (
    PlanningService("plan_kinematic_path", "moveit_msgs/srv/GetMotionPlan", plan_kinematic_path),
    PlanningService("plan_sequence_path", "moveit_msgs/srv/GetMotionSequence", plan_sequence_path),
    PlanningService("compute_cartesian_path", "moveit_msgs/srv/GetCartesianPath", compute_cartesian_path),
)
