"""Actions of controllers: following trajectories, motion primitives, and tool contact detection.

A goal is passed to the controller before it is accepted, so that the client is refused what the controller refuses.
Then the action's coroutine in the node's thread awaits a call to the control loop, answered when the goal ends.
"""

import math
from collections.abc import Coroutine, Mapping
from typing import Any, ClassVar, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from client.controllers.compliance import ToolContactController
from client.controllers.goals import (
    Feedback,
    FollowJointTrajectory,
    GoalStatus,
    MotionPrimitive,
    PrimitiveType,
    Tolerance,
)
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.motion_primitives import MotionPrimitivesForwardController
from client.controllers.passthrough import PassthroughTrajectoryController
from client.errors import ClientError
from client.ros2.control_side import SIDE, ControlSide, feedback_key
from client.ros2.host import NodeHost, RemoteController, interface, interface_if_any, stamp
from client.ros2.topics import CommandContext, seconds, set_point, trajectory
from client.ros2.transforms import Transforms, pose_in
from urproto.errors import URError
from urproto.robots.pose import Pose
from urproto.text import quoted

_ARGUMENTS: Final = ("velocity", "acceleration", "move_time")  # of motion primitives


def serve_actions(host: NodeHost, node: Node, controller: RemoteController, transforms: Transforms) -> None:
    """Offer a controller's actions on its node, which must already spin."""
    if issubclass(controller.kind, (JointTrajectoryController, PassthroughTrajectoryController)):
        FollowTrajectoryAction(host, node, controller)
    elif issubclass(controller.kind, ToolContactController):
        ToolContactAction(host, node, controller)
    elif issubclass(controller.kind, MotionPrimitivesForwardController):
        if interface_if_any(MotionSequenceAction.type_name) is None:
            node.get_logger().warning(
                f"~/motion_sequence is not offered: this distribution has no {MotionSequenceAction.type_name}"
            )
        else:
            MotionSequenceAction(host, node, controller, transforms)


class _Action:
    """An action of a controller; goals are accepted one at a time and executed in that order.

    A subclass begins a goal, which the control loop numbers, and converts its end to a result.
    """

    name: ClassVar[str]
    type_name: ClassVar[str]

    def __init__(self, host: NodeHost, node: Node, controller: RemoteController) -> None:
        self._host = host
        self._node = node
        self._controller = controller
        self._type = interface(self.type_name)
        self._accepted: Any = None  # the goal begun but not yet executed: callbacks come one after the other
        self._numbers: dict[bytes, int] = {}  # of goals under way
        self._server = ActionServer(
            node,
            self._type,
            self.name,
            self._execute,
            goal_callback=self._accept,
            cancel_callback=self._cancel,
        )

    def _begin(self, request: Any) -> int:
        """Begin a goal and return its number. Raises URError if the goal is refused."""
        raise NotImplementedError

    def _end_of(self, number: int) -> Coroutine[Any, Any, Any]:
        """Wait for the end of a goal, in the event loop."""
        return self._host.call(ControlSide.end_of, SIDE, number)

    def _finish(self, goal: Any, end: Any) -> Any:
        """Tell the client how its goal ended; return the action's result."""
        status, result = end
        if status is GoalStatus.SUCCEEDED:
            goal.succeed()
        elif status is GoalStatus.CANCELED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return self._type.Result(error_code=int(result.error_code), error_string=result.error_string)

    def _accept(self, request: Any) -> GoalResponse:
        try:
            self._accepted = self._begin(request)
        except URError as error:
            self._node.get_logger().error(f"goal refused: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        number, self._accepted = self._accepted, None
        name = bytes(goal.goal_id.uuid)
        self._numbers[name] = number
        try:
            return self._finish(goal, await self._host.task(self._node, self._end_of(number)))
        finally:
            del self._numbers[name]

    def _cancel(self, goal: Any) -> CancelResponse:
        try:
            if (number := self._numbers.get(bytes(goal.goal_id.uuid))) is not None:
                self._host.do(ControlSide.cancel, SIDE, number)
        except ClientError as error:
            self._node.get_logger().error(f"cannot cancel the goal: {error}")
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT


class FollowTrajectoryAction(_Action):
    """``~/follow_joint_trajectory`` of a controller."""

    name = "~/follow_joint_trajectory"
    type_name = "control_msgs/action/FollowJointTrajectory"

    def _begin(self, request: Any) -> int:
        goal = _goal(request, CommandContext(self._host), self._controller)
        number: int = self._host.do(ControlSide.begin_trajectory, SIDE, self._controller.reference, goal)
        return number

    async def _execute(self, goal: Any) -> Any:
        key = feedback_key(self._accepted)
        self._host.listen(key, lambda feedback: self._publish(goal, feedback))
        try:
            return await super()._execute(goal)
        finally:
            self._host.unlisten(key)

    def _publish(self, goal: Any, feedback: Feedback) -> None:
        message = self._type.Feedback()
        stamp(message.header.stamp, self._host.received_ns)
        message.joint_names = list(self._controller.joints)
        set_point(message.desired, feedback.desired)
        set_point(message.actual, feedback.actual)
        set_point(message.error, feedback.error)
        if hasattr(message, "index"):
            message.index = feedback.index
        goal.publish_feedback(message)


def _goal(request: Any, now: CommandContext, controller: RemoteController) -> FollowJointTrajectory:
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


class MotionSequenceAction(_Action):
    """``~/motion_sequence``: motion primitives that the robot executes. No feedback, as in the official driver."""

    name = "~/motion_sequence"
    type_name = "control_msgs/action/ExecuteMotionPrimitiveSequence"

    def __init__(self, host: NodeHost, node: Node, controller: RemoteController, transforms: Transforms) -> None:
        self._transforms = transforms
        super().__init__(host, node, controller)

    def _begin(self, request: Any) -> int:
        messages = request.trajectory.motions
        frames = {pose.header.frame_id for message in messages for pose in message.poses}
        poses = self._host.wait(self._transforms.poses_in_base(frames, self._controller.error))
        primitives = tuple(self._primitive(number, message, poses) for number, message in enumerate(messages))
        number: int = self._host.do(ControlSide.begin_primitives, SIDE, self._controller.reference, primitives)
        return number

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

    def _begin(self, request: Any) -> int:
        number: int = self._host.do(ControlSide.begin_contact, SIDE, self._controller.reference)
        return number

    async def _end_of(self, number: int) -> str:
        """Wait for the end; return why it failed, empty if it succeeded."""
        try:
            await self._host.call(ControlSide.end_of_contact, SIDE, number)
        except ClientError as error:
            return str(error)
        return ""

    def _finish(self, goal: Any, end: str) -> Any:
        if not end:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            self._node.get_logger().error(f"detect_tool_contact: {end}")
            goal.abort()
        return self._type.Result()
