"""Waypoints that arrive seldom or late, as a policy's actions do: the arm follows setpoints between them.

A policy computes 5 to 50 actions per second, one or several at a time; a robot wants a setpoint in each control period.
In between, setpoints are interpolated and limited in speed, as the controllers of Diffusion Policy and UMI do it.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import hypot
from typing import Any, Final, NamedTuple, Protocol

from client.errors import LateSetpointError
from client.robot.motion import MotionRunner
from client.robot.reach import reach_of
from client.robot.state import RobotState
from client.robot.streaming import Follow, Streams
from urproto.compat import Self
from urproto.errors import LocalProtocolError
from urproto.external_control import MotionType, TrajectoryPoint
from urproto.robots.pose import interpolate_pose, point_dist, pose_sub
from urproto.vectors import Vector6, all_finite, as_six, lerp, sub

MAX_SPEED_RAD_S: Final = 1.0
MAX_SPEED_M_S: Final = 0.25
MAX_TURN_RAD_S: Final = 1.0
_SIZE: Final = 6


@dataclass
class WaypointStatistics:
    """What became of waypoints.

    taken: became part of the way. late: were to be reached in the past, and were left out. slowed: setpoints that had
    to be limited in speed. pauses: how often the robot stopped the arm because this machine was late; the next waypoint
    goes on from there. worst_error: the farthest that the arm was from its setpoint [rad, or m for poses].
    """

    taken: int = 0
    late: int = 0
    slowed: int = 0
    pauses: int = 0
    worst_error: float = 0.0


class _Space(Protocol):
    """Joint angles, or poses."""

    def between(self, start: Sequence[float], end: Sequence[float], share: float) -> Vector6:
        """A point of the way from one to another."""

    def least_s(self, start: Sequence[float], end: Sequence[float]) -> float:
        """How long the way takes at least [s]."""

    def place(self, state: RobotState) -> Vector6:
        """Where the arm is."""

    def distance(self, start: Sequence[float], end: Sequence[float]) -> float:
        """The largest angle, or the length of the way, between two places [rad, or m]."""

    def point(self, target: Sequence[float]) -> TrajectoryPoint:
        """A target, to check whether it can be reached."""


class _Joints(NamedTuple):
    max_speed_rad_s: float

    def between(self, start: Sequence[float], end: Sequence[float], share: float) -> Vector6:
        return lerp(start, sub(end, start), share)

    def least_s(self, start: Sequence[float], end: Sequence[float]) -> float:
        return self.distance(start, end) / self.max_speed_rad_s

    def place(self, state: RobotState) -> Vector6:
        return state.q_rad

    def distance(self, start: Sequence[float], end: Sequence[float]) -> float:
        return max(map(abs, sub(end, start)))

    def point(self, target: Sequence[float]) -> TrajectoryPoint:
        return TrajectoryPoint(MotionType.MOVEJ, as_six(target))


class _Poses(NamedTuple):
    max_speed_m_s: float
    max_turn_rad_s: float

    def between(self, start: Sequence[float], end: Sequence[float], share: float) -> Vector6:
        return interpolate_pose(start, end, share)

    def least_s(self, start: Sequence[float], end: Sequence[float]) -> float:
        turn_rad = hypot(*pose_sub(end, start)[3:])
        return max(point_dist(start, end) / self.max_speed_m_s, turn_rad / self.max_turn_rad_s)

    def place(self, state: RobotState) -> Vector6:
        return state.pose_base_tcp

    def distance(self, start: Sequence[float], end: Sequence[float]) -> float:
        return point_dist(start, end)

    def point(self, target: Sequence[float]) -> TrajectoryPoint:
        return TrajectoryPoint(MotionType.MOVEL, as_six(target))


class WaypointFollower:
    """Follows waypoints, until its context is left. Any thread may send them.

    ``now_s`` is the clock of arrival times, which are given from now on. Where the waypoints end, the arm stays.
    """

    def __init__(
        self,
        space: _Space,
        start: Vector6,
        check: Callable[[Sequence[float]], object],
        now_s: Callable[[], float],
    ) -> None:
        self.statistics = WaypointStatistics()
        self._space, self._check, self._now_s = space, check, now_s
        self._way: tuple[tuple[float, Vector6], ...] = ()  # replaced as a whole: threads share it
        self._setpoint, self._sent_s = start, 0.0
        self._begin(start)
        self._failure: BaseException | None = None

    @property
    def setpoint(self) -> Vector6:
        """The latest setpoint (6,)."""
        return self._setpoint

    def send(self, waypoint: Sequence[float], arrival_s: float) -> None:
        """Go on to a waypoint (6,), to be there after ``arrival_s``, or later if that were too fast.

        It replaces those that were to be reached later. Raises LocalProtocolError for numbers that are not finite,
        OutOfReachError for a target out of reach, and what has ended the motion.
        """
        self.send_chunk([waypoint], 0.0, arrival_s)

    def send_chunk(self, waypoints: Sequence[Sequence[float]], every_s: float, first_s: float | None = None) -> int:
        """Go on with several waypoints ``every_s`` apart, the first of them after ``first_s``, by default ``every_s``.

        Waypoints for which it is too late are left out: for those that a policy computed from an observation 0.12 s
        ago, ``first_s`` is ``every_s - 0.12``. Returns how many were taken. Raises what `send` raises; then none is.
        """
        if self._failure is not None:
            raise self._failure
        first_s = every_s if first_s is None else first_s
        if not all_finite((every_s, first_s)) or every_s < 0.0:
            raise LocalProtocolError(
                f"waypoints must be a finite time apart, not {every_s} s, the first at {first_s} s"
            )
        for waypoint in waypoints:
            if len(waypoint) != _SIZE or not all_finite(waypoint):
                raise LocalProtocolError(f"a waypoint must be {_SIZE} finite numbers, not {list(waypoint)}")
            self._check(waypoint)
        now_s = self._now_s()
        times_s = [first_s + i * every_s for i in range(len(waypoints))]
        ahead = [(now_s + at_s, as_six(to)) for at_s, to in zip(times_s, waypoints, strict=True) if at_s >= 0.0]
        self.statistics.late += len(waypoints) - len(ahead)
        self.statistics.taken += len(ahead)
        if ahead:
            before = [entry for entry in self._way if entry[0] <= now_s][-1:]
            kept = [entry for entry in self._way if now_s < entry[0] < ahead[0][0]]
            self._way = (*before, *kept, *ahead) if kept else ((now_s, self.at(now_s)), *ahead)
        return len(ahead)

    def at(self, time_s: float) -> Vector6:
        """Where the waypoints say that the arm should be at a time (6,)."""
        (before_s, place), *later = self._way
        for at_s, to in later:
            if time_s < at_s:
                return self._space.between(place, to, (time_s - before_s) / (at_s - before_s))
            before_s, place = at_s, to
        return place

    def advance(self) -> Vector6:
        """The setpoint for now, not farther from the last one than the speed allows."""
        now_s = self._now_s()
        passed_s, self._sent_s = now_s - self._sent_s, now_s
        wanted = self.at(now_s)
        least_s = self._space.least_s(self._setpoint, wanted)
        if least_s > passed_s:
            self.statistics.slowed += 1
            wanted = self._space.between(self._setpoint, wanted, passed_s / least_s)
        self._setpoint = wanted
        return wanted

    @contextmanager
    def from_thread(self, call: Callable[[Coroutine[Any, Any, Any]], Any]) -> Iterator[Self]:
        """The form for a thread: the same, since any thread may send waypoints."""
        yield self

    async def run(self, follow: Follow, fresh_state: Callable[[], Awaitable[RobotState]]) -> None:
        """Send setpoints until cancelled, or until the motion ends, which the next waypoint raises."""
        try:
            while True:
                try:
                    place = self._space.place(await follow(self.advance()))
                except LateSetpointError:
                    self.statistics.pauses += 1
                    self._begin(self._space.place(await fresh_state()))
                else:
                    error = self._space.distance(place, self._setpoint)
                    self.statistics.worst_error = max(self.statistics.worst_error, error)
        except Exception as failure:
            self._failure = failure

    def _begin(self, place: Vector6) -> None:
        """Stay at a place, until the next waypoint."""
        self._setpoint, self._sent_s = place, self._now_s()
        self._way = ((self._sent_s, place),)


class Waypoints:
    """The contexts of `AsyncRobot` that follow waypoints."""

    def __init__(self, motion: MotionRunner, streams: Streams) -> None:
        self._motion = motion
        self._streams = streams

    @asynccontextmanager
    async def waypoints_j(
        self,
        *,
        max_speed_rad_s: float = MAX_SPEED_RAD_S,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[WaypointFollower]:
        """Follow joint angles that arrive now and then, such as the actions of a policy, with `servo_j` in between.

            with robot.waypoints_j() as waypoints:
                while not done:
                    waypoints.send(policy(observe()), arrival_s=1 / 30)    # (6,) [rad]; returns at once

        max_speed_rad_s: of each joint; what asks for more arrives later. lookahead_s, gain: as of `servo_j`. The value
        is a `WaypointFollower`, which also takes several waypoints at once. Leaving the block brings the arm to rest,
        and raises what ended the motion.
        """
        servo = self._streams.servo_j(lookahead_s=lookahead_s, gain=gain)
        async with self._follow("waypoints_j", servo, _Joints(max_speed_rad_s)) as follower:
            yield follower

    @asynccontextmanager
    async def waypoints_pose(
        self,
        *,
        max_speed_m_s: float = MAX_SPEED_M_S,
        max_turn_rad_s: float = MAX_TURN_RAD_S,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[WaypointFollower]:
        """Like `waypoints_j`, with poses base to TCP (6,) [m, rotation vector]."""
        servo = self._streams.servo_pose(lookahead_s=lookahead_s, gain=gain)
        space = _Poses(max_speed_m_s, max_turn_rad_s)
        async with self._follow("waypoints_pose", servo, space) as follower:
            yield follower

    @asynccontextmanager
    async def _follow(
        self,
        operation: str,
        servo: AbstractAsyncContextManager[Follow],
        space: _Space,
    ) -> AsyncIterator[WaypointFollower]:
        async with servo as follow:
            fresh_state = partial(self._motion.diagnosis.fresh_state, operation)
            state = await fresh_state()
            reach = reach_of(self._motion.driver.link, state.q_rad)
            follower = WaypointFollower(
                space,
                space.place(state),
                lambda target: None if reach is None else reach.check(operation, [space.point(target)]),
                asyncio.get_running_loop().time,
            )
            following = asyncio.create_task(follower.run(follow, fresh_state))
            try:
                yield follower
            finally:
                following.cancel()
                with suppress(asyncio.CancelledError):
                    await following
            if follower._failure is not None:
                raise follower._failure
