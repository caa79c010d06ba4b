"""A node for each loaded controller, with its parameters, topics, services and actions."""

import logging
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from client.controllers.controller import Controller
from client.controllers.running import Change
from client.errors import ClientError
from client.ros2 import parameters, services
from client.ros2.actions import serve_actions
from client.ros2.control_side import SIDE, ControllerFacts, ControlSide, RobotFacts
from client.ros2.host import (
    LATCHED,
    SYSTEM_DEFAULT,
    HostedNode,
    NodeHost,
    RefusalLog,
    RemoteController,
    in_thread,
    interface_if_any,
)
from client.ros2.publishing import Outbox, publisher
from client.ros2.topics import PUBLICATIONS, SUBSCRIPTIONS, CommandContext, Subscription
from client.ros2.transforms import Transforms

_logger = logging.getLogger(__name__)


class ControllerNodes:
    """Opens and closes the nodes of controllers. Don't call it in the event loop, which it would block."""

    def __init__(self, host: NodeHost, facts: RobotFacts, outbox: Outbox, transforms: Transforms) -> None:
        self._host = host
        self._facts = facts
        self._outbox = outbox
        self._transforms = transforms
        self._nodes: dict[str, ControllerNode] = {}

    def open(self, controller: ControllerFacts) -> None:
        """Open the node of a controller that has been loaded."""
        self._nodes[controller.name] = ControllerNode(
            self._host, self._facts, self._outbox, self._transforms, RemoteController(self._host, controller)
        )

    async def follow_changes(self) -> None:
        """Open, close and update nodes as controllers are loaded, unloaded and given parameters without them."""
        while True:
            controller, change, values = await self._host.call(ControlSide.next_change, SIDE)
            try:
                if change is Change.LOADED:
                    await in_thread(self.open, controller)
                elif change is Change.UNLOADED:
                    await in_thread(self._nodes.pop(controller.name).close)
                else:
                    changed = [Parameter(name, value=value) for name, value in values.items()]
                    await in_thread(self._nodes[controller.name].node.set_parameters, changed)
            except Exception:  # of one controller: the others go on
                _logger.exception("the node of %s could not follow it", controller.name)

    def close_all(self) -> None:
        while self._nodes:
            _, node = self._nodes.popitem()
            node.close()


class ControllerNode(HostedNode):
    """One controller as a node of the same name."""

    def __init__(
        self,
        host: NodeHost,
        facts: RobotFacts,
        outbox: Outbox,
        transforms: Transforms,
        controller: RemoteController,
    ) -> None:
        super().__init__(host, controller.name)
        self._outbox = outbox
        parameters.declare(
            self.node,
            controller.parameters,
            lambda changed: controller.do(Controller.reconfigure, changed),
            owner=controller.name,
        )
        rows = [row for row in PUBLICATIONS if issubclass(controller.kind, row.controller)]
        publishers = [publisher(self.node, row) for row in rows]
        self._keys = [outbox.add(controller, to, row) for row, to in zip(rows, publishers, strict=True)]
        for subscription in SUBSCRIPTIONS:
            if issubclass(controller.kind, subscription.controller):
                _Listener(host, self.node, controller, subscription)
        services.serve(host, self.node, controller, facts.version, transforms)
        host.spin(self.node)
        serve_actions(host, self.node, controller, transforms)

    def close(self) -> None:
        for key in self._keys:
            self._outbox.remove(key)
        super().close()


class _Listener:
    """Passes a topic's newest message to a controller: the queue of the subscription has length one."""

    def __init__(self, host: NodeHost, node: Node, controller: RemoteController, row: Subscription) -> None:
        self._host = host
        self._controller = controller
        self._row = row
        self._refused = RefusalLog(node, row.name)
        if (kind := interface_if_any(row.type)) is not None:
            node.create_subscription(kind, row.name, self._on_message, LATCHED if row.latched else SYSTEM_DEFAULT)

    def _on_message(self, message: Any) -> None:
        try:
            command = self._row.command(message, CommandContext(self._host))
            self._host.do(ControlSide.deliver, SIDE, self._controller.reference, self._row.hand_over, command)
        except ClientError as error:
            self._refused.add(str(error))
