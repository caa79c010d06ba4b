"""Executes trajectories, one at a time, through the driver's controllers, as MoveIt does through ros2_control's."""

import asyncio
import time
from collections.abc import Sequence
from typing import Any, Final

from client.controllers.control import RobotControl
from client.controllers.controller import LifecycleState
from client.controllers.goals import FollowJointTrajectory, GoalHandle, GoalStatus, JointTrajectory
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.passthrough import PassthroughTrajectoryController
from client.errors import ClientError
from client.ros2.move_group.arm import RefusedError
from client.ros2.topics import CommandContext, trajectory
from urproto.joints import JOINT_NAMES

_START_RAD: Final = 0.01  # MoveIt's allowed_start_tolerance
_FOLLOWING: Final = (JointTrajectoryController, PassthroughTrajectoryController)


class Execution:
    """Executes the trajectories of one robot; call it in the event loop only."""

    def __init__(self, control: RobotControl) -> None:
        self._control = control
        self._under_way: tuple[Any, GoalHandle] | None = None

    async def follow(self, message: Any, names: Sequence[str] = ()) -> None:
        """Execute a moveit_msgs/RobotTrajectory with the active trajectory controller, or with the one named.

        Raises RefusedError: CONTROL_FAILED with the reason, or PREEMPTED when the motion was stopped.
        """
        if self._under_way is not None:
            raise RefusedError("CONTROL_FAILED", "another trajectory is being executed: wait for its end, or stop it")
        try:
            controller = self._controller(names)
            handle = controller.send_goal(self._goal(message, controller))
        except RefusedError:
            raise
        except ClientError as error:
            raise RefusedError("CONTROL_FAILED", str(error)) from None
        self._under_way = controller, handle
        ended = asyncio.get_running_loop().create_future()
        handle.on_end.append(lambda result: None if ended.done() else ended.set_result(result))
        try:
            result = handle.result or await ended
        except asyncio.CancelledError:
            self.stop()
            raise
        finally:
            self._under_way = None
        if handle.status is GoalStatus.CANCELED:
            raise RefusedError("PREEMPTED", "the motion was stopped")
        if handle.status is not GoalStatus.SUCCEEDED:
            raise RefusedError("CONTROL_FAILED", f"{controller.name}: {result.error_code.name}: {result.error_string}")

    def stop(self) -> None:
        """Stop the current trajectory, if any. Raises ControllerError if that fails."""
        if self._under_way is not None:
            controller, handle = self._under_way
            if controller.goal is handle:
                controller.cancel()

    def _controller(self, names: Sequence[str]) -> Any:
        manager = self._control.manager
        active = [info.name for info in manager.list_controllers() if info.state is LifecycleState.ACTIVE]
        following = [name for name in active if isinstance(manager.controller(name), _FOLLOWING)]
        wanted = [name for name in following if not names or name in names]
        if len(names) > 1 or not wanted:
            raise RefusedError(
                "CONTROL_FAILED",
                f"no trajectory controller {' and '.join(names) or 'of any name'} is active; "
                f"{', '.join(following) or 'none'} is: switch with /controller_manager/switch_controller",
            )
        return manager.controller(wanted[0])

    def _goal(self, message: Any, controller: Any) -> FollowJointTrajectory:
        if message.multi_dof_joint_trajectory.points:
            raise RefusedError("CONTROL_FAILED", "this arm has no joints with several degrees of freedom")
        given = trajectory(message.joint_trajectory, CommandContext(self._control.manager.time_s, time.time_ns()))
        self._check_start(given)
        points = given.points
        if len(points) > 1 and points[0].time_from_start_s == 0.0:  # the current configuration
            points = points[1:]
        goal = JointTrajectory(given.joint_names, points, given.stamp_s)
        controller.check_active()
        controller.check(goal)
        self._control.check_reach(goal, speeds=False)
        return FollowJointTrajectory(goal)

    def _check_start(self, given: JointTrajectory) -> None:
        if not given.points or given.points[0].time_from_start_s > 0.0:
            return
        current = dict(zip(self._joints(), self._control.driver.state["actual_q"], strict=True))
        begins = dict(zip(given.joint_names, given.points[0].positions, strict=False))
        for name, q in begins.items():
            if abs(q - current.get(name, q)) > _START_RAD:
                raise RefusedError(
                    "CONTROL_FAILED",
                    f"{name} is at {current[name]:.4f} rad, but the trajectory begins at {q:.4f}: it has moved "
                    "since; plan again from where it is",
                )

    def _joints(self) -> list[str]:
        return [self._control.prefix + name for name in JOINT_NAMES]
