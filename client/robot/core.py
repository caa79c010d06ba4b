"""A robot that is connected, made ready, watched; and why it did not do what it was asked to."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from types import TracebackType
from typing import Any, Final, Self

from client import dashboard
from client.driver import URDriver
from client.driver.core import MOVABLE
from client.errors import (
    ClientError,
    MotionStoppedError,
    OutOfReachError,
    ProgramEndedError,
    ProgramNotRunningError,
    ProtectiveStopError,
    RobotUnreachableError,
    SafetyStopError,
    ScriptFailedError,
)
from client.robot.state import OUTPUTS, RobotState
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import ControlMode
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import Joints
from urproto.robots.pose import Pose

__all__ = ["LOCAL_CONTROL", "RobotCore"]

_FREE_PORTS: Final = {"reverse_port": 0, "trajectory_port": 0, "command_port": 0, "sender_port": 0}
_POWER_UP_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_REST_S: Final = 5.0  # guess: a ramp to rest takes less than one second
_WORDS_S: Final = 0.3  # guess: what explains an end arrives within this; the primary interface sends 10 times a second
_LISTEN_EVERY_S: Final = 0.01
_LOCAL_CONTROL_CODE: Final = 210  # error code of a script port while the robot is in local control
_REMOTE: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
LOCAL_CONTROL: Final = ("it is in local control", _REMOTE)
_RUN_LINE: Final = "set robotmode run"
_ENDS: Final = (ProgramEndedError, ProgramNotRunningError)

_ADVICE: Final = {
    SafetyMode.PROTECTIVE_STOP: "find the cause, see that the way is free, then recover()",
    SafetyMode.SAFEGUARD_STOP: "close what the safeguard watches; then resume on the robot, or stop() and move again",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.ROBOT_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.VIOLATION: "find the cause, then restart the safety system on the robot",
    SafetyMode.FAULT: "find the cause, then restart the safety system on the robot",
}


class RobotCore:
    """A driver, and the reasons it does not see: which stop it was, who ended the program.

    driver: for what this class does not offer.
    """

    def __init__(self, host: str, **options: Any) -> None:
        free = _FREE_PORTS if options.get("headless", True) else {}
        outputs = tuple(dict.fromkeys((*OUTPUTS, *options.pop("outputs", ()))))
        self.driver = URDriver(host, **(free | options), outputs=outputs)
        self._motion: asyncio.Task[None] | None = None  # begun, and its end not yet told to anybody
        self._doing = ""  # of the motion, or of the context that has the arm
        self._has_context = False
        self._stops = 0  # how often stop() was called
        self._started = False  # the program runs as far as the caller was told
        self._trouble = asyncio.Event()
        self._last_words: object = None  # the state after which the robot fell silent

    async def __aenter__(self) -> Self:
        """Connect. The arm does not move, and a program that runs on the robot goes on."""
        await self.driver.__aenter__()
        self.driver.on_safety_mode(self._safety_changed)
        self.driver.robot.on_silence.append(self._fell_silent)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the arm and disconnect. A failure nobody has asked for is raised, unless another is on its way."""
        motion, self._motion = self._motion, None
        try:
            if motion is not None and not motion.done():
                await _cancelled(motion)
        finally:
            await self.driver.__aexit__(kind, error, trace)
        if motion is not None and not motion.cancelled() and (failure := motion.exception()) and error is None:
            raise failure

    # what there is to see

    @property
    def state(self) -> RobotState:
        """The newest state."""
        return RobotState.of(self.driver.state)

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3."""
        return self.state.q_rad

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]."""
        return self.state.pose_base_tcp

    @property
    def moving(self) -> bool:
        """True while a motion that was begun here is under way."""
        return self._motion is not None and not self._motion.done()

    def digital_in(self, number: int) -> bool:
        """Level of a digital input: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return self.state.digital_in(number)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered as the inputs are."""
        return self.state.digital_out(number)

    async def wait_for(self, condition: Callable[[RobotState], bool], timeout_s: float | None = None) -> RobotState:
        """Look at each state until the condition holds for one, and return that.

        Raises TimeoutError, what ends the motion that is under way, and RobotUnreachableError
        for a silent robot. The condition must be quick and must not call the robot.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not condition(state := self.state):
                    if self._motion is not None and self._motion.done() and _failed(self._motion):
                        await self.wait_done()
                    await self._next_state("wait_for")
        except TimeoutError:
            raise TimeoutError(f"what was waited for did not happen within {timeout_s} s") from None
        return state

    # getting ready

    async def make_ready(self) -> None:
        """Power the arm on, release the brakes and start the control program, whatever of it is still to be done.

        The arm moves a little as its brakes are released. Raises SafetyStopError while a stop
        is in effect, RobotRefused when the robot says no.
        """
        self._check_safety("make_ready")
        if self.driver.robot.robot_mode is not RobotMode.RUNNING:
            await self._release_brakes()
        if not self.driver.program_running or self._paused:
            await self._start("make_ready")
        self._started = True

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        For a caller who knows why the arm stopped and that it may move. Raises RobotRefused
        when the stop comes back at once, SafetyStopError for another kind of stop.
        """
        if not self.driver.protective_stopped:
            self._check_safety("recover")
        await self._reporting("recover", self.driver.recover())
        self._started = True

    async def _release_brakes(self) -> None:
        if (board := self.driver.robot.dashboard) is not None:
            await board.ask(dashboard.BRAKE_RELEASE)
        else:
            await self.driver.robot.send_script(_RUN_LINE)
        try:
            async with asyncio.timeout(_POWER_UP_S):
                while self.driver.robot.robot_mode is not RobotMode.RUNNING:
                    await self._next_state("make_ready")
                    self._check_safety("make_ready")
        except TimeoutError:
            mode = self.driver.robot.robot_mode.name
            advice = f"look at the pendant; e-Series: {_REMOTE}"
            raise RobotRefused("brake release", f"after {_POWER_UP_S:g} s its mode is {mode}", advice) from None

    async def _start(self, doing: str) -> None:
        link = self.driver.robot
        link.reports.clear()
        link.popups.clear()
        await self._reporting(doing, self.driver.start_program())
        self._started = True

    async def _reporting(self, doing: str, start: Coroutine[Any, Any, None]) -> None:
        """Await the start of the program; one that does not come about is explained."""
        try:
            await start
        except ProgramNotRunningError as error:
            if await self._in_local_control():
                why, advice = LOCAL_CONTROL
                raise RobotRefused(
                    doing, why, f"{advice}; a simulator, which takes scripts anyway: {error.hint}"
                ) from None
            raise

    async def _in_local_control(self) -> bool:
        if any(report.code == _LOCAL_CONTROL_CODE for report in self.driver.robot.reports):
            return True
        try:
            board = self.driver.robot.dashboard
            return board is not None and not await board.ask(dashboard.IS_IN_REMOTE_CONTROL)
        except (RobotRefused, ClientError):  # a version without remote control, or a dashboard that is gone
            return False

    # before a motion

    async def _ready(self, doing: str) -> None:
        """The program runs and nobody has the arm, or else the error that says why not.

        The caller must take the arm before it awaits anything.
        """
        stops = self._stops
        await self._check_free(doing)
        self._trouble.clear()
        if self._silent:
            raise self._unreachable(doing)
        self._check_safety(doing)
        if self.driver.robot.robot_mode is not RobotMode.RUNNING:
            mode = self.driver.robot.robot_mode.name
            raise RobotRefused(doing, f"its mode is {mode}", "make_ready() powers it on and releases the brakes")
        if self.driver.program_running and self._paused:
            raise RobotRefused(doing, "its program is paused", "resume it on the robot, or make_ready() starts it anew")
        if self.driver.program_running:
            self._started = True
        elif self._started:
            raise await self._explanation(doing)
        else:
            await self._start(doing)
        if self._stops != stops:  # by another task, as what follows
            raise MotionStoppedError(doing, "stop() was called")
        self._check_nobody_moves(doing)

    async def _check_free(self, doing: str) -> None:
        self._check_nobody_moves(doing)
        await self.wait_done()  # a failure that nobody was told

    def _check_nobody_moves(self, doing: str) -> None:
        if self.moving or self._has_context:
            raise LocalProtocolError(f"{doing} has to wait for {self._doing}: wait_done() or stop() first")

    def _check_safety(self, doing: str) -> None:
        mode = self.driver.robot.safety_mode
        if mode not in MOVABLE:
            kind = ProtectiveStopError if mode is SafetyMode.PROTECTIVE_STOP else SafetyStopError
            raise kind(doing, mode, self._reported(), _ADVICE.get(mode, "the pendant says what has to be done"))

    @property
    def _paused(self) -> bool:
        return bool(self.driver.state["runtime_state"] in (RuntimeState.PAUSING, RuntimeState.PAUSED))

    # motions

    async def _launch(self, doing: str, work: Callable[[], Coroutine[Any, Any, None]], wait: bool) -> None:
        """Begin a motion, and wait for its end if asked to; then it ends with its caller."""
        self._doing = doing
        motion = self._motion = asyncio.create_task(self._guarded(work))
        if not wait:
            return
        try:
            await self.wait_done()
        except asyncio.CancelledError:
            self._motion = None
            await _cancelled(motion)
            raise

    async def wait_done(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the motion that is under way, if any, and raise what went wrong.

        Raises TimeoutError when it takes longer than ``timeout_s``; the motion goes on.
        """
        motion, doing = self._motion, self._doing
        if motion is None:
            return
        await asyncio.wait({motion}, timeout=timeout_s)
        if not motion.done():
            raise TimeoutError(f"{doing} is still under way after {timeout_s} s: wait_done() again, or stop()")
        if self._motion is motion:
            self._motion = None
        if motion.cancelled():
            raise MotionStoppedError(doing, "stop() was called")
        motion.result()

    async def stop(self) -> None:
        """Bring the arm to rest, and return when it has; who waits for the motion gets MotionStoppedError.

        The program goes on, the next motion may follow. For motions that were begun here: a
        program of somebody else is stopped by ``driver.robot.send_script("stop program")``.
        """
        self._stops += 1
        motion, self._motion = self._motion, None
        had_failed = motion is not None and motion.done()
        if motion is not None:
            await _cancelled(motion)
        await self._come_to_rest()
        if motion is not None and had_failed:
            motion.result()  # a failure that nobody was told

    async def _come_to_rest(self) -> None:
        if not self.driver.program_running or self._paused:
            return
        if self.driver.reverse.mode is ControlMode.FORWARD:
            with suppress(ClientError, LocalProtocolError):  # none under way, or it ended otherwise
                await self.driver.trajectory_result(_REST_S)
        else:
            self.driver.idle()
            await self._next_state("stop")  # the program reads it once a control period
        with suppress(TimeoutError):
            async with asyncio.timeout(_REST_S):
                while not self.state.at_rest:
                    await self._next_state("stop")

    async def _guarded(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Do it, and raise why it failed: also when the robot stops and the program waits for somebody."""
        doing = self._doing
        task = asyncio.create_task(work())
        trouble = asyncio.create_task(self._trouble.wait())
        try:
            await asyncio.wait((task, trouble), return_when=asyncio.FIRST_COMPLETED)
            if task.done() and not isinstance(task.exception(), _ENDS):
                return task.result()
        finally:
            await _cancelled(task)
            await _cancelled(trouble)
        raise await self._explanation(doing)

    @asynccontextmanager
    async def _holding(self, doing: str) -> AsyncIterator[None]:
        """A context that has the arm for itself; its end brings the arm to rest."""
        await self._ready(doing)
        self._doing, self._has_context = doing, True
        try:
            yield
        except BaseException:
            if self.driver.program_running:
                self.driver.idle()
            raise
        finally:
            self._has_context = False
        if not self.driver.program_running or self._trouble.is_set():
            raise await self._explanation(doing)
        await self._come_to_rest()

    # what went wrong

    async def _next_state(self, doing: str) -> None:
        try:
            await self.driver.next_state()
        except ClientError:
            raise self._unreachable(doing) from None

    def _safety_changed(self, mode: SafetyMode) -> None:
        if mode in MOVABLE:
            self.driver.robot.reports.clear()  # of a stop that is over
        else:
            self._trouble.set()

    def _fell_silent(self) -> None:
        self._last_words = self.driver.state
        self._trouble.set()

    def _unreachable(self, doing: str) -> RobotUnreachableError:
        config = self.driver.config
        reason = f"it was lost, or the robot fell silent, during {doing}"
        return RobotUnreachableError(config.robot, config.robot_ports["rtde"], reason)

    async def _explanation(self, doing: str) -> Exception:
        """Why this has ended, as far as the robot says so."""
        failure = await self._last_failure()
        if self._silent:
            return self._unreachable(doing)
        try:
            self._check_safety(doing)
        except SafetyStopError as stop:
            return stop
        if failure is not None and _means_out_of_reach(failure):
            self._started = False  # the caller's target, and nobody's wish to end the program: it may start by itself
            return OutOfReachError(doing, failure.text)
        return ProgramEndedError(self.driver.reverse.port, doing, self._why(failure), "make_ready() starts it again")

    async def _last_failure(self) -> ScriptFailedError | None:
        """The script error that ended the program, if one did; what else explains an end has then come too."""
        failures: list[ScriptFailedError] = []

        def heard() -> bool:
            if failure := self.driver.robot.take_script_error():
                failures.append(failure)
            stopped = self.driver.robot.safety_mode not in MOVABLE and self._reported()
            return bool(failures or self._silent or stopped)

        await self._hear(heard)
        return failures[0] if failures else None

    async def _hear(self, heard: Callable[[], bool]) -> None:
        """Wait for what the robot says by another connection, as long as that may take."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_WORDS_S):
                while not heard():
                    await asyncio.sleep(_LISTEN_EVERY_S)

    def _why(self, failure: ScriptFailedError | None) -> str:
        if failure is not None:
            return str(failure)
        mode = self.driver.robot.robot_mode
        if mode is not RobotMode.RUNNING:
            return f"the robot's mode is {mode.name}"
        return self._reported() or "somebody stopped it on the robot, or another program took its place"

    @property
    def _silent(self) -> bool:
        return self.driver.state is self._last_words

    def _reported(self) -> str:
        """The last error the robot has reported since the program was started."""
        grave = [
            report
            for report in self.driver.robot.reports
            if ReportLevel.WARNING <= report.level < ReportLevel.DEVELOPER_DEBUG
        ]
        return _described(grave[-1]) if grave else ""


def _described(report: ErrorCodeMessage) -> str:
    return f"{report.label} {report.text}".strip()


def _means_out_of_reach(failure: ScriptFailedError) -> bool:
    """By its text, which is the robot's: "unable to find an inverse kinematics solution" and the like."""
    text = failure.text.lower()
    return "inverse kin" in text or "out of reach" in text or "joint limits" in text


def _failed(motion: "asyncio.Task[None]") -> bool:
    return motion.cancelled() or motion.exception() is not None


async def _cancelled(task: "asyncio.Task[Any]") -> None:
    """End a task and wait until it has; its failure is for whoever awaits it."""
    task.cancel()
    await asyncio.wait({task})
    if not task.cancelled():
        task.exception()  # looked at
