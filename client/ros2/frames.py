"""Frames of an arm with the names of its description, as in robot_state_publisher and tf2."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import TransformStamped

from urproto.robots import RobotModel
from urproto.robots.description import JointFrame, joint_frames
from urproto.robots.pose import Pose, pose_inv, pose_trans, rotvec_to_quaternion
from urproto.vectors import ZERO6


class Frames:
    """The frames of an arm, as transforms."""

    def __init__(self, model: RobotModel, prefix: str = "") -> None:
        frames = joint_frames(model, prefix)
        self._frames = {frame.child: frame for frame in frames}
        self._fixed = [frame for frame in frames if not frame.moves]
        self._moving = {frame.joint: frame for frame in frames if frame.moves}

    @property
    def names(self) -> set[str]:
        return {*self._frames, *(frame.parent for frame in self._frames.values())}

    def fixed(self, sec: int, nanosec: int) -> list[TransformStamped]:
        """Transforms of frames that never move, for ``/tf_static``."""
        return [_transform(frame, frame.pose, sec, nanosec) for frame in self._fixed]

    def moving(self, names: Iterable[str], q_rad: Iterable[float], sec: int, nanosec: int) -> list[TransformStamped]:
        """Transforms of the joints' frames, for ``/tf``; names that are not joints of the arm are left out."""
        joints = ((self._moving[name], q) for name, q in zip(names, q_rad, strict=True) if name in self._moving)
        return [
            _transform(joint, pose_trans(joint.pose, (0.0, 0.0, 0.0, 0.0, 0.0, q)), sec, nanosec) for joint, q in joints
        ]

    def pose_in(self, base: str, frame: str, q_rad: Mapping[str, float]) -> Pose | None:
        """The pose of a frame in another one [m, rotation vector]; None unless both belong to the arm.

        q_rad: angles by joint name.
        """
        if not {base, frame} <= self.names:
            return None
        return pose_trans(pose_inv(self._from_root(base, q_rad)), self._from_root(frame, q_rad))

    def _from_root(self, name: str, q_rad: Mapping[str, float]) -> Pose:
        frame = self._frames.get(name)
        if frame is None:
            return ZERO6
        pose = pose_trans(self._from_root(frame.parent, q_rad), frame.pose)
        return pose_trans(pose, (0.0, 0.0, 0.0, 0.0, 0.0, q_rad[frame.joint])) if frame.moves else pose


def _transform(frame: JointFrame, pose: Sequence[float], sec: int, nanosec: int) -> TransformStamped:
    message = TransformStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    message.header.frame_id = frame.parent
    set_transform(message, frame.child, pose[:3], rotvec_to_quaternion(*pose[3:]))
    return message


def set_transform(message: Any, child: str, xyz: Sequence[float], xyzw: Sequence[float]) -> None:
    """Set all fields of a geometry_msgs/TransformStamped except its header."""
    message.child_frame_id = child
    place, turn = message.transform.translation, message.transform.rotation
    place.x, place.y, place.z = xyz
    turn.x, turn.y, turn.z, turn.w = xyzw
