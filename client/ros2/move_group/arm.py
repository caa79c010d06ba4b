"""An arm in terms of MoveIt's messages: links, frames, joint states, and the refusal of invalid requests.

Here, as everywhere in this project, poses are in the controller's base frame [m, rotation vector]. In messages, they
are in the frame that the header names; in responses, in ``base_link``, the root of the description.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, Final

from client.errors import ClientError
from client.planning import Trajectory
from client.planning.scene import LINKS
from client.ros2.frames import Frames
from client.ros2.host import interface, stamp
from urproto.joints import JOINT_NAMES
from urproto.robots import Joints, RobotModel, kinematics_of
from urproto.robots.description import joint_frames
from urproto.robots.pose import Pose, pose_inv, pose_trans, quaternion_to_rotvec, rotvec_to_quaternion
from urproto.vectors import ZERO6, as_six

GROUP: Final = "ur_manipulator"
"""As in ur_moveit_config's SRDF; the same for any prefix of names."""
_CARRYING: Final = ("wrist_3_link", "flange", "tool0", "ft_frame")
_BASE_GEOMETRY: Final = "base_link_inertia"  # the link of the description that has the shape of client.planning's base
_ZERO: Final = 1e-6  # a quaternion this short has not been set


class RefusedError(ClientError):
    """A request that is refused. code: the name of a code in MoveItErrorCodes."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class Arm:
    """An arm and its names. prefix: of joints, links and frames. now_ns: returns the time of ROS."""

    def __init__(self, model: RobotModel, prefix: str = "", now_ns: Callable[[], int] = time.time_ns) -> None:
        self.model = model
        self.prefix = prefix
        self._now_ns = now_ns
        self.kinematics = kinematics_of(model)
        self.joints = tuple(prefix + name for name in JOINT_NAMES)
        self.root = f"{prefix}base_link"
        self.tip = f"{prefix}tool0"
        self._base = f"{prefix}base"
        self._frames = Frames(model, prefix)
        self.links = (self.root, *(frame.child for frame in joint_frames(model, prefix)))
        self.collision_links = tuple(prefix + name for name in (_BASE_GEOMETRY, *LINKS[1:]))

    # links

    def planning_name(self, link: str) -> str:
        """The name in client.planning of a link that has a shape."""
        return LINKS[self.collision_links.index(link)]

    def description_name(self, name: str) -> str:
        """The name in the description of a link, or an object, of client.planning."""
        return self.collision_links[LINKS.index(name)] if name in LINKS else name

    def check_group(self, name: str) -> None:
        """Raise RefusedError for any group but the arm's."""
        if name != GROUP:
            raise RefusedError("INVALID_GROUP_NAME", f"unknown group {name!r}: the arm is {GROUP}")

    def flange_to_link(self, link: str) -> Pose:
        """The pose of a link in the flange's frame. Raises RefusedError unless it moves with the flange."""
        if link not in (self.prefix + name for name in _CARRYING):
            carrying = ", ".join(self.prefix + name for name in _CARRYING)
            raise RefusedError("INVALID_LINK_NAME", f"{link!r} does not move with the flange: use one of {carrying}")
        pose = self._frames.pose_in(self.tip, link, dict.fromkeys(self.joints, 0.0))
        assert pose is not None
        return pose

    # frames and poses

    def frame(self, name: str, q_rad: Sequence[float], others: Mapping[str, Pose] | None = None) -> Pose:
        """The pose of a frame; "" is the root. others: further frames. Raises RefusedError for an unknown frame."""
        name = name.lstrip("/") or self.root
        if others and name in others:
            return others[name]
        pose = self._frames.pose_in(self._base, name, dict(zip(self.joints, q_rad, strict=True)))
        if pose is None:
            raise RefusedError(
                "FRAME_TRANSFORM_FAILURE",
                f"{name!r} is not a frame of the arm or of the scene: use {self.root} or {self._base}",
            )
        return pose

    def pose_message(self, pose: Sequence[float], of: Sequence[float] | None = None) -> Any:
        """A geometry_msgs/Pose. of: the frame it is to be in; the root if None."""
        root = self.frame("", (0.0,) * 6) if of is None else of
        return pose_message(pose_trans(pose_inv(root), pose))

    # joint states

    def angles(self, state: Any, q_rad: Sequence[float]) -> Joints:
        """The joint angles of a moveit_msgs/RobotState; joints that it does not name keep their current position.

        Raises RefusedError for joints that the arm does not have, and for angles that are not finite.
        """
        names, positions = list(state.joint_state.name), list(state.joint_state.position)
        if state.multi_dof_joint_state.joint_names:
            raise RefusedError("INVALID_ROBOT_STATE", "this arm has no joints with several degrees of freedom")
        if unknown := [name for name in names if name not in self.joints]:
            raise RefusedError(
                "INVALID_ROBOT_STATE", f"the arm has no joint {unknown[0]!r}; it has {', '.join(self.joints)}"
            )
        if len(names) != len(positions) or not all(map(isfinite, positions)):
            raise RefusedError("INVALID_ROBOT_STATE", "a joint state must have one finite number for each of its names")
        given = dict(zip(self.joints, q_rad, strict=True)) | dict(zip(names, positions, strict=True))
        return as_six(given[name] for name in self.joints)

    def state_message(self, q_rad: Sequence[float]) -> Any:
        """A moveit_msgs/RobotState with all joints."""
        message = interface("moveit_msgs/msg/RobotState")()
        self.stamp(message.joint_state.header)
        message.joint_state.name = list(self.joints)
        message.joint_state.position = [float(q) for q in q_rad]
        return message

    def trajectory_message(self, trajectory: Trajectory) -> Any:
        """A moveit_msgs/RobotTrajectory; its first point is the start."""
        message = interface("moveit_msgs/msg/RobotTrajectory")()
        joints = message.joint_trajectory
        joints.header.frame_id = self.root
        joints.joint_names = list(self.joints)
        kind = interface("trajectory_msgs/msg/JointTrajectoryPoint")
        for time_s, q, qd, qdd in zip(trajectory.times_s, trajectory.q, trajectory.qd, trajectory.qdd, strict=True):
            point = kind(positions=q.tolist(), velocities=qd.tolist(), accelerations=qdd.tolist())
            set_duration(point.time_from_start, float(time_s))
            joints.points.append(point)
        return message

    def stamp(self, header: Any, frame: str = "") -> None:
        """Set a std_msgs/Header to the current time and a frame, the root if none is given."""
        stamp(header.stamp, self._now_ns())
        header.frame_id = frame or self.root


def pose_of(message: Any) -> Pose:
    """Read a geometry_msgs/Pose; an all-zero quaternion means no rotation. Raises RefusedError for numbers that are not
    finite.
    """
    place, turn = message.position, message.orientation
    parts = (turn.x, turn.y, turn.z, turn.w)
    if not all(map(isfinite, (place.x, place.y, place.z, *parts))):
        raise RefusedError("INVALID_ROBOT_STATE", "a pose has numbers that are not finite")
    if max(map(abs, parts)) < _ZERO:
        return (place.x, place.y, place.z, 0.0, 0.0, 0.0)
    return (place.x, place.y, place.z, *quaternion_to_rotvec(*parts))


def pose_message(pose: Sequence[float] = ZERO6) -> Any:
    """A geometry_msgs/Pose."""
    message = interface("geometry_msgs/msg/Pose")()
    place, turn = message.position, message.orientation
    place.x, place.y, place.z = map(float, pose[:3])
    turn.x, turn.y, turn.z, turn.w = rotvec_to_quaternion(*pose[3:])
    return message


def set_duration(message: Any, time_s: float) -> None:
    """Set a builtin_interfaces/Duration."""
    message.sec, message.nanosec = divmod(round(time_s * 1e9), 1_000_000_000)


def set_code(message: Any, code: str, reason: str = "") -> None:
    """Set a moveit_msgs/MoveItErrorCodes, which has a message since Jazzy."""
    message.val = getattr(type(message), code)
    if hasattr(message, "message"):
        message.message, message.source = reason, "move_group" if reason else ""
