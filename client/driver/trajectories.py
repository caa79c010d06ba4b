"""Trajectories: points that the program executes one after the other."""

from collections.abc import Iterable, Sequence
from typing import Final

from client.driver.core import DriverCore
from urproto.errors import LocalProtocolError
from urproto.external_control import MotionType, TrajectoryAction, TrajectoryPoint, TrajectoryResult

_OPTIMOVES: Final = frozenset(
    [MotionType.OPTIMOVEJ, MotionType.OPTIMOVEL, MotionType.OPTIMOVEJ_POSE, MotionType.OPTIMOVEL_JOINT]
)
_CANCEL_TIMEOUT_S: Final = 5.0  # guess: a ramp to rest and 100 000 points that nobody executes any more


class Trajectories(DriverCore):
    """One trajectory at a time, whole or as a stream of points; see client.driver.points for the points.

    Raises ProgramNotRunningError, ProgramEndedError when the program ends on the way, and
    LocalProtocolError for points that cannot be sent.
    """

    _executing = False
    _cancelling = False
    _streamed: int | None = None

    async def execute(self, points: Iterable[TrajectoryPoint], timeout_s: float | None = None) -> TrajectoryResult:
        """Execute a trajectory and wait for its end; it is cancelled when the caller is, or when it takes too long.

        CANCELED when somebody cancelled it, the robot too, which shows a popup for points it
        cannot reach in their time; FAILURE when points were missing.
        """
        points = list(points)
        self._check(points)
        try:
            await self.start_trajectory(points)
            return await self.trajectory_result(timeout_s)
        except BaseException:
            if self._executing and self.program_running:
                self._send_cancel()
            raise

    async def start_trajectory(self, points: Iterable[TrajectoryPoint]) -> None:
        """Begin a trajectory; one that is under way is cancelled."""
        points = list(points)
        self._check(points)
        await self._begin(TrajectoryAction.START, len(points))
        await self.trajectory.write(points)

    async def trajectory_result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Wait for the end of the trajectory that is under way; None waits as long as it takes."""
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: start one first")
        result = await self.trajectory.result(timeout_s)
        if self._cancelling and result is not TrajectoryResult.CANCELED:
            await self.trajectory.result(timeout_s)  # it ended just before; cancelling is answered all the same
        self._executing = self._cancelling = False
        return result

    async def cancel_trajectory(self) -> TrajectoryResult:
        """Stop the trajectory that is under way; SUCCESS when it ended by itself just before."""
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: there is nothing to cancel")
        self._send_cancel()
        return await self.trajectory_result(_CANCEL_TIMEOUT_S)

    async def start_stream(self) -> None:
        """Begin a trajectory whose points come one by one, by `stream`, until `end_stream`.

        A point that is not there within 0.5 s, or between spline points within a control
        period, is a FAILURE. The last point must not blend.
        """
        await self._begin(TrajectoryAction.STREAM_START, 0)
        self._streamed = 0

    async def stream(self, points: Iterable[TrajectoryPoint]) -> None:
        """Add points to the stream, as fast as the robot takes them."""
        if self._streamed is None:
            raise LocalProtocolError("no stream is under way: start one first")
        points = list(points)
        self._check(points)
        await self.trajectory.write(points)
        self._streamed += len(points)

    async def end_stream(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Say that there are no more points, and wait for the end."""
        if self._streamed is None:
            raise LocalProtocolError("no stream is under way: start one first")
        count, self._streamed = self._streamed, None
        self.reverse.trajectory(TrajectoryAction.STREAM_END, count, self.config.keep_alive_timeout_s)
        return await self.trajectory_result(timeout_s)

    async def _begin(self, action: TrajectoryAction, count: int) -> None:
        if self._executing:
            await self.cancel_trajectory()
        self.trajectory.forget_results()
        self.reverse.trajectory(action, count, self.config.keep_alive_timeout_s)
        self._executing, self._cancelling, self._streamed = True, False, None

    def _send_cancel(self) -> None:
        if self._cancelling:
            return
        self._cancelling = True
        count, self._streamed = self._streamed or 0, None
        self.reverse.trajectory(TrajectoryAction.CANCEL, count, self.config.keep_alive_timeout_s)

    def _check(self, points: Sequence[TrajectoryPoint]) -> None:
        if any(point.type in _OPTIMOVES for point in points):
            self._require("optimove")
        for point in points:
            point.encode()

    def _program_changed(self, connected: bool) -> None:
        if connected:
            self._executing, self._cancelling, self._streamed = False, False, None
        super()._program_changed(connected)
