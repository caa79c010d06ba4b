"""The ROS 2 driver: a robot and its controllers, as the nodes of the official driver.

Controllers run in a separate process (`client.ros2.control_process`), each node in a separate thread
(`client.ros2.host`).
"""

import asyncio
import importlib.util
import logging
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack
from functools import partial
from typing import Any

from client.cameras import CameraClient
from client.controllers.broadcasters import JointStateBroadcaster
from client.controllers.configuration import trajectory_controller
from client.controllers.running import RunningManager
from client.errors import Ros2Error
from client.gripper import GripperClient
from client.ros2.cameras import CameraNode
from client.ros2.control_side import RUNNING, SIDE, ControlSide, RobotFacts
from client.ros2.controller_manager import ControllerManagerNode
from client.ros2.controller_nodes import ControllerNodes
from client.ros2.dashboard import DashboardNode
from client.ros2.gripper import GripperNode
from client.ros2.host import NodeHost, RemoteController, in_thread
from client.ros2.options import DriverOptions
from client.ros2.publishing import ClockPublisher, Outbox, RobotStatePublisher
from client.ros2.state_helper import StateHelperNode
from client.ros2.topics import PublishingContext
from client.ros2.trajectory_until import TrajectoryUntilNode
from client.ros2.transforms import Transforms
from client.ros2.urscript_interface import URScriptNode
from urproto.extras import how_to_install

_logger = logging.getLogger(__name__)


class Ros2Driver:
    """The nodes of one robot. Use it with ``async with``, which waits until the robot can be reached.

    link: connection to the process of the control loop. host: runs the nodes.
    """

    def __init__(self, options: DriverOptions, link: socket.socket) -> None:
        self._options = options
        self._link = link
        self._opened = AsyncExitStack()
        self.host: NodeHost

    async def __aenter__(self) -> "Ros2Driver":
        async with AsyncExitStack() as opening:
            options = self._options
            self.host = host = await opening.enter_async_context(
                NodeHost(
                    self._link,
                    domain=options.domain,
                    namespace=options.namespace,
                    ros_arguments=options.ros_arguments,
                    use_sim_time=options.use_sim_time,
                )
            )
            await self._open_nodes(
                opening, host, await host.call(ControlSide.start, SIDE, options, options.use_sim_time)
            )
            opening.callback(host.end)  # first of all, the arm comes to rest
            self._opened = opening.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._opened.aclose()

    async def waiting(self) -> str:
        """What the user has to do until the driver is ready; empty if nothing."""
        return str(await self.host.call(RunningManager.waiting, RUNNING, self._options))

    async def ready(self) -> str:
        """Say that the driver is ready; with make_ready, first wait until the control program runs."""
        return str(await self.host.call(RunningManager.ready, RUNNING, self._options))

    async def ended(self) -> None:
        """Wait for the end of the control loop, which raises Ros2Error: the nodes cannot do without it."""
        await self.host.ended()
        raise Ros2Error("the process of the control loop has ended: see its last messages, and start the driver again")

    async def _open_nodes(self, opening: AsyncExitStack, host: NodeHost, facts: RobotFacts) -> None:
        options, prefix, model = self._options, self._options.tf_prefix, facts.model
        scene = PublishingContext(prefix, facts.states)
        if options.use_sim_time:
            await self._open(opening, ClockPublisher, host)
        outbox = Outbox(host, scene)
        opening.callback(outbox.close)
        transforms = Transforms(host, scene)
        controllers = ControllerNodes(host, facts, outbox, transforms)
        opening.push_async_callback(in_thread, controllers.close_all)
        for controller in sorted(facts.controllers, key=lambda one: not one.active):  # nodes of active ones come first
            await in_thread(controllers.open, controller)
        changes = asyncio.ensure_future(controllers.follow_changes())
        opening.callback(changes.cancel)
        broadcasters = [one for one in facts.controllers if issubclass(one.kind, JointStateBroadcaster)]
        if model is None:
            _logger.warning("unknown model of arm: robot_description and the arm's frames on /tf are not published")
        elif broadcasters and options.robot_state_publisher:
            await self._open(
                opening, RobotStatePublisher, host, outbox, model, RemoteController(host, broadcasters[0]), prefix
            )
        await in_thread(ControllerManagerNode, host, facts, prefix)
        await in_thread(lambda: host.spin(host.node(facts.component.lower())))
        for kind in ((DashboardNode,) if options.dashboard_client else ()) + (StateHelperNode, URScriptNode):
            await self._open(opening, kind, host, facts.config)
        if options.gripper:
            gripper = GripperClient(options.robot_ip, options.gripper_port)
            opening.push_async_callback(gripper.close)
            await self._open(opening, GripperNode, host, gripper, options.gripper, scene)
        if options.cameras:
            await self._open_cameras(opening, host)
        follows = options.initial_controller or trajectory_controller(facts.types)
        await self._open(opening, TrajectoryUntilNode, host, follows)
        if model is not None and can_plan():
            from client.ros2.move_group.arm import Arm
            from client.ros2.move_group.monitor import Monitor
            from client.ros2.move_group.node import MoveGroupNode
            from client.ros2.servo import ServoNode

            monitor = Monitor(Arm(model, prefix, host.now_ns), host)
            await self._open(opening, ServoNode, host, monitor, transforms)
            await self._open(opening, MoveGroupNode, host, monitor)

    async def _open(self, opening: AsyncExitStack, kind: Callable[..., Any], *arguments: Any) -> None:
        node = await in_thread(kind, *arguments)
        opening.push_async_callback(in_thread, node.close)

    async def _open_cameras(self, opening: AsyncExitStack, host: NodeHost) -> None:
        """Start the camera node. Raises CameraError for cameras that do not exist."""
        options = self._options
        client = CameraClient(options.robot_ip, options.camera_port)
        opening.callback(client.close)
        cameras = await asyncio.to_thread(client.chosen, options.cameras)
        robot_time = partial(host.do, ControlSide.robot_time, SIDE)
        await self._open(opening, CameraNode, host, client, cameras, options.camera_hz, options.tf_prefix, robot_time)


def can_plan() -> bool:
    """Whether the extra ``plan`` is installed; logs a warning if not."""
    if importlib.util.find_spec("ompl") is not None:
        return True
    _logger.warning("no move_group and no servo_node, because OMPL is missing: %s", how_to_install("plan"))
    return False
