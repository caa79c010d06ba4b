"""Frames of an arm as ROS 2 tells them, under the names of its description."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from client.recording.timestamps import header
from urproto.robots import RobotModel
from urproto.robots.description import JointFrame, joint_frames
from urproto.robots.pose import pose_trans, rotvec_to_quaternion

Values = Mapping[str, Any]


class Frames:
    """The frames of an arm; messages are those of robot_state_publisher."""

    def __init__(self, model: RobotModel, prefix: str = "") -> None:
        frames = joint_frames(model, prefix)
        self._fixed = [frame for frame in frames if not frame.moves]
        self._moving = {frame.joint: frame for frame in frames if frame.moves}

    def fixed(self, time_ns: int) -> Values:
        """Those that never move, for ``/tf_static``."""
        return _message(_stamped(frame, frame.pose, time_ns) for frame in self._fixed)

    def moving(self, names: Iterable[str], q_rad: Iterable[float], time_ns: int) -> Values:
        """Those of joints, for ``/tf``; names that are no joints of the arm are left out."""
        angles = zip(names, q_rad, strict=True)
        joints = ((self._moving[name], q) for name, q in angles if name in self._moving)
        return _message(_stamped(joint, pose_trans(joint.pose, (*(0.0,) * 5, q)), time_ns) for joint, q in joints)


def transform(parent: str, child: str, xyz: Sequence[float], xyzw: Sequence[float], time_ns: int) -> Values:
    """``child`` in ``parent``, as geometry_msgs/TransformStamped."""
    turned = {"translation": dict(zip("xyz", xyz, strict=True)), "rotation": dict(zip("xyzw", xyzw, strict=True))}
    return {"header": header(time_ns, parent), "child_frame_id": child, "transform": turned}


def _stamped(frame: JointFrame, pose: Sequence[float], time_ns: int) -> Values:
    return transform(frame.parent, frame.child, pose[:3], rotvec_to_quaternion(*pose[3:]), time_ns)


def _message(transforms: Iterable[Values]) -> Values:
    return {"transforms": list(transforms)}
