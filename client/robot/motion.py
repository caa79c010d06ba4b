"""Runs one motion at a time: starts it, watches it, waits for it, stops it."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any, Final
from weakref import WeakKeyDictionary

from client.driver.control_program import DECELERATION, SPEED_ACCELERATION
from client.errors import ClientError, LateSetpointError, MotionStoppedError, NoAnswerError, WaitTimeoutError
from client.robot.readiness import PROGRAM_GONE, Readiness
from client.robot.state import RobotState
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError
from urproto.external_control import ControlMode

_REST_S: Final = 5.0  # guess: a ramp to rest takes less than one second
_SETTLE_STATES: Final = 3  # guess: a command sent during a motion is read within one control period
_STUCK_S: Final = 2.0  # before it is worth a warning (guess)
_REMIND_S: Final = 60.0  # until the next one (guess)
_DEFAULTS: Final[Mapping[str, float | None]] = {
    "acceleration": SPEED_ACCELERATION,
    "deceleration_rad_s2": DECELERATION,
}

_logger = logging.getLogger(__name__)


class MotionRunner:
    """Keeps track of what uses the arm, a motion or a context; it knows nothing about what a motion does."""

    operation: str
    """Name of what uses the arm, or used it last, for error messages."""
    stops: int
    """Number of calls of `stop`; a task that sees it change knows that it has been stopped."""
    rolling: bool
    """True while one stream of speeds replaces another, without a stop in between."""

    def __init__(self, readiness: Readiness) -> None:
        self.readiness = readiness
        self.driver = readiness.driver
        self.diagnosis = readiness.diagnosis
        self.operation = ""
        self.stops = 0
        self.rolling = False
        self._motion: asyncio.Task[None] | None = None  # started, and its result not yet reported to a caller
        self._has_context = False
        self._awaited: asyncio.Task[None] | None = None  # the last motion with a waiting caller; it cannot be replaced
        self._replaced: WeakKeyDictionary[asyncio.Task[None], str] = WeakKeyDictionary()
        self._stream_parameters: Mapping[str, float | None] = _DEFAULTS  # how setpoints are followed
        self.driver.on_program_state(self._program_changed)

    @property
    def state(self) -> RobotState:
        """The newest state, whatever its age."""
        return RobotState(self.driver.state)

    async def close(self) -> BaseException | None:
        """End the motion under way. Returns the failure of one that had already ended, if not yet reported."""
        motion, self._motion = self._motion, None
        if motion is not None and not motion.done():
            await _cancelled(motion)
        return None if motion is None or motion.cancelled() else motion.exception()

    @property
    def moving(self) -> bool:
        """True while a motion started by this object is under way."""
        return self._motion is not None and not self._motion.done()

    @property
    def busy(self) -> bool:
        """True while a motion or a context is using the arm."""
        return self.moving or self._has_context

    # starting

    async def ready(self, operation: str, *, rolling: bool = False) -> None:
        """Make sure that the program is running and the arm is free, or raise the error that says why not.

        A motion without a waiting caller is replaced. The caller must claim the arm before its next ``await``.
        """
        stops = self.stops
        if not self._has_context:
            await self._replace(operation, rolling=rolling)
        await self.check_free(operation)
        self.diagnosis.alarm.clear()
        await self.readiness.require_program(operation)
        if self.stops != stops:  # by another task during the await; the arm may have been claimed then, too
            raise MotionStoppedError(operation, "stop() was called")
        self.check_not_busy(operation)

    async def check_free(self, operation: str) -> None:
        """Make sure that no motion or context is using the arm.

        Raises LocalProtocolError, or the failure of a motion that has not been reported to a caller yet.
        """
        self.check_not_busy(operation)
        await self.wait_done()

    def check_not_busy(self, operation: str) -> None:
        """Raise LocalProtocolError while a motion or a context is using the arm."""
        if self.busy:
            raise LocalProtocolError(f"{operation} has to wait for {self.operation}: wait_done() or stop() first")

    async def launch(self, operation: str, work: Callable[[], Coroutine[Any, Any, None]], wait: bool) -> None:
        """Start a motion. With ``wait``, wait for its end; cancelling the caller then ends the motion."""
        self.operation = operation
        motion = self._motion = asyncio.create_task(self._run(work))
        if not wait:
            return
        self._awaited = motion
        try:
            await self.wait_done()
        except asyncio.CancelledError:
            self._motion = None
            await _cancelled(motion)
            raise

    @asynccontextmanager
    async def exclusive(self, operation: str) -> AsyncIterator[None]:
        """A context that has exclusive use of the arm; leaving it brings the arm to rest."""
        await self.ready(operation)
        self.operation, self._has_context = operation, True
        try:
            yield
        except BaseException:
            if self.driver.program_running:
                self.driver.idle()
            raise
        finally:
            self._has_context = False
        if not self.driver.program_running or self.diagnosis.alarm.is_set():
            raise await self.readiness.end_error(operation)
        await self.come_to_rest()

    async def settle(self, operation: str) -> None:
        """Wait until a command is in effect, because the next message travels on another connection."""
        for _ in range(_SETTLE_STATES):
            await self.diagnosis.next_state(operation)

    async def tune(self, operation: str, **parameters: float | None) -> None:
        """Set how setpoints are followed; parameters are those of `URDriver.set_stream_parameters`."""
        parameters = {name: value for name, value in ({**_DEFAULTS, **parameters}).items() if value is not None}
        if parameters == self._stream_parameters:
            return
        self.driver.set_stream_parameters(**parameters)  # type: ignore[arg-type] # names of floats
        self._stream_parameters = parameters
        await self.settle(operation)

    # waiting and stopping

    async def wait_done(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the motion under way, if any, and raise its error.

        Raises WaitTimeoutError if it takes longer than ``timeout_s``; the motion continues.
        """
        motion, operation = self._motion, self.operation
        if motion is None:
            return
        await asyncio.wait({motion}, timeout=timeout_s)
        if not motion.done():
            raise WaitTimeoutError(f"{operation} is still under way after {timeout_s} s: wait_done() again, or stop()")
        if self._motion is motion:
            self._motion = None
        if motion.cancelled():
            raise MotionStoppedError(operation, self._replaced.get(motion, "stop() was called"))
        motion.result()

    async def wait_for(self, condition: Callable[[RobotState], bool], timeout_s: float | None = None) -> RobotState:
        """Check every state until the condition is true for one of them, and return that state.

        Raises WaitTimeoutError, the error that ends the motion under way, and RobotUnreachableError if the robot stops
        sending states. The condition must be quick and must not call the robot.
        """
        try:
            async with timeout(timeout_s):
                while not condition(state := await self.diagnosis.fresh_state("wait_for")):
                    if self._motion is not None and self._motion.done() and _failed(self._motion):
                        await self.wait_done()
                    await self.diagnosis.next_state("wait_for")
        except TimeoutError:
            raise WaitTimeoutError(f"the condition was not met within {timeout_s} s: wait again") from None
        return state

    async def stop(self, deceleration_rad_s2: float = DECELERATION) -> None:
        """Bring the arm to rest, and return when it is; a caller waiting for the motion gets MotionStoppedError.

        The control program continues and accepts the next motion. This stops motions that were started by this object;
        to stop another program, use ``driver.link.send_script("stop program")``.
        """
        self.stops += 1
        if self.driver.program_running and not self.diagnosis.paused:
            await self.tune("stop", deceleration_rad_s2=deceleration_rad_s2)
        motion, self._motion = self._motion, None
        had_failed = motion is not None and motion.done()
        if motion is not None:
            await _cancelled(motion)
        await self._rest()
        if motion is not None and had_failed:
            motion.result()  # raises a failure that has not been reported yet

    async def come_to_rest(self) -> None:
        """Stop sending setpoints, and wait until the target speeds of all joints are zero.

        Raises LateSetpointError, and what `Readiness.end_error` finds, if not all setpoints were followed.
        """
        failure = await self._rest()
        if failure is not None:
            raise failure

    async def _rest(self) -> Exception | None:
        """Come to rest; returns what kept setpoints from being followed.

        The arm of a program that has just ended, or was lost, is still coming to rest.
        """
        if self.diagnosis.paused:
            return None
        running, failure = self.driver.program_running, None
        if running and self.driver.reverse.mode is ControlMode.FORWARD:
            with suppress(ClientError, LocalProtocolError):  # no trajectory is under way, or it ended some other way
                await self.driver.trajectory_result(_REST_S)
        elif running:
            self.driver.idle()
            failure = await self._wait_until_read()
        await self.diagnosis.state_from_now("stop")
        with suppress(TimeoutError):
            async with timeout(_REST_S):
                while not self.state.at_rest:
                    await self.diagnosis.next_state("stop")
        return failure

    async def _wait_until_read(self) -> Exception | None:
        """Wait until the program has read all messages; return the error if some were lost, or came too late."""
        try:
            ignored = await self.driver.program.wait_until_read()
        except PROGRAM_GONE:
            return await self.readiness.end_error(self.operation)
        except NoAnswerError:  # it is paused, or the robot is stopped
            return None
        if ignored:
            return LateSetpointError(self.operation, f"a setpoint was late, and the robot ignored {ignored} after it")
        return None

    async def _replace(self, operation: str, *, rolling: bool) -> None:
        """End a motion that no caller waits for, since another motion replaces it.

        rolling: one stream of speeds replaces another without a stop in between.
        """
        motion = self._motion
        if motion is None or motion.done() or motion is self._awaited:
            return
        self._motion, self.rolling = None, rolling
        self._replaced[motion] = f"{operation} replaced it"
        try:
            await _cancelled(motion)
        finally:
            self.rolling = False
        if self.driver.program_running and self.driver.reverse.mode is ControlMode.FORWARD:
            with suppress(ClientError, LocalProtocolError):  # no trajectory is under way, or it ended some other way
                await self.driver.trajectory_result(_REST_S)

    async def _run(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Run the motion, and raise the cause if it fails, or if the robot stops for safety while the program waits."""
        operation = self.operation
        task = asyncio.create_task(work())
        alarm = asyncio.create_task(self.diagnosis.alarm.wait())
        try:
            await self._wait_for_any(operation, task, alarm)
            if task.done() and not isinstance(task.exception(), PROGRAM_GONE):
                return task.result()
        finally:
            await _cancelled(task)
            await _cancelled(alarm)
        raise await self.readiness.end_error(operation)

    async def _wait_for_any(self, operation: str, *tasks: "asyncio.Task[Any]") -> None:
        """Wait until a task is done; meanwhile warn of what keeps the arm from moving without ending its motion."""
        quiet_s = 0.0  # until the next warning
        while not (await asyncio.wait(tasks, timeout=_STUCK_S, return_when=asyncio.FIRST_COMPLETED))[0]:
            why = self._stuck_reason()
            quiet_s = max(quiet_s - _STUCK_S, 0.0) if why else 0.0
            if why and not quiet_s:
                _logger.warning("%s waits: %s", operation, why)
                quiet_s = _REMIND_S

    def _stuck_reason(self) -> str:
        """Say why the arm does not move although a motion is under way; "" if it may."""
        if self.diagnosis.paused:
            return "the robot's program is paused: resume it on the robot, or stop()"
        if self.state.speed_fraction == 0.0:
            return "the speed slider is at 0 %: raise it on the pendant, or set_speed_slider()"
        return ""

    def _program_changed(self, connected: bool) -> None:
        if connected:
            self._stream_parameters = _DEFAULTS  # a newly started program has the defaults


def _failed(motion: "asyncio.Task[None]") -> bool:
    return motion.cancelled() or motion.exception() is not None


async def _cancelled(task: "asyncio.Task[Any]") -> None:
    """Cancel a task and wait until it has ended; its failure is left to the caller that awaits it."""
    task.cancel()
    await asyncio.wait({task})
    if not task.cancelled():
        task.exception()  # marks it as retrieved, so that asyncio does not log it
