"""The node ``cameras``: images from the cameras of an emulator's scene, published like those of camera drivers.

Only images with subscribers are rendered. Converting an image to a message takes milliseconds. Images are therefore
published from the thread that receives them, and not from the event loop, where they would delay setpoints.
"""

import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from client.cameras import CameraClient, CameraFollower, Shot
from client.cameras.messages import (
    COMPRESSED,
    IMAGE,
    INFO,
    FrameTransform,
    camera_info,
    compressed,
    fixed_frames,
    image,
    moving_frames,
    optical_frame,
    ros_name,
)
from client.ros2.frames import set_transform
from client.ros2.host import LATCHED, HostedNode, NodeHost, interface, stamp
from urproto.cameras import CameraDescription
from urproto.robots.pose import rotvec_to_quaternion

_QUALITY: Final = QoSProfile(depth=2)  # reliable, like Gazebo's: best-effort subscribers get them too
_FRAMES: Final = "tf2_msgs/msg/TFMessage"
_NS: Final = 1_000_000_000


@dataclass(frozen=True)
class _Topics:
    """Publishers of one camera."""

    image: Publisher
    compressed: Publisher
    info: Publisher
    depth: Publisher
    depth_info: Publisher


class CameraNode(HostedNode):
    """Publishes cameras. rate_hz: of each camera. prefix: for frames.

    Stamps are the time at which an image was taken. robot_time: the robot's time [s], and this machine's at that moment
    [ns since 1970]; None if images are stamped with the time of their arrival.
    """

    def __init__(
        self,
        host: NodeHost,
        client: CameraClient,
        cameras: Sequence[CameraDescription],
        rate_hz: float,
        prefix: str = "",
        robot_time: Callable[[], tuple[float, int]] | None = None,
    ) -> None:
        super().__init__(host, "cameras")
        self._prefix = prefix
        self._robot_time = robot_time
        self._topics = {camera: _publishers(self.node, ros_name(camera)) for camera in cameras}
        fixed = [frame for camera in cameras for frame in fixed_frames(camera, prefix)]
        self._static = self.node.create_publisher(interface(_FRAMES), "/tf_static", LATCHED)
        self._static.publish(_transforms(fixed, host.now_ns()))
        self._moving = self.node.create_publisher(interface(_FRAMES), "/tf", QoSProfile(depth=100))
        self._publishers_by_form: Mapping[str, Callable[[Shot, int], None]] = {
            "rgb.npy": self._rgb,
            "rgb.jpg": self._jpeg,
            "depth.npy": self._depth,
            "rgbd.npz": self._rgbd,
        }
        host.spin(self.node)
        warn = self.node.get_logger().warning
        self._follower = CameraFollower(client, lambda: self._required_images(), rate_hz, self._publish_shot, warn)
        self._follower.__enter__()

    def close(self) -> None:
        self._follower.close()
        super().close()

    def _required_images(self) -> Iterator[tuple[CameraDescription, str]]:
        """The fewest images that cover all subscriptions; colours and depth are of the same moment."""
        for camera, topics in self._topics.items():
            rgb, depth = (
                _has_subscribers(topics.image),
                _has_subscribers(topics.depth) or _has_subscribers(topics.depth_info),
            )
            if rgb or depth:
                yield camera, "rgbd.npz" if rgb and depth else "rgb.npy" if rgb else "depth.npy"
            if _has_subscribers(topics.compressed) or (_has_subscribers(topics.info) and not rgb):
                yield camera, "rgb.jpg"

    def _publish_shot(self, shot: Shot) -> None:
        age_s, time_ns = 0.0, self._host.now_ns()
        if self._robot_time is not None:
            robot_s, time_ns = self._robot_time()
            age_s = max(0.0, robot_s - shot.time_s)
        time_ns -= round(age_s * _NS)
        if moving := moving_frames(shot, self._prefix):
            self._moving.publish(_transforms(moving, time_ns))
        self._publishers_by_form[shot.form](shot, time_ns)

    def _rgbd(self, shot: Shot, time_ns: int) -> None:
        self._rgb(shot, time_ns)
        self._depth(shot, time_ns)

    def _rgb(self, shot: Shot, time_ns: int) -> None:
        topics = self._topics[shot.camera]
        self._publish(topics.image, IMAGE, image(shot.arrays["rgb"]), shot, time_ns)
        self._publish(topics.info, INFO, camera_info(shot.camera), shot, time_ns)

    def _depth(self, shot: Shot, time_ns: int) -> None:
        topics = self._topics[shot.camera]
        self._publish(topics.depth, IMAGE, image(shot.arrays["depth"]), shot, time_ns)
        self._publish(topics.depth_info, INFO, camera_info(shot.camera), shot, time_ns)

    def _jpeg(self, shot: Shot, time_ns: int) -> None:
        topics = self._topics[shot.camera]
        self._publish(topics.compressed, COMPRESSED, compressed(shot.data), shot, time_ns)
        self._publish(topics.info, INFO, camera_info(shot.camera), shot, time_ns)

    def _publish(self, publisher: Publisher, kind: str, values: Mapping[str, Any], shot: Shot, time_ns: int) -> None:
        message = interface(kind)()
        stamp(message.header.stamp, time_ns)
        message.header.frame_id = optical_frame(shot.camera, self._prefix)
        for name, value in values.items():
            setattr(message, name, array.array("B", value) if isinstance(value, bytes) else value)
        publisher.publish(message)


def _publishers(node: Node, name: str) -> _Topics:
    create = partial(node.create_publisher, qos_profile=_QUALITY)
    return _Topics(
        create(interface(IMAGE), f"{name}/image_raw"),
        create(interface(COMPRESSED), f"{name}/image_raw/compressed"),
        create(interface(INFO), f"{name}/camera_info"),
        create(interface(IMAGE), f"{name}/depth/image_raw"),
        create(interface(INFO), f"{name}/depth/camera_info"),
    )


def _has_subscribers(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())


def _transforms(frames: Sequence[FrameTransform], time_ns: int) -> Any:
    message = interface(_FRAMES)()
    for frame in frames:
        transform = interface("geometry_msgs/msg/TransformStamped")()
        stamp(transform.header.stamp, time_ns)
        transform.header.frame_id = frame.parent
        set_transform(transform, frame.child, frame.pose[:3], rotvec_to_quaternion(*frame.pose[3:]))
        message.transforms.append(transform)
    return message
