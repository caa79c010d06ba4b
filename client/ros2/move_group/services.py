"""What the services of ``move_group`` answer: one function each, of a request and where the arm stands.

They raise RefusedError for what cannot be had, and PlanningError.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from client.errors import PlanningError
from client.planning import CollisionChecker, PairDistance
from client.ros2.host import interface
from client.ros2.move_group.arm import Arm, RefusedError, pose_of, set_code
from client.ros2.move_group.constraints import is_empty
from client.ros2.move_group.requests import PLANNERS, Planned, reaching
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.description import urdf
from urproto.robots.pose import pose_inv, pose_trans


@dataclass(frozen=True)
class Situation:
    """What a request is answered by. q_rad: where the arm stands."""

    arm: Arm
    state: SceneState
    q_rad: Sequence[float]


def compute_ik(now: Situation, message: Any, response: Any) -> None:
    """The joint angles nearest to the robot state of the request."""
    request, arm = message.ik_request, now.arm
    arm.check_group(request.group_name)
    if request.ik_link_names or request.pose_stamped_vector:
        raise RefusedError("INVALID_LINK_NAME", "an arm has one tip: give ik_link_name and pose_stamped")
    seed = arm.angles(request.robot_state, now.q_rad)
    state = now.state.with_attached(request.robot_state.attached_collision_objects, seed)
    beyond = arm.beyond_flange(request.ik_link_name or arm.tip)
    stamped = request.pose_stamped
    frame = arm.frame(stamped.header.frame_id, seed, state.frames(seed))
    flange = pose_trans(pose_trans(frame, pose_of(stamped.pose)), pose_inv(beyond))
    found = [q for q in reaching(arm, flange, seed) if _keeps(arm, request.constraints, q)]
    if not found:
        raise RefusedError("NO_IK_SOLUTION", "no joint angles put the link there, within limits and constraints")
    if request.avoid_collisions:
        checker = CollisionChecker(state.scene())
        free = [q for q in found if checker.is_free(q)]
        if not free:
            why = "; ".join(map(str, checker.collisions(found[0])[:3]))
            raise RefusedError("NO_IK_SOLUTION", f"all of {len(found)} postures touch something; the nearest: {why}")
        found = free
    response.solution = arm.state_message(found[0])
    response.solution.attached_collision_objects = state.attached_messages()


def _keeps(arm: Arm, constraints: Any, q_rad: Joints) -> bool:
    """Whether joint angles are within joint constraints. Raises RefusedError for others."""
    if not is_empty(constraints) and not constraints.joint_constraints:
        raise RefusedError("INVALID_GOAL_CONSTRAINTS", "of constraints, those of joints are kept, no others")
    angles = dict(zip(arm.joints, q_rad, strict=True))
    for one in constraints.joint_constraints:
        if one.joint_name not in angles:
            raise RefusedError("INVALID_GOAL_CONSTRAINTS", f"the arm has no joint {one.joint_name!r}")
        away = angles[one.joint_name] - one.position
        if not -one.tolerance_below <= away <= one.tolerance_above:
            return False
    return True


def compute_fk(now: Situation, request: Any, response: Any) -> None:
    """Where links, or objects of the scene, are."""
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
        raise RefusedError("INVALID_LINK_NAME", f"there is no link {unknown[0]!r}" if unknown else "no link is named")


def check_state_validity(now: Situation, request: Any, response: Any) -> None:
    """Whether an arm may stand like that: its limits, the padding, and joint constraints."""
    _judge(now, request, request.robot_state, response)


def check_multi_state_validity(now: Situation, request: Any, response: Any) -> None:
    """The same for several states, up to the first that may not be."""
    kind = interface("moveit_msgs/msg/RobotState")
    response.valid = True
    for joints in request.joint_states:
        state = kind(joint_state=joints)
        state.attached_collision_objects = request.robot_state.attached_collision_objects
        _judge(now, request, state, response)
        if not response.valid:
            return


def _judge(now: Situation, request: Any, state: Any, response: Any) -> None:
    arm = now.arm
    if request.group_name:  # MoveIt takes none as the whole robot, which the arm is
        arm.check_group(request.group_name)
    q = arm.angles(state, now.q_rad)
    scene = now.state.with_attached(state.attached_collision_objects, q)
    checker = CollisionChecker(scene.scene())
    near = checker.collisions(q)
    response.contacts = [_contact(scene, arm, one) for one in near]
    response.valid = checker.is_free(q) and _keeps(arm, request.constraints, q)


def _contact(state: SceneState, arm: Arm, pair: PairDistance) -> Any:
    """Of two things that are nearer than the padding, as if each link had it around it."""
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
        setattr(message, f"contact_body_{number}", body if body in state.bodies else arm.described(name))
        setattr(message, f"body_type_{number}", kind)
    return message


def get_planning_scene(now: Situation, request: Any, response: Any) -> None:
    """The scene, or those parts of it that are asked for."""
    response.scene = now.state.message(now.q_rad, request.components.components)


def query_planner_interface(now: Situation, request: Any, response: Any) -> None:
    """The planners that there are."""
    kind = interface("moveit_msgs/msg/PlannerInterfaceDescription")
    response.planner_interfaces = [
        kind(name=name, pipeline_id=name, planner_ids=list(names)) for name, names in PLANNERS.items()
    ]


def get_urdf(now: Situation, request: Any, response: Any) -> None:
    """The description: the group is all of the arm."""
    now.arm.check_group(request.group_name)
    response.urdf_string = urdf(now.arm.model, prefix=now.arm.prefix)


@dataclass(frozen=True)
class Service:
    """A service. answer: fills the response, and gives what it has planned, if it plans."""

    name: str
    type: str
    answer: Callable[[Situation, Any, Any], Planned | None]


SERVICES: Final = (
    Service("compute_ik", "moveit_msgs/srv/GetPositionIK", compute_ik),
    Service("compute_fk", "moveit_msgs/srv/GetPositionFK", compute_fk),
    Service("check_state_validity", "moveit_msgs/srv/GetStateValidity", check_state_validity),
    Service("check_multi_state_validity", "moveit_msgs/srv/GetMultiStateValidity", check_multi_state_validity),
    Service("get_planning_scene", "moveit_msgs/srv/GetPlanningScene", get_planning_scene),
    Service("get_urdf", "moveit_msgs/srv/GetGroupUrdf", get_urdf),
    Service("query_planner_interface", "moveit_msgs/srv/QueryPlannerInterfaces", query_planner_interface),
)
"""Those that change nothing and move nothing."""


def answered(row: Service, now: Situation, request: Any, response: Any) -> tuple[Planned | None, str]:
    """Fill a response, with its code if it has one; what was planned, and why it is none of success, or nothing."""
    code, reason, plan = "SUCCESS", "", None
    try:
        plan = row.answer(now, request, response)
    except RefusedError as error:
        code, reason = error.code, str(error)
    except PlanningError as error:
        code, reason = "FAILURE", str(error)
    answer_code(response, code, reason)
    return plan, reason


def answer_code(response: Any, code: str, reason: str) -> None:
    """Set the code of a response that has one."""
    for holder in (response, *(getattr(response, name, None) for name in ("motion_plan_response", "response"))):
        if hasattr(holder, "error_code"):
            set_code(holder.error_code, code, reason)
