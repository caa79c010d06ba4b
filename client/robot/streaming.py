"""Setpoint streams: one setpoint for each state of the robot."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, Final

from client.driver.endpoint import read_timeout_ms
from client.driver.robot import MOVABLE
from client.errors import ClientError, LateSetpointError, MotionError, MotionStoppedError
from client.robot.motion import MotionRunner
from client.robot.readiness import PROGRAM_GONE
from client.robot.state import RobotState
from urproto.external_control import ControlMode

_logger = logging.getLogger(__name__)

_UNCHANGED: Final[Mapping[str, float | None]] = {}
_LATE_SHARE: Final = 0.01  # guess: share of control periods without a setpoint above which a warning is logged


class Follow:
    """Sends one setpoint (6,) per call, waits for the next new state, and returns it."""

    def __init__(self, motion: MotionRunner, operation: str, send: Callable[[Sequence[float]], None]) -> None:
        self._motion = motion
        self._link = motion.driver.robot
        self._feed = motion.driver.robot.feed
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

    def from_thread(self, call: Callable[[Coroutine[Any, Any, Any]], Any], setpoint: Sequence[float]) -> RobotState:
        """Send a setpoint from a thread, bypassing the event loop; ``call`` runs a coroutine in the loop and waits."""
        if not self._send_setpoint(setpoint):
            raise call(self._motion.readiness.end_error(self._operation))
        try:
            self._feed.wait(self._seen, self._silence_s)
        except ClientError:
            raise self._motion.diagnosis.unreachable(self._operation) from None
        self._seen = self._feed.count
        return RobotState.of(self._feed.fresh())

    def _send_setpoint(self, setpoint: Sequence[float]) -> bool:
        """Send a setpoint; False if the stream has ended for a cause that the caller has to find out."""
        if self._motion.stops != self._stops:
            raise MotionStoppedError(self._operation, "stop() was called")
        if popups := self._link.popups:
            raise MotionError(self._operation, popups[-1].text)
        if self._link.safety_mode not in MOVABLE:
            return False
        try:
            self._send(setpoint)
        except LateSetpointError as late:
            raise LateSetpointError(self._operation, late.late) from None
        except PROGRAM_GONE:
            return False
        return True


@asynccontextmanager
async def setpoint_stream(
    motion: MotionRunner,
    operation: str,
    send: Callable[[Sequence[float], float], None],
    timeout_s: float,
    tuning: Mapping[str, float | None] = _UNCHANGED,
) -> AsyncIterator[Follow]:
    """Reserve the arm for setpoints sent through ``send`` with the timeout; logs statistics of the stream at its end.

    Raises LocalProtocolError for a ``timeout_s`` that the robot does not honour.
    """
    read_timeout_ms(ControlMode.SERVOJ, timeout_s, motion.driver.reverse.period_s)
    async with motion.exclusive(operation):
        await motion.tune(operation, **tuning)
        motion.driver.robot.popups.clear()
        yield Follow(motion, operation, lambda setpoint: send(setpoint, timeout_s))
        if why := motion.driver.reverse.pop_late_reason():
            raise LateSetpointError(operation, why)
        stream = motion.driver.reverse.stream
        level = logging.WARNING if stream.skipped > _LATE_SHARE * stream.sent else logging.INFO
        _logger.log(level, "%s: %s", operation, stream)
