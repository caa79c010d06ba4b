"""The node ``move_group``: topics by which the scene changes and is seen, services, actions, and the arm's SRDF."""

import asyncio
from collections.abc import Callable
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from client.controllers.robot import ControlledRobot
from client.errors import ClientError, PlanningError
from client.ros2.host import LATCHED, NodeHost, interface, interface_if_any
from client.ros2.move_group.actions import ExecuteTrajectoryAction, MoveAction
from client.ros2.move_group.arm import Arm, RefusedError, set_code
from client.ros2.move_group.execution import Execution
from client.ros2.move_group.monitor import Monitor
from client.ros2.move_group.requests import Planned, planned
from client.ros2.move_group.services import SERVICES, Service, Situation, answered
from client.ros2.move_group.srdf import srdf
from urproto.robots import RobotModel
from urproto.robots.description import urdf

NAME: Final = "move_group"
_DEPTH: Final = 100
_CHANGING: Final = (
    ("planning_scene", "moveit_msgs/msg/PlanningScene"),
    ("planning_scene_world", "moveit_msgs/msg/PlanningSceneWorld"),
    ("collision_object", "moveit_msgs/msg/CollisionObject"),
    ("attached_collision_object", "moveit_msgs/msg/AttachedCollisionObject"),
)
"""Topics whose messages change the scene. Source: MoveIt's planning scene monitor."""


class MoveGroupNode:
    """The node; it spins from its making until `close`."""

    def __init__(self, host: NodeHost, robot: ControlledRobot, model: RobotModel, prefix: str = "") -> None:
        self._host = host
        self.node = node = host.node(NAME)
        self._arm = Arm(model, prefix)
        self._monitor = Monitor(self._arm, robot)
        self._execution = Execution(robot)
        semantic = srdf(self._arm)
        fixed = ParameterDescriptor(read_only=True)
        node.declare_parameter("robot_description", urdf(model, prefix=prefix), fixed)
        node.declare_parameter("robot_description_semantic", semantic, fixed)
        self._semantic = node.create_publisher(String, "robot_description_semantic", LATCHED)
        self._semantic.publish(String(data=semantic))
        self._scene = node.create_publisher(
            interface("moveit_msgs/msg/PlanningScene"), "monitored_planning_scene", LATCHED
        )
        self._way = node.create_publisher(
            interface("moveit_msgs/msg/DisplayTrajectory"), "display_planned_path", QoSProfile(depth=10)
        )
        for topic, kind in _CHANGING:
            node.create_subscription(interface(kind), topic, self._listener(topic), _DEPTH)
        node.create_subscription(String, "trajectory_execution_event", self._event, 1)
        for row in SERVICES:
            if (kind := interface_if_any(row.type)) is not None:  # Humble has fewer
                node.create_service(kind, row.name, self._handler(row))
        node.create_service(interface("moveit_msgs/srv/ApplyPlanningScene"), "apply_planning_scene", self._apply)
        node.create_service(
            interface("moveit_msgs/srv/GetMotionPlan"),
            "plan_kinematic_path",
            self._plan,
            callback_group=ReentrantCallbackGroup(),
        )
        self._actions = (
            ExecuteTrajectoryAction(host, node, self._execution),
            MoveAction(host, node, self._execution, self._monitor, self._show),
        )
        host.spin(node)

    def close(self) -> None:
        """End the node; a trajectory that is under way is stopped."""
        self._host.close(self.node)

    # in the node's thread

    def _error(self, what: str, reason: object) -> None:
        self.node.get_logger().error(f"{what}: {reason}")

    def _listener(self, topic: str) -> Callable[[Any], None]:
        def listen(message: Any) -> None:
            self._change(topic, message)

        return listen

    def _change(self, what: str, message: Any) -> bool:
        """Whether the scene has been changed; all of a message or nothing."""
        try:
            self._host.do(lambda: self._monitor.apply(message))
            told = self._monitor.state.message(self._host.do(self._monitor.stands))
        except (RefusedError, PlanningError) as error:
            self._error(what, error)
            return False
        self._scene.publish(told)
        return True

    def _apply(self, request: Any, response: Any) -> Any:
        response.success = self._change("apply_planning_scene", request.scene)
        return response

    def _handler(self, row: Service) -> Callable[[Any, Any], Any]:
        def handle(request: Any, response: Any) -> Any:
            try:
                now = self._host.do(self._situation)
            except RefusedError as error:
                reason = str(error)
                if hasattr(response, "error_code"):
                    set_code(response.error_code, error.code, reason)
            else:
                reason = answered(row, now, request, response)
            if reason:
                self._error(row.name, reason)
            return response

        return handle

    async def _plan(self, request: Any, response: Any) -> Any:
        answer, wanted = response.motion_plan_response, request.motion_plan_request
        answer.group_name = wanted.group_name
        try:
            now = self._host.do(self._situation)
            work = asyncio.to_thread(planned, now.arm, now.state, wanted, now.q_rad)
            plan = await self._host.task(self.node, work)
        except RefusedError as error:
            self._error("plan_kinematic_path", error)
            set_code(answer.error_code, error.code, str(error))
            return response
        answer.trajectory_start = self._arm.state_message(plan.start_rad)
        answer.trajectory = self._arm.trajectory_message(plan.timed)
        answer.planning_time = plan.time_s
        set_code(answer.error_code, "SUCCESS")
        self._show(plan)
        return response

    def _event(self, message: Any) -> None:
        if message.data != "stop":
            self._error("trajectory_execution_event", f"{message.data!r} is not known: there is stop")
            return
        try:
            self._host.do(self._execution.stop)
        except ClientError as error:
            self._error("trajectory_execution_event", error)

    # anywhere

    def _situation(self) -> Situation:
        """In the event loop."""
        return Situation(self._arm, self._monitor.state, self._monitor.stands())

    def _show(self, plan: Planned) -> None:
        """What RViz draws."""
        message = interface("moveit_msgs/msg/DisplayTrajectory")()
        message.model_id = self._arm.model.name
        message.trajectory_start = self._arm.state_message(plan.start_rad)
        message.trajectory = [self._arm.trajectory_message(plan.timed)]
        self._way.publish(message)
