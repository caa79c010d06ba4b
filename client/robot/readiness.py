"""Power, brakes, control program: from whatever state the robot is in to one in which it moves."""

import asyncio
from collections.abc import Coroutine
from typing import Any, Final

from client import dashboard
from client.errors import ClientError, ProgramNotRunningError
from client.robot.troubles import Troubles
from urproto.errors import RobotRefused
from urproto.modes import RobotMode

__all__ = ["LOCAL_CONTROL", "Readiness"]

_POWER_UP_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_LOCAL_CONTROL_CODE: Final = 210  # error code of a script port while the robot is in local control
_REMOTE: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
LOCAL_CONTROL: Final = ("it is in local control", _REMOTE)
_RUN_LINE: Final = "set robotmode run"


class Readiness(Troubles):
    """Makes the arm ready, at first and after a protective stop."""

    async def make_ready(self) -> None:
        """Power the arm on, release the brakes and start the control program, whatever of it is still to be done.

        The arm moves a little as its brakes are released. Raises SafetyStopError while a stop
        is in effect, RobotRefused when the robot says no.
        """
        await self._refuse_in_stop("make_ready")
        if self.driver.robot.robot_mode is not RobotMode.RUNNING:
            await self._release_brakes()
        if not self.driver.program_running or self._paused:
            await self._start("make_ready")
        self._started = True

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        For a caller who knows why the arm stopped and that it may move. Raises RobotRefused
        when the stop comes back at once, SafetyStopError for another kind of stop.
        """
        if not self.driver.protective_stopped:
            await self._refuse_in_stop("recover")
        await self._reporting("recover", self.driver.recover())
        self._started = True

    async def _release_brakes(self) -> None:
        if (board := self.driver.robot.dashboard) is not None:
            await board.ask(dashboard.BRAKE_RELEASE)
        else:
            await self.driver.robot.send_script(_RUN_LINE)
        try:
            async with asyncio.timeout(_POWER_UP_S):
                while self.driver.robot.robot_mode is not RobotMode.RUNNING:
                    await self._next_state("make_ready")
                    self._check_safety("make_ready")
        except TimeoutError:
            mode = self.driver.robot.robot_mode.name
            advice = f"look at the pendant; e-Series: {_REMOTE}"
            raise RobotRefused("brake release", f"after {_POWER_UP_S:g} s its mode is {mode}", advice) from None

    async def _start(self, doing: str) -> None:
        link = self.driver.robot
        link.reports.clear()
        link.popups.clear()
        await self._reporting(doing, self.driver.start_program())
        self._started = True

    async def _reporting(self, doing: str, start: Coroutine[Any, Any, None]) -> None:
        """Await the start of the program; one that does not come about is explained."""
        try:
            await start
        except ProgramNotRunningError as error:
            if await self._in_local_control():
                why, advice = LOCAL_CONTROL
                raise RobotRefused(
                    doing, why, f"{advice}; a simulator, which takes scripts anyway: {error.hint}"
                ) from None
            raise

    async def _in_local_control(self) -> bool:
        if any(report.code == _LOCAL_CONTROL_CODE for report in self.driver.robot.reports):
            return True
        try:
            board = self.driver.robot.dashboard
            return board is not None and not await board.ask(dashboard.IS_IN_REMOTE_CONTROL)
        except (RobotRefused, ClientError):  # a version without remote control, or a dashboard that is gone
            return False
