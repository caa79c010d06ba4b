"""The ROS 2 driver: a robot with its controllers, as the nodes of the official driver.

Controllers run in the event loop with each state of the robot; nodes have threads of their own (`client.ros2.host`).
"""

import asyncio
import logging
import re
from contextlib import AsyncExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final

from client.calibration import calibration_of, described
from client.controllers.broadcasters import JointStateBroadcaster
from client.controllers.configuration import ControllersFile
from client.controllers.modes import mode_of
from client.controllers.robot import ControlledRobot
from client.errors import (
    ClientError,
    ConnectionLostError,
    ControllerError,
    NoAnswerError,
    RobotUnreachableError,
    Ros2Error,
)
from client.ros2.controller_manager import ControllerManagerNode
from client.ros2.controller_nodes import ControllerNodes
from client.ros2.dashboard import DashboardNode
from client.ros2.hardware import ControllerStopper, HardwareComponent, ProgramKeeper, start_if_ready
from client.ros2.host import NodeHost
from client.ros2.publishing import Outbox
from client.ros2.state_helper import StateHelperNode
from client.ros2.state_publisher import RobotStatePublisher
from client.ros2.topics import Scene
from client.ros2.urscript_interface import URScriptNode

_AGAIN_S: Final = 1.0  # between tries to reach the robot; guess
_SAID_S: Final = 10.0  # how often it is said that it is still out of reach; guess
_PREFIX: Final = re.compile(r"|[A-Za-z_][A-Za-z0-9_]*")
_OUTPUTS: Final = ("payload", "payload_cog", "payload_inertia", "tcp_offset")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriverOptions:
    """What `ur_control.launch.py` takes, by the names of this project.

    controller: the one that is active at first, beside those that move nothing; "" for none. namespace: of all nodes.
    robot: options of `client.driver.DriverConfig`.
    """

    robot_ip: str
    robot: dict[str, Any]
    file: ControllersFile | None = None
    controller: str = "scaled_joint_trajectory_controller"
    tf_prefix: str = ""
    namespace: str = ""
    domain: int | None = None
    headless: bool = True
    make_ready: bool = False
    ros_arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises Ros2Error."""
        if not _PREFIX.fullmatch(self.tf_prefix):
            raise Ros2Error(f"{self.tf_prefix!r} is not a prefix of names: use letters, digits and _, as in left_")


class Ros2Driver:
    """The nodes of one robot; use it with ``async with``, which waits until the robot can be reached."""

    def __init__(self, options: DriverOptions) -> None:
        self._options = options
        self._opened = AsyncExitStack()
        self.robot: ControlledRobot

    async def __aenter__(self) -> "Ros2Driver":
        async with AsyncExitStack() as opening:
            options = self._options
            self.robot = await self._reach(opening)
            host = await opening.enter_async_context(
                NodeHost(domain=options.domain, namespace=options.namespace, ros_arguments=options.ros_arguments)
            )
            await self._open_nodes(opening, host)
            self._opened = opening.pop_all()
        return self

    def summary(self) -> str:
        """What there is, in some words."""
        names = [info.name for info in self.robot.manager.list_controllers()]
        active = [one.name for one in self.robot.manager.active()]
        program = "runs" if self.robot.driver.program_running else "does not run yet"
        return f"{len(names)} controllers, {len(active)} of them active; the control program {program}"

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._opened.aclose()

    async def _reach(self, opening: AsyncExitStack) -> ControlledRobot:
        """The robot, as soon as it answers; what it refuses is raised."""
        options, said_s = self._options, -_SAID_S
        while True:
            robot = ControlledRobot(
                options.robot_ip,
                options.file,
                prefix=options.tf_prefix,
                make_ready=options.make_ready,
                start=False,
                headless=options.headless,
                outputs_if_any=_OUTPUTS,
                **options.robot,
            )
            try:
                return await opening.enter_async_context(robot)
            except (RobotUnreachableError, ConnectionLostError, NoAnswerError) as error:
                now_s = asyncio.get_running_loop().time()
                if now_s - said_s >= _SAID_S:
                    said_s = now_s
                    _logger.warning("%s; it is tried again", error)
                await asyncio.sleep(_AGAIN_S)

    async def _open_nodes(self, opening: AsyncExitStack, host: NodeHost) -> None:
        robot, prefix = self.robot, self._options.tf_prefix
        manager = robot.manager
        scene = Scene(prefix, robot.driver.version, manager.hardware.states)
        outbox = Outbox(host, scene)
        opening.callback(outbox.close)
        manager.on_cycle.append(lambda: setattr(outbox, "time_s", manager.time_s))
        arm = robot.driver.robot.configuration
        model = described(arm, calibration_of(await robot.driver.robot.kinematics())) if arm else None
        hardware = HardwareComponent(robot, model.name if model else "ur", headless=self._options.headless)
        controllers = ControllerNodes(host, robot, outbox)
        opening.push_async_callback(asyncio.to_thread, controllers.close_all)
        loaded = self._load()
        for controller in loaded:
            await asyncio.to_thread(controllers.open, controller)
        broadcasters = [one for one in loaded if isinstance(one, JointStateBroadcaster)]
        if model is None:
            _logger.warning("the arm is not a model that is known here: no robot_description, and no frames on /tf")
        elif broadcasters:
            states = await asyncio.to_thread(RobotStatePublisher, host, outbox, model, broadcasters[0], prefix)
            opening.push_async_callback(asyncio.to_thread, states.close)
        await asyncio.to_thread(ControllerManagerNode, host, robot, controllers, hardware)
        beside: tuple[Any, ...] = (DashboardNode, StateHelperNode, URScriptNode)
        for kind in beside:
            node = await asyncio.to_thread(kind, host, robot.robot)
            opening.push_async_callback(asyncio.to_thread, node.close)
        stopper = ControllerStopper(robot)
        opening.callback(stopper.close)
        self._activate(loaded, stopper)
        if self._options.headless:
            opening.callback(ProgramKeeper(robot).close)
            await start_if_ready(robot)

    def _load(self) -> list[Any]:
        """All controllers of the file that there are here, configured."""
        manager, loaded = self.robot.manager, []
        for name in manager.file.types:
            try:
                controller = manager.load(name)
                manager.configure(name)
            except ControllerError as error:
                _logger.warning("%s", error)
            else:
                loaded.append(controller)
        return loaded

    def _activate(self, loaded: list[Any], stopper: ControllerStopper) -> None:
        """What moves nothing at once, what shall move the arm as soon as it can."""
        for controller in loaded:
            modes = {mode_of(name, self._options.tf_prefix) for name in controller.command_interfaces} - {None}
            if controller.name == self._options.controller:
                stopper.activate_when_possible(controller.name)
            elif not modes:
                try:
                    self.robot.manager.activate(controller.name)
                except ClientError as error:
                    _logger.warning("%s", error)
        names = [controller.name for controller in loaded]
        if self._options.controller and self._options.controller not in names:
            raise ControllerError(self._options.controller, f"the controllers here are {', '.join(names)}")
