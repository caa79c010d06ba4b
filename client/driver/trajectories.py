"""Trajectories: points that the control program executes one after the other."""

from collections.abc import Iterable
from typing import Final

from client.driver.config import DriverConfig
from client.driver.link import RobotLink
from client.driver.program import ProgramSupervisor
from client.quantities import points_of
from urproto.errors import LocalProtocolError
from urproto.external_control import MotionType, TrajectoryAction, TrajectoryPoint, TrajectoryResult

_OPTIMOVES: Final = frozenset(
    [MotionType.OPTIMOVEJ, MotionType.OPTIMOVEL, MotionType.OPTIMOVEJ_POSE, MotionType.OPTIMOVEL_JOINT]
)
_CANCEL_TIMEOUT_S: Final = 5.0  # guess: a ramp to rest, and reading 100 000 points that are not executed


class Trajectories:
    """Manages the trajectory under way, and keeps the driver's view of it consistent with the robot's.

    A trajectory uses two ports: the reverse interface announces its start and end, the other one carries its points.
    `URDriver` documents the methods.
    """

    def __init__(self, config: DriverConfig, link: RobotLink, program: ProgramSupervisor) -> None:
        self._link = link
        self._program = program
        self._reverse = program.reverse
        self._port = program.trajectory
        self._timeout_s = config.keep_alive_timeout_s
        self._executing = False  # started, and its result not yet fetched
        self._cancelling = False  # cancellation was sent; the robot answers it in any case
        self._streaming = False
        self._reverse.listeners.append(self._program_changed)

    async def execute(self, points: Iterable[TrajectoryPoint], timeout_s: float | None) -> TrajectoryResult:
        """Send all points and wait for the result."""
        points = self._checked(points)
        try:
            await self.start(points)
            return await self.result(timeout_s)
        except BaseException:
            if self._executing and self._program.running:
                self._send_cancel()
            raise

    async def start(self, points: Iterable[TrajectoryPoint]) -> None:
        """Cancel the trajectory under way, if any, and start this one."""
        points = self._checked(points)
        await self._begin(TrajectoryAction.START, len(points))
        await self._port.write(points)

    async def result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Wait for the result of the trajectory under way, and for a state taken after it."""
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: start one first")
        result = await self._port.result(timeout_s)
        if self._cancelling and result is not TrajectoryResult.CANCELED:
            await self._port.result(timeout_s)  # it ended just before, but the cancellation is answered too
        self._executing = self._cancelling = False
        await self._link.state_from_now()  # states may take longer than the result
        return result

    async def cancel(self) -> TrajectoryResult:
        """Stop the trajectory under way."""
        if not self._executing:
            raise LocalProtocolError("no trajectory is under way: there is nothing to cancel")
        self._send_cancel()
        return await self.result(_CANCEL_TIMEOUT_S)

    async def start_stream(self) -> None:
        """Start a trajectory whose points follow later."""
        await self._begin(TrajectoryAction.STREAM_START, 0)
        self._streaming = True

    async def stream(self, points: Iterable[TrajectoryPoint]) -> None:
        """Send further points of the stream."""
        if not self._streaming:
            raise LocalProtocolError("no stream is under way: start one first")
        await self._port.write(self._checked(points))

    async def end_stream(self, timeout_s: float | None) -> TrajectoryResult:
        """Send the total number of points, and wait for the result."""
        if not self._streaming:
            raise LocalProtocolError("no stream is under way: start one first")
        self._streaming = False
        self._reverse.trajectory(TrajectoryAction.STREAM_END, self._port.end(), self._timeout_s)
        return await self.result(timeout_s)

    async def _begin(self, action: TrajectoryAction, count: int) -> None:
        if self._executing:
            await self.cancel()
        self._port.clear_results()
        self._reverse.trajectory(action, count, self._timeout_s)
        self._port.begin()
        self._executing, self._cancelling, self._streaming = True, False, False

    def _send_cancel(self) -> None:
        if self._cancelling:
            return
        self._cancelling, self._streaming = True, False
        self._reverse.trajectory(TrajectoryAction.CANCEL, self._port.end(), self._timeout_s)

    def _checked(self, given: Iterable[TrajectoryPoint]) -> list[TrajectoryPoint]:
        points = points_of(given)
        if any(point.type in _OPTIMOVES for point in points):
            self._link.require("optimove")
        return points

    def _program_changed(self, connected: bool) -> None:
        if connected:
            self._executing, self._cancelling, self._streaming = False, False, False
