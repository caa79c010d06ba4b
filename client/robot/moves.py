"""Motions that end by themselves: trajectories, speeds for a duration, approach until contact."""

import asyncio
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from client.errors import LateSetpointError, MotionError, MotionStoppedError, NoAnswerError
from client.quantities import QUANTITIES, points_of
from client.robot.motion import MotionRunner
from client.robot.reach import reach_of
from client.robot.state import RobotState
from urproto.errors import LocalProtocolError
from urproto.external_control import Query, TrajectoryPoint, TrajectoryResult

_READ_STATES: Final = 20  # guess: messages sent while the arm returned from a contact are read within this
_LONG_WAIT_S: Final = 0.1  # guess: half of the time that a robot waits for a setpoint


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of the motion under way.

    operation: its name, empty without one. running: whether it is under way. point: index of the point that the arm is
    moving to, from 0; points: number of points. Both are 0 for motions without points. With a blend, a point counts
    from where the move to it begins.
    """

    operation: str
    running: bool
    point: int
    points: int


class Moves:
    """The three kinds of motion behind the moves of `AsyncRobot`, which documents them."""

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver
        self._diagnosis = motion.diagnosis
        self._points: Sequence[TrajectoryPoint] = ()  # of the current or last motion

    async def progress(self) -> MotionProgress:
        """Progress of the motion under way, as the robot reports it."""
        point, executing = await self._motion.readiness.query("progress", Query.PROGRESS)
        points = len(self._points) if self._motion.moving else 0
        running = self._motion.moving and (bool(executing) or not points)
        return MotionProgress(
            self._motion.operation if running else "", running, max(0, round(point) - 1) if points else 0, points
        )

    async def execute(self, operation: str, moves: Iterable[TrajectoryPoint], wait: bool) -> None:
        """Execute points as one trajectory. Raises OutOfReachError before anything moves."""
        moves = points_of(moves)
        await self._motion.ready(operation)
        if reach := reach_of(self._driver.robot, self._motion.state.q_rad):
            reach.check(operation, moves)
        self._points = moves
        await self._motion.launch(operation, partial(self._follow_points, operation, moves), wait)

    async def _follow_points(self, operation: str, moves: list[TrajectoryPoint]) -> None:
        popups = self._driver.robot.popups
        popups.clear()
        program = self._driver.program
        losses = program.losses
        try:
            result = await self._driver.execute(moves)
        except NoAnswerError:
            raise self._diagnosis.unreachable(operation) from None
        if result is TrajectoryResult.FAILURE:
            raise MotionError(operation, "its points did not reach the robot in time: check the network")
        if result is TrajectoryResult.CANCELED and not popups:
            await self._diagnosis.wait_for_messages(
                lambda: bool(popups or program.losses > losses or program.keep_alive.stop_reason)
            )
        if result is TrajectoryResult.CANCELED and (program.losses > losses or program.keep_alive.stop_reason):
            raise await self._motion.readiness.end_error(operation)
        if result is TrajectoryResult.CANCELED and popups:
            raise MotionError(operation, popups[-1].text)
        if result is TrajectoryResult.CANCELED:
            raise MotionStoppedError(operation, "it was cancelled")

    async def come_to_rest(self) -> None:
        """Bring the arm to rest, after a motion whose caller gave up."""
        await self._motion.come_to_rest()

    async def send_speeds(
        self, operation: str, send: Callable[[RobotState], None], duration_s: float, acceleration: float, wait: bool
    ) -> None:
        """Call ``send`` with every state for ``duration_s``, then come to rest."""
        if not duration_s > 0.0:
            raise LocalProtocolError(f"the duration of {operation} must be above 0 s, not {duration_s}")
        await self._motion.ready(operation, rolling=True)
        await self._motion.tune(operation, acceleration=acceleration)
        self._motion.check_not_busy(operation)
        self._points = ()
        await self._motion.launch(operation, partial(self._send_for, operation, send, duration_s), wait)

    async def _send_for(self, operation: str, send: Callable[[RobotState], None], duration_s: float) -> None:
        end_s = (await self._diagnosis.fresh_state(operation)).timestamp_s + duration_s
        try:
            await self._repeat(operation, send, lambda state: state.timestamp_s >= end_s)
        finally:
            if self._driver.program_running and not self._motion.rolling:
                self._driver.idle()
        await self._motion.come_to_rest()

    async def _repeat(
        self, operation: str, send: Callable[[RobotState], None], done: Callable[[RobotState], bool]
    ) -> None:
        """Call ``send`` with every state until ``done``.

        Raises LateSetpointError if this machine was late, and MotionError if the robot's states were.
        """
        waited_s = 0.0
        while not done(state := await self._diagnosis.fresh_state(operation)):
            try:
                send(state)
            except LateSetpointError as late:
                stood_still = self._driver.robot.feed.standstill.describe()
                if stood_still or waited_s < _LONG_WAIT_S:
                    why = f"{late.late} ({stood_still})" if stood_still else late.late
                    raise LateSetpointError(operation, why) from None
                raise MotionError(
                    operation,
                    f"the robot's next state came after {waited_s:.2f} s, too late for the next setpoint, so the robot "
                    "stopped the arm: check the network and the robot",
                ) from None
            began_s = time.monotonic()
            await self._diagnosis.next_state(operation)
            waited_s = time.monotonic() - began_s

    async def until_contact(
        self,
        velocity: Sequence[float],
        direction_base: Sequence[float],
        acceleration: float,
        timeout_s: float,
        wait: bool,
    ) -> None:
        """Move the TCP until the tool touches something, and return to where the contact began."""
        operation = "move_until_contact"
        self._driver.robot.require("contact")
        work = partial(self._approach, operation, velocity, direction_base, timeout_s)
        await self._motion.ready(operation)
        await self._motion.tune(operation, acceleration=acceleration)
        self._points = ()
        await self._motion.launch(operation, work, wait)

    async def _approach(
        self, operation: str, velocity: Sequence[float], direction_base: Sequence[float], timeout_s: float
    ) -> None:
        end_s = (await self._diagnosis.fresh_state(operation)).timestamp_s + timeout_s
        self._driver.start_tool_contact(direction_base)
        result = asyncio.create_task(self._driver.tool_contact_result())

        def send(state: RobotState) -> None:
            if state.timestamp_s >= end_s:
                raise MotionError(operation, f"the tool touched nothing within {timeout_s:g} s")
            self._driver.speedl(velocity)

        try:
            await self._repeat(operation, send, lambda _: result.done())
            result.result()
        finally:
            result.cancel()
            await asyncio.gather(result, return_exceptions=True)
            if self._driver.program_running:
                self._driver.idle()
                for _ in range(_READ_STATES):  # while it watches for contact it ignores velocities still on their way
                    await self._diagnosis.next_state(operation)
                self._driver.end_tool_contact()
        await self._motion.come_to_rest()


def frame_rotation(frame: str | Sequence[float]) -> Sequence[float] | None:
    """The rotation vector of a frame in the base frame; None for the tool's."""
    if frame == "base":
        return (0.0, 0.0, 0.0)
    if frame == "tool":
        return None
    if isinstance(frame, str):
        raise LocalProtocolError(f'a frame is "base", "tool" or a pose, not {frame!r}')
    QUANTITIES["frame_base"].check(frame)
    return frame[3:]
