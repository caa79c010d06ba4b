"""Publishes what the control loop sends, which sends only topics that are latched or have subscribers."""

import asyncio
from collections.abc import Hashable
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from client.errors import ClientError
from client.ros2.control_side import CLOCK, SIDE, ControlSide
from client.ros2.frames import Frames
from client.ros2.host import LATCHED, SYSTEM_DEFAULT, HostedNode, NodeHost, RemoteController, interface, stamp
from client.ros2.topics import MOVING_FRAMES, Publication, PublishingContext
from urproto.robots import RobotModel
from urproto.robots.description import urdf

_CLOCK: Final = "rosgraph_msgs/msg/Clock"
_POLL_S: Final = 0.05  # interval at which subscribers are counted, which costs 2 us per topic


class Outbox:
    """Publishes the messages of controllers' topics. Create and close it in the event loop."""

    def __init__(self, host: NodeHost, scene: PublishingContext) -> None:
        self.scene = scene
        self._host = host
        self._channels: dict[Hashable, _Channel] = {}
        self._polling = host.loop.create_task(self._poll())

    def close(self) -> None:
        self._polling.cancel()

    def add(self, controller: RemoteController, publisher: Publisher, row: Publication) -> Hashable:
        """Publish a topic from now on; returns its key. From a thread."""
        key = (controller.name, row.name)
        channel = _Channel(controller, publisher, row, self.scene)
        self._host.listen(key, lambda message: channel.publish(message, self._host.received_ns))
        if row.latched:
            self._host.do(*channel.subscription(key))
        else:
            self._channels[key] = channel
        return key

    def remove(self, key: Hashable) -> None:
        self._channels.pop(key, None)
        self._host.unlisten(key)

    async def _poll(self) -> None:
        while True:
            for key, channel in list(self._channels.items()):
                if channel.subscribers_changed():
                    await self._follow(key, channel)
            await asyncio.sleep(_POLL_S)

    async def _follow(self, key: Hashable, channel: "_Channel") -> None:
        try:
            if channel.has_subscribers:
                await self._host.call(*channel.subscription(key))
            else:
                await self._host.call(ControlSide.unsubscribe, SIDE, key)
        except ClientError:  # the controller has just been unloaded
            return


class _Channel:
    """Connects a controller's topic to a topic of ROS 2."""

    def __init__(
        self, controller: RemoteController, publisher: Publisher, row: Publication, scene: PublishingContext
    ) -> None:
        self.has_subscribers = False
        self._controller = controller
        self._publisher = publisher
        self._row = row
        self._scene = scene
        self._message = interface(row.type)()

    def subscription(self, key: Hashable) -> tuple[Any, ...]:
        """The call that subscribes to the controller's topic."""
        row, controller = self._row, self._controller.reference
        return ControlSide.subscribe, SIDE, key, controller, row.source, row.every_s, row.latched, row.all_states

    def subscribers_changed(self) -> bool:
        """Update whether the topic has subscribers; returns whether this has changed."""
        before, self.has_subscribers = self.has_subscribers, self._publisher.get_subscription_count() > 0
        return before != self.has_subscribers

    def publish(self, message: Any, time_ns: int) -> None:
        """Publish one message, unless it has no content."""
        self._scene.sec, self._scene.nanosec = divmod(time_ns, 1_000_000_000)
        if self._row.fill(self._message, message, self._scene):
            self._publisher.publish(self._message)


class ClockPublisher(HostedNode):
    """Publishes the time of ROS as ``/clock`` with each batch of messages, for ``use_sim_time`` of other nodes."""

    def __init__(self, host: NodeHost) -> None:
        super().__init__(host, "robot_clock")
        self._publisher = self.node.create_publisher(interface(_CLOCK), "/clock", SYSTEM_DEFAULT)
        host.listen(CLOCK, self._publish)
        host.spin(self.node)

    def close(self) -> None:
        self._host.unlisten(CLOCK)
        super().close()

    def _publish(self, time_s: float) -> None:
        message = interface(_CLOCK)()
        stamp(message.clock, round(time_s * 1e9))
        self._publisher.publish(message)


class RobotStatePublisher(HostedNode):
    """Publishes a model's description and frames."""

    def __init__(
        self, host: NodeHost, outbox: Outbox, model: RobotModel, states: RemoteController, prefix: str = ""
    ) -> None:
        super().__init__(host, "robot_state_publisher")
        self._outbox = outbox
        description = urdf(model, prefix=prefix)
        self.node.declare_parameter("robot_description", description)
        self.node.declare_parameter("frame_prefix", "")
        self.node.declare_parameter("publish_frequency", 20.0)
        self._description = self.node.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=description))
        frames = Frames(model, prefix)
        sec, nanosec = divmod(host.now_ns(), 1_000_000_000)
        message = interface("tf2_msgs/msg/TFMessage")(transforms=frames.fixed(sec, nanosec))
        self._static = self.node.create_publisher(type(message), "/tf_static", LATCHED)
        self._static.publish(message)
        outbox.scene.frames = frames
        self._key = outbox.add(states, publisher(self.node, MOVING_FRAMES), MOVING_FRAMES)
        host.spin(self.node)

    def close(self) -> None:
        self._outbox.remove(self._key)
        super().close()


def publisher(node: Node, row: Publication) -> Publisher:
    quality = LATCHED if row.latched else SYSTEM_DEFAULT if row.depth == 1 else QoSProfile(depth=row.depth)
    return node.create_publisher(interface(row.type), row.name, quality)
