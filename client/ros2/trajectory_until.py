"""The node ``trajectory_until_node``: its action ``~/execute`` follows a trajectory until the tool touches something.

Like the official driver's node, it is a client of two actions: the trajectory's and ``detect_tool_contact``'s. The one
that ends first ends the other. Source of names, types, parameters and texts: trajectory_until_node.cpp of
ur_robot_driver. See docs/ros2.md for the differences.
"""

from dataclasses import dataclass
from typing import Any, Final

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup

from client.ros2.host import HostedNode, NodeHost, interface
from client.ros2.one_goal import OneGoalAction

NAME: Final = "trajectory_until_node"
_ANSWER_S: Final = 1.0  # an action that does not exist or does not answer within this counts as rejecting the goal
_GRACE_S: Final = 0.5  # guess: an event that ends one action may also end the other, which is reported a little later
_MOTION: Final = "control_msgs/action/FollowJointTrajectory"
_CONTACT: Final = "ur_msgs/action/ToolContact"
_WATCH: Final = "tool_contact_controller/detect_tool_contact"
_ENDS: Final = {GoalStatus.STATUS_ABORTED: "aborted", GoalStatus.STATUS_CANCELED: "canceled"}


class TrajectoryUntilNode(HostedNode):
    """The node; it executes one goal at a time and rejects others.

    When it is closed, the controllers continue the actions that it has begun.

    controller: whose ``follow_joint_trajectory`` is used, unless the parameter ``motion_controller_uri`` names another.
    """

    def __init__(self, host: NodeHost, controller: str) -> None:
        super().__init__(host, NAME)
        self._goals: _RunningGoals | None = None  # while a goal is being executed
        self._group = ReentrantCallbackGroup()  # an answer comes while a callback of the server awaits it
        default = f"{controller}/follow_joint_trajectory"
        self._motion = self._client("motion_controller_uri", default, interface(_MOTION))
        self._contact = self._client("until_action_uri", _WATCH, interface(_CONTACT))
        self._action = OneGoalAction(
            self.node,
            "execute",
            "ur_msgs/action/FollowJointTrajectoryUntil",
            begin=self._begin,
            execute=self._execute,
            cancel=self._cancel,
        )
        self._type = self._action.type
        host.spin(self.node)

    def _client(self, parameter: str, default: str, type_: Any) -> "_Client":
        uri = str(self._fixed(parameter, default))
        return _Client(uri, type_, ActionClient(self.node, type_, uri, callback_group=self._group))

    # in the node's thread

    async def _begin(self, goal: Any) -> bool:
        self._goals = await self._begin_goals(goal)
        return self._goals is not None

    async def _begin_goals(self, goal: Any) -> "_RunningGoals | None":
        """Begin both actions, the contact first; if one rejects its goal, log the reason and return None."""
        if goal.until_type != self._type.Goal.TOOL_CONTACT:
            self._action.reject(f"there is no until_type {goal.until_type}: choose TOOL_CONTACT (0)")
            return None
        for client in (self._motion, self._contact):
            if not client.ros.wait_for_server(timeout_sec=_ANSWER_S):
                self._action.reject(f"the action {client.uri} is not offered: check that its controller is loaded")
                return None
        contact = await self._sent(self._contact, self._contact.type.Goal())
        if contact is None:
            self._action.reject("tool contact detection rejects the goal: check that tool_contact_controller is active")
            return None
        motion = self._motion.type.Goal()
        for name in ("trajectory", "path_tolerance", "goal_tolerance", "goal_time_tolerance"):
            setattr(motion, name, getattr(goal, name))
        goals = _RunningGoals(contact, self._host.ending(self.node))
        goals.motion = await self._sent(
            self._motion, motion, lambda message: self._on_feedback(goals, message.feedback)
        )
        if goals.motion is None:
            contact.cancel_goal_async()
            self._action.reject(f"{self._motion.uri} rejects the trajectory: see the log of its node")
            return None
        return goals

    async def _sent(self, client: "_Client", goal: Any, feed_back: Any = None) -> Any:
        """Send a goal; return its handle, or None if it is rejected or not answered."""
        answer = client.ros.send_goal_async(goal, feed_back)
        if not await self._wait_for(answer, _ANSWER_S):
            answer.add_done_callback(lambda late: late.result().accepted and late.result().cancel_goal_async())
            return None
        return answer.result() if answer.result().accepted else None

    async def _wait_for(self, future: Any, timeout_s: float) -> bool:
        """Wait for a future, with a time limit; return whether it is done."""
        either = self._host.ending(self.node)

        def end(_: object = None) -> None:
            if not either.done():
                either.set_result(None)

        timer = self.node.create_timer(timeout_s, end, callback_group=self._group)
        future.add_done_callback(end)
        try:
            await either
        finally:
            self.node.destroy_timer(timer)
        return bool(future.done())

    async def _cancel(self) -> None:
        if self._goals is not None:
            self._goals.cancel()

    async def _execute(self, goal: Any) -> Any:
        goals = self._goals
        assert goals is not None
        goals.goal = goal
        try:
            return await self._ended(goals)
        finally:
            goals.cancel()  # the other one
            self._goals = None

    async def _ended(self, goals: "_RunningGoals") -> Any:
        touched, moved = goals.contact.get_result_async(), goals.motion.get_result_async()
        for end in (touched, moved):
            end.add_done_callback(goals.end)
        await goals.ended
        if goals.goal.is_cancel_requested:
            await self._wait_for(moved, _GRACE_S)
        elif moved.done() and moved.result().status == GoalStatus.STATUS_ABORTED:
            await self._wait_for(touched, _GRACE_S)
        if touched.done() and touched.result().status == GoalStatus.STATUS_SUCCEEDED:
            text = "Trajectory finished successfully by triggering until condition."
            goals.goal.succeed()
            return self._type.Result(until_condition_result=self._type.Result.TRIGGERED, error_string=text)
        result = self._type.Result(until_condition_result=self._type.Result.NOT_TRIGGERED)
        if moved.done():
            status, answer = moved.result().status, moved.result().result
            result.error_code, result.error_string = answer.error_code, answer.error_string
            action_title = "Trajectory action"
        else:
            status, action_title = touched.result().status, "Until action"
        if status == GoalStatus.STATUS_SUCCEEDED:
            goals.goal.succeed()
            return result
        result.error_string = f"{result.error_string} {action_title} was {_ENDS.get(status, 'lost')}.".lstrip()
        self.node.get_logger().error(f"execute: {result.error_string}")
        if goals.goal.is_cancel_requested:
            goals.goal.canceled()
        else:
            goals.goal.abort()
        return result

    def _on_feedback(self, goals: "_RunningGoals", feedback: Any) -> None:
        if goals.goal is None or not goals.goal.is_active:
            return
        message = self._type.Feedback()
        for name in ("header", "joint_names", "desired", "actual", "error"):
            setattr(message, name, getattr(feedback, name))
        goals.goal.publish_feedback(message)


@dataclass(frozen=True, slots=True)
class _Client:
    """Client of an action. uri: name of the action, as in the parameter."""

    uri: str
    type: Any
    ros: ActionClient


class _RunningGoals:
    """The goals of the two actions, and this node's goal."""

    def __init__(self, contact: Any, ended: Any) -> None:
        self.contact = contact
        self.motion: Any = None
        self.ended = ended  # set when one of them has
        self.goal: Any = None

    def end(self, _: object) -> None:
        if not self.ended.done():
            self.ended.set_result(None)

    def cancel(self) -> None:
        for handle in (self.contact, self.motion):
            if handle.status in (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_UNKNOWN):
                handle.cancel_goal_async()
