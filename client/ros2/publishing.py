"""What a control cycle publishes goes out after it, so that setpoints go first, and only where somebody listens."""

import asyncio
import time
from functools import partial
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from client.controllers.controller import Topic
from client.ros2.host import LATCHED, SYSTEM_DEFAULT, NodeHost, interface
from client.ros2.topics import Publication, Scene

_LOOK_S: Final = 0.05  # how often it is looked whether somebody listens: the question costs 2 us a topic


class Outbox:
    """Publishes what controllers' topics have; methods are called in the event loop."""

    def __init__(self, host: NodeHost, scene: Scene) -> None:
        self.scene = scene
        self.time_s = 0.0
        self._loop = host.loop
        self._channels: list[_Channel] = []
        self._due: dict[_Channel, Any] = {}
        self._looking = host.loop.create_task(self._look())

    def close(self) -> None:
        """Publish nothing from now on."""
        self._looking.cancel()

    def add(self, topic: Topic[Any], publisher: Publisher, row: Publication) -> "_Channel":
        """Publish what a topic has from now on; a latched one has its newest message published at once."""
        channel = _Channel(publisher, row)
        channel.end = topic.subscribe(partial(self._note, channel))
        self._channels.append(channel)
        if row.latched and topic.latest is not None:
            self._note(channel, topic.latest)
        return channel

    def remove(self, channel: "_Channel") -> None:
        """Publish it no longer."""
        channel.end()
        self._channels.remove(channel)
        self._due.pop(channel, None)

    def _note(self, channel: "_Channel", message: Any) -> None:
        """Within a control cycle."""
        if not channel.wanted or not channel.is_time(self.time_s):
            return
        if not self._due:
            self._loop.call_soon(self._send)
        self._due[channel] = message

    def _send(self) -> None:
        due, self._due = self._due, {}
        self.scene.sec, self.scene.nanosec = divmod(time.time_ns(), 1_000_000_000)
        for channel, message in due.items():
            channel.publish(message, self.scene)

    async def _look(self) -> None:
        while True:
            for channel in self._channels:
                channel.look()
            await asyncio.sleep(_LOOK_S)


class _Channel:
    """From a topic of a controller to one of ROS 2."""

    def __init__(self, publisher: Publisher, row: Publication) -> None:
        self.row = row
        self.wanted = row.latched
        self.end: Any = None
        self._publisher = publisher
        self._message = interface(row.type)()
        self._next_s = 0.0

    def look(self) -> None:
        """Whether somebody listens."""
        self.wanted = self.row.latched or self._publisher.get_subscription_count() > 0

    def is_time(self, time_s: float) -> bool:
        """Whether enough has passed since the last message; this one counts as published if so."""
        every_s, wait_s = self.row.every_s, self._next_s - time_s
        if 0.0 < wait_s <= every_s:
            return False
        in_step = -every_s < wait_s <= 0.0  # else nobody listened for a while, or the robot's clock has jumped
        self._next_s = (self._next_s if in_step else time_s) + every_s
        return True

    def publish(self, message: Any, scene: Scene) -> None:
        """One message, unless there is nothing to say."""
        if self.row.fill(self._message, message, scene):
            self._publisher.publish(self._message)


def publisher(node: Node, row: Publication) -> Publisher:
    """For a row's topic."""
    quality = LATCHED if row.latched else SYSTEM_DEFAULT if row.depth == 1 else QoSProfile(depth=row.depth)
    return node.create_publisher(interface(row.type), row.name, quality)
