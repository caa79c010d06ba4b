"""The scene as all messages so far have made it, and the arm's current configuration."""

import asyncio
from typing import Any

from client.controllers.control import RobotControl
from client.errors import StaleStateError
from client.ros2.move_group.arm import Arm, RefusedError
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints


class Monitor:
    """Changes in the event loop only; its states can be used anywhere, since they are never changed in place."""

    def __init__(self, arm: Arm, control: RobotControl) -> None:
        self.arm = arm
        self.state = SceneState(arm)
        self._control = control
        self._waiting: list[asyncio.Future[None]] = []

    def current_configuration(self) -> Joints:
        """The arm's current configuration. Raises RefusedError while the robot does not report it."""
        try:
            state = self._control.driver.link.feed.fresh()
        except StaleStateError as error:
            raise RefusedError("ROBOT_STATE_STALE", f"the arm's configuration is unknown: {error}") from None
        a, b, c, d, e, f = (float(q) for q in state["actual_q"])
        return (a, b, c, d, e, f)

    def apply(self, message: Any) -> None:
        """Apply a message to the scene. Raises RefusedError and SceneError; the scene then stays as it was."""
        self.state = self.state.changed(message, self.current_configuration())
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            if not future.done():
                future.set_result(None)

    async def wait_for_change(self) -> None:
        """Wait until the scene changes."""
        future = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        await future
