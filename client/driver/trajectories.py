"""Trajectories: points that the control program executes one after the other."""

from collections.abc import Iterable
from typing import Final

from client.driver.config import DriverConfig
from client.driver.link import RobotLink
from client.driver.program import ProgramSupervisor
from client.quantities import checked, points_of
from urproto.errors import LocalProtocolError
from urproto.external_control import MotionType, TrajectoryAction, TrajectoryPoint, TrajectoryResult

_OPTIMOVES: Final = frozenset(
    [MotionType.OPTIMOVEJ, MotionType.OPTIMOVEL, MotionType.OPTIMOVEJ_POSE, MotionType.OPTIMOVEL_JOINT]
)
_CANCEL_TIMEOUT_S: Final = 5.0  # guess: a ramp to rest, and reading 100 000 points that are not executed


@checked
class Trajectories:
    """The trajectories of `URDriver`, whose view of the one under way is kept consistent with the robot's.

    A trajectory uses two ports: the reverse interface announces its start and end, the other one carries its points.
    """

    config: DriverConfig
    link: RobotLink
    program: ProgramSupervisor

    def __init__(self) -> None:
        self._executing = False  # started, and its result not yet fetched
        self._cancelling = False  # cancellation was sent; the robot answers it in any case
        self._streaming = False
        self.program.reverse.listeners.append(self._program_changed)

    async def execute(self, points: Iterable[TrajectoryPoint], timeout_s: float | None = None) -> TrajectoryResult:
        """Execute a trajectory and wait for its end; it is cancelled if the caller is cancelled, or on timeout.

        Returns CANCELED if it was cancelled, also by the robot itself, which shows a popup for points that it cannot
        reach in time; FAILURE if points did not arrive in time.
        """
        points = self._checked(points)
        try:
            await self.start_trajectory(points)
            return await self.trajectory_result(timeout_s)
        except BaseException:
            if self._executing and self.program.running:
                self._send_cancel()
            raise

    async def start_trajectory(self, points: Iterable[TrajectoryPoint]) -> None:
        """Start a trajectory; a trajectory that is under way is cancelled first."""
        points = self._checked(points)
        await self._begin(TrajectoryAction.START, len(points))
        await self.program.trajectory.write(points)

    async def trajectory_result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Wait for the end of the trajectory under way, and for a state taken after it.

        A timeout of None waits as long as it takes.
        """
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: start one first")
        port = self.program.trajectory
        result = await port.result(timeout_s)
        if self._cancelling and result is not TrajectoryResult.CANCELED:
            await port.result(timeout_s)  # it ended just before, but the cancellation is answered too
        self._executing = self._cancelling = False
        await self.link.state_from_now()  # states may take longer than the result
        return result

    async def cancel_trajectory(self) -> TrajectoryResult:
        """Stop the trajectory under way; returns SUCCESS if it ended by itself just before."""
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: there is nothing to cancel")
        self._send_cancel()
        return await self.trajectory_result(_CANCEL_TIMEOUT_S)

    async def start_stream(self) -> None:
        """Start a trajectory whose points are added by `stream`, until `end_stream`.

        The trajectory ends with FAILURE if the next point does not arrive within 0.5 s, or between spline points
        within one control period. The last point must not blend.
        """
        await self._begin(TrajectoryAction.STREAM_START, 0)
        self._streaming = True

    async def stream(self, points: Iterable[TrajectoryPoint]) -> None:
        """Add points to the stream, as fast as the robot accepts them."""
        if not self._streaming:
            raise LocalProtocolError("no stream is under way: start one first")
        await self.program.trajectory.write(self._checked(points))

    async def end_stream(self, timeout_s: float | None = None) -> TrajectoryResult:
        """End the stream of points, and wait for the end of the trajectory."""
        if not self._streaming:
            raise LocalProtocolError("no stream is under way: start one first")
        self._streaming = False
        self._announce(TrajectoryAction.STREAM_END, self.program.trajectory.end())
        return await self.trajectory_result(timeout_s)

    def _announce(self, action: TrajectoryAction, points: int) -> None:
        self.program.reverse.trajectory(action, points, self.config.keep_alive_timeout_s)

    async def _begin(self, action: TrajectoryAction, count: int) -> None:
        if self._executing:
            await self.cancel_trajectory()
        self.program.trajectory.clear_results()
        self._announce(action, count)
        self.program.trajectory.begin()
        self._executing, self._cancelling, self._streaming = True, False, False

    def _send_cancel(self) -> None:
        if self._cancelling:
            return
        self._cancelling, self._streaming = True, False
        self._announce(TrajectoryAction.CANCEL, self.program.trajectory.end())

    def _checked(self, given: Iterable[TrajectoryPoint]) -> list[TrajectoryPoint]:
        points = points_of(given)
        if any(point.type in _OPTIMOVES for point in points):
            self.link.require("optimove")
        return points

    def _program_changed(self, connected: bool) -> None:
        if connected:
            self._executing, self._cancelling, self._streaming = False, False, False
