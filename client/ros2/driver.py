"""The ROS 2 driver: a robot and its controllers, as the nodes of the official driver.

Controllers run in the event loop with each state of the robot. Each node has a separate thread (`client.ros2.host`).
"""

import asyncio
import importlib.util
import logging
import re
from contextlib import AsyncExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final

from client.calibration import calibrated_model, calibration_of
from client.cameras import CameraClient
from client.controllers.broadcasters import JointStateBroadcaster
from client.controllers.configuration import trajectory_controller
from client.controllers.control import RobotControl
from client.controllers.running import ManagerOptions, RunningManager, reached
from client.controllers.serving import ManagerServer, claim
from client.errors import Ros2Error
from client.ros2.cameras import CameraNode
from client.ros2.controller_manager import ControllerManagerNode
from client.ros2.controller_nodes import ControllerNodes
from client.ros2.dashboard import DashboardNode
from client.ros2.host import NodeHost, in_thread
from client.ros2.publishing import Outbox
from client.ros2.state_helper import StateHelperNode
from client.ros2.state_publisher import RobotStatePublisher
from client.ros2.topics import PublishingContext
from client.ros2.trajectory_until import TrajectoryUntilNode
from client.ros2.transforms import Transforms
from client.ros2.urscript_interface import URScriptNode
from urproto.extras import how_to_install
from urproto.ports import CAMERA_PORT

_PREFIX: Final = re.compile(r"|[A-Za-z_][A-Za-z0-9_]*")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriverOptions(ManagerOptions):
    """Options as in `ur_control.launch.py`, under this project's names.

    namespace: of all nodes. domain: ROS domain, None for ROS_DOMAIN_ID. dashboard_client, robot_state_publisher:
    whether there are nodes of these names. cameras: names of the cameras to publish; `client.cameras.ALL_CAMERAS` for
    all. camera_port: the emulator's camera port. camera_hz: images per second of each.
    """

    namespace: str = ""
    domain: int | None = None
    ros_arguments: tuple[str, ...] = ()
    dashboard_client: bool = True
    robot_state_publisher: bool = True
    cameras: tuple[str, ...] = ()
    camera_port: int = CAMERA_PORT
    camera_hz: float = 10.0

    def __post_init__(self) -> None:
        """Raise Ros2Error for an invalid tf_prefix."""
        if not _PREFIX.fullmatch(self.tf_prefix):
            raise Ros2Error(f"{self.tf_prefix!r} is not a valid prefix: use letters, digits and _, as in left_")


class Ros2Driver:
    """The nodes of one robot. Use it with ``async with``, which waits until the robot can be reached."""

    def __init__(self, options: DriverOptions) -> None:
        self._options = options
        self._opened = AsyncExitStack()
        self.running: RunningManager

    @property
    def control(self) -> RobotControl:
        """The robot and its control loop."""
        return self.running.control

    async def __aenter__(self) -> "Ros2Driver":
        async with AsyncExitStack() as opening:
            options = self._options
            place = opening.enter_context(claim(options.robot_ip, options.rtde_port))
            control = await opening.enter_async_context(reached(options))
            self.running = RunningManager(control, headless=options.headless)
            host = await opening.enter_async_context(
                NodeHost(domain=options.domain, namespace=options.namespace, ros_arguments=options.ros_arguments)
            )
            await self._open_nodes(opening, host)
            await opening.enter_async_context(self.running.at_work(options))
            await opening.enter_async_context(ManagerServer(self.running, place))
            self._opened = opening.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._opened.aclose()

    async def _open_nodes(self, opening: AsyncExitStack, host: NodeHost) -> None:
        running, control, prefix = self.running, self.control, self._options.tf_prefix
        manager = running.manager
        scene = PublishingContext(prefix, manager.hardware.states)
        outbox = Outbox(host, scene)
        opening.callback(outbox.close)
        manager.on_cycle.append(lambda: setattr(outbox, "time_s", manager.time_s))
        arm = control.driver.link.configuration
        model = calibrated_model(arm, calibration_of(await control.driver.link.kinematics())) if arm else None
        controllers = ControllerNodes(host, running, outbox, Transforms(host, scene))
        opening.push_async_callback(in_thread, controllers.close_all)
        loaded = running.load_all()
        for controller in loaded:
            await in_thread(controllers.open, controller)
        running.on_loaded.append(lambda one: in_thread(controllers.open, one))
        running.on_unloaded.append(lambda one: in_thread(controllers.close, one))
        running.on_parameters.append(lambda one, values: in_thread(controllers.set_parameters, one, values))
        broadcasters = [one for one in loaded if isinstance(one, JointStateBroadcaster)]
        if model is None:
            _logger.warning("unknown model of arm: robot_description and the arm's frames on /tf are not published")
        elif broadcasters and self._options.robot_state_publisher:
            states = await in_thread(RobotStatePublisher, host, outbox, model, broadcasters[0], prefix)
            opening.push_async_callback(in_thread, states.close)
        await in_thread(ControllerManagerNode, host, running)
        await in_thread(lambda: host.spin(host.node(running.component.name.lower())))
        dashboard = (DashboardNode,) if self._options.dashboard_client else ()
        nodes: tuple[Any, ...] = (*dashboard, StateHelperNode, URScriptNode)
        for kind in nodes:
            node = await in_thread(kind, host, control.robot)
            opening.push_async_callback(in_thread, node.close)
        if self._options.cameras:
            await self._open_cameras(opening, host)
        follows = self._options.initial_controller or trajectory_controller(manager.file.types)
        until = await in_thread(TrajectoryUntilNode, host, follows)
        opening.push_async_callback(in_thread, until.close)
        if model is not None and can_plan():
            from client.ros2.move_group.node import MoveGroupNode

            group = await in_thread(MoveGroupNode, host, control, model, prefix)
            opening.push_async_callback(in_thread, group.close)

    async def _open_cameras(self, opening: AsyncExitStack, host: NodeHost) -> None:
        """Start the camera node. Raises CameraError for cameras that do not exist."""
        options, manager = self._options, self.running.manager
        client = CameraClient(options.robot_ip, options.camera_port)
        opening.callback(client.close)
        cameras = await asyncio.to_thread(client.chosen, options.cameras)
        node = await in_thread(CameraNode, host, client, cameras, options.camera_hz, options.tf_prefix)
        opening.push_async_callback(in_thread, node.close)
        manager.on_cycle.append(lambda: node.set_robot_time(manager.time_s))


def can_plan() -> bool:
    """Whether the extra ``plan`` is installed; logs a warning if not."""
    if importlib.util.find_spec("ompl") is not None:
        return True
    _logger.warning("no move_group, because OMPL is missing: %s", how_to_install("plan"))
    return False
