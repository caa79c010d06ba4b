"""One motion at a time: begun, watched, waited for, stopped."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from types import TracebackType
from typing import Any, Final, Self, cast
from weakref import WeakKeyDictionary

from client import dashboard
from client.control_program import DECELERATION, SPEED_ACCELERATION
from client.driver.core import MOVABLE
from client.errors import (
    ClientError,
    MotionStoppedError,
    NoAnswerError,
    ProgramEndedError,
    ProgramNotRunningError,
    WaitTimeoutError,
)
from client.robot.diagnosis import Troubles
from client.robot.state import RobotState, check_signal
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import ControlMode, Question, to_words
from urproto.modes import RobotMode, SafetyMode
from urproto.robots import Joints
from urproto.robots.pose import Pose
from urproto.signals import digital_signal

_POWER_UP_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_LOCAL_CONTROL_CODE: Final = 210  # error code of a script port while the robot is in local control
_REMOTE: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
LOCAL_CONTROL: Final = ("it is in local control", _REMOTE)
_RUN_LINE: Final = "set robotmode run"


class Readiness(Troubles):
    """Makes the arm ready, at first and after a protective stop."""

    async def make_ready(self) -> None:
        """Power the arm on, release the brakes and start the control program, whatever of it is still to be done.

        The arm moves a little as its brakes are released. Raises SafetyStopError while a stop
        is in effect, RobotRefused when the robot says no.
        """
        await self._refuse_in_stop("make_ready")
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
            await self._refuse_in_stop("recover")
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


_REST_S: Final = 5.0  # guess: a ramp to rest takes less than one second
SETTLE_STATES: Final = 3  # guess: a command beside the motion is read within one control period
_USUAL: Final[Mapping[str, float | None]] = {
    "acceleration": SPEED_ACCELERATION,
    "deceleration_rad_s2": DECELERATION,
}
_ENDS: Final = (ProgramEndedError, ProgramNotRunningError)


class RobotCore(Readiness):
    """A robot that is connected, and the motion that is under way."""

    def __init__(self, host: str, **options: Any) -> None:
        super().__init__(host, **options)
        self._motion: asyncio.Task[None] | None = None  # begun, and its end not yet told to anybody
        self._doing = ""  # of the motion, or of the context that has the arm
        self._has_context = False
        self._stops = 0  # how often stop() was called
        self._awaited: asyncio.Task[None] | None = None  # the last motion whose caller waits: nobody may replace it
        self._replaced: WeakKeyDictionary[asyncio.Task[None], str] = WeakKeyDictionary()
        self._tuned: Mapping[str, float | None] = _USUAL  # how setpoints are followed
        self._rolling = False  # a stream of speeds goes on as another one

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self.driver.on_program_state(self._program_changed)
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

    def _program_changed(self, connected: bool) -> None:
        if connected:
            self._tuned = _USUAL  # a new program has those

    @property
    def moving(self) -> bool:
        """True while a motion that was begun here is under way."""
        return self._motion is not None and not self._motion.done()

    async def wait_for(self, condition: Callable[[RobotState], bool], timeout_s: float | None = None) -> RobotState:
        """Look at each state until the condition holds for one, and return that.

        Raises WaitTimeoutError, what ends the motion that is under way, and RobotUnreachableError
        for a silent robot. The condition must be quick and must not call the robot.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not condition(state := self.state):
                    if self._motion is not None and self._motion.done() and _failed(self._motion):
                        await self.wait_done()
                    await self._next_state("wait_for")
        except TimeoutError:
            raise WaitTimeoutError(f"what was waited for did not happen within {timeout_s} s: wait again") from None
        return state

    # beside a motion

    async def need_program(self, doing: str) -> None:
        """See that the control program runs and obeys, or raise the error that says why it does not.

        Started as by a motion: the first time, or after an end that was this machine's own fault.
        """
        if self._silent:
            raise self._unreachable(doing)
        await self._refuse_in_stop(doing)
        if self.driver.program_running and self._paused:
            raise RobotRefused(doing, "its program is paused", "resume it on the robot, or make_ready() starts it anew")
        if self.driver.program_running:
            return
        if self.driver.robot.robot_mode is not RobotMode.RUNNING:
            mode = self.driver.robot.robot_mode.name
            raise RobotRefused(doing, f"its mode is {mode}", "make_ready() powers it on and releases the brakes")
        if self._started and (not self.driver.lost_why or self.driver.pulse.bitten):
            raise await self._explanation(doing)
        await self._start(doing)

    async def ask(
        self,
        doing: str,
        question: Question,
        *arguments: Sequence[float] | None,
        number: int = 0,
        gate: str | None = None,
    ) -> tuple[float, ...]:
        """What the control program answers; the robot's components ask so. See `URDriver.ask`."""
        await self.need_program(doing)
        try:
            return await self.driver.ask(question, *arguments, number=number, gate=gate)
        except _ENDS:
            raise await self._explanation(doing) from None
        except NoAnswerError:
            await self._refuse_in_stop(doing)
            raise

    async def free(self, doing: str) -> None:
        """See that nobody has the arm. Raises LocalProtocolError, and the failure of a motion that nobody was told."""
        await self._check_free(doing)

    async def start_again(self, doing: str) -> None:
        """Start the control program after one of the caller's own."""
        await self._start(doing)

    # before a motion

    async def _ready(self, doing: str, *, rolling: bool = False) -> None:
        """The program runs and nobody has the arm, or else the error that says why not.

        A motion that nobody waits for is replaced. The caller must take the arm before it awaits anything.
        """
        stops = self._stops
        if not self._has_context:
            await self._replace(doing, rolling=rolling)
        await self._check_free(doing)
        self._trouble.clear()
        await self.need_program(doing)
        self._started = True
        if self._stops != stops:  # by another task, as what follows
            raise MotionStoppedError(doing, "stop() was called")
        self._check_nobody_moves(doing)

    async def _check_free(self, doing: str) -> None:
        self._check_nobody_moves(doing)
        await self.wait_done()  # a failure that nobody was told

    async def _replace(self, doing: str, *, rolling: bool) -> None:
        """End a motion that goes on by itself, since its owner wants another one instead.

        rolling: speeds that replace speeds do so without a stop in between.
        """
        motion = self._motion
        if motion is None or motion.done() or motion is self._awaited:
            return
        self._motion, self._rolling = None, rolling
        self._replaced[motion] = f"{doing} replaced it"
        try:
            await _cancelled(motion)
        finally:
            self._rolling = False
        if self.driver.program_running and self.driver.reverse.mode is ControlMode.FORWARD:
            with suppress(ClientError, LocalProtocolError):  # none under way, or it ended otherwise
                await self.driver.trajectory_result(_REST_S)

    def _check_nobody_moves(self, doing: str) -> None:
        if self.moving or self._has_context:
            raise LocalProtocolError(f"{doing} has to wait for {self._doing}: wait_done() or stop() first")

    # motions

    async def _launch(self, doing: str, work: Callable[[], Coroutine[Any, Any, None]], wait: bool) -> None:
        """Begin a motion, and wait for its end if asked to; then it ends with its caller."""
        self._doing = doing
        motion = self._motion = asyncio.create_task(self._guarded(work))
        if not wait:
            return
        self._awaited = motion
        try:
            await self.wait_done()
        except asyncio.CancelledError:
            self._motion = None
            await _cancelled(motion)
            raise

    async def wait_done(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the motion that is under way, if any, and raise what went wrong.

        Raises WaitTimeoutError when it takes longer than ``timeout_s``; the motion goes on.
        """
        motion, doing = self._motion, self._doing
        if motion is None:
            return
        await asyncio.wait({motion}, timeout=timeout_s)
        if not motion.done():
            raise WaitTimeoutError(f"{doing} is still under way after {timeout_s} s: wait_done() again, or stop()")
        if self._motion is motion:
            self._motion = None
        if motion.cancelled():
            raise MotionStoppedError(doing, self._replaced.get(motion, "stop() was called"))
        motion.result()

    async def stop(self, deceleration_rad_s2: float = DECELERATION) -> None:
        """Bring the arm to rest, and return when it has; who waits for the motion gets MotionStoppedError.

        The program goes on, the next motion may follow. For motions that were begun here: a
        program of somebody else is stopped by ``driver.robot.send_script("stop program")``.
        """
        self._stops += 1
        if self.driver.program_running and not self._paused:
            await self._tune("stop", deceleration_rad_s2=deceleration_rad_s2)
        motion, self._motion = self._motion, None
        had_failed = motion is not None and motion.done()
        if motion is not None:
            await _cancelled(motion)
        await self._come_to_rest()
        if motion is not None and had_failed:
            motion.result()  # a failure that nobody was told

    async def _tune(self, doing: str, **parameters: float | None) -> None:
        """Let setpoints be followed as these `URDriver.set_stream_parameters` say."""
        parameters = {name: value for name, value in ({**_USUAL, **parameters}).items() if value is not None}
        if parameters == self._tuned:
            return
        self.driver.set_stream_parameters(**parameters)  # type: ignore[arg-type] # names of floats
        self._tuned = parameters
        for _ in range(SETTLE_STATES):
            await self._next_state(doing)

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


def _failed(motion: "asyncio.Task[None]") -> bool:
    return motion.cancelled() or motion.exception() is not None


async def _cancelled(task: "asyncio.Task[Any]") -> None:
    """End a task and wait until it has; its failure is for whoever awaits it."""
    task.cancel()
    await asyncio.wait({task})
    if not task.cancelled():
        task.exception()  # looked at


_EFFECT_S: Final = 2.0  # guess: ten times what the slowest takes, which the primary interface shows
_SAME_M: Final = 1e-5  # m or rad


class Settings(RobotCore):
    """Any of these works with and without the control program, and beside a motion.

    Raises LocalProtocolError for values that make no sense, RobotRefused when no effect is seen.
    """

    async def set_digital_out(self, number: int, on: bool) -> None:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        group, index = digital_signal(check_signal(number))
        await self._say(group.statement(index, on))
        await self._take_effect(f"digital output {number}", lambda state: state.digital_out(number) is bool(on))

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Mass and its centre of gravity (3,) in the flange frame; takes effect within a few control periods."""
        await self.driver.set_payload(mass_kg, cog_m)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = (0.0,) * 6,
        transition_time_s: float = 0.0,
    ) -> None:
        """As set_payload with the inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,), taking effect gradually; from 5.10 on."""
        await self.driver.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Acceleration of the base (3,) in its frame: [0, 0, 9.82] for an upright arm."""
        await self.driver.set_gravity(gravity_m_s2)

    def set_watchdog(self, longest_s: float) -> None:
        """End the control program, and so stop the arm, when `kick_watchdog` is not called for so long; 0 ends that.

        Without one the arm goes on as long as this process lives, also if the caller's own loop hangs.
        """
        self.driver.pulse.watch(longest_s)

    def kick_watchdog(self) -> None:
        """Say that the caller's own program works; takes no time."""
        self.driver.pulse.kick()

    async def trigger_protective_stop(self) -> None:
        """Stop the arm as the robot would after a collision, from any motion. See `recover`."""
        await self._say("protective_stop()")
        await self._take_effect("protective stop", lambda state: state.safety_mode == SafetyMode.PROTECTIVE_STOP)

    # asked for

    async def tcp_offset(self) -> Pose:
        """Flange to TCP (6,) [m, rotation vector], as it is in effect. From 3.6 on."""
        return cast(Pose, await self.ask("tcp_offset", Question.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured some control periods ago. From 5.4 on."""
        if steps < 0:
            raise LocalProtocolError(f"history goes back 0 periods or more, not {steps}")
        question = Question.JOINT_POSITIONS_HISTORY
        return cast(Joints, await self.ask("history", question, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has stood for a while, and is in neither force mode nor freedrive."""
        return bool((await self.ask("is_steady", Question.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self.ask("step_time", Question.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Pose of the TCP (6,) that the move under way leads to. From 5.3 on."""
        return cast(Pose, await self.ask("target_waypoint", Question.TARGET_WAYPOINT, gate="target_waypoint"))

    async def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Flange to TCP (6,) [m, rotation vector]; not while a motion is under way."""
        if self.moving or self._has_context:
            await self._check_free("set_tcp")
        to_words(pose_flange_tcp)
        if len(pose_flange_tcp) != 6:
            raise LocalProtocolError(f"a pose has 6 numbers, not {len(pose_flange_tcp)}")
        if self.driver.program_running and self._obeys:
            self.driver.set_tcp(pose_flange_tcp)
        else:
            await self._say(f"set_tcp(p[{', '.join(str(float(value)) for value in pose_flange_tcp)}])")
        await self._take_effect("set_tcp", lambda _: self._tcp_is(pose_flange_tcp))

    async def set_speed_slider(self, fraction: float) -> None:
        """Scale the speed of everything by 0.01 to 1."""
        await self.driver.set_speed_slider(fraction)
        await self._take_effect("speed slider", lambda state: abs(state.speed_fraction - fraction) < 1e-3)

    async def _say(self, statement: str) -> None:
        await self.driver.robot.send_script(f"sec setting():\n  {statement}\nend")

    async def _take_effect(self, what: str, done: Callable[[RobotState], bool]) -> None:
        try:
            await self.wait_for(done, _EFFECT_S)
        except TimeoutError:
            await self._refuse_in_stop(what)
            raise RobotRefused(what, *await self._why_no_effect()) from None

    @property
    def _obeys(self) -> bool:
        """The control program executes commands: it is not held by a pause or a stop."""
        return not self._paused and self.driver.robot.safety_mode in MOVABLE

    async def _why_no_effect(self) -> tuple[str, str]:
        link = self.driver.robot
        failure = link.take_script_error()
        why = str(failure) if failure else self._reported()
        if not why and await self._in_local_control():
            return LOCAL_CONTROL
        if not why and link.robot_mode is not RobotMode.RUNNING:
            return f"its mode is {link.robot_mode.name}", "make_ready() powers it on and releases the brakes"
        return f"{why or 'nothing changed'} within {_EFFECT_S:g} s", "look at the pendant and its log"

    def _tcp_is(self, pose_flange_tcp: Sequence[float]) -> bool:
        state = self.driver.robot.primary_state
        if state is None or state.cartesian is None:
            return False
        return all(abs(a - b) < _SAME_M for a, b in zip(state.cartesian.tcp_offset, pose_flange_tcp, strict=True))
