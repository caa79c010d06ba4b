"""The node ``move_group``: topics that change and publish the scene, services, actions, and the arm's SRDF."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from client.errors import PlanningError
from client.planning import NAMED_CONFIGURATIONS
from client.planning.markers import Marker, path_marker, scene_markers
from client.ros2.host import LATCHED, HostedNode, NodeHost, interface, interface_if_any
from client.ros2.move_group.actions import ExecuteTrajectoryAction, Execution, MoveAction, SequenceAction
from client.ros2.move_group.arm import GROUP, Arm, RefusedError
from client.ros2.move_group.monitor import Monitor
from client.ros2.move_group.requests import PlanResult
from client.ros2.move_group.scene import SceneState
from client.ros2.move_group.services import (
    PLANS,
    SERVICES,
    PlanningService,
    RequestContext,
    answer_request,
    set_response_code,
)
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
_ARRAY: Final = "visualization_msgs/msg/MarkerArray"
_DELETE_ALL: Final = 3  # visualization_msgs/Marker


class MoveGroupNode(HostedNode):
    """The node; a trajectory in progress is stopped when it is closed."""

    def __init__(self, host: NodeHost, monitor: Monitor) -> None:
        super().__init__(host, NAME)
        node = self.node
        self._monitor = monitor
        self._arm = arm = monitor.arm
        self._execution = Execution(host)
        semantic = srdf(self._arm)
        self._fixed("robot_description", urdf(arm.model, prefix=arm.prefix))
        self._fixed("robot_description_semantic", semantic)
        self._semantic = node.create_publisher(String, "robot_description_semantic", LATCHED)
        self._semantic.publish(String(data=semantic))
        self._scene = node.create_publisher(
            interface("moveit_msgs/msg/PlanningScene"), "monitored_planning_scene", LATCHED
        )
        self._path = node.create_publisher(
            interface("moveit_msgs/msg/DisplayTrajectory"), "display_planned_path", QoSProfile(depth=10)
        )
        self._markers = MarkerPublisher(node, self._arm)
        for topic, kind in _CHANGING:
            node.create_subscription(interface(kind), topic, self._listener(topic), _DEPTH)
        node.create_subscription(String, "trajectory_execution_event", self._on_event, 1)
        for row in SERVICES:
            if (kind := interface_if_any(row.type)) is not None:  # Humble has fewer
                node.create_service(kind, row.name, self._handler(row))
        node.create_service(interface("moveit_msgs/srv/ApplyPlanningScene"), "apply_planning_scene", self._on_apply)
        concurrent = ReentrantCallbackGroup()  # other requests are answered during planning
        for row in PLANS:
            node.create_service(interface(row.type), row.name, self._planner(row), callback_group=concurrent)
        self._actions = (
            ExecuteTrajectoryAction(host, node, self._execution),
            MoveAction(host, node, self._execution, self._monitor, self._publish_plan),
            SequenceAction(host, node, self._execution, self._monitor, self._publish_plan),
        )
        host.spin(node)

    # in the node's thread

    def _log_error(self, what: str, reason: object) -> None:
        self.node.get_logger().error(f"{what}: {reason}")

    def _listener(self, topic: str) -> Callable[[Any], None]:
        def listen(message: Any) -> None:
            self._apply_message(topic, message)

        return listen

    def _apply_message(self, what: str, message: Any) -> bool:
        """Apply a message to the scene, completely or not at all; return whether it was applied."""
        try:
            q = self._host.wait(self._monitor.apply(message))
            scene_message = self._monitor.state.message(q)
        except (RefusedError, PlanningError) as error:
            self._log_error(what, error)
            return False
        self._scene.publish(scene_message)
        self._markers.scene(self._monitor.state)
        return True

    def _on_apply(self, request: Any, response: Any) -> Any:
        response.success = self._apply_message("apply_planning_scene", request.scene)
        return response

    def _handler(self, row: PlanningService) -> Callable[[Any, Any], Any]:
        def handle(request: Any, response: Any) -> Any:
            try:
                _, reason = answer_request(row, self._host.wait(self._context()), request, response)
            except RefusedError as error:
                self._refuse(row, response, error)
            else:
                if reason:
                    self._log_error(row.name, reason)
            return response

        return handle

    def _planner(self, row: PlanningService) -> Callable[[Any, Any], Any]:
        async def handle(request: Any, response: Any) -> Any:
            try:
                now = self._host.wait(self._context())
            except RefusedError as error:
                self._refuse(row, response, error)
                return response
            work = asyncio.to_thread(answer_request, row, now, request, response)
            plan, reason = await self._host.task(self.node, work)
            if reason:
                self._log_error(row.name, reason)
            if plan is not None:
                self._publish_plan(plan)
            return response

        return handle

    def _refuse(self, row: PlanningService, response: Any, error: RefusedError) -> None:
        self._log_error(row.name, error)
        set_response_code(response, error.code, str(error))

    def _on_event(self, message: Any) -> None:
        if message.data != "stop":
            self._log_error("trajectory_execution_event", f"unknown event {message.data!r}: only stop is supported")
            return
        self._host.loop.call_soon_threadsafe(self._execution.stop)

    # in the event loop

    async def _context(self) -> RequestContext:
        q = await self._monitor.current_configuration()
        return RequestContext(self._arm, self._monitor.state, q)

    # anywhere

    def _publish_plan(self, plan: PlanResult) -> None:
        message = interface("moveit_msgs/msg/DisplayTrajectory")()
        message.model_id = self._arm.model.name
        message.trajectory_start = self._arm.state_message(plan.start_rad)
        message.trajectory = [self._arm.trajectory_message(plan.trajectory)]
        self._path.publish(message)
        self._markers.path(self._monitor.state, plan)


class MarkerPublisher:
    """Publishes ``~/scene_markers`` and ``~/path_markers``, latched."""

    def __init__(self, node: Any, arm: Arm) -> None:
        self._arm = arm
        self._scene = node.create_publisher(interface(_ARRAY), "~/scene_markers", LATCHED)
        self._path = node.create_publisher(interface(_ARRAY), "~/path_markers", LATCHED)

    def scene(self, state: SceneState) -> None:
        markers = scene_markers(state.scene(), None, prefix=self._arm.prefix)
        self._scene.publish(_message([{"action": _DELETE_ALL}, *markers]))

    def path(self, state: SceneState, plan: PlanResult) -> None:
        self._path.publish(_message([path_marker(state.scene(), plan.trajectory.q, prefix=self._arm.prefix)]))


def _message(markers: Sequence[Marker]) -> Any:
    kind = interface("visualization_msgs/msg/Marker")
    return interface(_ARRAY)(markers=[_filled(kind(), marker) for marker in markers])


def _filled(message: Any, values: Mapping[str, Any]) -> Any:
    """A message with these fields; lists of mappings are lists of points."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            _filled(getattr(message, name), value)
        elif isinstance(value, list):
            point = interface("geometry_msgs/msg/Point")
            setattr(message, name, [_filled(point(), one) for one in value])
        else:
            setattr(message, name, value)
    return message


def srdf(arm: Arm) -> str:
    """The SRDF that matches this planner, for the URDF of the robot_state_publisher."""
    root = Element("robot", name=arm.model.name)
    group = SubElement(root, "group", name=GROUP)
    SubElement(group, "chain", base_link=arm.root, tip_link=arm.tip)
    for name, q_rad in NAMED_CONFIGURATIONS.items():
        state = SubElement(root, "group_state", name=name, group=GROUP)
        for joint, angle in zip(arm.joints, q_rad, strict=True):
            SubElement(state, "joint", name=joint, value=repr(angle))
    scene = SceneState(arm)
    for one, other in combinations(arm.collision_links, 2):
        if scene.is_collision_disabled(one, other):
            adjacent = arm.collision_links.index(other) - arm.collision_links.index(one) == 1
            SubElement(root, "disable_collisions", link1=one, link2=other, reason="Adjacent" if adjacent else "Never")
    indent(root)
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'
