"""An action of a node that carries out one goal at a time, and rejects others meanwhile."""

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from client.ros2.host import interface_if_any


class OneGoalAction:
    """The action ``~/name``; the log says so where the distribution does not have its type, which is None then.

    begin: whether a goal is taken, with the reason in the log if not. execute: gives the result of a goal that was
    taken. cancel: called when a client wants it to end; the goal ends when ``execute`` does. All are coroutines in the
    node's thread.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        type_name: str,
        *,
        begin: Callable[[Any], Awaitable[bool]],
        execute: Callable[[Any], Awaitable[Any]],
        cancel: Callable[[], Awaitable[None]],
    ) -> None:
        self.type = interface_if_any(type_name)
        self.busy = False
        self._node = node
        self._name = name
        self._begin, self._do, self._end = begin, execute, cancel
        if self.type is None:
            node.get_logger().warning(f"~/{name} is not offered: this distribution has no {type_name}")
            return
        self._server = ActionServer(
            node, self.type, f"~/{name}", self._execute, goal_callback=self._judge, cancel_callback=self._cancel
        )

    def reject(self, why: str) -> None:
        """Say why a goal is not taken."""
        self._node.get_logger().error(f"{self._name}: a goal is rejected: {why}")

    async def _judge(self, request: Any) -> GoalResponse:
        if self.busy:
            self.reject("another goal is carried out")
            return GoalResponse.REJECT
        self.busy, taken = True, False
        try:
            taken = await self._begin(request)
        finally:
            self.busy = taken
        return GoalResponse.ACCEPT if taken else GoalResponse.REJECT

    async def _execute(self, goal: Any) -> Any:
        try:
            return await self._do(goal)
        finally:
            self.busy = False

    async def _cancel(self, goal: Any) -> CancelResponse:
        if not self.busy:
            return CancelResponse.REJECT
        await self._end()
        return CancelResponse.ACCEPT
