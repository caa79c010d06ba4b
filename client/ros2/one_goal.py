"""An action that executes one goal at a time, and rejects others meanwhile."""

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from client.ros2.host import interface_if_any


class OneGoalAction:
    """The action ``~/name``. If the distribution lacks its type, a warning is logged and ``type`` is None.

    begin: returns whether a goal is accepted, and logs the reason if not. execute: executes an accepted goal and
    returns its result. cancel: called when a client cancels the goal, which ends when ``execute`` does. All are
    coroutines in the node's thread.
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
            node, self.type, f"~/{name}", self._execute, goal_callback=self._accept, cancel_callback=self._cancel
        )

    def reject(self, why: str) -> None:
        self._node.get_logger().error(f"{self._name}: goal rejected: {why}")

    async def _accept(self, request: Any) -> GoalResponse:
        if self.busy:
            self.reject("another goal is being executed")
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
