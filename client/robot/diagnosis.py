"""Why a robot does not do, or no longer does, what it was asked to."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from client import dashboard
from client.driver import URDriver
from client.driver.robot import MOVABLE
from client.errors import (
    ClientError,
    OutOfReachError,
    ProgramEndedError,
    ProtectiveStopError,
    RobotUnreachableError,
    SafetyStopError,
    ScriptFailedError,
)
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage

_WORDS_S: Final = 0.3  # guess: what explains an end arrives within this; the primary interface sends 10 times a second
_LISTEN_EVERY_S: Final = 0.01
_LOCAL_CONTROL_CODE: Final = 210  # error code of a script port while the robot is in local control

_ADVICE: Final = {
    SafetyMode.PROTECTIVE_STOP: "find the cause, see that the way is free, then recover()",
    SafetyMode.SAFEGUARD_STOP: "clear what the safeguard watches and reset it, then make_ready()",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.ROBOT_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.VIOLATION: "find the cause, then restart the safety system on the robot",
    SafetyMode.FAULT: "find the cause, then restart the safety system on the robot",
}


class Diagnosis:
    """The reasons that a driver does not see: which stop it was, who ended the program, whether the robot is there."""

    alarm: asyncio.Event
    """Set when the robot stops for safety or falls silent; who begins a motion clears it."""

    def __init__(self, driver: URDriver) -> None:
        self.driver = driver
        self.alarm = asyncio.Event()
        self._last_words: object = None  # the state after which the robot fell silent

    def watch(self) -> None:
        """Begin, once the driver is connected."""
        self.driver.on_safety_mode(self._safety_changed)
        self.driver.robot.on_silence.append(self._fell_silent)

    @property
    def silent(self) -> bool:
        """Nothing has come from the robot since it fell silent."""
        return self.driver.state is self._last_words

    @property
    def paused(self) -> bool:
        """A program on the robot is paused, or about to be."""
        return bool(self.driver.state["runtime_state"] in (RuntimeState.PAUSING, RuntimeState.PAUSED))

    async def next_state(self, doing: str) -> None:
        """Wait for it. Raises RobotUnreachableError from a silent robot."""
        try:
            await self.driver.next_state()
        except ClientError:
            raise self.unreachable(doing) from None

    def check_safety(self, doing: str) -> None:
        """Raise SafetyStopError, or ProtectiveStopError, while a stop is in effect."""
        mode = self.driver.robot.safety_mode
        if mode not in MOVABLE:
            kind = ProtectiveStopError if mode is SafetyMode.PROTECTIVE_STOP else SafetyStopError
            raise kind(doing, mode, self.reported(), _ADVICE.get(mode, "the pendant says what has to be done"))

    async def refuse_in_stop(self, doing: str) -> None:
        """As `check_safety`, with the cause, which comes by another connection than the mode."""
        if self.driver.robot.safety_mode not in MOVABLE:
            await self.hear(lambda: bool(self.reported()))
        self.check_safety(doing)

    def unreachable(self, doing: str) -> RobotUnreachableError:
        """The error of a robot that is lost, or silent."""
        config = self.driver.config
        reason = f"it was lost, or the robot fell silent, during {doing}"
        return RobotUnreachableError(config.robot, config.robot_ports["rtde"], reason)

    async def explanation(self, doing: str) -> Exception:
        """Why this has ended, as far as the robot says so."""
        failure = await self._last_failure()
        if self.silent:
            return self.unreachable(doing)
        try:
            self.check_safety(doing)
        except SafetyStopError as stop:
            return stop
        if failure is not None and _means_out_of_reach(failure):
            return OutOfReachError(doing, failure.text)
        advice = "make_ready() starts it again"
        if self.driver.lost_why and not self.driver.pulse.bitten:
            advice = "the next motion starts it again"
        return ProgramEndedError(self.driver.reverse.port, doing, self._why(failure), advice)

    async def hear(self, heard: Callable[[], bool]) -> None:
        """Wait for what the robot says by another connection, as long as that may take."""
        with suppress(TimeoutError):
            async with timeout(_WORDS_S):
                while not heard():
                    await asyncio.sleep(_LISTEN_EVERY_S)

    async def in_local_control(self) -> bool:
        """Whether it takes no scripts for that reason, as far as it says so: who plays a program takes them."""
        if any(report.code == _LOCAL_CONTROL_CODE for report in self.driver.robot.reports):
            return True
        if self.driver.state["runtime_state"] == RuntimeState.PLAYING:
            return False
        try:
            board = self.driver.robot.dashboard
            return board is not None and not await board.ask(dashboard.IS_IN_REMOTE_CONTROL)
        except URError:  # a version without remote control, or a dashboard that is gone
            return False

    def reported(self) -> str:
        """The last error the robot has reported since the program was started."""
        grave = [
            report
            for report in self.driver.robot.reports
            if ReportLevel.WARNING <= report.level < ReportLevel.DEVELOPER_DEBUG
        ]
        return _described(grave[-1]) if grave else ""

    async def _last_failure(self) -> ScriptFailedError | None:
        """The script error that ended the program, if one did; what else explains an end has then come too."""
        failures: list[ScriptFailedError] = []

        def heard() -> bool:
            if failure := self.driver.robot.take_script_error():
                failures.append(failure)
            stopped = self.driver.robot.safety_mode not in MOVABLE and self.reported()
            return bool(failures or self.silent or stopped or self.driver.lost_why)

        await self.hear(heard)
        return failures[0] if failures else None

    def _why(self, failure: ScriptFailedError | None) -> str:
        if failure is not None:
            return str(failure)
        if self.driver.lost_why:
            return self.driver.lost_why
        mode = self.driver.robot.robot_mode
        if mode is not RobotMode.RUNNING:
            return f"the robot's mode is {mode.name}"
        return self.reported() or "somebody stopped it on the robot, or another program took its place"

    def _safety_changed(self, mode: SafetyMode) -> None:
        if mode in MOVABLE:
            self.driver.robot.reports.clear()  # of a stop that is over
        else:
            self.alarm.set()

    def _fell_silent(self) -> None:
        self._last_words = self.driver.state
        self.alarm.set()


def _described(report: ErrorCodeMessage) -> str:
    return f"{report.label} {report.text}".strip()


def _means_out_of_reach(failure: ScriptFailedError) -> bool:
    """By its text, which is the robot's: "unable to find an inverse kinematics solution" and the like."""
    text = failure.text.lower()
    return "inverse kin" in text or "out of reach" in text or "joint limits" in text
