"""Actions of controllers: following trajectories, motion primitives, and tool contact detection.

A goal is passed to the controller before it is accepted, so that the client is refused what the controller refuses.
The controller ends the goal in the event loop, which wakes the action's coroutine in the node's thread.
"""

import math
import time
from collections.abc import Mapping
from typing import Any, ClassVar, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from client.controllers.calls import Call
from client.controllers.compliance import ToolContactController
from client.controllers.control import RobotControl
from client.controllers.controller import Controller
from client.controllers.goals import (
    Feedback,
    FollowJointTrajectory,
    GoalHandle,
    GoalStatus,
    MotionPrimitive,
    PrimitiveType,
    Tolerance,
)
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.motion_primitives import MotionPrimitivesForwardController
from client.controllers.passthrough import PassthroughTrajectoryController
from client.errors import ClientError
from client.ros2.host import NodeHost, interface, interface_if_any
from client.ros2.topics import CommandContext, seconds, set_point, trajectory
from client.ros2.transforms import Transforms, pose_in
from urproto.errors import URError
from urproto.robots.pose import Pose
from urproto.text import quoted

_FEEDBACK_S: Final = 0.05  # action_monitor_rate is 20 Hz
_ARGUMENTS: Final = ("velocity", "acceleration", "move_time")  # of motion primitives


def serve_actions(
    host: NodeHost, node: Node, controller: Controller[Any], control: RobotControl, transforms: Transforms
) -> None:
    """Offer a controller's actions on its node, which must already spin."""
    if isinstance(controller, (JointTrajectoryController, PassthroughTrajectoryController)):
        FollowTrajectoryAction(host, node, controller, control)
    elif isinstance(controller, ToolContactController):
        ToolContactAction(host, node, controller)
    elif isinstance(controller, MotionPrimitivesForwardController):
        if interface_if_any(MotionSequenceAction.type_name) is None:
            node.get_logger().warning(
                f"~/motion_sequence is not offered: this distribution has no {MotionSequenceAction.type_name}"
            )
        else:
            MotionSequenceAction(host, node, controller, control, transforms)


class _Action:
    """An action of a controller; goals are accepted one at a time and executed in that order.

    A subclass begins a goal in the event loop, executes it in the node's thread, and stops it in the event loop.
    """

    name: ClassVar[str]
    type_name: ClassVar[str]

    def __init__(self, host: NodeHost, node: Node, controller: Any) -> None:
        self._host = host
        self._node = node
        self._controller = controller
        self._type = interface(self.type_name)
        self._accepted: Any = None  # the goal begun but not yet executed: callbacks come one after the other
        self._server = ActionServer(
            node,
            self._type,
            self.name,
            self._execute,
            goal_callback=self._accept,
            cancel_callback=self._cancel,
        )

    async def _begin(self, request: Any) -> Any:
        """Begin a goal, in the event loop. Raises URError if the goal is refused."""
        raise NotImplementedError

    async def _execute(self, goal: Any) -> Any:
        """Wait for the end of an accepted goal, in the node's thread; return the action's result."""
        raise NotImplementedError

    def _stop(self, goal: Any) -> None:
        """Cancel a goal, in the event loop. Raises ClientError if it cannot be cancelled."""
        raise NotImplementedError

    def _accept(self, request: Any) -> GoalResponse:
        try:
            self._accepted = self._host.wait(self._begin(request))
        except URError as error:
            self._node.get_logger().error(f"goal refused: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _pop_accepted(self) -> Any:
        accepted, self._accepted = self._accepted, None
        assert accepted is not None
        return accepted

    def _cancel(self, goal: Any) -> CancelResponse:
        try:
            self._host.do(lambda: self._stop(goal))
        except ClientError as error:
            self._node.get_logger().error(f"cannot cancel the goal: {error}")
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT


class _GoalAction(_Action):
    """An action of a controller whose goals have a `GoalHandle`."""

    def __init__(self, host: NodeHost, node: Node, controller: Any) -> None:
        self._goals: dict[bytes, _RunningGoal] = {}
        super().__init__(host, node, controller)

    async def _send(self, request: Any) -> GoalHandle:
        """Send the goal to the controller, in the event loop. Raises URError if the goal is refused."""
        raise NotImplementedError

    async def _begin(self, request: Any) -> "_RunningGoal":
        running = _RunningGoal(await self._send(request), self._host.ending(self._node))
        running.handle.on_end.append(running.ended.set_result)
        return running

    async def _execute(self, goal: Any) -> Any:
        running = self._pop_accepted()
        running.goal, self._goals[bytes(goal.goal_id.uuid)] = goal, running
        result = await running.ended
        del self._goals[bytes(goal.goal_id.uuid)]
        if running.handle.status is GoalStatus.SUCCEEDED:
            goal.succeed()
        elif running.handle.status is GoalStatus.CANCELED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return self._type.Result(error_code=int(result.error_code), error_string=result.error_string)

    def _stop(self, goal: Any) -> None:
        """Cancel the controller's goal, unless this one was replaced or has ended."""
        running = self._goals.get(bytes(goal.goal_id.uuid))
        if running is not None and self._controller.goal is running.handle:
            self._controller.cancel()


class FollowTrajectoryAction(_GoalAction):
    """``~/follow_joint_trajectory`` of a controller."""

    name = "~/follow_joint_trajectory"
    type_name = "control_msgs/action/FollowJointTrajectory"

    def __init__(self, host: NodeHost, node: Node, controller: Any, control: RobotControl) -> None:
        self._control = control
        super().__init__(host, node, controller)

    async def _send(self, request: Any) -> GoalHandle:
        goal = _goal(request, CommandContext(self._control.manager.time_s, time.time_ns()), self._controller)
        self._controller.check_active()
        self._controller.check(goal.trajectory)
        self._control.check_reach(goal.trajectory, speeds=False)  # speeds: by tolerances, as in ros2_controllers
        handle: GoalHandle = self._controller.send_goal(goal)
        return handle

    async def _begin(self, request: Any) -> "_RunningGoal":
        running = await super()._begin(request)
        running.handle.on_feedback.append(lambda feedback: self._on_feedback(running, feedback))
        return running

    def _on_feedback(self, running: "_RunningGoal", feedback: Feedback) -> None:
        """Note feedback to publish, in the event loop, within a control cycle."""
        if running.goal is None or 0.0 <= feedback.time_s - running.fed_back_s < _FEEDBACK_S:
            return
        running.fed_back_s = feedback.time_s
        self._host.loop.call_soon(self._publish, running, feedback)

    def _publish(self, running: "_RunningGoal", feedback: Feedback) -> None:
        if running.handle.done:
            return
        message = self._type.Feedback()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
        message.joint_names = list(self._controller.joints)
        set_point(message.desired, feedback.desired)
        set_point(message.actual, feedback.actual)
        set_point(message.error, feedback.error)
        if hasattr(message, "index"):
            message.index = feedback.index
        running.goal.publish_feedback(message)


class _RunningGoal:
    """A goal that the controller executes for a client."""

    def __init__(self, handle: GoalHandle, ended: Any) -> None:
        self.handle = handle
        self.ended = ended
        self.goal: Any = None
        self.fed_back_s = -1.0


def _goal(request: Any, now: CommandContext, controller: Any) -> FollowJointTrajectory:
    """Convert a request to a goal. Raises ControllerError for features that this controller lacks."""
    if request.multi_dof_trajectory.points or request.component_path_tolerance or request.component_goal_tolerance:
        raise controller.error("trajectories of joints with several degrees of freedom are not supported by this arm")
    return FollowJointTrajectory(
        trajectory(request.trajectory, now),
        _tolerances(request.path_tolerance),
        _tolerances(request.goal_tolerance),
        seconds(request.goal_time_tolerance),
    )


def _tolerances(messages: Any) -> dict[str, Tolerance]:
    return {one.name: Tolerance(one.position, one.velocity, one.acceleration) for one in messages}


class MotionSequenceAction(_GoalAction):
    """``~/motion_sequence``: motion primitives that the robot executes. No feedback, as in the official driver."""

    name = "~/motion_sequence"
    type_name = "control_msgs/action/ExecuteMotionPrimitiveSequence"

    def __init__(
        self, host: NodeHost, node: Node, controller: Any, control: RobotControl, transforms: Transforms
    ) -> None:
        self._control = control
        self._transforms = transforms
        super().__init__(host, node, controller)

    async def _send(self, request: Any) -> GoalHandle:
        controller, messages = self._controller, request.trajectory.motions
        controller.check_active()
        frames = {pose.header.frame_id for message in messages for pose in message.poses}
        poses = await self._transforms.poses_in_base(frames, controller.error)
        primitives = tuple(self._primitive(number, message, poses) for number, message in enumerate(messages))
        controller.check(primitives)
        self._control.check_primitives(primitives)
        handle: GoalHandle = controller.send_goal(primitives)
        return handle

    def _primitive(self, number: int, message: Any, frames: Mapping[str, Pose]) -> MotionPrimitive:
        refuse = self._controller.error
        if message.type not in set(PrimitiveType):
            known = ", ".join(f"{kind.name} ({kind:d})" for kind in PrimitiveType)
            raise refuse(f"primitive {number}: there is no type {message.type}: choose one of {known}")
        given = {argument.name: argument.value for argument in message.additional_arguments}
        for unknown in given.keys() - _ARGUMENTS:
            text = f"primitive {number}: the argument {quoted(unknown)} is unknown and has no effect"
            self._node.get_logger().warning(text)
        goal, via, *_ = (*(pose_in(frames, pose, refuse) for pose in message.poses[:2]), (), ())
        return MotionPrimitive(
            PrimitiveType(message.type),
            tuple(message.joint_positions),
            goal,
            via,
            message.blend_radius,
            *(given.get(name, math.nan) for name in _ARGUMENTS),
        )


class ToolContactAction(_Action):
    """``~/detect_tool_contact``: ends when the tool has touched something and the arm is back at the contact point."""

    name = "~/detect_tool_contact"
    type_name = "ur_msgs/action/ToolContact"

    async def _begin(self, request: Any) -> tuple[Call, Any]:
        call, ended = self._controller.detect_tool_contact(), self._host.ending(self._node)
        call.on_end.append(ended.set_result)
        return call, ended

    async def _execute(self, goal: Any) -> Any:
        call, ended = self._pop_accepted()
        success = await ended
        if success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            self._node.get_logger().error(f"detect_tool_contact: {call.message}")
            goal.abort()
        return self._type.Result()

    def _stop(self, goal: Any) -> None:
        self._controller.cancel()
