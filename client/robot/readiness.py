"""Makes sure that the arm can move: starts the control program, but not after it was ended on purpose."""

from collections.abc import Coroutine, Sequence
from typing import Any, Final

from client import dashboard
from client.driver import URDriver
from client.errors import NoAnswerError, OutOfReachError, ProgramEndedError, ProgramNotRunningError
from client.robot.diagnosis import Diagnosis
from urproto.compat_asyncio import timeout
from urproto.errors import RobotRefused
from urproto.external_control import Query
from urproto.modes import RobotMode

PROGRAM_GONE: Final = (ProgramEndedError, ProgramNotRunningError)
"""Errors of a driver whose program has disconnected; `Readiness.explanation` finds the cause."""
_POWER_UP_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_REMOTE: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
LOCAL_CONTROL: Final = ("it is in local control", _REMOTE)
_POWERED: Final = (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.BACKDRIVE)
_RUN_LINE: Final = "set robotmode run"


class Readiness:
    """Makes the arm ready to move, at first and after a protective stop, and checks that it still is."""

    def __init__(self, driver: URDriver, diagnosis: Diagnosis) -> None:
        self.driver = driver
        self.diagnosis = diagnosis
        self._reported_running = False  # the caller believes that the program runs: report its end before a restart

    async def make_ready(self, *, program: bool = True) -> None:
        """Power the arm on, release its brakes and start the control program, as far as that is still to be done.

        program: False leaves the control program alone. The arm moves slightly as its brakes are released. Raises
        SafetyStopError while a safety stop is in effect, and RobotRefused if the robot refuses.
        """
        await self.diagnosis.refuse_in_stop("make_ready")
        if self.driver.link.robot_mode is not RobotMode.RUNNING:
            await self._release_brakes()
        if program:
            if not self.driver.program_running or self.diagnosis.paused:
                await self.restart_program("make_ready")
            self._reported_running = True

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        Call it only when you know why the arm stopped and that it may move. Raises RobotRefused if the stop recurs
        immediately, and SafetyStopError for any other kind of stop.
        """
        if not self.driver.protective_stopped:
            await self.diagnosis.refuse_in_stop("recover")
        await self._start_program("recover", self.driver.recover())
        self._reported_running = True

    async def require_program(self, operation: str) -> None:
        """Make sure that the control program runs, starting it as a motion would; raises why it does not."""
        if self.diagnosis.silent:
            raise self.diagnosis.unreachable(operation)
        await self.diagnosis.refuse_in_stop(operation)
        if self.driver.program_running:
            self.diagnosis.check_not_paused(operation)
            self._reported_running = True
            return
        if self.driver.link.robot_mode is not RobotMode.RUNNING:
            mode = self.driver.link.robot_mode.name
            raise RobotRefused(operation, f"its mode is {mode}", "make_ready() powers it on and releases its brakes")
        if self._reported_running and (not self.driver.loss_reason or self.driver.keep_alive.stop_reason):
            raise await self.end_error(operation)
        await self.restart_program(operation)

    async def restart_program(self, operation: str) -> None:
        """Start the control program again, after a program of the caller has run.

        Raises RobotRefused for a robot in local control.
        """
        link = self.driver.link
        link.reports.clear()
        link.popups.clear()
        await self._start_program(operation, self.driver.start_program())
        self._reported_running = True

    async def query(
        self,
        operation: str,
        query: Query,
        *arguments: Sequence[float] | None,
        number: int = 0,
        gate: str | None = None,
    ) -> tuple[float, ...]:
        """Query the control program and return its answer; see `URDriver.query`."""
        await self.require_program(operation)
        try:
            return await self.driver.query(query, *arguments, number=number, gate=gate)
        except PROGRAM_GONE:
            raise await self.end_error(operation) from None
        except NoAnswerError:
            await self.diagnosis.refuse_in_stop(operation)
            raise

    async def end_error(self, operation: str) -> Exception:
        """Return the exception that says why ``operation`` ended, as far as the robot reports it."""
        error = await self.diagnosis.end_error(operation)
        if isinstance(error, OutOfReachError):  # the target ended the program, so this was not on purpose
            self._reported_running = False  # so the next motion may restart it
        return error

    async def _release_brakes(self) -> None:
        if (board := self.driver.link.dashboard) is not None:
            await board.request(dashboard.BRAKE_RELEASE)
        else:
            await self.driver.link.send_script(_RUN_LINE)
        before, is_on = self.driver.state, False
        try:
            async with timeout(_POWER_UP_S):
                while (now := self.driver.link.robot_mode) is not RobotMode.RUNNING:
                    if is_on and now is RobotMode.POWER_OFF:
                        raise RobotRefused("brake release", "it was switched off meanwhile", "make_ready() again")
                    is_on = is_on or now in _POWERED
                    await self.diagnosis.next_state("make_ready")
                    self.diagnosis.check_safety("make_ready")
                    if self.driver.state["timestamp"] < before["timestamp"]:  # it does not know the request any more
                        raise self.diagnosis.unreachable("make_ready")
                    before = self.driver.state
        except TimeoutError:
            mode = self.driver.link.robot_mode.name
            advice = f"check the pendant; e-Series: {_REMOTE}"
            raise RobotRefused("brake release", f"after {_POWER_UP_S:g} s its mode is {mode}", advice) from None

    async def _start_program(self, operation: str, starting: Coroutine[Any, Any, None]) -> None:
        """Await the start of the program, and find the cause if it fails."""
        try:
            await starting
        except ProgramNotRunningError as error:
            if await self.diagnosis.in_local_control():
                why, advice = LOCAL_CONTROL
                raise RobotRefused(
                    operation, why, f"{advice}; if this is a simulator, which accepts scripts anyway: {error.hint}"
                ) from None
            raise
