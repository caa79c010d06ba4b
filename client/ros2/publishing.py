"""Publish the messages of a control cycle after it, so that setpoints go first, and only on topics with subscribers."""

import asyncio
import time
from functools import partial
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from client.controllers.controller import Topic
from client.ros2.host import LATCHED, SYSTEM_DEFAULT, NodeHost, interface
from client.ros2.topics import Publication, PublishingContext

_POLL_S: Final = 0.05  # interval at which subscribers are counted, which costs 2 us per topic


class Outbox:
    """Publishes the messages of controllers' topics. Call its methods in the event loop."""

    def __init__(self, host: NodeHost, scene: PublishingContext) -> None:
        self.scene = scene
        self.time_s = 0.0
        self._loop = host.loop
        self._channels: list[_Channel] = []
        self._due: dict[_Channel, Any] = {}
        self._polling = host.loop.create_task(self._poll())

    def close(self) -> None:
        """Stop publishing."""
        self._polling.cancel()

    def add(self, topic: Topic[Any], publisher: Publisher, row: Publication) -> "_Channel":
        """Publish a topic from now on; a latched topic publishes its newest message immediately."""
        channel = _Channel(publisher, row)
        channel.end = topic.subscribe(partial(self._enqueue, channel))
        self._channels.append(channel)
        if row.latched and topic.latest is not None:
            self._enqueue(channel, topic.latest)
        return channel

    def remove(self, channel: "_Channel") -> None:
        """Stop publishing a topic."""
        channel.end()
        self._channels.remove(channel)
        self._due.pop(channel, None)

    def _enqueue(self, channel: "_Channel", message: Any) -> None:
        """Note a message, within a control cycle."""
        if not channel.has_subscribers or not channel.is_time(self.time_s):
            return
        if not self._due:
            self._loop.call_soon(self._publish_due)
        self._due[channel] = message

    def _publish_due(self) -> None:
        due, self._due = self._due, {}
        self.scene.sec, self.scene.nanosec = divmod(time.time_ns(), 1_000_000_000)
        for channel, message in due.items():
            channel.publish(message, self.scene)

    async def _poll(self) -> None:
        while True:
            for channel in self._channels:
                channel.count_subscribers()
            await asyncio.sleep(_POLL_S)


class _Channel:
    """Connects a controller's topic to a topic of ROS 2."""

    def __init__(self, publisher: Publisher, row: Publication) -> None:
        self.row = row
        self.has_subscribers = row.latched
        self.end: Any = None
        self._publisher = publisher
        self._message = interface(row.type)()
        self._next_s = 0.0

    def count_subscribers(self) -> None:
        """Update whether the topic has subscribers."""
        self.has_subscribers = self.row.latched or self._publisher.get_subscription_count() > 0

    def is_time(self, time_s: float) -> bool:
        """Whether enough time has passed since the last message; if so, this one counts as published."""
        every_s, wait_s = self.row.every_s, self._next_s - time_s
        if 0.0 < wait_s <= every_s:
            return False
        in_step = -every_s < wait_s <= 0.0  # otherwise: no subscribers for a while, or a jump of the clock
        self._next_s = (self._next_s if in_step else time_s) + every_s
        return True

    def publish(self, message: Any, scene: PublishingContext) -> None:
        """Publish one message, unless it has no content."""
        if self.row.fill(self._message, message, scene):
            self._publisher.publish(self._message)


def publisher(node: Node, row: Publication) -> Publisher:
    """Create the publisher for a row of the table of topics."""
    quality = LATCHED if row.latched else SYSTEM_DEFAULT if row.depth == 1 else QoSProfile(depth=row.depth)
    return node.create_publisher(interface(row.type), row.name, quality)
