"""Poses of frames that do not belong to the arm, from transforms on ``/tf`` and ``/tf_static``.

There is no permanent listener: the driver's own frames arrive every cycle, and reading them would cost more than
everything else it does. A request in a foreign frame listens until the frame is linked to one of the arm's.
"""

import asyncio
import math
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, QoSProfile

from client.controllers.controller import Interfaces
from client.ros2.control_side import STATES
from client.ros2.host import NodeHost, interface
from client.ros2.topics import TF_DEPTH, PublishingContext
from urproto.robots.pose import Pose, pose_inv, pose_trans, quaternion_to_rotvec
from urproto.text import quoted
from urproto.vectors import ZERO6

_NODE: Final = "transform_listener"
_WAIT_S: Final = 2.0  # guess: a frame that moves is published once a second or more often
_SMALL: Final = 1e-6  # below it a quaternion has no direction

Refuse = Callable[[str], Exception]
"""Creates an exception from a reason."""


class Transforms:
    """Frames of the arm and other frames. Call its methods in the event loop."""

    def __init__(self, host: NodeHost, scene: PublishingContext) -> None:
        self._host = host
        self._scene = scene
        self._one_at_a_time = asyncio.Lock()

    async def poses_in_base(self, frames: Iterable[str], refuse: Refuse) -> dict[str, Pose]:
        """Current poses of frames in the arm's base frame, by name [m, rotation vector]; "" is the base frame.

        Raises the exception that ``refuse`` creates if a frame is not published.
        """
        requested = set(frames)
        states = await self._host.call(Interfaces.get, STATES)
        others = {frame for frame in requested if self._scene.pose_of(frame, states) is None}
        nearest_known = {}
        if others:
            nearest_known = await self._listen(others)
            states = await self._host.call(Interfaces.get, STATES)
        poses = {}
        for frame in requested:
            anchor, pose = nearest_known.get(frame, (frame, ZERO6))
            anchor_pose = self._scene.pose_of(anchor, states)
            if anchor_pose is None:
                raise refuse(
                    f"the frame {quoted(frame)} does not belong to the arm, and was not published on /tf or /tf_static "
                    f"within {_WAIT_S:g} s: publish it, or use the frame {self._scene.prefix}base"
                )
            poses[frame] = pose_trans(anchor_pose, pose)
        return poses

    async def _listen(self, frames: set[str]) -> dict[str, tuple[str, Pose]]:
        async with self._one_at_a_time:
            listener = _Listener(frames, self._scene.frame_names)
            return await asyncio.to_thread(listener.listen, self._host)


class _Listener:
    """Listens until each of these frames is linked to one of ``known``, but not longer than `_WAIT_S`."""

    def __init__(self, frames: set[str], known: frozenset[str]) -> None:
        self._frames = {frame: frame.lstrip("/") for frame in frames}
        self._known = known
        self._links: dict[str, dict[str, Pose]] = {}  # frame -> neighbour -> pose of the neighbour in the frame
        self._found: dict[str, tuple[str, Pose]] = {}
        self._complete = threading.Event()

    def listen(self, host: NodeHost) -> dict[str, tuple[str, Pose]]:
        """For each frame, a known frame and the pose in it; frames that are not published are left out."""
        node = host.node(_NODE, start_parameter_services=False, enable_rosout=False)
        kind = interface("tf2_msgs/msg/TFMessage")
        static = QoSProfile(depth=TF_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(kind, "/tf", self._on_transforms, QoSProfile(depth=TF_DEPTH))
        node.create_subscription(kind, "/tf_static", self._on_transforms, static)
        host.spin(node)
        try:
            self._complete.wait(_WAIT_S)
        finally:
            host.close(node)
        return self._found

    def _on_transforms(self, message: Any) -> None:
        for transform in message.transforms:
            if (pose := pose_of_transform(transform.transform)) is not None:
                parent, child = transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")
                self._links.setdefault(parent, {})[child] = pose
                self._links.setdefault(child, {})[parent] = pose_inv(pose)
        for frame, name in self._frames.items():
            if frame not in self._found and (link := nearest_known(name, self._known, self._links)) is not None:
                self._found[frame] = link
        if len(self._found) == len(self._frames):
            self._complete.set()


def nearest_known(
    frame: str, known: frozenset[str], links: Mapping[str, Mapping[str, Pose]]
) -> tuple[str, Pose] | None:
    """The known frame that is the fewest links away, and the pose of ``frame`` in it; None if none is linked."""
    reached: dict[str, Pose] = {frame: ZERO6}  # pose of each, in ``frame``
    queue = [frame]
    for name in queue:
        if name in known:
            return name, pose_inv(reached[name])
        for neighbour, pose in links.get(name, {}).items():
            if neighbour not in reached:
                reached[neighbour] = pose_trans(reached[name], pose)
                queue.append(neighbour)
    return None


def pose_of_transform(transform: Any) -> Pose | None:
    """The pose of a geometry_msgs/Transform [m, rotation vector]; None if it is not finite or has a zero rotation."""
    place, turn = transform.translation, transform.rotation
    numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    if not all(map(math.isfinite, numbers)) or math.hypot(*numbers[3:]) < _SMALL:
        return None
    return (place.x, place.y, place.z, *quaternion_to_rotvec(turn.x, turn.y, turn.z, turn.w))


def pose_in(poses: Mapping[str, Pose], stamped: Any, refuse: Refuse) -> Pose:
    """A geometry_msgs/PoseStamped in the base frame. poses: of frames in the base. Raises for a zero orientation."""
    place, turn = stamped.pose.position, stamped.pose.orientation
    if max(map(abs, (turn.x, turn.y, turn.z, turn.w))) < _SMALL:
        raise refuse("its orientation is zero, which is not a valid quaternion: w=1 is no rotation")
    pose = (place.x, place.y, place.z, *quaternion_to_rotvec(turn.x, turn.y, turn.z, turn.w))
    return pose_trans(poses[stamped.header.frame_id], pose)
