"""Logs why messages of a topic are refused: once, and again after a while, however many come."""

import time
from typing import Final

from rclpy.node import Node

from urproto.log_throttle import LogThrottle

_QUIET_S: Final = 1.0  # before the same reason is logged again; guess


class RefusalLog:
    """The refusals of one topic. node: whose log it is. topic: its name."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic.removeprefix("~/")
        self._reason = ""
        self._throttle = LogThrottle(time.monotonic, _QUIET_S)

    def add(self, reason: str) -> None:
        """Log the reason of a refusal, unless that has just been done."""
        if reason != self._reason:
            self._reason, self._throttle = reason, LogThrottle(time.monotonic, _QUIET_S)
        if (more := self._throttle.due()) is not None:
            self._node.get_logger().error(f"{self._topic}: message refused: {reason}{more}")
