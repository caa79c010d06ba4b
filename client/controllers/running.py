"""A controller manager that keeps running regardless of the robot's state, and serves all clients.

`ur-client controllers serve` runs it in the foreground, and the ROS 2 driver runs it with nodes. Other processes reach
it through `client.controllers.remote`.
"""

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Final

from client.calibration import model_of
from client.controllers.component import ControllerStopper, HardwareComponent, ProgramKeeper, start_if_ready
from client.controllers.configuration import ControllersFile, trajectory_controller, usual_controllers
from client.controllers.control import RobotControl
from client.controllers.controller import Controller
from client.controllers.manager import ControllerManager
from client.controllers.modes import mode_of
from client.controllers.parameters import with_changes
from client.driver.config import ROBOT_PORTS
from client.errors import ClientError, ConnectionLostError, ControllerError, NoAnswerError, RobotUnreachableError
from client.recording import DEFAULT_FIELDS
from urproto.errors import RobotRefused
from urproto.robots import load_model

_RETRY_S: Final = 1.0  # between attempts to reach the robot; guess
_LOG_INTERVAL_S: Final = 10.0  # interval of log messages while it is unreachable; guess
_CHECK_S: Final = 0.1  # interval of checks for a program that is to be started on the robot
_OUTPUTS: Final = ("payload", "payload_cog", "payload_inertia", "tcp_offset")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ManagerOptions:
    """Options: which robot, and which controllers.

    driver_options: those of `client.driver.DriverConfig`. file: the controllers file; None for the usual controllers.
    controller: the controller that is active at first, in addition to those that move nothing; "" for none, None for
    the file's trajectory controller. headless: the control program is sent to the robot; otherwise the manager waits
    until External Control is played there. ur_type: refuse a robot of another type, for example ur5e; "" for any.
    make_ready: power the arm on and release its brakes; if not headless, also play the program loaded on the robot.
    """

    robot_ip: str
    driver_options: dict[str, Any]
    file: ControllersFile | None = None
    controller: str | None = None
    tf_prefix: str = ""
    headless: bool = True
    make_ready: bool = False
    ur_type: str = ""

    @property
    def initial_controller(self) -> str:
        """The controller that is active at first; "" for none."""
        file = usual_controllers(self.tf_prefix) if self.file is None else self.file
        return trajectory_controller(file.types) if self.controller is None else self.controller

    @property
    def rtde_port(self) -> int:
        return int(self.driver_options.get("robot_ports", ROBOT_PORTS)["rtde"])


@asynccontextmanager
async def reached(options: ManagerOptions) -> AsyncIterator[RobotControl]:
    """Connect to the robot, as soon as it answers. Raises RobotRefused if it refuses, or is of another type."""
    reported_s = -_LOG_INTERVAL_S
    async with AsyncExitStack() as opened:
        while True:
            control = RobotControl(
                options.robot_ip,
                options.file,
                prefix=options.tf_prefix,
                make_ready=options.make_ready,
                start=options.make_ready and options.headless,
                headless=options.headless,
                outputs=DEFAULT_FIELDS,  # a client may record
                outputs_if_any=_OUTPUTS,
                **options.driver_options,
            )
            try:
                await opened.enter_async_context(control)
                break
            except (RobotUnreachableError, ConnectionLostError, NoAnswerError) as error:
                now_s = asyncio.get_running_loop().time()
                if now_s - reported_s >= _LOG_INTERVAL_S:
                    reported_s = now_s
                    _logger.warning("%s; trying again", error)
                await asyncio.sleep(_RETRY_S)
        _check_type(control, options.ur_type)
        yield control


def _check_type(control: RobotControl, wanted: str) -> None:
    """A UR7e reports itself as a UR5e, and a UR12e as a UR10e: with them, either name is accepted, as officially."""
    arm = control.driver.link.configuration
    if not wanted:
        return
    if arm is None:
        _logger.warning("the robot does not report its type: it may be another than %s", wanted)
        return
    model = load_model(wanted)
    if (model.robot_type, model.sub_type) != (arm.robot_type, arm.sub_type):
        found = model_of(arm)
        what = f"a {found.title}" if found else f"an arm of type {arm.robot_type}.{arm.sub_type}"
        advice = "give the type of the arm, or verify_robot_model:=false in a launch file"
        raise RobotRefused("driver", f"it is {what}, not a {model.title}", advice)


class Change(Enum):
    """What happened to a controller."""

    LOADED = auto()
    UNLOADED = auto()
    PARAMETERS = auto()


class RunningManager:
    """The manager of a connected robot, with callbacks for changes of its controllers.

    component: the arm as a hardware component of ros2_control. on_change: awaited with a controller that was loaded,
    unloaded or given parameters, which of these, and the parameters, by names with dots.
    """

    def __init__(self, control: RobotControl, *, headless: bool = True) -> None:
        self.control = control
        arm = control.driver.link.configuration
        model = model_of(arm) if arm else None
        self.component = HardwareComponent(control, model.name if model else "ur", headless=headless)
        self.on_change: list[Callable[[Controller[Any], Change, Mapping[str, Any]], Awaitable[object]]] = []

    @property
    def manager(self) -> ControllerManager:
        """The controller manager, for all operations that need no waiting; use it in the event loop."""
        return self.control.manager

    # operations with callbacks

    async def load(
        self, name: str, type_name: str | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Controller[Any]:
        """Like `ControllerManager.load`. Raises ControllerError."""
        controller: Controller[Any] = self.manager.load(name, type_name, parameters)
        await self._report(controller, Change.LOADED)
        return controller

    async def unload(self, name: str) -> None:
        """Like `ControllerManager.unload`. Raises ControllerError."""
        controller = self.manager.controller(name)
        self.manager.unload(name)
        await self._report(controller, Change.UNLOADED)

    async def set_parameters(self, name: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a controller; on an error, none is changed. Raises ControllerError."""
        controller = self.manager.controller(name)
        controller.reconfigure(with_changes(controller.parameters_type, controller.parameters, values, name))
        await self._report(controller, Change.PARAMETERS, values)

    async def _report(
        self, controller: Controller[Any], change: Change, values: Mapping[str, Any] | None = None
    ) -> None:
        for callback in self.on_change:
            await callback(controller, change, values or {})

    # life cycle

    def load_all(self) -> list[Controller[Any]]:
        """Load and configure all controllers of the file whose types exist here."""
        loaded = []
        for name in self.manager.file.types:
            try:
                controller = self.manager.load(name)
                self.manager.configure(name)
            except ControllerError as error:
                _logger.warning("%s", error)
            else:
                loaded.append(controller)
        return loaded

    @asynccontextmanager
    async def at_work(self, options: ManagerOptions) -> AsyncIterator[None]:
        """Keep controllers active whenever possible, and the control program running if the manager starts it.

        Raises ControllerError if the controller that is to be active does not exist.
        """
        with ControllerStopper(self.control) as stopper:
            self._activate(options, stopper)
            if not options.headless:
                if options.make_ready:
                    await start_if_ready(self.control)  # another program may be played later
                yield
                return
            with ProgramKeeper(self.control):
                await start_if_ready(self.control)
                yield

    def _activate(self, options: ManagerOptions, stopper: ControllerStopper) -> None:
        """Activate controllers that move nothing now, and the one that moves the arm as soon as possible."""
        names, initial = [info.name for info in self.manager.list_controllers()], options.initial_controller
        if initial and initial not in names:
            raise ControllerError(initial, f"the controllers here are {', '.join(names)}")
        for name in names:
            claims = self.manager.controller(name).command_interfaces
            if name == initial:
                stopper.activate_when_possible(name)
            elif not {mode_of(claim, options.tf_prefix) for claim in claims} - {None}:
                try:
                    self.manager.activate(name)
                except ClientError as error:
                    _logger.warning("%s", error)

    def waiting(self, options: ManagerOptions) -> str:
        """What the user has to do until the manager is ready; empty if nothing."""
        if not options.make_ready or self.control.driver.program_running:
            return ""
        return (
            f"waiting for the control program: {options.robot_ip}, {self._summary()}. "
            "Load and play a program with External Control on the robot."
        )

    async def ready(self, options: ManagerOptions) -> str:
        """Say that the manager is ready; with make_ready, first wait until the control program runs."""
        while options.make_ready and not self.control.driver.program_running:
            await asyncio.sleep(_CHECK_S)
        return f"ready: {options.robot_ip}, {self._summary()}. Ctrl-C ends it."

    def _summary(self) -> str:
        infos, active = self.manager.list_controllers(), self.manager.active()
        program = "is running" if self.control.driver.program_running else "is not running yet"
        return f"{len(infos)} controllers, {len(active)} of them active; the control program {program}"
