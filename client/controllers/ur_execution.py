"""Execution on the robot: trajectories and motion primitives that controllers hand over through interfaces."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from typing import Final

from client.controllers.controller import NO_COMMAND
from client.controllers.goals import PrimitiveType
from client.controllers.motion_primitives import (
    PRIMITIVE_COMMANDS,
    READY,
    STATUS,
    ExecutionStatus,
    Marker,
    point_of,
    primitive_of,
)
from client.controllers.passthrough import PASSTHROUGH, POINT, Transfer
from client.controllers.ur_commands import Spawn, URCommands
from client.controllers.ur_states import URStates
from client.driver import URDriver, points
from urproto.errors import URError
from urproto.external_control import TrajectoryPoint, TrajectoryResult
from urproto.joints import JOINT_NAMES

_STATE: Final = f"{PASSTHROUGH}/transfer_state"
_ABORT: Final = f"{PASSTHROUGH}/abort"

_logger = logging.getLogger(__name__)


class TrajectoryExecution:
    """At most one trajectory that the robot executes itself, and a callback for its end."""

    def __init__(self, driver: URDriver, spawn: Spawn) -> None:
        self._driver = driver
        self._spawn = spawn
        self._task: asyncio.Task[None] | None = None
        self._succeeded = False

    @property
    def under_way(self) -> bool:
        """True from `start` until ``ended`` is called."""
        return self._task is not None

    def start(self, moves: Sequence[TrajectoryPoint], ended: Callable[[bool], object]) -> None:
        """Let the robot execute moves; ``ended`` is called with True if it executed all of them."""

        def end(_: object) -> None:
            self._task = None
            ended(self._succeeded)

        self._succeeded = False
        self._task = self._spawn(self._execute(moves))
        self._task.add_done_callback(end)

    def cancel(self) -> None:
        """Stop the trajectory, if one is under way."""
        if self._task is not None:
            self._task.cancel()  # the driver passes the cancellation on to the robot

    async def _execute(self, moves: Sequence[TrajectoryPoint]) -> None:
        try:
            self._succeeded = await self._driver.execute(moves) is TrajectoryResult.SUCCESS
        except URError as error:
            _logger.error("%s", error)


class PassthroughExecution:
    """The hardware's side of `client.controllers.passthrough`.

    The controller has claimed its interfaces from `begin` to `end`. ready: whether the arm can move in this cycle;
    otherwise nothing is started.
    """

    def __init__(self, commands: URCommands, driver: URDriver, spawn: Spawn) -> None:
        self._commands = commands
        self._execution = TrajectoryExecution(driver, spawn)
        self._trajectory: list[TrajectoryPoint] = []
        self._last_s = 0.0
        self._active = False

    def begin(self) -> None:
        self._active = True

    def end(self) -> None:
        self._active = False
        self._execution.cancel()

    def step(self, *, ready: bool) -> None:
        commands = self._commands
        state = commands[_STATE]
        if commands[_ABORT] == 1.0 and state not in (Transfer.IDLE, Transfer.DONE):
            self._execution.cancel()
            if not self._execution.under_way:
                commands[_STATE] = Transfer.DONE
        elif state == Transfer.NEW_TRAJECTORY:
            self._trajectory, self._last_s = [], 0.0
            commands[_ABORT] = 0.0
            commands[_STATE] = Transfer.WAITING_FOR_POINT
        elif state == Transfer.TRANSFERRING:
            self._take_point()
            commands[_STATE] = Transfer.WAITING_FOR_POINT
        elif state == Transfer.TRANSFER_DONE and ready and not self._execution.under_way:
            commands[_STATE] = Transfer.IN_MOTION
            self._execution.start(self._trajectory, self._ended)

    def _take_point(self) -> None:
        parts = [
            self._commands.part([f"{PASSTHROUGH}/{part}_{joint}" for joint in range(len(JOINT_NAMES))]).get()
            for part in POINT
        ]
        q, qd, qdd = (None if any(value != value for value in part) else part for part in parts)
        time_s = self._commands[f"{PASSTHROUGH}/time_from_start"]
        assert q is not None  # the controller has checked it
        at_rest = [0.0] * len(JOINT_NAMES)
        self._trajectory.append(points.spline(q, qd or at_rest, time_s - self._last_s, qdd))
        self._last_s = time_s

    def _ended(self, succeeded: bool) -> None:
        if self._active:
            self._commands[_ABORT] = float(not succeeded)
            self._commands[_STATE] = Transfer.DONE


class PrimitivesExecution:
    """The hardware's side of `client.controllers.motion_primitives`, with the methods of `PassthroughExecution`."""

    def __init__(self, commands: URCommands, states: URStates, driver: URDriver, spawn: Spawn) -> None:
        self._commands = commands.part(PRIMITIVE_COMMANDS)
        self._states = states
        self._execution = TrajectoryExecution(driver, spawn)
        self._sequence: list[TrajectoryPoint] | None = None  # between two markers
        self._stopping = False
        states[STATUS], states[READY] = float(ExecutionStatus.IDLE), 0.0

    def begin(self) -> None:
        self._sequence, self._stopping = None, False
        self._set_idle()

    def end(self) -> None:
        self._states[READY] = 0.0
        self._execution.cancel()

    def step(self, *, ready: bool) -> None:
        values = self._commands.get()
        kind = values[0]
        if kind == kind and self._take(values, may_begin=ready and not self._execution.under_way):
            self._commands.fill(NO_COMMAND)

    def _take(self, values: Sequence[float], *, may_begin: bool) -> bool:
        kind = int(values[0])
        if kind == Marker.STOP_MOTION:
            self._stop()
        elif kind == Marker.RESET_STOP:
            self._set_idle()
        elif kind == Marker.SEQUENCE_START:
            self._sequence = []
        elif kind in set(PrimitiveType) and self._sequence is not None:
            self._sequence.append(point_of(primitive_of(values)))
        elif not may_begin:
            return False
        else:
            self._execute(values)
        return True

    def _execute(self, values: Sequence[float]) -> None:
        sequence, self._sequence = self._sequence, None
        moves = [point_of(primitive_of(values))] if sequence is None else sequence
        self._states[STATUS] = float(ExecutionStatus.EXECUTING)
        self._execution.start(moves, self._ended)

    def _stop(self) -> None:
        self._sequence = None
        self._states[READY] = 0.0
        self._stopping = self._execution.under_way
        self._states[STATUS] = float(ExecutionStatus.STOPPING if self._stopping else ExecutionStatus.STOPPED)
        self._execution.cancel()

    def _set_idle(self) -> None:
        self._states[STATUS], self._states[READY] = float(ExecutionStatus.IDLE), 1.0

    def _ended(self, succeeded: bool) -> None:
        stopped, self._stopping = self._stopping, False
        status = ExecutionStatus.SUCCESS if succeeded else ExecutionStatus.ERROR
        self._states[STATUS] = float(ExecutionStatus.STOPPED if stopped else status)
