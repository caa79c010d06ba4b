"""The arm as a hardware component of ros2_control: its life cycle, and how controllers resume after a stop."""

import asyncio
import logging
from typing import Any, Final

from client.controllers.control import RobotControl
from client.controllers.controller import LifecycleState
from client.driver.link import MOVABLE
from client.errors import ControllerError
from urproto.compat import Self
from urproto.errors import URError
from urproto.modes import RobotMode

PLUGIN: Final = "ur_robot_driver/URPositionHardwareInterface"
"""Plugin name of a UR arm's hardware component in ROS 2."""

_ATTEMPTS: Final = 10
_RETRY_S: Final = 1.0  # between attempts to start the program; guess

_logger = logging.getLogger(__name__)


class HardwareComponent:
    """The arm as a hardware component; methods are called in the event loop.

    name: the component's name in ros2_control.
    """

    def __init__(self, control: RobotControl, name: str, *, headless: bool) -> None:
        self.name = name
        self._state = LifecycleState.ACTIVE
        self._control = control
        self._headless = headless

    @property
    def state(self) -> LifecycleState:
        """The state that was requested last; an active component is inactive while the robot sends nothing."""
        silent = self._state is LifecycleState.ACTIVE and self._control.driver.link.feed.silent
        return LifecycleState.INACTIVE if silent else self._state

    @property
    def available(self) -> bool:
        """Whether its interfaces are available; those of an inactive component are."""
        return self._state is not LifecycleState.UNCONFIGURED

    async def go_to(self, target: LifecycleState) -> None:
        """Change the state. Raises ControllerError.

        While the component is not active, nothing moves the arm, and controllers' requests to the robot are refused.
        Controllers that moved the arm are reactivated with the component; the others stay active, as in ros2_control.
        """
        if target is LifecycleState.FINALIZED:
            raise ControllerError(self.name, "its state is unconfigured, inactive or active: end the driver instead")
        hardware: Any = self._control.manager.hardware
        if target is LifecycleState.ACTIVE:
            hardware.withheld = None
        elif self._state is not target:
            manager = self._control.manager
            hardware.withheld = f"the hardware component {self.name} is {target}: activate it first"
            manager.stop_motion(hardware.withheld)
            manager.switch(deactivate=[one.name for one in manager.modifying()])
        before, self._state = self._state, target
        if target is LifecycleState.UNCONFIGURED:
            await self._control.driver.stop_program()
        elif target is LifecycleState.ACTIVE and before is LifecycleState.UNCONFIGURED and self._headless:
            await start_if_ready(self._control)


async def start_if_ready(control: RobotControl) -> bool:
    """Start the control program if the robot can run it; returns False, and logs the reason, if it did not start."""
    if control.driver.program_running or control.driver.link.robot_mode is not RobotMode.RUNNING:
        return True
    try:
        await control.driver.start_program()
    except URError as error:
        _logger.error("%s", error)
        return False
    return True


class ControllerStopper:
    """Reactivates controllers that ended because the arm could not move, once it can; use it with ``with``.

    It has the role of the official driver's controller stopper.
    """

    def __init__(self, control: RobotControl) -> None:
        self._manager = control.manager
        self._control = control
        self._stopped: list[str] = []

    def __enter__(self) -> Self:
        self._manager.on_stop.append(self._remember)
        self._manager.on_cycle.append(self._check)
        return self

    def __exit__(self, *_: object) -> None:
        self._manager.on_stop.remove(self._remember)
        self._manager.on_cycle.remove(self._check)

    def activate_when_possible(self, name: str) -> None:
        """Activate a controller that moves the arm, now or as soon as possible."""
        self._remember([name])

    def _remember(self, names: list[str]) -> None:
        self._stopped = list(dict.fromkeys((*self._stopped, *names)))

    def _check(self) -> None:
        """Check the state; called after each cycle."""
        if not self._stopped or self._manager.hardware.failure is not None or not self._control.driver.program_running:
            return
        names, self._stopped = self._stopped, []
        inactive = {info.name for info in self._manager.list_controllers() if info.state is LifecycleState.INACTIVE}
        for name in names:
            if name in inactive:
                self._activate(name)

    def _activate(self, name: str) -> None:
        try:
            self._manager.switch(activate=[name])
            _logger.info("%s is active again", name)
        except ControllerError as error:
            _logger.warning("%s stays inactive: %s", name, error)


class ProgramKeeper:
    """Restarts the control program on a robot that was silent and has reconnected; use it with ``with``.

    It starts the program in the same way as at the first connection. A program that was stopped on purpose stays
    stopped, as with the official driver: resend_robot_program starts it.
    """

    def __init__(self, control: RobotControl) -> None:
        self._control = control
        self._was_silent = False
        self._starting: asyncio.Task[None] | None = None

    def __enter__(self) -> Self:
        self._control.driver.link.on_silence.append(self._remember)
        self._control.manager.on_cycle.append(self._check)
        return self

    def __exit__(self, *_: object) -> None:
        self._control.driver.link.on_silence.remove(self._remember)
        self._control.manager.on_cycle.remove(self._check)
        if self._starting is not None:
            self._starting.cancel()

    def _remember(self) -> None:
        self._was_silent = True

    def _check(self) -> None:
        """Check the state; called after each cycle."""
        link = self._control.driver.link
        if self._was_silent and link.robot_mode is RobotMode.RUNNING and link.safety_mode in MOVABLE:
            self._was_silent = False
            self._starting = asyncio.get_running_loop().create_task(self._start())

    async def _start(self) -> None:
        for _ in range(_ATTEMPTS):  # a robot's connections do not all return at the same time
            if await start_if_ready(self._control):
                return
            await asyncio.sleep(_RETRY_S)
