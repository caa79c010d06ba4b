"""The scene as all messages so far have made it, and the arm's current configuration."""

import asyncio
from typing import Any

from client.errors import StaleStateError
from client.ros2.control_side import SIDE, ControlSide
from client.ros2.host import NodeHost
from client.ros2.move_group.arm import Arm, RefusedError
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints
from urproto.vectors import as_six


class Monitor:
    """Changes in the event loop only; its states can be used anywhere, since they are never changed in place."""

    def __init__(self, arm: Arm, host: NodeHost) -> None:
        self.arm = arm
        self.state = SceneState(arm)
        self._host = host
        self._waiting: list[asyncio.Future[None]] = []

    async def current_configuration(self) -> Joints:
        """The arm's current configuration. Raises RefusedError while the robot does not report it."""
        try:
            return as_six(await self._host.call(ControlSide.configuration, SIDE))
        except StaleStateError as error:
            raise RefusedError("ROBOT_STATE_STALE", f"the arm's configuration is unknown: {error}") from None

    async def apply(self, message: Any) -> Joints:
        """Apply a message to the scene; returns the arm's configuration.

        Raises RefusedError and SceneError; the scene then stays as it was.
        """
        q = await self.current_configuration()
        self.state = self.state.changed(message, q)
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            if not future.done():
                future.set_result(None)
        return q

    async def wait_for_change(self) -> None:
        future = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        await future
