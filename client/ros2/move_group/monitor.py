"""The scene as everybody's messages have made it, and where the arm stands in it."""

import asyncio
from typing import Any

from client.controllers.robot import ControlledRobot
from client.ros2.move_group.arm import Arm, RefusedError
from client.ros2.move_group.scene import SceneState
from urproto.robots import Joints


class Monitor:
    """Changed in the event loop; what it gives may be looked at anywhere, since it is never changed in place."""

    def __init__(self, arm: Arm, robot: ControlledRobot) -> None:
        self.arm = arm
        self.state = SceneState(arm)
        self._robot = robot
        self._waiting: list[asyncio.Future[None]] = []

    def stands(self) -> Joints:
        """Where the arm is now. Raises RefusedError while the robot is silent."""
        if self._robot.driver.robot.feed.silent:
            raise RefusedError("ROBOT_STATE_STALE", "the robot is silent, so nobody knows where the arm is")
        a, b, c, d, e, f = (float(q) for q in self._robot.driver.state["actual_q"])
        return (a, b, c, d, e, f)

    def apply(self, message: Any) -> None:
        """Change the scene by a message. Raises RefusedError and SceneError, and the scene stays as it was."""
        self.state = self.state.changed(message, self.stands())
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            if not future.done():
                future.set_result(None)

    async def change(self) -> None:
        """Wait until the scene changes."""
        future = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        await future
