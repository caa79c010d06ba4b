"""Setpoint streams: one setpoint for each state of the robot."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import Any, Final

from client.driver.control_program import SPEED_ACCELERATION
from client.driver.link import MOVABLE
from client.driver.reverse import MAX_REAL_TIME_S, StreamStatistics, read_timeout_ms
from client.driver.scheduling import real_time
from client.errors import ClientError, LateSetpointError, MotionError, MotionStoppedError
from client.robot.motion import MotionRunner
from client.robot.readiness import PROGRAM_GONE
from client.robot.state import RobotState
from urproto.external_control import ControlMode

_logger = logging.getLogger(__name__)

BlockingFollow = Callable[[Sequence[float]], RobotState]
"""`Follow` for a thread."""

_UNCHANGED: Final[Mapping[str, float | None]] = {}
_LATE_SHARE: Final = 0.01  # guess: share of control periods without a setpoint above which a warning is logged


class Follow:
    """Sends one setpoint (6,) per call, waits for the next new state, and returns it."""

    def __init__(self, motion: MotionRunner, operation: str, send: Callable[[Sequence[float]], None]) -> None:
        self._motion = motion
        self._link = motion.driver.link
        self._feed = motion.driver.link.feed
        self._silence_s = motion.driver.config.silence_s
        self._operation = operation
        self._send = send
        self._stops = motion.stops
        self._seen = self._feed.count

    async def __call__(self, setpoint: Sequence[float]) -> RobotState:
        """Send a setpoint from the event loop."""
        if not self._send_setpoint(setpoint):
            raise await self._motion.readiness.end_error(self._operation)
        if self._feed.count > self._seen:
            await asyncio.sleep(0)
        else:
            await self._motion.diagnosis.next_state(self._operation)
        self._seen = self._feed.count
        return await self._motion.diagnosis.fresh_state(self._operation)

    @contextmanager
    def from_thread(self, call: Callable[[Coroutine[Any, Any, Any]], Any]) -> Iterator[BlockingFollow]:
        """The form for a thread, which gets real-time priority; ``call`` runs a coroutine in the loop and waits."""
        with real_time(self._motion.driver.config.realtime):
            yield partial(self._follow, call)

    def _follow(self, call: Callable[[Coroutine[Any, Any, Any]], Any], setpoint: Sequence[float]) -> RobotState:
        """Send a setpoint, bypassing the event loop."""
        if not self._send_setpoint(setpoint):
            raise call(self._motion.readiness.end_error(self._operation))
        try:
            self._feed.wait(self._seen, self._silence_s)
        except ClientError:
            raise self._motion.diagnosis.unreachable(self._operation) from None
        self._seen = self._feed.count
        return RobotState(self._feed.fresh())

    def _send_setpoint(self, setpoint: Sequence[float]) -> bool:
        """Send a setpoint; False if the stream has ended for a cause that the caller has to find out."""
        if self._motion.stops != self._stops:
            raise MotionStoppedError(self._operation, "stop() was called")
        if popups := self._link.popups:
            raise MotionError(self._operation, popups[-1].text)
        if self._link.safety_mode not in MOVABLE:
            return False
        self._motion.diagnosis.check_not_paused(self._operation)
        try:
            self._send(setpoint)
        except LateSetpointError as late:
            raise LateSetpointError(self._operation, late.late) from None
        except PROGRAM_GONE:
            return False
        return True


class Streams:
    """The setpoint streams of `AsyncRobot`."""

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver

    @asynccontextmanager
    async def servo_j(
        self,
        timeout_s: float = MAX_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """Follow a stream of joint angles, one setpoint in every control period.

            with robot.servo_j() as follow:
                while not done:
                    state = follow(next_target(state))     # (6,) [rad]; paces the loop

        timeout_s: without a setpoint for this long (at most 0.2 s) the robot stops the arm, and the next setpoint
        raises LateSetpointError; the control program continues. Leaving the block raises it too, or ProgramEndedError,
        if setpoints were lost on their way. lookahead_s (0.03 to 0.2, longer is smoother) and gain (100 to 2000,
        higher is stiffer): parameters of servoj; None takes those of the configuration. The robot ignores setpoints
        that are too far away, which raises MotionError. `stream` has statistics.
        """
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_j", self._driver.servoj, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def servo_pose(
        self,
        timeout_s: float = MAX_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """Like `servo_j`, with poses base to TCP (6,) [m, rotation vector]."""
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_pose", self._driver.servo_pose, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_j(
        self, timeout_s: float = MAX_REAL_TIME_S, *, acceleration_rad_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """Like `servo_j`, with joint speeds (6,) [rad/s].

        With the default acceleration, speeds are reached almost instantly: the caller provides the ramps.
        """
        tuning = {"acceleration": acceleration_rad_s2}
        async with self._stream("velocity_j", self._driver.speedj, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_l(
        self, timeout_s: float = MAX_REAL_TIME_S, *, acceleration_m_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """Like `velocity_j`, with TCP velocities in the base frame (6,) [m/s, rad/s]."""
        tuning = {"acceleration": acceleration_m_s2}
        async with self._stream("velocity_l", self._driver.speedl, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def direct_torque(self, timeout_s: float = MAX_REAL_TIME_S) -> AsyncIterator[Follow]:
        """Like `servo_j`, with joint torques (6,) [Nm] in addition to gravity compensation; PolyScope 5.23 or newer.

        `URDriver.set_friction_scales` (5.25.1) and `set_friction_compensation` set how much friction the robot
        compensates.
        """
        async with self._stream("direct_torque", self._driver.torque, timeout_s) as follow:
            yield follow

    @property
    def stream(self) -> StreamStatistics:
        """Statistics of the current or last setpoint stream: sent, skipped and late setpoints, longest gap."""
        return self._driver.reverse.stream

    @asynccontextmanager
    async def _stream(
        self,
        operation: str,
        send: Callable[[Sequence[float], float], None],
        timeout_s: float,
        tuning: Mapping[str, float | None] = _UNCHANGED,
    ) -> AsyncIterator[Follow]:
        """Reserve the arm for setpoints sent through ``send``; logs statistics of the stream at its end.

        Raises LocalProtocolError for a ``timeout_s`` that the robot does not honour.
        """
        reverse = self._driver.reverse
        read_timeout_ms(ControlMode.SERVOJ, timeout_s, reverse.period_s)
        async with self._motion.exclusive(operation):
            await self._motion.tune(operation, **tuning)
            self._driver.link.popups.clear()
            yield Follow(self._motion, operation, lambda setpoint: send(setpoint, timeout_s))
            if why := reverse.pop_late_reason():
                raise LateSetpointError(operation, why)
            stream = reverse.stream
            level = logging.WARNING if stream.skipped > _LATE_SHARE * stream.sent else logging.INFO
            _logger.log(level, "%s: %s", operation, stream)
