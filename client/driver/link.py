"""The driver's connections to its robot: states through RTDE, messages and scripts through the primary interface."""

import asyncio
import logging
import socket
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack, suppress
from typing import Any, Final

from client import dashboard
from client.dashboard import DashboardClient
from client.driver.availability import require
from client.driver.config import DriverConfig
from client.driver.endpoint import notify
from client.driver.feed import StateFeed
from client.errors import (
    ClientError,
    ConnectionLostError,
    NoAnswerError,
    RobotUnreachableError,
    ScriptFailedError,
    StaleStateError,
)
from client.primary import PrimaryClient
from client.rtde import BlockingRTDEClient, ReceivedState, RTDEClient
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, mode_of
from urproto.primary.messages import ErrorCodeMessage, PopupMessage, RuntimeExceptionMessage, TextMessage
from urproto.primary.state import RobotStateData
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo
from urproto.versions import PolyscopeVersion

_REQUIRED_OUTPUTS: Final = ("timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction")
_MAX_KEPT: Final = 100  # error reports and popups, each
_RECONNECT_S: Final = 1.0  # between attempts to reconnect, and for those of the dashboard
_ON_ITS_WAY_US: Final = 10_000_000  # longer than a message can be under way (guess)
MOVABLE: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)
"""Safety modes in which the arm may move."""
_LOCKED_S: Final = 5.0  # dashboard manual: a protective stop cannot be unlocked for 5 s after it occurred
_MARGIN_S: Final = 0.2  # guess: the state that showed the stop may have been late
_UNLOCK_LINE: Final = "set unlock protective stop"
_UNLOCK_TIMEOUT_S: Final = 5.0

_logger = logging.getLogger(__name__)


class RobotLink:
    """The connections a driver opens to its robot; use it with ``async with``.

    A thread receives the states (`StateFeed`); they are passed to the event loop only if a listener needs them.
    """

    reports: deque[ErrorCodeMessage]
    """Error messages of the robot, oldest first."""
    popups: deque[PopupMessage]
    """Popups of the robot, oldest first."""
    on_state: list[Callable[[ReceivedState], None]]
    """Called with each state, in order, in the event loop."""
    on_modes: list[Callable[[ReceivedState], None]]
    """Called with each state in which a mode has changed."""
    on_silence: list[Callable[[], None]]
    """Called once when the robot falls silent."""
    on_text: list[Callable[[str], None]]
    """Called with each text that a program sends (textmsg)."""
    dashboard: DashboardClient | None
    """The dashboard; None if the robot has none, like PolyScope X."""
    version: PolyscopeVersion
    """The robot's PolyScope version."""
    feed: StateFeed
    """Receives the states, and passes them to threads."""

    def __init__(self, config: DriverConfig) -> None:
        self.config = config
        self.reports = deque(maxlen=_MAX_KEPT)
        self.popups = deque(maxlen=_MAX_KEPT)
        self.on_state = []
        self.on_modes = []
        self.on_silence = []
        self.on_text = []
        self.dashboard = None
        self.version = PolyscopeVersion(0, 0)
        self.feed = StateFeed(
            self._rtde, self._receive_state, self._on_feed_silence, config.silence_s, config.max_age_s, config.realtime
        )
        self._inputs: RTDEClient | None = None
        self._recipes: list[tuple[str, ...]] = []
        self._write_lock = asyncio.Lock()
        self._primary = PrimaryClient(config.host, config.robot_ports["primary"])
        self._kinematics: asyncio.Future[KinematicsInfo]
        self._exceptions: asyncio.Queue[ScriptFailedError] = asyncio.Queue()
        self._cleared_until_us = -1  # robot time up to which errors are of no interest
        self._connections = AsyncExitStack()
        self._loop: asyncio.AbstractEventLoop
        self._undelivered: deque[ReceivedState] = deque()  # states to be passed to the event loop
        self._reported_modes: tuple[int, ...] = ()  # as seen by the thread
        self._last_modes: tuple[int, ...] = ()  # as seen by the event loop
        self._delivery_scheduled = False  # their delivery to the event loop is scheduled
        self._awaited = False  # a task waits for the next state
        self._changed = asyncio.Event()
        self._stopped_at_s: float | None = None  # since when a protective stop has been in effect

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._kinematics = self._loop.create_future()
        async with AsyncExitStack() as opening:
            opening.push_async_callback(self._close_feed)
            rtde = await self._loop.run_in_executor(None, self.feed.open)
            self._check_outputs(rtde)
            assert rtde.core.version is not None
            self.version = rtde.core.version
            opening.push_async_callback(self._close_inputs)
            await opening.enter_async_context(self._primary)
            self.dashboard = await self._connect_dashboard(opening)
            opening.push_async_callback(cancel, asyncio.create_task(self._watch_messages()))
            self._connections = opening.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._connections.aclose()

    @property
    def state(self) -> ReceivedState:
        """The newest RTDE state, by variable name, whatever its age."""
        return self.feed.state

    @property
    def own_address(self) -> str:
        """This machine's address as the robot sees it, unless the network translates addresses (NAT)."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # connecting UDP sends nothing
            probe.connect((self.config.host, self.config.robot_ports["primary"]))
            return str(probe.getsockname()[0])

    @property
    def robot_mode(self) -> RobotMode:
        """Robot mode as RTDE reports it; ``UNKNOWN(n)`` for an unknown number."""
        return mode_of(RobotMode, self.state["robot_mode"])

    @property
    def safety_mode(self) -> SafetyMode:
        """Safety mode as RTDE reports it; ``UNKNOWN(n)`` for an unknown number."""
        return mode_of(SafetyMode, self.state["safety_mode"])

    @property
    def protective_stopped(self) -> bool:
        """True during a protective stop."""
        return self.safety_mode is SafetyMode.PROTECTIVE_STOP

    def on_safety_mode(self, callback: Callable[[SafetyMode], None]) -> None:
        """Register a callback that is called with each new safety mode."""
        before: list[SafetyMode] = [self.safety_mode]

        def changed(_: Mapping[str, Any]) -> None:
            if self.safety_mode != before[0]:
                before[0] = self.safety_mode
                callback(before[0])

        self.on_modes.append(changed)

    def require(self, feature: str) -> None:
        """Raise RobotRefused if this robot's version lacks a feature of `client.driver.availability`."""
        require(feature, self.version)

    @property
    def primary_state(self) -> RobotStateData | None:
        """The newest state of the primary interface, which sends ten per second."""
        return self._primary.core.state

    @property
    def configuration(self) -> ConfigurationData | None:
        """The arm's type and limits; None until they are received."""
        return self._primary.core.configuration

    @property
    def calibration(self) -> KinematicsInfo | None:
        """The calibrated Denavit-Hartenberg parameters [m, rad]; None until they are received."""
        return self._primary.core.kinematics

    async def state_from_now(self) -> ReceivedState:
        """Wait for a state that the robot takes from now on: one that is still on its way does not count.

        Raises StaleStateError if it takes longer than ``silence_s``, and NoAnswerError if the robot sends none.
        """
        asked_s = self.feed.mark()
        try:
            async with timeout(self.config.silence_s + self.feed.max_age_s):  # after next_state()
                while (state := self.state).taken_after_s < asked_s:
                    await self.next_state()
        except TimeoutError:
            why = self.feed.standstill.describe()
            raise StaleStateError(self.config.host, state.age_s, self.config.max_age_s, why) from None
        return state

    async def fresh_state(self) -> ReceivedState:
        """The newest state, or one from now on if that is too old. Raises StaleStateError if it is too old as well."""
        try:
            return self.feed.fresh()
        except StaleStateError:
            await self.state_from_now()
            return self.feed.fresh()

    async def next_state(self) -> ReceivedState:
        """Wait for the next state. Raises NoAnswerError if the robot sends none."""
        before = self.feed.count
        self._awaited = True
        while self.feed.count == before:
            try:
                async with timeout(self.config.silence_s):
                    await self._changed.wait()
            except TimeoutError:
                if self.feed.silent:
                    where = self.config.host, self.config.robot_ports["rtde"]
                    raise NoAnswerError(*where, self.config.silence_s) from None
            self._awaited = True
        return self.state

    async def kinematics(self) -> KinematicsInfo:
        """Wait for the calibrated Denavit-Hartenberg parameters [m, rad]. Raises NoAnswerError on timeout."""
        primary = self._primary
        try:
            async with timeout(primary.timeout_s):
                return await asyncio.shield(self._kinematics)
        except TimeoutError:
            raise NoAnswerError(primary.host, primary.port, primary.timeout_s, "its calibration") from None

    async def send_script(self, text: str) -> None:
        """Send a script through the primary interface."""
        await self._primary.run(self._primary.core.send_script(text))

    async def unlock_protective_stop(self) -> None:
        """Unlock a protective stop, 5 s after it occurred. Raises RobotRefused if the stop recurs immediately."""
        since = self._stopped_at_s if self._stopped_at_s is not None else self.state["timestamp"]
        while self.state["timestamp"] < since + _LOCKED_S + _MARGIN_S:
            await self.next_state()
            if not self.protective_stopped:  # unlocked on the pendant, or the controller was restarted
                return
            since = min(since, self.state["timestamp"])  # after a restart, its clock begins anew
        if self.dashboard is not None:
            await self.dashboard.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        else:
            await self.send_script(_UNLOCK_LINE)
        try:
            async with timeout(_UNLOCK_TIMEOUT_S):
                while self.safety_mode not in MOVABLE:
                    await self.next_state()
        except TimeoutError:
            mode = self.safety_mode.name
            raise RobotRefused("unlock protective stop", f"it stays in {mode}: remove the cause first") from None

    async def script_error(self) -> ScriptFailedError:
        """Wait until the robot reports an error in a script."""
        return await self._exceptions.get()

    def pop_script_error(self) -> ScriptFailedError | None:
        """Return the oldest script error that has not been fetched yet; None without one."""
        return None if self._exceptions.empty() else self._exceptions.get_nowait()

    async def clear_errors(self) -> None:
        """Discard the errors of scripts that the robot has received so far, also those that are still on their way.

        Messages leave the robot with the next state of the primary interface, up to 0.1 s after their cause.
        """
        await self.next_state()
        self._cleared_until_us = round(self.state["timestamp"] * 1e6)
        while not self._exceptions.empty():
            self._exceptions.get_nowait()

    def _is_cleared(self, message: RuntimeExceptionMessage) -> bool:
        """Whether an error is older than the last `clear_errors`; one that is much older has another clock."""
        return 0 <= self._cleared_until_us - message.timestamp_us < _ON_ITS_WAY_US

    async def write_inputs(self, ahead: int = 0, /, **values: Any) -> None:
        """Write RTDE inputs, through a separate connection that the first call opens; return when the robot has them.

        ahead: so many writes need not have arrived yet: in a stream of them, a later one reports the loss.
        Raises RobotRefused for an input that another client writes, or that this version does not have, and
        NoAnswerError if the robot falls silent: then it may have them or not.
        """
        async with self._write_lock:
            try:
                await self._write(ahead, values)
            except ConnectionLostError:  # the robot may have restarted: try once more
                await self._close_inputs()
                await self._write(ahead, values)

    async def _write(self, ahead: int, values: Mapping[str, Any]) -> None:
        await self._ensure_recipe(tuple(values))
        assert self._inputs is not None
        try:
            await self._inputs.run(self._inputs.core.write_and_confirm(values, ahead), self.config.silence_s)
        except NoAnswerError:
            await self._close_inputs()
            raise

    async def _ensure_recipe(self, names: tuple[str, ...]) -> None:
        """Make sure that these inputs are part of a recipe."""
        known = names in self._recipes or any(set(names) <= set(recipe) for recipe in self._recipes)
        if self._inputs is not None and known:
            return
        if self._inputs is not None:
            await self._inputs.run(self._inputs.core.add_inputs(names))
        else:
            recipes = self._recipes if known else [*self._recipes, names]
            inputs = RTDEClient(self.config.host, (), recipes, port=self.config.robot_ports["rtde"])
            self._inputs = await inputs.__aenter__()
        if not known:
            self._recipes.append(names)

    # connections

    def _rtde(self) -> BlockingRTDEClient:
        config = self.config
        outputs = tuple(dict.fromkeys((*_REQUIRED_OUTPUTS, *config.outputs, *config.outputs_if_any)))
        return BlockingRTDEClient(
            config.host,
            outputs,
            frequency_hz=config.frequency_hz,
            ignore_unavailable=True,
            port=config.robot_ports["rtde"],
        )

    def _check_outputs(self, rtde: BlockingRTDEClient) -> None:
        if missing := [name for name in self.config.outputs if name in rtde.core.unavailable]:
            advice = "this controller's version does not have it: leave it out"
            raise RobotRefused("RTDE recipe", f"{', '.join(missing)}: NOT_FOUND", advice)

    async def _close_feed(self) -> None:
        await self._loop.run_in_executor(None, self.feed.close)

    async def _close_inputs(self) -> None:
        inputs, self._inputs = self._inputs, None
        if inputs is not None:
            await inputs.close()

    async def _connect_dashboard(self, opening: AsyncExitStack) -> DashboardClient | None:
        dashboard = DashboardClient(
            self.config.host,
            self.config.robot_ports["dashboard"],
            robot_api_port=self.config.robot_ports.get("robot api"),
            reconnect_s=_RECONNECT_S,
        )
        try:
            return await opening.enter_async_context(dashboard)
        except RobotUnreachableError:
            if not self.config.headless:  # the URCap's program is played through it
                raise
            _logger.info("this robot has no dashboard: continuing without it")
            return None

    # incoming data; the first two methods run in the feed's thread

    def _receive_state(self, state: ReceivedState) -> None:
        modes = (state["robot_mode"], state["safety_mode"], state["runtime_state"])
        if not (self.on_state or self._awaited or modes != self._reported_modes):
            return
        self._reported_modes = modes
        self._undelivered.append(state)
        if not self._delivery_scheduled:
            self._delivery_scheduled = True
            self._call_in_loop(self._deliver)

    def _on_feed_silence(self) -> None:
        self._call_in_loop(self._deliver_silence)

    def _call_in_loop(self, callback: Callable[[], object]) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(callback)

    def _deliver(self) -> None:
        self._delivery_scheduled = False
        while self._undelivered:
            state = self._undelivered.popleft()
            notify(self.on_state, state)
            modes = (state["robot_mode"], state["safety_mode"], state["runtime_state"])
            if modes != self._last_modes:
                self._last_modes = modes
                self._track_protective_stop(state)
                notify(self.on_modes, state)
        self._wake()

    def _track_protective_stop(self, state: Mapping[str, Any]) -> None:
        if state["safety_mode"] != SafetyMode.PROTECTIVE_STOP:
            self._stopped_at_s = None
        elif self._stopped_at_s is None:
            self._stopped_at_s = state["timestamp"]
            _logger.warning("protective stop")

    def _deliver_silence(self) -> None:
        notify(self.on_silence)
        self._wake()

    def _wake(self) -> None:
        self._awaited = False
        previous, self._changed = self._changed, asyncio.Event()
        previous.set()

    async def _watch_messages(self) -> None:
        while True:
            primary = self._primary  # replaced by each reconnection
            try:
                self._handle_message(await primary.run(primary.core.next_message(), self.config.silence_s))
            except (ClientError, RemoteProtocolError) as error:
                _logger.error("no messages from the robot: %s", self.feed.standstill.describe() or error)
                await self._reconnect_primary()

    async def _reconnect_primary(self) -> None:
        await self._primary.close()
        while True:
            await asyncio.sleep(_RECONNECT_S)
            client = PrimaryClient(self.config.host, self.config.robot_ports["primary"])
            try:
                self._primary = await client.__aenter__()
                self._connections.push_async_callback(client.close)
                return
            except ClientError as error:
                _logger.info("still no messages from the robot: %s", error)

    def _handle_message(self, message: object) -> None:
        if isinstance(message, RobotStateData):
            if message.kinematics is not None and not self._kinematics.done():
                self._kinematics.set_result(message.kinematics)
        elif isinstance(message, RuntimeExceptionMessage) and not self._is_cleared(message):
            self._exceptions.put_nowait(ScriptFailedError(message.line, message.column, message.text))
        elif isinstance(message, ErrorCodeMessage):
            self.reports.append(message)
        elif isinstance(message, PopupMessage):
            self.popups.append(message)
        elif isinstance(message, TextMessage):
            notify(self.on_text, message.text)


async def cancel(task: "asyncio.Task[None]") -> None:
    """Cancel a task and wait until it has ended."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
