"""The node ``ur_robot_state_helper``: its action ``~/set_mode`` brings the arm to a mode, from any other mode."""

import asyncio
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse

from client.driver import DriverConfig
from client.ros2.control_side import FEED, SIDE, ControlSide
from client.ros2.host import HostedNode, NodeHost, interface
from client.ros2.mode_setter import ModeRequest, Modes
from urproto.errors import URError

NAME: Final = "ur_robot_state_helper"


class StateHelperNode(HostedNode):
    """The node; a goal in execution is abandoned when it is closed.

    Goals are executed one after the other and cannot be cancelled. With ``headless_mode``, ``play_program`` sends the
    control program; without it, it plays the program that is loaded on the pendant. A goal is rejected while the robot
    sends no states.
    """

    def __init__(self, host: NodeHost, config: DriverConfig) -> None:
        super().__init__(host, NAME)
        self._headless = self._fixed("headless_mode", config.headless)
        self._address = self._fixed("robot_ip", config.host)
        self._type = interface("ur_dashboard_msgs/action/SetMode")
        self._one_at_a_time = asyncio.Lock()
        self._server = ActionServer(
            self.node,
            self._type,
            "~/set_mode",
            self._execute,
            goal_callback=self._accept,
            cancel_callback=lambda handle: CancelResponse.REJECT,
        )
        host.spin(self.node)

    # in the node's thread

    def _accept(self, goal: Any) -> GoalResponse:
        if self._host.do(getattr, FEED, "silent"):
            self.node.get_logger().error("set_mode: goal rejected: the robot sends no states, so its mode is unknown")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        why = await self._host.task(self.node, self._set_mode(handle))
        if why:
            self.node.get_logger().error(f"set_mode: {why}")
            handle.abort()
        else:
            handle.succeed()
        return self._type.Result(success=not why, message=why or "the robot is in the requested mode")

    # in the event loop

    async def _set_mode(self, handle: Any) -> str:
        """Execute a goal; return the reason if it fails, otherwise an empty string."""
        goal, key = handle.request, (NAME, bytes(handle.goal_id.uuid))
        request = ModeRequest(
            goal.target_robot_mode, goal.stop_program, goal.play_program, self._headless, self._address
        )

        def publish(modes: Modes) -> None:
            robot_mode, safety_mode = map(int, modes)
            handle.publish_feedback(self._type.Feedback(current_robot_mode=robot_mode, current_safety_mode=safety_mode))

        async with self._one_at_a_time:
            self._host.listen(key, publish)
            try:
                await self._host.call(ControlSide.set_mode, SIDE, key, request)
            except URError as error:
                return str(error)
            finally:
                self._host.unlisten(key)
        return ""
