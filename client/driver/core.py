"""The life of the control program: started, watched, kept alive, ended, started again."""

import asyncio
import logging
import secrets
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from types import TracebackType
from typing import Any, Final, Self

from client import dashboard
from client.availability import require
from client.control_program import GONE_TEXT, LATE_TEXT, ControlProgram
from client.driver.config import DriverConfig, calibration_problem
from client.driver.endpoint import LONGEST_REAL_TIME_S, Endpoint, Peer, Pulse, ReverseEndpoint, ScriptSender
from client.driver.results import ScriptCommandEndpoint, TrajectoryEndpoint
from client.driver.robot import RobotLink, cancel
from client.errors import ClientError, ProgramNotRunningError, ProgramStaysError
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import ControlMode, FreedriveAction
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.versions import PolyscopeVersion

_PLAYED: Final = (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.PAUSED, RuntimeState.RESUMING)
_ENDED: Final = (RuntimeState.STOPPING, RuntimeState.STOPPED)
MOVABLE: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_STOP_LINE: Final = "stop program"
_END_TIMEOUT_S: Final = 2.0  # guess: a ramp to rest from full speed takes 0.8 s

_BREATH_S: Final = 0.1
_SETTLE_S: Final = 0.5  # guess: connections of one program are accepted within this
_GREETING_S: Final = 0.2  # guess: who has said nothing for so long is no program of ours
_LINGER_S: Final = 2.0  # guess: a program that was disconnected has ended, by the robot's state too

_logger = logging.getLogger(__name__)


class DriverCore:
    """The four ports, the robot's own interfaces, and the program between them.

    robot: what the robot says about itself. reverse, sender, trajectory, commands: the ports.
    """

    def __init__(self, config: DriverConfig) -> None:
        self.config = config
        self.robot = RobotLink(config)
        self.reverse = ReverseEndpoint(config.reverse_port)
        self.sender = ScriptSender(self.program_text, config.sender_port)
        self.trajectory = TrajectoryEndpoint(config.trajectory_port)
        self.commands = ScriptCommandEndpoint(config.command_port)
        self.pulse = Pulse(
            self.reverse, config.keep_alive_s, config.keep_alive_timeout_s, config.realtime, config.hang_s
        )
        self._own_address = ""
        self._has_played = False  # the robot's state shows that the program runs
        self.losses = 0  # programs that have ended through this machine's fault
        self._lost_why = ""  # how the last of them did
        self._losses_before = 0  # the program that is here now, or was last
        self._restart: asyncio.Task[None] | None = None
        self._one_at_a_time = asyncio.Lock()  # a program is started or stopped, by the caller or after a loss
        self._partners: dict[Endpoint, Peer | None] = {}
        self._token = secrets.token_hex(8)  # not against who listens in: against who connects by accident
        self._starting = False  # a program of ours, which will greet
        self._seen_ended = True  # the robot's state has shown the end of the last program that was here, and
        self._left_s = 0.0  # when it left, by the loop's clock
        self._played_since_s: float | None = None  # a program, whose ever, by the robot's clock
        self._open = AsyncExitStack()

    async def __aenter__(self) -> Self:
        """Connect, open the ports and check the calibration; the program is not started yet.

        Raises the errors of client.errors, RobotRefused for a wrong calibration, OSError for a
        port that is taken.
        """
        async with AsyncExitStack() as opening:
            await opening.enter_async_context(self.robot)
            self._own_address = self.config.own_address or self.robot.own_address
            self.reverse.period_s = self.version.series.period_s
            for endpoint in self._endpoints:
                endpoint.token = self._token
                endpoint.host = self._own_address if self.config.listen_on is None else self.config.listen_on
                await opening.enter_async_context(endpoint)
            await self._check_calibration()
            self.reverse.listeners.append(self._program_changed)
            for partner in (self.trajectory, self.commands):
                partner.listeners.append(self._partner_changed)
            self.robot.on_silence.append(self._robot_is_silent)
            self.robot.on_text.append(self._heard)
            self.robot.on_modes.append(self._look_for_end)
            self._look_for_end(self.state)
            opening.enter_context(self.pulse)
            opening.push_async_callback(cancel, asyncio.create_task(self._breathe()))
            self._open = opening.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the program, which stops the arm, and close everything."""
        try:
            with suppress(ProgramStaysError):
                await self.stop_program()
        finally:
            await self._open.aclose()

    @property
    def _endpoints(self) -> tuple[Endpoint, ...]:
        return self.reverse, self.sender, self.trajectory, self.commands

    @property
    def version(self) -> PolyscopeVersion:
        """The robot's PolyScope version."""
        return self.robot.version

    @property
    def state(self) -> Mapping[str, Any]:
        """The newest RTDE state, by variable name."""
        return self.robot.state

    @property
    def program_running(self) -> bool:
        """True while the control program is connected, and has not ended or been told to end."""
        return self.reverse.connected and self.reverse.mode is not ControlMode.STOPPED and not self._has_ended

    @property
    def _has_ended(self) -> bool:
        """By the robot's state, which may know it before its connection does."""
        state = self.state["runtime_state"]
        if not self._has_played and state in _PLAYED:
            self._has_played = True
        return self._has_played and state in _ENDED

    @property
    def lost_why(self) -> str:
        """Why the last control program that ended has ended, when that was this machine's doing; else empty.

        It stays while the program that replaced it runs: who waits for the end of a motion may ask only then.
        """
        lost = self.program_running or self.losses > self._losses_before
        return (self._lost_why if lost else "") or self.pulse.bitten

    def program_text(self) -> str:
        """The control program as the URCap gets it."""
        return self._program().render(self.version)

    def on_program_state(self, callback: Callable[[bool], None]) -> None:
        """Call back with True and False as the control program connects and leaves."""
        self.reverse.listeners.append(callback)

    async def next_state(self) -> Mapping[str, Any]:
        """The RTDE state after the newest one."""
        return await self.robot.next_state()

    async def set_speed_slider(self, fraction: float) -> None:
        """Scale the speed of everything by 0.01 to 1; RobotRefused when another client holds the slider."""
        if not 0.01 <= fraction <= 1.0:
            raise LocalProtocolError(f"the speed slider goes from 0.01 to 1, not to {fraction}")
        try:
            await self.robot.write_inputs(speed_slider_mask=1, speed_slider_fraction=fraction)
        except RobotRefused as refused:
            if "IN_USE" not in refused.answer:
                raise
            why = "another RTDE client holds the speed slider: end that one first"
            raise RobotRefused("speed_slider_fraction", why) from None

    async def start_program(self) -> None:
        """Start the control program, or start it again, and wait until it is connected.

        Raises ScriptFailedError when the robot reports an error in it, RobotRefused in a mode
        in which no program can run, ProgramNotRunningError when it does not connect in time.
        """
        was_running = self.program_running
        await self._give_up_restart()
        async with self._one_at_a_time:
            if self.program_running and not was_running:
                return  # somebody else has started it meanwhile
            await self._start_it()
            self._lost_why = ""

    async def _start_it(self) -> None:
        self._check_modes()
        await self._end_old_program()
        self.pulse.bitten = ""
        self.pulse.breathe()
        self.robot.forget_errors()
        self._starting = self.config.headless
        try:
            if self.config.headless:
                await self.robot.send_script(self._program().render_headless(self.version))
            else:
                await self._play()
            await self._wait_for_program()
        finally:
            self._starting = False

    async def stop_program(self) -> None:
        """End the control program, which stops the arm; does nothing when it is not running."""
        await self._give_up_restart()
        async with self._one_at_a_time:
            if self.reverse.connected:
                self.reverse.stop()
                await self.reverse.wait_disconnected(_END_TIMEOUT_S)

    async def wait_for_program(self, timeout_s: float) -> None:
        """Wait until somebody started the program on the robot. Raises ProgramNotRunningError."""
        await self.reverse.wait_connected(timeout_s)

    def _program(self) -> ControlProgram:
        config = self.config
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
        )

    def _require(self, feature: str) -> None:
        require(feature, self.version)

    async def _check_calibration(self) -> None:
        problem = calibration_problem(await self.robot.kinematics(), self.config.calibration)
        if problem is not None:
            raise RobotRefused("the calibration check", problem)

    # starting

    def _check_modes(self) -> None:
        if self.robot.safety_mode not in MOVABLE:
            raise RobotRefused(
                "start of the control program",
                f"its safety mode is {self.robot.safety_mode.name}: clear the cause, then unlock "
                "(dashboard: unlock protective stop) or restart the safety",
            )
        if self.robot.robot_mode is not RobotMode.RUNNING:
            raise RobotRefused(
                "start of the control program",
                f"its mode is {self.robot.robot_mode.name}: power it on and release the brakes",
            )

    async def _end_old_program(self) -> None:
        if self.reverse.connected:
            await self.robot.send_script(_STOP_LINE)
            await self.reverse.wait_disconnected(_END_TIMEOUT_S)

    async def _play(self) -> None:
        assert self.robot.dashboard is not None
        if self.config.program is not None:
            await self.robot.dashboard.ask(dashboard.load(self.config.program))
        await self.robot.dashboard.ask(dashboard.PLAY)

    async def _wait_for_program(self) -> None:
        connected = asyncio.create_task(self.reverse.wait_connected(self.config.start_timeout_s))
        failed = asyncio.create_task(self.robot.script_error())
        try:
            await asyncio.wait((connected, failed), return_when=asyncio.FIRST_COMPLETED)
            if failed.done():
                raise failed.result()
            await connected
        except ProgramNotRunningError:
            raise ProgramNotRunningError(self.reverse.port, await self._why_not()) from None
        finally:
            for task in (connected, failed):
                task.cancel()
            await asyncio.gather(connected, failed, return_exceptions=True)

    async def _why_not(self) -> str:
        where = f"{self._own_address}, ports {', '.join(str(endpoint.port) for endpoint in self._endpoints)}"
        remote = "the robot has to be in remote control"
        if not self.config.headless and not self.sender.requests:
            return f"the URCap did not ask for it; check that it is set to {where} (program: {self.sender.port})"
        return f"the robot was sent it; it must be able to reach {where}, and e-Series: {remote}"

    # watching

    def _program_changed(self, connected: bool) -> None:
        self._has_played = False
        if connected:
            self._losses_before = self.losses
            self._seen_ended = False
            self._partners = {end: end.current_peer for end in (self.trajectory, self.commands)}
            self.reverse.keep_alive(self.config.keep_alive_timeout_s)
            asyncio.get_running_loop().call_later(_SETTLE_S, self._expect_partners, self.reverse.current_peer)
            return
        self._left_s = asyncio.get_running_loop().time()
        partners, self._partners = self._partners, {}
        for peer in partners.values():  # only its own: a new program may have connected to these already
            if peer is not None:
                peer.abort()

    def _partner_changed(self, connected: bool) -> None:
        """A program that has lost one of its connections is ended as a whole."""
        for endpoint, peer in tuple(self._partners.items()):
            if peer is None:
                self._partners[endpoint] = endpoint.current_peer  # accepted after the last one
            elif not connected and peer is not endpoint.current_peer:
                self._end_crippled(endpoint)
                return

    def _expect_partners(self, reverse: Peer | None) -> None:
        """A program that got through to the last port only, because others were lost meanwhile, is of no use."""
        if reverse is None or reverse is not self.reverse.current_peer:
            return
        for endpoint, peer in self._partners.items():
            if peer is None:
                self._end_crippled(endpoint)
                return

    def _end_crippled(self, endpoint: Endpoint) -> None:
        _logger.error("the robot is not connected to port %d: its program is ended", endpoint.port)
        if self.reverse.connected:
            self.reverse.stop()
            asyncio.get_running_loop().call_later(_END_TIMEOUT_S, self.reverse.peer.abort)  # should it not obey

    def _look_for_end(self, state: Mapping[str, Any]) -> None:
        if state["runtime_state"] in _ENDED:
            self._seen_ended, self._played_since_s = True, None
        elif self._played_since_s is None:
            self._played_since_s = state["timestamp"]

    def _admit_foreign_program(self) -> None:
        """A control program with another text than ours, such as the vendor's, does not say who it is.

        Three silent connections from one address are taken for one while the robot's state shows that a program runs,
        which is not the one that was here last.
        """
        vacant = not self.reverse.connected
        if self._starting or self._played_since_s is None or not (vacant or self._seen_ended):
            return
        if self.state["timestamp"] - self._played_since_s < _GREETING_S:
            return  # one of ours has not had the time to greet, however late it is here
        now_s = asyncio.get_running_loop().time()
        if (vacant and not self._seen_ended and now_s - self._left_s < _LINGER_S) or (
            not vacant and self.reverse.peer.proven
        ):
            return
        ends = (self.trajectory, self.commands, self.reverse)
        for address in {peer.address for peer in self.reverse.waiting if now_s - peer.arrived_s > _GREETING_S}:
            newest = [[peer for peer in end.waiting if peer.address == address][-1:] for end in ends]
            if all(newest):
                _logger.warning("a control program that is not this driver's connects from %s", address)
                for end, (peer,) in zip(ends, newest, strict=True):
                    end.admit(peer)
                return

    async def _breathe(self) -> None:
        while True:
            self.pulse.breathe()
            self._admit_foreign_program()
            await asyncio.sleep(_BREATH_S)

    # late, or lost

    def _heard(self, text: str) -> None:
        """What the control program says about its driver."""
        if text == LATE_TEXT:
            self.reverse.note_late("the robot had to wait too long for the next setpoint")
        elif text == GONE_TEXT and not self.pulse.bitten and not self._one_at_a_time.locked():
            # While a program is being started or stopped, this is the last word of the one before it: who then started
            # another again would end the one that the caller has just got.
            self.losses += 1
            self._lost_why = (
                f"the robot heard nothing from this machine for too long ({self.reverse.quiet_s:.1f} s by its clock), "
                "or the network failed"
            )
            _logger.warning("the control program has ended: %s", self._lost_why)
            if self.config.restart and self.config.headless and self._restart is None:
                self._restart = asyncio.create_task(self._start_again())

    async def _start_again(self) -> None:
        """The program that was lost through our own fault. The arm rests until somebody moves it."""
        try:
            await self.reverse.wait_disconnected(_END_TIMEOUT_S)
            async with asyncio.timeout(_END_TIMEOUT_S):
                while self.state["runtime_state"] != RuntimeState.STOPPED:
                    await self.next_state()
            self._restart = None  # from here on it is not given up but waited for
            async with self._one_at_a_time:
                await self._start_it()
            _logger.warning("the control program runs again; the arm rests until it is moved")
        except (ClientError, RobotRefused, TimeoutError, LocalProtocolError) as error:
            _logger.error("the control program could not be started again: %s", error)
        finally:
            self._restart = None

    async def _give_up_restart(self) -> None:
        restart, self._restart = self._restart, None
        if restart is not None and restart is not asyncio.current_task():
            await cancel(restart)

    def _robot_is_silent(self) -> None:
        peer = self.reverse.current_peer
        if peer is not None:
            _logger.error("the robot is silent: its program is disconnected")
            peer.abort()


class Setpoints(DriverCore):
    """Servoing, speeds, torques and freedrive.

    timeout_s: how long the robot waits for the next message before it stops the arm, from one
    control period to 0.2 s. Until `idle`, or another mode, the next one has to come within it; one
    that comes later is not sent but a LateSetpointError, and the program goes on. May be called from
    any thread. Raises ProgramNotRunningError, LocalProtocolError and, for what this version does not
    have, RobotRefused.
    """

    def servoj(self, q_rad: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint angles (6,) [rad] to be at one control period from now."""
        self.reverse.setpoint(ControlMode.SERVOJ, q_rad, timeout_s)

    def servo_pose(self, pose_base_tcp: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Pose of the TCP in the base frame (6,) [m, rotation vector], reached by the nearest joint angles."""
        self.reverse.setpoint(ControlMode.POSE, pose_base_tcp, timeout_s)

    def speedj(self, qd_rad_s: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint speeds (6,) [rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDJ, qd_rad_s, timeout_s)

    def speedl(self, velocity_base: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Velocity of the TCP in the base frame (6,) [m/s, rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDL, velocity_base, timeout_s)

    def torque(self, torque_Nm: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint torques (6,) [Nm] on top of what gravity needs; from 5.23 on."""
        self._require("torque")
        self.reverse.setpoint(ControlMode.TORQUE, torque_Nm, timeout_s)

    def idle(self) -> None:
        """Bring the arm to rest and keep the program running, for as long as the driver lives."""
        self.reverse.keep_alive(self.config.keep_alive_timeout_s)

    def start_freedrive(self) -> None:
        """Let the arm be moved by hand until `stop_freedrive`, `idle` or another mode."""
        self.reverse.freedrive(FreedriveAction.START, self.config.keep_alive_timeout_s)

    def keep_freedrive(self) -> None:
        """Say that freedrive goes on; the driver does so by itself too."""
        self.reverse.freedrive(FreedriveAction.NOOP, self.config.keep_alive_timeout_s)

    def stop_freedrive(self) -> None:
        """Hold the arm where it is."""
        self.reverse.freedrive(FreedriveAction.STOP, self.config.keep_alive_timeout_s)


_LOCKED_S: Final = 5.0  # dashboard manual: it cannot be unlocked for 5 s after it occurred
_SPARE_S: Final = 0.2  # guess: the state that showed it may have been late
_UNLOCK_LINE: Final = "set unlock protective stop"
_UNLOCK_TIMEOUT_S: Final = 5.0


class Recovery(DriverCore):
    """Watches the safety mode."""

    def __init__(self, config: DriverConfig) -> None:
        super().__init__(config)
        self._safety_mode: SafetyMode | None = None
        self._stopped_at_s: float | None = None
        self.robot.on_modes.append(self._note)

    def on_safety_mode(self, callback: Callable[[SafetyMode], None]) -> None:
        """Call back with each new safety mode."""
        before: list[SafetyMode] = [self.robot.safety_mode]

        def changed(_: Mapping[str, Any]) -> None:
            if self.robot.safety_mode != before[0]:
                before[0] = self.robot.safety_mode
                callback(before[0])

        self.robot.on_modes.append(changed)

    @property
    def protective_stopped(self) -> bool:
        """True during a protective stop."""
        return self.robot.safety_mode is SafetyMode.PROTECTIVE_STOP

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        For a caller who knows why the arm stopped and that it may move again. Raises RobotRefused
        when something else than a protective stop is the matter, or it comes back at once.
        """
        if self.protective_stopped:
            await self._unlock()
        await self.start_program()

    async def _unlock(self) -> None:
        since = self._stopped_at_s if self._stopped_at_s is not None else self.state["timestamp"]
        while self.state["timestamp"] < since + _LOCKED_S + _SPARE_S:
            await self.next_state()
        if self.robot.dashboard is not None:
            await self.robot.dashboard.ask(dashboard.UNLOCK_PROTECTIVE_STOP)
        else:
            await self.robot.send_script(_UNLOCK_LINE)
        try:
            async with asyncio.timeout(_UNLOCK_TIMEOUT_S):
                while self.robot.safety_mode not in MOVABLE:
                    await self.next_state()
        except TimeoutError:
            mode = self.robot.safety_mode.name
            raise RobotRefused("unlock protective stop", f"it stays in {mode}: remove the cause first") from None

    def _note(self, state: Mapping[str, Any]) -> None:
        mode = self.robot.safety_mode
        if mode == self._safety_mode:
            return
        self._safety_mode = mode
        if mode is SafetyMode.PROTECTIVE_STOP:
            self._stopped_at_s = state["timestamp"]
            _logger.warning("protective stop")
