"""Executes trajectories, one at a time, through the driver's controllers, as MoveIt does through ros2_control's."""

import asyncio
from collections.abc import Sequence
from typing import Any

from client.controllers.goals import GoalStatus
from client.errors import ClientError
from client.ros2.control_side import SIDE, ControlSide
from client.ros2.host import NodeHost
from client.ros2.move_group.arm import RefusedError
from client.ros2.topics import CommandContext, trajectory


class Execution:
    """Executes the trajectories of one robot; call it in the event loop only."""

    def __init__(self, host: NodeHost) -> None:
        self._host = host
        self._following: asyncio.Future[Any] | None = None

    async def follow(self, message: Any, names: Sequence[str] = ()) -> None:
        """Execute a moveit_msgs/RobotTrajectory with the active trajectory controller, or with the one named.

        Raises RefusedError: CONTROL_FAILED with the reason, or PREEMPTED when the motion was stopped.
        """
        if self._following is not None:
            raise RefusedError("CONTROL_FAILED", "another trajectory is being executed: wait for its end, or stop it")
        if message.multi_dof_joint_trajectory.points:
            raise RefusedError("CONTROL_FAILED", "this arm has no joints with several degrees of freedom")
        self._following = following = asyncio.ensure_future(self._follow(message.joint_trajectory, names))
        try:
            await asyncio.wait([following])
            if following.cancelled():
                raise RefusedError("PREEMPTED", "the motion was stopped")
            controller, status, result = following.result()
        except ClientError as error:
            raise error if isinstance(error, RefusedError) else RefusedError("CONTROL_FAILED", str(error)) from None
        finally:
            following.cancel()
            self._following = None
        if status is GoalStatus.CANCELED:
            raise RefusedError("PREEMPTED", "the motion was stopped")
        if status is not GoalStatus.SUCCEEDED:
            raise RefusedError("CONTROL_FAILED", f"{controller}: {result.error_code.name}: {result.error_string}")

    def stop(self) -> None:
        """Stop the current trajectory, if any."""
        if self._following is not None:
            self._following.cancel()

    async def _follow(self, message: Any, names: Sequence[str]) -> Any:
        given = await asyncio.to_thread(trajectory, message, CommandContext(self._host))
        return await self._host.call(ControlSide.follow, SIDE, tuple(names), given)
