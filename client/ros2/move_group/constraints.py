"""Path constraints from messages, of the kinds that `client.planning` supports: an orientation, and a box for a
position.
"""

from math import isfinite
from typing import Any

from client.errors import PlanningError
from client.planning import OrientationConstraint, PathConstraints, PositionConstraint
from client.ros2.move_group.arm import Arm, RefusedError, pose_of
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.robots.pose import pose_trans, quaternion_to_rotvec

_ZERO = 1e-6  # a quaternion this short has not been set


def is_empty(constraints: Any) -> bool:
    """Whether a moveit_msgs/Constraints contains no constraint."""
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
