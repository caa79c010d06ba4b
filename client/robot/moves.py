"""Motions that end by themselves: trajectories, speeds for a duration, approach until contact."""

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from client.driver import points
from client.driver.control_program import SPEED_ACCELERATION
from client.driver.reverse import MAX_REAL_TIME_S
from client.errors import LateSetpointError, MotionError, MotionStoppedError, NoAnswerError
from client.quantities import QUANTITIES, points_of
from client.robot.motion import MotionRunner
from client.robot.reach import reach_of
from client.robot.state import RobotState
from urproto.errors import LocalProtocolError
from urproto.external_control import SCALE, Query, TrajectoryPoint, TrajectoryResult
from urproto.robots.pose import Pose, pose_trans
from urproto.vectors import ZERO6

_JOINT_SPEED: Final = 1.04  # rad/s and rad/s2, m/s and m/s2: the defaults of URScript
_JOINT_ACCELERATION: Final = 1.4
_TOOL_SPEED: Final = 0.25
_TOOL_ACCELERATION: Final = 1.2
_JOG_ACCELERATION: Final = 0.5  # m/s2, ur_rtde's default
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
    """The moves of `AsyncRobot`, of three kinds: points, speeds for a duration, speeds until a contact."""

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver
        self._diagnosis = motion.diagnosis
        self._points: Sequence[TrajectoryPoint] = ()  # of the current or last motion

    async def progress(self) -> MotionProgress:
        """Progress of the motion under way, as the robot reports it."""
        point, executing = await self._motion.readiness.query("progress", Query.PROGRESS)
        count = len(self._points) if self._motion.moving else 0
        running = self._motion.moving and (bool(executing) or not count)
        index = max(0, round(point * SCALE) - 1) if count else 0
        return MotionProgress(self._motion.operation if running else "", running, index, count)

    async def move_j(
        self,
        q_rad: Sequence[float] | None = None,
        *,
        pose_base_tcp: Sequence[float] | None = None,
        near_q_rad: Sequence[float] | None = None,
        speed_rad_s: float = _JOINT_SPEED,
        acceleration_rad_s2: float = _JOINT_ACCELERATION,
        duration_s: float = 0.0,
        wait: bool = True,
    ) -> None:
        """Move all joints at the same time to joint angles, or to a pose.

        A pose is reached by the inverse kinematics solution nearest to ``near_q_rad``, by default to the present joint
        angles. Speed and acceleration apply to the joint with the longest distance; a duration above 0 replaces both.
        """
        speeds = {"v": speed_rad_s, "a": acceleration_rad_s2, "duration_s": duration_s}
        if (q_rad is None) == (pose_base_tcp is None):
            raise LocalProtocolError("move_j takes either joint angles or a pose: give one of them")
        if q_rad is not None:
            point = points.movej(q_rad, **speeds)
        else:
            assert pose_base_tcp is not None
            point = points.movej_pose(pose_base_tcp, near_q_rad=near_q_rad, **speeds)
        await self.execute("move_j", [point], wait)

    async def move_l(
        self,
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        duration_s: float = 0.0,
        wait: bool = True,
    ) -> None:
        """Move the TCP in a straight line; a duration above 0 replaces speed and acceleration."""
        point = points.movel(pose_base_tcp, v=speed_m_s, a=acceleration_m_s2, duration_s=duration_s)
        await self.execute("move_l", [point], wait)

    async def move_p(
        self,
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the TCP in a straight line at constant speed, for processes such as gluing."""
        await self.execute("move_p", [points.movep(pose_base_tcp, v=speed_m_s, a=acceleration_m_s2)], wait)

    async def move_c(
        self,
        via_base_tcp: Sequence[float],
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        fixed_orientation: bool = False,
        wait: bool = True,
    ) -> None:
        """Move the TCP on the circular arc through ``via_base_tcp``.

        The orientation is interpolated towards the target's, or with ``fixed_orientation`` stays fixed relative to the
        arc.
        """
        point = points.movec(
            via_base_tcp, pose_base_tcp, v=speed_m_s, a=acceleration_m_s2, fixed_orientation=fixed_orientation
        )
        await self.execute("move_c", [point], wait)

    async def sequence(self, moves: Iterable[TrajectoryPoint], *, wait: bool = True) -> None:
        """Execute moves of `client.points` as one trajectory, without stopping where they blend.

        With ``points.movel(pose, blend_radius_m=0.02)`` the next move begins 2 cm before the pose. The last move must
        not blend.
        """
        await self.execute("the sequence", moves, wait)

    async def speed_j(
        self,
        qd_rad_s: Sequence[float],
        duration_s: float,
        *,
        acceleration_rad_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the joints at speeds (6,) [rad/s] for ``duration_s``, then come to rest.

        A call that replaces a previous one continues from its speeds, without a stop in between.
        """
        send = partial(self._driver.speedj, qd_rad_s)
        await self._send_speeds("speed_j", lambda _: send(), duration_s, acceleration_rad_s2, wait)

    async def speed_l(
        self,
        velocity_base: Sequence[float],
        duration_s: float,
        *,
        acceleration_m_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the TCP at a velocity in the base frame (6,) [m/s, rad/s] for ``duration_s``, then come to rest."""
        send = partial(self._driver.speedl, velocity_base)
        await self._send_speeds("speed_l", lambda _: send(), duration_s, acceleration_m_s2, wait)

    async def jog(
        self,
        velocity: Sequence[float],
        *,
        frame: str | Sequence[float] = "base",
        acceleration_m_s2: float = _JOG_ACCELERATION,
    ) -> None:
        """Move the TCP at a velocity (6,) [m/s, rad/s] until `stop` or the next motion; returns immediately.

        frame: axes of the velocity: "base", "tool" (the TCP's axes, which turn with it), or those of a pose in the base
        frame (6,). Call it again to change the velocity: there is no stop in between.
        """
        turn = _frame_rotation(frame)

        def send(state: RobotState) -> None:
            x, y, z = state.pose_base_tcp[3:] if turn is None else turn
            rotation: Pose = (0.0, 0.0, 0.0, x, y, z)
            linear = pose_trans(rotation, (*velocity[:3], 0.0, 0.0, 0.0))[:3]
            angular = pose_trans(rotation, (*velocity[3:], 0.0, 0.0, 0.0))[:3]
            self._driver.speedl((*linear, *angular), MAX_REAL_TIME_S)

        await self._send_speeds("jog", send, math.inf, acceleration_m_s2, False)

    async def execute(self, operation: str, moves: Iterable[TrajectoryPoint], wait: bool) -> None:
        """Execute points as one trajectory. Raises OutOfReachError before anything moves."""
        moves = points_of(moves)
        await self._motion.ready(operation)
        if reach := reach_of(self._driver.link, self._motion.state.q_rad):
            reach.check(operation, moves)
        self._points = moves
        await self._motion.launch(operation, partial(self._follow_points, operation, moves), wait)

    async def _follow_points(self, operation: str, moves: list[TrajectoryPoint]) -> None:
        popups = self._driver.link.popups
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

    async def _send_speeds(
        self, operation: str, send: Callable[[RobotState], None], duration_s: float, acceleration: float, wait: bool
    ) -> None:
        if not duration_s > 0.0:
            raise LocalProtocolError(f"the duration of {operation} must be above 0 s, not {duration_s}")
        await self._motion.ready(operation, rolling=True)
        await self._motion.tune(operation, acceleration=acceleration)
        self._motion.check_not_busy(operation)
        self._points = ()
        await self._motion.launch(operation, partial(self._send_for, operation, send, duration_s), wait)

    async def _send_for(self, operation: str, send: Callable[[RobotState], None], duration_s: float) -> None:
        end_s = (await self._first_state(operation)).timestamp_s + duration_s
        try:
            await self._repeat(operation, send, lambda state: state.timestamp_s >= end_s)
        finally:
            if self._driver.program_running and not self._motion.rolling:
                self._driver.idle()
        await self._motion.come_to_rest()

    async def _first_state(self, operation: str) -> RobotState:
        """The state with which a stream begins, after a cycle without a setpoint: what is slow once makes none late."""
        await self._diagnosis.next_state(operation)
        return await self._diagnosis.fresh_state(operation)

    async def _repeat(
        self, operation: str, send: Callable[[RobotState], None], done: Callable[[RobotState], bool]
    ) -> None:
        """Call ``send`` with every state until ``done``.

        Raises LateSetpointError if this machine was late, MotionError if the robot's states were, and RobotRefused if
        its program is paused.
        """
        waited_s = 0.0
        while not done(state := await self._diagnosis.fresh_state(operation)):
            self._diagnosis.check_not_paused(operation)
            try:
                send(state)
            except LateSetpointError as late:
                stood_still = self._driver.link.feed.standstill.describe()
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

    async def move_until_contact(
        self,
        velocity_base: Sequence[float],
        *,
        direction_base: Sequence[float] = ZERO6,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        timeout_s: float = math.inf,
        wait: bool = True,
    ) -> None:
        """Move the TCP at a velocity (6,) [m/s, rad/s] until the tool touches something; PolyScope 5.4 or newer.

        The arm then stops, returns to where the contact began, and rests. direction_base: direction in which contact
        counts (6,), in the base frame; only the first three numbers are used, and all zeros stand for the direction of
        motion. Raises MotionError if there is no contact within ``timeout_s``, by the robot's clock.
        """
        operation = "move_until_contact"
        self._driver.link.require("contact")
        await self._motion.ready(operation)
        await self._motion.tune(operation, acceleration=acceleration_m_s2)
        self._points = ()
        work = partial(self._approach, operation, velocity_base, direction_base, timeout_s)
        await self._motion.launch(operation, work, wait)

    async def _approach(
        self, operation: str, velocity: Sequence[float], direction_base: Sequence[float], timeout_s: float
    ) -> None:
        end_s = (await self._first_state(operation)).timestamp_s + timeout_s
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


def _frame_rotation(frame: str | Sequence[float]) -> Sequence[float] | None:
    """The rotation vector of a frame in the base frame; None for the tool's."""
    if frame == "base":
        return (0.0, 0.0, 0.0)
    if frame == "tool":
        return None
    if isinstance(frame, str):
        raise LocalProtocolError(f'a frame is "base", "tool" or a pose, not {frame!r}')
    QUANTITIES["frame_base"].check(frame)
    return frame[3:]
