"""Finds out why a robot does not carry out a request, or stopped doing so."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from client import dashboard
from client.driver import URDriver
from client.driver.link import MOVABLE
from client.errors import (
    ClientError,
    NoAnswerError,
    OutOfReachError,
    ProgramEndedError,
    ProtectiveStopError,
    RobotUnreachableError,
    SafetyStopError,
    ScriptFailedError,
)
from client.robot.state import RobotState
from urproto.compat_asyncio import timeout
from urproto.errors import RobotRefused, URError
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage

_MESSAGE_DELAY_S: Final = (
    0.3  # guess: what explains an end arrives within this; the primary interface sends 10 times a second
)
_POLL_INTERVAL_S: Final = 0.01
_LOCAL_CONTROL_CODE: Final = 210  # error code of a script port while the robot is in local control

_ADVICE: Final = {
    SafetyMode.PROTECTIVE_STOP: "find the cause, make sure that the path is clear, then recover()",
    SafetyMode.SAFEGUARD_STOP: "clear the safeguarded area and reset the safeguard, then make_ready()",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.ROBOT_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.VIOLATION: "find the cause, then restart the safety system on the robot",
    SafetyMode.FAULT: "find the cause, then restart the safety system on the robot",
}


class Diagnosis:
    """Causes that a driver does not see: which stop it was, why the program ended, whether the robot still answers."""

    alarm: asyncio.Event
    """Set when the robot stops for safety or stops sending states; starting a motion clears it."""

    def __init__(self, driver: URDriver) -> None:
        self.driver = driver
        self.alarm = asyncio.Event()
        self._state_at_silence: object = None  # the state after which the robot fell silent

    def watch(self) -> None:
        """Start watching; the driver must be connected."""
        self.driver.on_safety_mode(self._on_safety_mode)
        self.driver.link.on_silence.append(self._on_silence)

    @property
    def silent(self) -> bool:
        """True if the robot stopped sending states and has not sent one since."""
        return self.driver.state is self._state_at_silence

    @property
    def paused(self) -> bool:
        """True if a program on the robot is paused, or about to be."""
        return bool(self.driver.state["runtime_state"] in (RuntimeState.PAUSING, RuntimeState.PAUSED))

    async def next_state(self, operation: str) -> None:
        """Wait for the next state. Raises RobotUnreachableError if the robot sends none."""
        try:
            await self.driver.next_state()
        except ClientError:
            raise self.unreachable(operation) from None

    async def state_from_now(self, operation: str) -> None:
        """Wait for a state that the robot takes from now on. Raises RobotUnreachableError, and StaleStateError."""
        try:
            await self.driver.link.state_from_now()
        except NoAnswerError:
            raise self.unreachable(operation) from None

    async def fresh_state(self, operation: str) -> RobotState:
        """The newest state that is young enough. Raises RobotUnreachableError, and StaleStateError."""
        try:
            return RobotState(await self.driver.link.fresh_state())
        except NoAnswerError:
            raise self.unreachable(operation) from None

    def check_safety(self, operation: str) -> None:
        """Raise SafetyStopError, or ProtectiveStopError, while a stop is in effect."""
        mode = self.driver.link.safety_mode
        if mode not in MOVABLE:
            kind = ProtectiveStopError if mode is SafetyMode.PROTECTIVE_STOP else SafetyStopError
            raise kind(operation, mode, self.reported(), _ADVICE.get(mode, "follow the instructions on the pendant"))

    def check_not_paused(self, operation: str) -> None:
        """Raise RobotRefused while the program is paused: it would follow what is sent meanwhile when it resumes."""
        if self.paused:
            raise RobotRefused(operation, "its program is paused", "resume it on the robot, or call make_ready()")

    async def refuse_in_stop(self, operation: str) -> None:
        """Like `check_safety`, but wait for the cause, which arrives on another connection than the mode."""
        if self.driver.link.safety_mode not in MOVABLE:
            await self.wait_for_messages(lambda: bool(self.reported()))
        self.check_safety(operation)

    def unreachable(self, operation: str) -> RobotUnreachableError:
        """Return the error for a lost connection, or for a robot that sends nothing."""
        config = self.driver.config
        reason = f"the connection was lost, or the robot stopped sending, during {operation}"
        advice = self.driver.link.feed.standstill.describe() or "check the network, and that the controller is up"
        return RobotUnreachableError(config.host, config.robot_ports["rtde"], reason, advice)

    async def end_error(self, operation: str) -> Exception:
        """Return the exception that says why ``operation`` ended, as far as the robot reports it."""
        failure = await self._last_failure()
        if self.silent:
            return self.unreachable(operation)
        try:
            self.check_safety(operation)
        except SafetyStopError as stop:
            return stop
        if failure is not None and _means_out_of_reach(failure):
            return OutOfReachError(operation, failure.text)
        advice = "make_ready() starts it again"
        if self.driver.loss_reason and not self.driver.keep_alive.stop_reason:
            advice = "the next motion starts it again"
        return ProgramEndedError(self.driver.reverse.port, operation, self._end_reason(failure), advice)

    async def wait_for_messages(self, received: Callable[[], bool]) -> None:
        """Wait until ``received`` returns True, for as long as messages on another connection may be delayed."""
        with suppress(TimeoutError):
            async with timeout(_MESSAGE_DELAY_S):
                while not received():
                    await asyncio.sleep(_POLL_INTERVAL_S)

    async def in_local_control(self) -> bool:
        """Whether the robot refuses scripts because it is in local control, as far as it reports that.

        A robot that is playing a program accepts scripts.
        """
        if any(report.code == _LOCAL_CONTROL_CODE for report in self.driver.link.reports):
            return True
        if self.driver.state["runtime_state"] == RuntimeState.PLAYING:
            return False
        try:
            board = self.driver.link.dashboard
            return board is not None and not await board.request(dashboard.IS_IN_REMOTE_CONTROL)
        except URError:  # a version without remote control, or a dashboard that is gone
            return False

    def reported(self) -> str:
        """The last error that the robot reported since the program was started; "" without one."""
        grave = [
            report
            for report in self.driver.link.reports
            if ReportLevel.WARNING <= report.level < ReportLevel.DEVELOPER_DEBUG
        ]
        return _describe(grave[-1]) if grave else ""

    async def _last_failure(self) -> ScriptFailedError | None:
        """The script error that ended the program, if any; other messages that explain the end have arrived by then."""
        failures: list[ScriptFailedError] = []

        def received() -> bool:
            if failure := self.driver.link.pop_script_error():
                failures.append(failure)
            stopped = self.driver.link.safety_mode not in MOVABLE and self.reported()
            return bool(failures or self.silent or stopped or self.driver.loss_reason)

        await self.wait_for_messages(received)
        return failures[0] if failures else None

    def _end_reason(self, failure: ScriptFailedError | None) -> str:
        if failure is not None:
            return str(failure)
        if self.driver.loss_reason:
            return self.driver.loss_reason
        mode = self.driver.link.robot_mode
        if mode is not RobotMode.RUNNING:
            return f"the robot's mode is {mode.name}"
        return self.reported() or "it was stopped on the robot, or another program replaced it"

    def _on_safety_mode(self, mode: SafetyMode) -> None:
        if mode in MOVABLE:
            self.driver.link.reports.clear()  # they belong to a stop that is over
        else:
            self.alarm.set()

    def _on_silence(self) -> None:
        self._state_at_silence = self.driver.state
        self.alarm.set()


def _describe(report: ErrorCodeMessage) -> str:
    return f"{report.label} {report.text}".strip()


def _means_out_of_reach(failure: ScriptFailedError) -> bool:
    """Judged by the robot's text, such as "unable to find an inverse kinematics solution"."""
    text = failure.text.lower()
    return "inverse kin" in text or "out of reach" in text or "joint limits" in text
