"""Life cycle of the control program: start, supervision, keep-alive, end, restart."""

import asyncio
import logging
import secrets
import time
from contextlib import AsyncExitStack, suppress
from typing import Final

from client import dashboard
from client.driver.config import DriverConfig
from client.driver.control_program import LATE_TEXT, ControlProgram
from client.driver.endpoint import Endpoint, Peer
from client.driver.keep_alive import KeepAliveThread
from client.driver.link import MOVABLE, RobotLink, cancel
from client.driver.results import ScriptCommandEndpoint, TrajectoryEndpoint
from client.driver.reverse import ReverseEndpoint
from client.driver.script_sender import ScriptSender
from client.errors import ClientError, NoAnswerError, ProgramEndedError, ProgramNotRunningError, ProgramStaysError
from client.rtde import ReceivedState
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import RobotRefused, URError
from urproto.external_control import SCALE, ControlMode, Query
from urproto.modes import RobotMode, RuntimeState

_PLAYED: Final = (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.PAUSED, RuntimeState.RESUMING)
_ENDED: Final = (RuntimeState.STOPPING, RuntimeState.STOPPED)
_STOP_LINE: Final = "stop program"
_END_TIMEOUT_S: Final = 2.0  # guess: a ramp to rest from full speed takes 0.8 s

_KEEP_ALIVE_S: Final = 0.1
_SETTLE_S: Final = 0.5  # guess: connections of one program are accepted within this
_CLOSING_S: Final = 0.1  # guess: the ends of all connections of one program arrive within this
_TOKEN_DELAY_S: Final = 0.2  # guess: a connection that is silent for this long is not this driver's program
_LAST_RESULT_S: Final = 1.0  # guess: results that a program sent before its end have arrived within this
_RESULT_CHECK_S: Final = 2.0  # guess: rare enough to cost nothing; a lost result is noticed at the second check
_LINGER_S: Final = 2.0  # guess: a disconnected program has ended within this, by the robot's state too

_logger = logging.getLogger(__name__)


class ProgramSupervisor:
    """Owns the ports that the control program connects to; starts, supervises, ends and restarts the program.

    Use it with ``async with``, inside the context of the `RobotLink` that reports the robot's state.
    """

    reverse: ReverseEndpoint
    """Sends setpoints and modes; while a robot is connected here, its program is running."""
    sender: ScriptSender
    """Sends the program to the URCap on request."""
    trajectory: TrajectoryEndpoint
    """Sends the points of trajectories."""
    commands: ScriptCommandEndpoint
    """Sends commands and queries, during any motion."""
    keep_alive: KeepAliveThread
    """Keeps the program alive from a dedicated thread."""
    losses: int
    """Number of programs that ended because of this machine."""

    def __init__(self, config: DriverConfig, link: RobotLink) -> None:
        self.reverse = ReverseEndpoint(config.reverse_port)
        self.sender = ScriptSender(self.text, config.sender_port)
        self.trajectory = TrajectoryEndpoint(config.trajectory_port)
        self.commands = ScriptCommandEndpoint(config.command_port)
        self.keep_alive = KeepAliveThread(
            self.reverse,
            config.keep_alive_s,
            config.keep_alive_timeout_s,
            config.realtime,
            config.hang_s,
            link.feed.standstill,
        )
        self._config = config
        self._link = link
        self._own_address = ""
        self._has_played = False  # the robot's state has shown it running
        self._has_stopped = False  # and ended after that, although its connection may not have ended
        self._connected_s = 0.0  # when the last program connected, by the monotonic clock
        self._number = 0  # of the program that was started last
        self.losses = 0
        self._loss_reason = ""  # why the last of them ended
        self._losses_before = 0  # losses before the current or last program connected
        self._restart: asyncio.Task[None] | None = None
        self._start_stop_lock = asyncio.Lock()  # held while a program is being started or stopped
        self._partners: dict[Endpoint, Peer | None] = {}
        self._token = secrets.token_hex(8)  # protects against accidental connections, not against eavesdroppers
        self._starting = False  # this driver's program is being started; it will send the token
        self._seen_ended = True  # the robot's state has shown the end of the last connected program
        self._disconnected_s = 0.0  # when that program disconnected, by the event loop's clock
        self._played_since_s: float | None = None  # since when any program has been playing, by the robot's clock
        self._open = AsyncExitStack()
        self.reverse.listeners.append(self._program_changed)
        for partner in (self.trajectory, self.commands):
            partner.listeners.append(self._partner_changed)

    async def __aenter__(self) -> Self:
        """Open the ports; the program is not started yet. Raises OSError for a port that is in use."""
        async with AsyncExitStack() as opening:
            self._own_address = self._config.own_address or self._link.own_address
            self.reverse.period_s = self._link.version.series.period_s
            for endpoint in self._endpoints:
                endpoint.token = self._token
                endpoint.host = self._own_address if self._config.listen_on is None else self._config.listen_on
                await opening.enter_async_context(endpoint)
            self._link.on_silence.append(self._on_silence)
            self._link.on_text.append(self._on_text)
            self._link.on_modes.append(self._track_end)
            self._track_end(self._link.state)
            opening.enter_context(self.keep_alive)
            for watch in (self._report_alive, self._watch_results):
                opening.push_async_callback(cancel, asyncio.create_task(watch()))
            self._open = opening.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """End the program, which stops the arm, and close the ports."""
        self._link.on_text.remove(self._on_text)  # a program that is lost from now on is not restarted
        try:
            with suppress(ProgramStaysError):
                await self.stop()
        finally:
            await self._open.aclose()

    @property
    def _endpoints(self) -> tuple[Endpoint, ...]:
        return self.reverse, self.sender, self.trajectory, self.commands

    @property
    def running(self) -> bool:
        """True while the control program is connected, and has not ended or been stopped."""
        return self.reverse.connected and self.reverse.mode is not ControlMode.STOPPED and not self._has_ended

    @property
    def _has_ended(self) -> bool:
        """Whether the program has ended by the robot's state, which may show it before the connection does."""
        state = self._link.state["runtime_state"]
        if not self._has_played and state in _PLAYED:
            self._has_played = True
        return self._has_stopped or (self._has_played and state in _ENDED)

    @property
    def loss_reason(self) -> str:
        """Why the last control program ended, if this machine was the cause; otherwise empty.

        The text is kept while the replacement program runs, because a task that waits for a motion may ask only then.
        """
        lost = self.running or self.losses > self._losses_before
        return (self._loss_reason if lost else "") or self.keep_alive.stop_reason

    def control_program(self) -> ControlProgram:
        """The program with this driver's address, ports and token."""
        config = self._config
        return ControlProgram(
            host=self._own_address,
            reverse_port=self.reverse.port,
            trajectory_port=self.trajectory.port,
            command_port=self.commands.port,
            servoj_lookahead_s=config.servoj_lookahead_s,
            servoj_gain=config.servoj_gain,
            tool_voltage=config.tool_voltage,
            tool_communication=config.tool_communication,
            token=self._token,
            number=self._number,
        )

    def text(self) -> str:
        """The program in the form that the URCap receives."""
        return self.control_program().render(self._link.version)

    async def start(self) -> None:
        """Start or restart the program, and wait until it is connected; see `URDriver.start_program`."""
        was_running = self.running
        await self._cancel_restart()
        async with self._start_stop_lock:
            if self.running and not was_running:
                return  # another task has started it meanwhile
            await self._start()
            self._loss_reason = ""

    async def _start(self) -> None:
        self._check_modes()
        await self._end_old_program()
        self.keep_alive.stop_reason = ""
        self.keep_alive.report_alive()
        await self._link.clear_errors()
        self._starting = self._config.headless
        try:
            if self._config.headless:
                # A paused program takes the new one's place and only ends (issue 123 of the official client library).
                await self._link.send_script(_STOP_LINE)
                self._number += 1
                await self._link.send_script(self.control_program().render_headless(self._link.version))
            else:
                await self._play()
            await self._wait_for_program()
        finally:
            self._starting = False

    async def stop(self) -> None:
        """End the program, which stops the arm; does nothing if it is not running."""
        await self._cancel_restart()
        async with self._start_stop_lock:
            if self.reverse.connected:
                self.reverse.stop()
                await self._wait_until_left()

    async def wait_until_read(self) -> int:
        """Wait until the program has read all messages; return how many setpoints it ignored, because one was late.

        A message that is lost together with its connection leaves no other trace until the program misses the next one.
        Raises ProgramEndedError if the program ends or is lost before, and NoAnswerError while it cannot answer because
        it is paused or the robot is stopped. The vendor's program does not answer: it counts as having read them.
        """
        peer, sent, losses = self.reverse.peer, self.reverse.sent, self.losses
        while peer.authenticated:
            try:
                read, ignored = (round(value * SCALE) for value in await self.commands.query(Query.MESSAGES))
            except NoAnswerError:
                if self._link.state["runtime_state"] != RuntimeState.PLAYING or self._link.safety_mode not in MOVABLE:
                    raise
                self.commands.peer.abort()  # the connection is lost, although the system has not noticed it yet
                raise ProgramEndedError(self.commands.port, "a query") from None
            if read >= sent:
                return ignored
            await self._link.next_state()
            if peer is not self.reverse.current_peer or self.losses > losses:
                raise ProgramEndedError(self.reverse.port, "a message")
        return 0

    # starting

    def _check_modes(self) -> None:
        if self._link.safety_mode not in MOVABLE:
            raise RobotRefused(
                "start of the control program",
                f"its safety mode is {self._link.safety_mode.name}: clear the cause, then unlock "
                "(dashboard: unlock protective stop) or restart the safety system",
            )
        if self._link.robot_mode is not RobotMode.RUNNING:
            raise RobotRefused(
                "start of the control program",
                f"its mode is {self._link.robot_mode.name}: power it on and release the brakes",
            )

    async def _end_old_program(self) -> None:
        if self.reverse.connected:
            await self._link.send_script(_STOP_LINE)
            await self._wait_until_left()

    async def _wait_until_left(self) -> None:
        """Wait until the program has disconnected. Raises ProgramStaysError.

        The end of its connection may be lost: a program that has ended by the robot's state has left, too.
        """
        try:
            await self.reverse.wait_disconnected(_END_TIMEOUT_S)
        except ProgramStaysError:
            if not self._has_stopped and self._link.state["runtime_state"] not in _ENDED:
                raise
            self.reverse.peer.abort()
            await self.reverse.wait_disconnected(_END_TIMEOUT_S)

    async def _play(self) -> None:
        board = self._link.dashboard
        assert board is not None
        if self._config.program is not None:
            await board.request(dashboard.load(self._config.program))
        elif await board.request(dashboard.LOADED_PROGRAM) is None:
            raise RobotRefused(
                "start of the control program",
                "no program is loaded on the robot",
                "load one with an External Control node and play it",
            )
        await board.request(dashboard.PLAY)

    async def _wait_for_program(self) -> None:
        connected = asyncio.create_task(self.reverse.wait_connected(self._config.start_timeout_s))
        failed = asyncio.create_task(self._link.script_error())
        try:
            await asyncio.wait((connected, failed), return_when=asyncio.FIRST_COMPLETED)
            if failed.done():
                raise failed.result()
            await connected
        except ProgramNotRunningError:
            raise ProgramNotRunningError(self.reverse.port, await self._connection_hint()) from None
        finally:
            for task in (connected, failed):
                task.cancel()
            await asyncio.gather(connected, failed, return_exceptions=True)

    async def _connection_hint(self) -> str:
        where = f"{self._own_address}, ports {', '.join(str(endpoint.port) for endpoint in self._endpoints)}"
        remote = "the robot must be in remote control"
        if not self._config.headless and not self.sender.requests:
            return f"the URCap did not request it; check that it is set to {where} (program: {self.sender.port})"
        return f"it was sent to the robot, which must be able to reach {where}; e-Series: {remote}"

    # supervision

    def _program_changed(self, connected: bool) -> None:
        self._has_played = self._has_stopped = False
        if connected:
            self._connected_s = time.monotonic()
            self._losses_before = self.losses
            self._seen_ended = False
            self._partners = {end: end.current_peer for end in (self.trajectory, self.commands)}
            self.reverse.keep_alive(self._config.keep_alive_timeout_s)
            asyncio.get_running_loop().call_later(_SETTLE_S, self._expect_partners, self.reverse.current_peer)
            return
        self._disconnected_s = asyncio.get_running_loop().time()
        partners, self._partners = self._partners, {}
        for peer in partners.values():  # only this program's: a new one may have connected already
            if peer is not None:
                peer.abort()

    def _partner_changed(self, connected: bool) -> None:
        """End a program that has lost one of its connections."""
        for endpoint, peer in tuple(self._partners.items()):
            if peer is None:
                self._partners[endpoint] = endpoint.current_peer  # accepted after the reverse connection
            elif not connected and peer is not endpoint.current_peer:
                call_later = asyncio.get_running_loop().call_later
                call_later(_CLOSING_S, self._end_incomplete, endpoint, self.reverse.current_peer)
                return

    def _expect_partners(self, reverse: Peer | None) -> None:
        """End a program that is connected to the reverse port only, because its other connections were lost."""
        for endpoint, peer in self._partners.items():
            if peer is None:
                self._end_incomplete(endpoint, reverse)
                return

    def _end_incomplete(self, endpoint: Endpoint, reverse: Peer | None) -> None:
        """Stop the program of this reverse connection, unless it has ended, or is about to."""
        if reverse is None or reverse is not self.reverse.current_peer or not self.running:
            return
        _logger.error("the robot is not connected to port %d: its program is stopped", endpoint.port)
        self.losses += 1
        self._loss_reason = f"its connection to port {endpoint.port} of this machine was lost"
        self.reverse.stop()
        asyncio.get_running_loop().call_later(_END_TIMEOUT_S, reverse.abort)  # in case it does not stop

    async def _watch_results(self) -> None:
        """Notice a result that was lost: the system, which repeats unanswered points, takes a quarter of an hour."""
        suspected = 0  # the trajectory that the program has finished, without its result
        while True:
            await asyncio.sleep(_RESULT_CHECK_S)
            peer, awaited = self.trajectory.current_peer, self.trajectory.awaited
            if peer is None or not peer.authenticated or not awaited:
                continue
            try:
                _, executing = await self.commands.query(Query.PROGRESS)
            except ClientError:  # it is paused, or has ended
                continue
            if executing or awaited != self.trajectory.awaited:
                suspected = 0
            elif awaited == suspected:
                peer.abort()
            else:
                suspected = awaited

    def _track_end(self, state: ReceivedState) -> None:
        if state["runtime_state"] in _ENDED:
            has_played, is_newer = self._played_since_s is not None, state.taken_after_s >= self._connected_s
            self._has_stopped = self._has_stopped or (self.reverse.connected and has_played and is_newer)
            self._seen_ended, self._played_since_s = True, None
        elif self._played_since_s is None:
            self._played_since_s = state["timestamp"]

    def _admit_foreign_program(self) -> None:
        """Admit a control program that is not this driver's and sends no token, such as the vendor's.

        Three silent connections from one address are taken for such a program while the robot's state shows that a
        program is running which is not the one that was connected last.
        """
        disconnected = not self.reverse.connected
        if self._starting or self._played_since_s is None or not (disconnected or self._seen_ended):
            return
        if self._link.state["timestamp"] - self._played_since_s < _TOKEN_DELAY_S:
            return  # this driver's program has not had time to send its token yet, by the robot's clock
        now_s = asyncio.get_running_loop().time()
        if (disconnected and not self._seen_ended and now_s - self._disconnected_s < _LINGER_S) or (
            not disconnected and self.reverse.peer.authenticated
        ):
            return
        endpoints = (self.trajectory, self.commands, self.reverse)
        for address in {peer.address for peer in self.reverse.waiting if now_s - peer.accepted_s > _TOKEN_DELAY_S}:
            newest = [[peer for peer in end.waiting if peer.address == address][-1:] for end in endpoints]
            if all(newest):
                _logger.warning("a control program that is not this driver's connected from %s", address)
                for end, (peer,) in zip(endpoints, newest, strict=True):
                    end.admit(peer)
                return

    def _drop_ended_program(self) -> None:
        """Disconnect a program that had ended before its connection was accepted, because the event loop hung.

        The end of such a connection may be lost; the robot's states never show its program running.
        """
        state = self._link.state
        if state.taken_after_s < self._connected_s + _SETTLE_S or state["runtime_state"] not in _ENDED:
            return
        if self.reverse.connected and not self._has_ended and not self._has_played:
            self.reverse.peer.abort()

    async def _report_alive(self) -> None:
        while True:
            self.keep_alive.report_alive()
            self._admit_foreign_program()
            self._drop_ended_program()
            await asyncio.sleep(_KEEP_ALIVE_S)

    # late setpoints and lost programs

    def _on_text(self, text: str) -> None:
        """Handle the control program's messages about its driver."""
        if text.startswith(LATE_TEXT) and (number := text.removeprefix(LATE_TEXT)).isdecimal():
            why = self._link.feed.standstill.describe()
            self.reverse.report_late(
                int(number), f"the robot waited too long for the next setpoint{why and f' ({why})'}"
            )
        elif (
            text == self.control_program().gone_text
            and not self.keep_alive.stop_reason
            and not self._start_stop_lock.locked()
        ):
            # While a program is being started or stopped, this text comes from the previous program. Restarting then
            # would end the program that the caller has just started.
            if (peer := self.reverse.current_peer) is not None:  # the end of its connections may have been lost
                asyncio.get_running_loop().call_later(_LAST_RESULT_S, peer.abort)
            self.losses += 1
            why = self._link.feed.standstill.describe() or (
                f"{self.reverse.silence_s:.1f} s by this machine's clock, or the network failed"
            )
            self._loss_reason = f"the robot received nothing from this machine for too long ({why})"
            _logger.warning("the control program has ended: %s", self._loss_reason)
            if self._config.restart and self._config.headless and self._restart is None:
                self._restart = asyncio.create_task(self._restart_program())

    async def _restart_program(self) -> None:
        """Restart a program that ended because of this machine. The arm rests until the next motion."""
        try:
            await self.reverse.wait_disconnected(_END_TIMEOUT_S)
            async with timeout(_END_TIMEOUT_S):
                while self._link.state["runtime_state"] != RuntimeState.STOPPED:
                    await self._link.next_state()
            self._restart = None  # from here on it is no longer cancelled, but waited for
            async with self._start_stop_lock:
                await self._start()
            _logger.warning("the control program has been restarted; the arm rests until it is moved")
        except (URError, TimeoutError) as error:
            _logger.error("the control program could not be restarted: %s", error)
        finally:
            self._restart = None

    async def _cancel_restart(self) -> None:
        restart, self._restart = self._restart, None
        if restart is not None and restart is not asyncio.current_task():
            await cancel(restart)

    def _on_silence(self) -> None:
        peer = self.reverse.current_peer
        if peer is not None:
            _logger.error("the robot sends nothing: its program is disconnected")
            peer.abort()
