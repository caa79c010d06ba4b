"""The actions of ``move_group``: plan and execute in one, and execute a trajectory planned earlier."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse

from client.controllers.goals import GoalStatus
from client.errors import ClientError, PlanningError
from client.planning import CollisionChecker, Trajectory
from client.planning.collisions import blocking_reason
from client.ros2.control_side import SIDE, ControlSide
from client.ros2.host import NodeHost, interface
from client.ros2.move_group.arm import RefusedError, set_code
from client.ros2.move_group.monitor import Monitor
from client.ros2.move_group.requests import PlanResult, plan_motion, plan_motion_sequence
from client.ros2.move_group.scene import SceneState
from client.ros2.move_group.services import fill_sequence_response
from client.ros2.topics import CommandContext, trajectory
from urproto.robots import Joints

_MAX_ATTEMPTS: Final = 10  # to replan when the path is blocked; guess
_SUCCESS: Final = "SUCCESS", ""


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
        if self._following is not None:
            self._following.cancel()

    async def _follow(self, message: Any, names: Sequence[str]) -> Any:
        given = await asyncio.to_thread(trajectory, message, CommandContext(self._host))
        return await self._host.call(ControlSide.follow, SIDE, tuple(names), given)


class _Action:
    """An action that accepts every goal, and whose results contain a MoveIt error code."""

    def __init__(self, host: NodeHost, node: Any, name: str, type_name: str, execution: Execution) -> None:
        self._host = host
        self._node = node
        self._name = name
        self._type = interface(type_name)
        self._execution = execution
        self._canceled: set[bytes] = set()
        self._moving: set[bytes] = set()
        self.server = ActionServer(
            node,
            self._type,
            name,
            self._execute,
            goal_callback=lambda goal: GoalResponse.ACCEPT,
            cancel_callback=self._cancel,
        )

    # in the node's thread

    async def _execute(self, handle: Any) -> Any:
        result = self._type.Result()
        code, reason = await self._host.task(self._node, self._run(handle, result))
        set_code(self._response_in(result).error_code, code, reason)
        if code == "SUCCESS":
            handle.succeed()
        elif code == "PREEMPTED" and handle.is_cancel_requested:
            handle.canceled()
        else:
            self._node.get_logger().error(f"{self._name}: {code}: {reason}")
            handle.abort()
        return result

    def _cancel(self, handle: Any) -> CancelResponse:
        self._host.loop.call_soon_threadsafe(self._stop, handle)
        return CancelResponse.ACCEPT

    # in the event loop

    def _stop(self, handle: Any) -> None:
        name = _name(handle)
        self._canceled.add(name)
        if name in self._moving:
            self._execution.stop()

    async def _follow(self, handle: Any, trajectory: Any, controllers: Sequence[str] = ()) -> None:
        """Execute a trajectory. Nothing is awaited between the check whether the goal was canceled and the start."""
        self._check_canceled(handle)
        self._moving.add(_name(handle))
        try:
            await self._execution.follow(trajectory, controllers)
        finally:
            self._moving.discard(_name(handle))

    def _check_canceled(self, handle: Any) -> None:
        if _name(handle) in self._canceled:
            raise RefusedError("PREEMPTED", "the goal was canceled before the arm moved")

    def _response_in(self, result: Any) -> Any:
        return result

    async def _work(self, handle: Any, result: Any) -> None:
        raise NotImplementedError

    async def _run(self, handle: Any, result: Any) -> tuple[str, str]:
        try:
            await self._work(handle, result)
        except RefusedError as error:
            return error.code, str(error)
        except PlanningError as error:
            return "FAILURE", str(error)
        except ClientError as error:
            return "CONTROL_FAILED", str(error)
        finally:
            self._canceled.discard(_name(handle))
        return _SUCCESS

    def _send_feedback(self, handle: Any, state: str) -> None:
        handle.publish_feedback(self._type.Feedback(state=state))


class ExecuteTrajectoryAction(_Action):
    """``execute_trajectory``."""

    def __init__(self, host: NodeHost, node: Any, execution: Execution) -> None:
        super().__init__(host, node, "execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", execution)

    async def _work(self, handle: Any, result: Any) -> None:
        goal = handle.request
        self._send_feedback(handle, "MONITOR")
        await self._follow(handle, goal.trajectory, getattr(goal, "controller_names", ()))


class _PlanAndMove(_Action):
    """Plans, executes the plan, and stops if a change of the scene blocks it.

    NAME, TYPE: of the action.
    """

    NAME: str
    TYPE: str

    def __init__(
        self,
        host: NodeHost,
        node: Any,
        execution: Execution,
        monitor: Monitor,
        show: Callable[[PlanResult], object],
    ) -> None:
        self._monitor = monitor
        self._show = show
        super().__init__(host, node, self.NAME, self.TYPE, execution)

    def _start_request(self, goal: Any) -> Any:
        """The moveit_msgs/MotionPlanRequest that has the start state."""
        raise NotImplementedError

    def _plan(self, state: SceneState, goal: Any, q_rad: Joints) -> PlanResult:
        """Plan, in a thread. Raises RefusedError."""
        raise NotImplementedError

    def _fill_result(self, result: Any, plan: PlanResult, *, executed: bool) -> None:
        raise NotImplementedError

    async def _work(self, handle: Any, result: Any) -> None:
        options = handle.request.planning_options
        if options.look_around:
            raise RefusedError("FAILURE", "look_around needs a sensor, which the arm does not have: leave it out")
        tries = 1 + min(max(options.replan_attempts, 0), _MAX_ATTEMPTS) if options.replan else 1
        for left in reversed(range(tries)):
            try:
                await self._plan_and_execute(handle, result)
                return
            except RefusedError as error:
                if error.code != "MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE" or not left:
                    raise
            await asyncio.sleep(max(0.0, options.replan_delay))

    async def _plan_and_execute(self, handle: Any, result: Any) -> None:
        self._send_feedback(handle, "PLANNING")
        goal = handle.request
        plan_only = goal.planning_options.plan_only
        if not plan_only and self._start_request(goal).start_state.joint_state.name:
            self._node.get_logger().warning(
                f"{self.NAME}: start_state is ignored; the motion starts at the arm's current configuration"
            )
        planned_in = self._monitor.state
        plan = await self._planned(goal, plan_only=plan_only)
        self._fill_result(result, plan, executed=False)
        self._show(plan)
        self._check_canceled(handle)
        if plan_only or not plan.trajectory.duration_s:  # the arm is already at the goal
            return
        self._send_feedback(handle, "MONITOR")
        planned_in = await self._check_scene(planned_in, plan.trajectory)  # it may have changed during planning
        await self._follow_monitored(
            self._follow(handle, self._monitor.arm.trajectory_message(plan.trajectory)), plan.trajectory, planned_in
        )
        self._fill_result(result, plan, executed=True)

    async def _planned(self, goal: Any, *, plan_only: bool) -> PlanResult:
        q = await self._monitor.current_configuration()
        difference = goal.planning_options.planning_scene_diff
        difference.is_diff = True  # as its name says; an empty message does not mean an empty scene
        state = self._monitor.state.changed(difference, q)
        if not plan_only:
            self._start_request(goal).start_state = interface("moveit_msgs/msg/RobotState")(is_diff=True)
        return await asyncio.to_thread(self._plan, state, goal, q)

    async def _check_scene(self, planned_in: SceneState, trajectory: Trajectory) -> SceneState:
        """The current scene. Raises RefusedError if it is not the one that was seen, and blocks the path."""
        now = self._monitor.state
        if now is not planned_in:
            q = await self._monitor.current_configuration()
            blocked = await asyncio.to_thread(lambda: blocking_reason(CollisionChecker(now.scene()), trajectory, q))
            if blocked:
                raise RefusedError("MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE", blocked)
        return now

    async def _follow_monitored(
        self, following: Awaitable[None], trajectory: Trajectory, planned_in: SceneState
    ) -> None:
        """Execute, and check the rest of the path whenever the scene changes."""
        follow = asyncio.ensure_future(following)
        try:
            while not follow.done():
                if self._monitor.state is planned_in:
                    change = asyncio.ensure_future(self._monitor.wait_for_change())
                    await asyncio.wait({follow, change}, return_when=asyncio.FIRST_COMPLETED)
                    change.cancel()
                    continue
                try:
                    planned_in = await self._check_scene(planned_in, trajectory)
                except RefusedError:
                    if follow.done():  # the motion finished meanwhile
                        break
                    self._execution.stop()
                    await asyncio.wait({follow})
                    follow.exception()
                    raise
            await follow
        finally:
            follow.cancel()


class MoveAction(_PlanAndMove):
    """``move_action``: one motion."""

    NAME = "move_action"
    TYPE = "moveit_msgs/action/MoveGroup"

    def _start_request(self, goal: Any) -> Any:
        return goal.request

    def _plan(self, state: SceneState, goal: Any, q_rad: Joints) -> PlanResult:
        return plan_motion(self._monitor.arm, state, goal.request, q_rad)

    def _fill_result(self, result: Any, plan: PlanResult, *, executed: bool) -> None:
        arm = self._monitor.arm
        if executed:
            result.executed_trajectory = result.planned_trajectory
            return
        result.trajectory_start = arm.state_message(plan.start_rad)
        result.planned_trajectory = arm.trajectory_message(plan.trajectory)
        result.planning_time = plan.time_s


class SequenceAction(_PlanAndMove):
    """``sequence_move_group``: motions that blend, like Pilz' MoveGroupSequenceAction."""

    NAME = "sequence_move_group"
    TYPE = "moveit_msgs/action/MoveGroupSequence"

    def _response_in(self, result: Any) -> Any:
        return result.response

    async def _work(self, handle: Any, result: Any) -> None:
        if not handle.request.request.items:
            return  # as in MoveIt, an empty sequence succeeds
        await super()._work(handle, result)

    def _start_request(self, goal: Any) -> Any:
        return goal.request.items[0].req

    def _plan(self, state: SceneState, goal: Any, q_rad: Joints) -> PlanResult:
        return plan_motion_sequence(self._monitor.arm, state, goal.request, q_rad)

    def _fill_result(self, result: Any, plan: PlanResult, *, executed: bool) -> None:
        if not executed:
            fill_sequence_response(self._monitor.arm, result.response, plan)


def _name(handle: Any) -> bytes:
    return bytes(handle.goal_id.uuid)
