"""What the driver knows about its robot: state by RTDE, messages and scripts by the primary interface."""

import asyncio
import logging
import socket
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Any, Final, Self

from client.dashboard import DashboardClient
from client.driver.config import DriverConfig
from client.driver.endpoint import tell
from client.errors import ClientError, NoAnswerError, RobotUnreachableError, ScriptFailedError
from client.primary import PrimaryClient
from client.rtde import RTDEClient
from urproto.errors import RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.primary.messages import ErrorCodeMessage, PopupMessage, RuntimeExceptionMessage
from urproto.primary.state import ConfigurationData, KinematicsInfo, RobotStateData
from urproto.versions import PolyscopeVersion

__all__ = ["RobotLink", "cancel"]

_NEEDED: Final = ("timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction")
_SLIDER: Final = ("speed_slider_mask", "speed_slider_fraction")
_KEPT: Final = 100  # error reports and popups, each
_AGAIN_S: Final = 1.0  # between attempts to get a lost connection back

_ROBOT_MODES: Final = frozenset(int(mode) for mode in RobotMode)
_SAFETY_MODES: Final = frozenset(int(mode) for mode in SafetyMode)

_logger = logging.getLogger(__name__)


class RobotLink:
    """The connections a driver opens to its robot; use it with ``async with``.

    state: the newest RTDE state, by variable name. reports, popups: error messages and popups
    of the robot, oldest first. on_state: called with each state. on_silence: called once when the robot falls silent.
    """

    def __init__(self, config: DriverConfig) -> None:
        self.config = config
        self.state: Mapping[str, Any] = {}
        self.reports: deque[ErrorCodeMessage] = deque(maxlen=_KEPT)
        self.popups: deque[PopupMessage] = deque(maxlen=_KEPT)
        self.on_state: list[Callable[[Mapping[str, Any]], None]] = []
        self.on_silence: list[Callable[[], None]] = []
        self.dashboard: DashboardClient | None = None
        self.version = PolyscopeVersion(0, 0)
        self._rtde: RTDEClient | None = None
        self._has_slider = True
        self._primary = PrimaryClient(config.robot, config.robot_ports["primary"])
        self._kinematics: asyncio.Future[KinematicsInfo]
        self._exceptions: asyncio.Queue[ScriptFailedError] = asyncio.Queue()
        self._connections = AsyncExitStack()
        self._news = asyncio.Event()

    async def __aenter__(self) -> Self:
        self._kinematics = asyncio.get_running_loop().create_future()
        async with AsyncExitStack() as opening:
            self._rtde = await self._connect_rtde()
            opening.push_async_callback(self._close_rtde)
            assert self._rtde.core.version is not None
            self.version = self._rtde.core.version
            await opening.enter_async_context(self._primary)
            self.dashboard = await self._connect_dashboard(opening)
            for work in (self._watch_state(), self._watch_messages()):
                opening.push_async_callback(cancel, asyncio.create_task(work))
            self._connections = opening.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._connections.aclose()

    @property
    def own_address(self) -> str:
        """This machine's address as the robot sees it, unless there is address translation in between."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # connecting UDP sends nothing
            probe.connect((self.config.robot, self.config.robot_ports["primary"]))
            return str(probe.getsockname()[0])

    @property
    def robot_mode(self) -> RobotMode:
        """As RTDE says; NO_CONTROLLER for one that is not known here."""
        value = self.state["robot_mode"]
        return RobotMode(value) if value in _ROBOT_MODES else RobotMode.NO_CONTROLLER

    @property
    def safety_mode(self) -> SafetyMode:
        """As RTDE says; UNDEFINED_SAFETY_MODE for one that is not known here."""
        value = self.state["safety_mode"]
        return SafetyMode(value) if value in _SAFETY_MODES else SafetyMode.UNDEFINED_SAFETY_MODE

    @property
    def primary_state(self) -> RobotStateData | None:
        """The newest state of the primary interface, which sends ten a second."""
        return self._primary.core.state

    @property
    def configuration(self) -> ConfigurationData | None:
        """The arm's type and limits, None until they came."""
        return self._primary.core.configuration

    @property
    def calibration(self) -> KinematicsInfo | None:
        """The calibrated Denavit-Hartenberg parameters [m, rad], None until they came."""
        return self._primary.core.kinematics

    async def next_state(self) -> Mapping[str, Any]:
        """The state after the newest one. Raises NoAnswerError from a silent robot."""
        try:
            async with asyncio.timeout(self.config.silence_s):
                await self._news.wait()
        except TimeoutError:
            raise NoAnswerError(self.config.robot, self.config.robot_ports["rtde"], self.config.silence_s) from None
        return self.state

    async def kinematics(self) -> KinematicsInfo:
        """The calibrated Denavit-Hartenberg parameters [m, rad]."""
        return await asyncio.wait_for(asyncio.shield(self._kinematics), self._primary.timeout_s)

    async def send_script(self, text: str) -> None:
        """Hand a script to the primary interface."""
        await self._primary.run(self._primary.core.send_script(text))

    async def script_error(self) -> ScriptFailedError:
        """Wait until the robot reports an error in a script."""
        return await self._exceptions.get()

    def take_script_error(self) -> ScriptFailedError | None:
        """The oldest error in a script that nobody has taken yet; None without any."""
        return None if self._exceptions.empty() else self._exceptions.get_nowait()

    def forget_errors(self) -> None:
        """Drop errors of scripts that were sent before."""
        while not self._exceptions.empty():
            self._exceptions.get_nowait()

    async def set_speed_slider(self, fraction: float) -> None:
        """Move the speed slider to 0 to 1 of the programmed speed."""
        if not self._has_slider or self._rtde is None:
            raise RobotRefused(
                "speed_slider_fraction", "another RTDE client holds the speed slider: end that one first"
            )
        await self._rtde.send(speed_slider_mask=1, speed_slider_fraction=fraction)

    # connections

    async def _connect_rtde(self) -> RTDEClient:
        try:
            return await self._rtde_with([_SLIDER])
        except RobotRefused as refused:
            if "IN_USE" not in refused.answer:
                raise
            _logger.warning("the speed slider cannot be moved: %s", refused)
            self._has_slider = False
            return await self._rtde_with([])

    async def _rtde_with(self, inputs: list[tuple[str, ...]]) -> RTDEClient:
        config = self.config
        outputs = [*_NEEDED, *(name for name in config.outputs if name not in _NEEDED)]
        client = RTDEClient(
            config.robot, outputs, inputs, frequency_hz=config.frequency_hz, port=config.robot_ports["rtde"]
        )
        await client.__aenter__()
        self._take(await client.receive())
        return client

    async def _close_rtde(self) -> None:
        if self._rtde is not None:
            await self._rtde.close()

    async def _connect_dashboard(self, opening: AsyncExitStack) -> DashboardClient | None:
        dashboard = DashboardClient(self.config.robot, self.config.robot_ports["dashboard"])
        try:
            return await opening.enter_async_context(dashboard)
        except RobotUnreachableError:
            if not self.config.headless:  # the URCap's program is played through it
                raise
            _logger.info("no dashboard on this robot; doing without")  # PolyScope X has none
            return None

    # what comes in

    async def _watch_state(self) -> None:
        while True:
            try:
                assert self._rtde is not None
                self._take(await self._rtde.run(self._rtde.core.receive(), self.config.silence_s))
            except (ClientError, RemoteProtocolError) as error:
                _logger.error("the robot's state is lost: %s", error)
                tell(self.on_silence)
                await self._reconnect()

    async def _reconnect(self) -> None:
        await self._close_rtde()
        while True:
            try:
                self._rtde = await self._connect_rtde()
                return
            except (ClientError, RemoteProtocolError, RobotRefused) as error:
                _logger.info("the robot's state is not back yet: %s", error)
                await asyncio.sleep(_AGAIN_S)

    def _take(self, state: Mapping[str, Any]) -> None:
        self.state = state
        tell(self.on_state, state)
        news, self._news = self._news, asyncio.Event()
        news.set()

    async def _watch_messages(self) -> None:
        primary = self._primary
        while True:
            try:
                self._judge(await primary.run(primary.core.next_message(), float("inf")))
            except (ClientError, RemoteProtocolError) as error:
                _logger.error("the robot's messages are lost: %s", error)
                await self._reconnect_primary()

    async def _reconnect_primary(self) -> None:
        await self._primary.close()
        while True:
            await asyncio.sleep(_AGAIN_S)
            client = PrimaryClient(self.config.robot, self.config.robot_ports["primary"])
            try:
                self._primary = await client.__aenter__()
                self._connections.push_async_callback(client.close)
                return
            except ClientError as error:
                _logger.info("the robot's messages are not back yet: %s", error)

    def _judge(self, message: object) -> None:
        if isinstance(message, RobotStateData):
            if message.kinematics is not None and not self._kinematics.done():
                self._kinematics.set_result(message.kinematics)
        elif isinstance(message, RuntimeExceptionMessage):
            self._exceptions.put_nowait(ScriptFailedError(message.line, message.column, message.text))
        elif isinstance(message, ErrorCodeMessage):
            self.reports.append(message)
        elif isinstance(message, PopupMessage):
            self.popups.append(message)


async def cancel(task: "asyncio.Task[None]") -> None:
    """End a task and wait until it has."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
