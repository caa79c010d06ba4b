"""What lasts as long as a with block: servoing, velocities, freedrive, force mode."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, Final

from client.control_program import SPEED_ACCELERATION
from client.driver.endpoint import LONGEST_REAL_TIME_S, StreamStatistics
from client.driver.robot import MOVABLE
from client.errors import (
    ClientError,
    LateSetpointError,
    MotionError,
    MotionStoppedError,
    ProgramEndedError,
    ProgramNotRunningError,
)
from client.robot.core import SETTLE_STATES, RobotCore
from client.robot.state import RobotState

_logger = logging.getLogger(__name__)

_AS_IT_IS: Final[Mapping[str, float | None]] = {}
_MANY: Final = 0.01  # guess: so many control periods without a setpoint are worth a warning
_SLOW: Final = (0.1, 0.1, 0.1, 0.17, 0.17, 0.17)  # m/s, rad/s where it complies, m, rad elsewhere; guess: slow


class Contexts(RobotCore):
    """The arm obeys one of these at a time; leaving the block brings it to rest. Errors are those of the moves."""

    @asynccontextmanager
    async def servo_j(
        self,
        timeout_s: float = LONGEST_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator["Follow"]:
        """Follow joint angles, one set in every control period.

            with robot.servo_j() as follow:
                while not done:
                    state = follow(next_target(state))     # (6,) [rad]; paces the loop

        timeout_s: without a target for so long (at most 0.2 s) the robot stops the arm, and the next
        target is a LateSetpointError; the program goes on. lookahead_s (0.03 to 0.2, longer is smoother)
        and gain (100 to 2000, higher is stiffer): of servoj, None for those of the configuration. Targets
        too far away are ignored by the robot: MotionError says so. `stream` tells how it went.
        """
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_j", lambda q_rad: self.driver.servoj(q_rad, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def servo_pose(
        self,
        timeout_s: float = LONGEST_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator["Follow"]:
        """As servo_j with poses base to TCP (6,) [m, rotation vector]."""
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_pose", lambda pose: self.driver.servo_pose(pose, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_j(
        self, timeout_s: float = LONGEST_REAL_TIME_S, *, acceleration_rad_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator["Follow"]:
        """As servo_j with joint speeds (6,) [rad/s]; by default they are reached at once, so ramps are the caller's."""
        tuning = {"acceleration": acceleration_rad_s2}
        async with self._stream("velocity_j", lambda qd: self.driver.speedj(qd, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_l(
        self, timeout_s: float = LONGEST_REAL_TIME_S, *, acceleration_m_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator["Follow"]:
        """As velocity_j with velocities of the TCP in the base frame (6,) [m/s, rad/s]."""
        tuning = {"acceleration": acceleration_m_s2}
        async with self._stream("velocity_l", lambda xd: self.driver.speedl(xd, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def direct_torque(self, timeout_s: float = LONGEST_REAL_TIME_S) -> AsyncIterator["Follow"]:
        """As servo_j with joint torques (6,) [Nm] on top of what gravity needs; from 5.23 on.

        How much friction the robot makes up for: `URDriver.set_friction_scales` (5.25.1), `set_friction_compensation`.
        """
        async with self._stream("direct_torque", lambda torque_Nm: self.driver.torque(torque_Nm, timeout_s)) as follow:
            yield follow

    @asynccontextmanager
    async def freedrive(
        self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = (0.0,) * 6
    ) -> AsyncIterator[None]:
        """Let the arm be moved by hand, and hold it where it is left.

        axes: 1 for those (6,) that are free, of a frame given in the base frame (6,) [m, rotation vector]; fewer
        than all from 5.10 on.
        """
        async with self._holding("freedrive"):
            self.driver.set_freedrive_axes(axes, frame_base)
            for _ in range(SETTLE_STATES):
                await self._next_state("freedrive")
            self.driver.start_freedrive()
            yield

    @asynccontextmanager
    async def force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        *,
        kind: int = 2,
        limits: Sequence[float] = _SLOW,
        damping: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> AsyncIterator[None]:
        """Comply along some axes of a frame, while moves go on along the others.

        task_frame_base: pose in the base frame (6,) [m, rotation vector]. selection: 1 for
        axes that comply (6,). wrench: to press with (6,) [N, Nm]. kind: 1 the frame's y axis
        points to the TCP, 2 the frame as it is, 3 its x axis follows the velocity. limits: top
        speeds of complying axes [m/s, rad/s], deviations of the others [m, rad] (6,).
        damping: 0 to 1. gain_scaling: 0 to 2, e-Series only.
        """
        await self._ready("force_mode")
        self.driver.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        for _ in range(SETTLE_STATES):
            await self._next_state("force_mode")
        try:
            yield
        finally:
            if self.driver.program_running:  # it ends with the program
                self.driver.end_force_mode()
        if not self.driver.program_running:
            raise await self._explanation("force_mode")
        if not self.moving:
            await self._come_to_rest()

    @property
    def stream(self) -> StreamStatistics:
        """How the setpoints of the present or the last such block went out: sent, skipped, late, longest gap."""
        return self.driver.reverse.stream

    @asynccontextmanager
    async def _stream(
        self, doing: str, send: Callable[[Sequence[float]], None], tuning: Mapping[str, float | None] = _AS_IT_IS
    ) -> AsyncIterator["Follow"]:
        async with self._holding(doing):
            await self._tune(doing, **tuning)
            self.driver.robot.popups.clear()
            yield Follow(self, doing, send)
            if why := self.driver.reverse.take_late():
                raise LateSetpointError(doing, why)
            stream = self.stream
            level = logging.WARNING if stream.skipped > _MANY * stream.sent else logging.INFO
            _logger.log(level, "%s: %s", doing, stream)


class Follow:
    """Send one setpoint (6,), wait for a state that was not seen yet, return that."""

    def __init__(self, robot: Contexts, doing: str, send: Callable[[Sequence[float]], None]) -> None:
        self._robot = robot
        self._doing = doing
        self._send = send
        self._stops = robot._stops
        self._feed = robot.driver.robot.feed
        self._seen = self._feed.count

    async def __call__(self, setpoint: Sequence[float]) -> RobotState:
        """From the event loop."""
        if not self._put(setpoint):
            raise await self._robot._explanation(self._doing)
        if self._feed.count > self._seen:
            await asyncio.sleep(0)
        else:
            await self._robot._next_state(self._doing)
        self._seen = self._feed.count
        return self._robot.state

    def from_thread(self, call: Callable[[Coroutine[Any, Any, Any]], Any], setpoint: Sequence[float]) -> RobotState:
        """From a thread, past the event loop; ``call`` runs a coroutine in it and waits."""
        if not self._put(setpoint):
            raise call(self._robot._explanation(self._doing))
        try:
            self._feed.wait(self._seen, self._robot.driver.config.silence_s)
        except ClientError:
            raise self._robot._unreachable(self._doing) from None
        self._seen = self._feed.count
        return self._robot.state

    def _put(self, setpoint: Sequence[float]) -> bool:
        """Send it; False when there is a trouble to be explained."""
        robot = self._robot
        if robot._stops != self._stops:
            raise MotionStoppedError(self._doing, "stop() was called")
        if popups := robot.driver.robot.popups:
            raise MotionError(self._doing, popups[-1].text)
        if robot.driver.robot.safety_mode not in MOVABLE:
            return False
        try:
            self._send(setpoint)
        except LateSetpointError as late:
            raise LateSetpointError(self._doing, late.late) from None
        except (ProgramNotRunningError, ProgramEndedError):
            return False
        return True
