"""A node for each loaded controller, with its parameters, topics, services and actions."""

import time
from collections.abc import Mapping
from typing import Any, Final

from rclpy.node import Node
from rclpy.parameter import Parameter

from client.controllers.control import RobotControl
from client.controllers.controller import Controller
from client.controllers.goals import JointTrajectory
from client.controllers.running import RunningManager
from client.errors import ClientError
from client.ros2 import parameters, services
from client.ros2.actions import serve_actions
from client.ros2.host import LATCHED, SYSTEM_DEFAULT, NodeHost, interface_if_any
from client.ros2.publishing import Outbox, publisher
from client.ros2.topics import PUBLICATIONS, SUBSCRIPTIONS, CommandContext, Subscription
from client.ros2.transforms import Transforms
from urproto.log_throttle import LogThrottle

_QUIET_S: Final = 1.0  # before the same error is logged again; guess


class ControllerNodes:
    """Opens and closes the nodes of controllers. Don't call it in the event loop, which it would block."""

    def __init__(self, host: NodeHost, running: RunningManager, outbox: Outbox, transforms: Transforms) -> None:
        self._host = host
        self._control = running.control
        self._outbox = outbox
        self._transforms = transforms
        self._nodes: dict[str, ControllerNode] = {}

    def open(self, controller: Controller[Any]) -> None:
        """Open the node of a controller that has been loaded."""
        self._nodes[controller.name] = ControllerNode(
            self._host, self._control, self._outbox, self._transforms, controller
        )

    def close(self, controller: Controller[Any]) -> None:
        """Close the node of a controller that has been unloaded."""
        self._nodes.pop(controller.name).close()

    def set_parameters(self, controller: Controller[Any], values: Mapping[str, Any]) -> None:
        """Update a controller's node after parameters were set without it."""
        node = self._nodes[controller.name].node
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])

    def close_all(self) -> None:
        """Close all nodes."""
        while self._nodes:
            _, node = self._nodes.popitem()
            node.close()


class ControllerNode:
    """One controller as a node of the same name."""

    def __init__(
        self,
        host: NodeHost,
        control: RobotControl,
        outbox: Outbox,
        transforms: Transforms,
        controller: Controller[Any],
    ) -> None:
        self._host = host
        self._control = control
        self._outbox = outbox
        self._controller = controller
        self.node: Node = host.node(controller.name)
        parameters.declare(host, self.node, controller)
        rows = [row for row in PUBLICATIONS if isinstance(controller, row.controller)]
        publishers = [publisher(self.node, row) for row in rows]
        for subscription in SUBSCRIPTIONS:
            if isinstance(controller, subscription.controller):
                _Listener(host, self.node, control, controller, subscription)
        services.serve(host, self.node, controller, control, transforms)
        host.spin(self.node)
        serve_actions(host, self.node, controller, control, transforms)

        def add() -> list[Any]:
            return [
                outbox.add(getattr(controller, row.source), to, row) for row, to in zip(rows, publishers, strict=True)
            ]

        self._channels = host.do(add)

    def close(self) -> None:
        """End the node; not from its own thread."""

        def remove() -> None:
            for channel in self._channels:
                self._outbox.remove(channel)

        self._host.do(remove)
        self._host.close(self.node)


class _Listener:
    """Passes a topic's newest message to a controller: the queue of the subscription has length one."""

    def __init__(
        self, host: NodeHost, node: Node, control: RobotControl, controller: Controller[Any], row: Subscription
    ) -> None:
        self._host = host
        self._node = node
        self._control = control
        self._controller = controller
        self._row = row
        self._reason = ""  # why the last one was refused
        self._throttle = LogThrottle(time.monotonic, _QUIET_S)
        if (kind := interface_if_any(row.type)) is not None:
            node.create_subscription(kind, row.name, self._on_message, LATCHED if row.latched else SYSTEM_DEFAULT)

    def _on_message(self, message: Any) -> None:
        try:
            command = self._row.command(message, CommandContext(self._control.manager.time_s, time.time_ns()))
            self._host.do(lambda: self._deliver(command))
        except ClientError as error:
            self._log_refusal(str(error))

    def _deliver(self, command: Any) -> None:
        if isinstance(command, JointTrajectory):
            self._controller.check_active()
            controller: Any = self._controller
            controller.check(command)
            self._control.check_reach(command, speeds=False)
        self._row.hand_over(self._controller, command)

    def _log_refusal(self, text: str) -> None:
        if text != self._reason:
            self._reason, self._throttle = text, LogThrottle(time.monotonic, _QUIET_S)
        if (more := self._throttle.due()) is not None:
            self._node.get_logger().error(f"{self._row.name.lstrip('~/')}: message refused: {text}{more}")
