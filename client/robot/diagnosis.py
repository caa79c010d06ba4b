"""What a robot is doing, and why it does not do what it was asked to."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Self

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
from client.robot.state import MORE_OUTPUTS, OUTPUTS, RobotState
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import Joints
from urproto.robots.pose import Pose

_FREE_PORTS: Final = {"reverse_port": 0, "trajectory_port": 0, "command_port": 0, "sender_port": 0}
_WORDS_S: Final = 0.3  # guess: what explains an end arrives within this; the primary interface sends 10 times a second
_LISTEN_EVERY_S: Final = 0.01

_ADVICE: Final = {
    SafetyMode.PROTECTIVE_STOP: "find the cause, see that the way is free, then recover()",
    SafetyMode.SAFEGUARD_STOP: "clear what the safeguard watches and reset it, then make_ready()",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.ROBOT_EMERGENCY_STOP: "release the emergency stop, then make_ready()",
    SafetyMode.VIOLATION: "find the cause, then restart the safety system on the robot",
    SafetyMode.FAULT: "find the cause, then restart the safety system on the robot",
}


class Troubles:
    """A driver, and the reasons it does not see: which stop it was, who ended the program.

    driver: for what this class does not offer.
    """

    def __init__(self, host: str, **options: Any) -> None:
        free = _FREE_PORTS if options.get("headless", True) else {}
        outputs = tuple(dict.fromkeys((*OUTPUTS, *options.pop("outputs", ()))))
        more = {"outputs_if_any": MORE_OUTPUTS}
        self.driver = URDriver(host, **(free | more | options), outputs=outputs)
        self._started = False  # the program runs as far as the caller was told
        self._trouble = asyncio.Event()
        self._last_words: object = None  # the state after which the robot fell silent

    async def __aenter__(self) -> Self:
        """Connect. The arm does not move, and a program that runs on the robot goes on."""
        await self.driver.__aenter__()
        self.driver.on_safety_mode(self._safety_changed)
        self.driver.robot.on_silence.append(self._fell_silent)
        return self

    # what there is to see

    @property
    def state(self) -> RobotState:
        """The newest state."""
        return RobotState.of(self.driver.state)

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3."""
        return self.state.q_rad

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]."""
        return self.state.pose_base_tcp

    def digital_in(self, number: int) -> bool:
        """Level of a digital input: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return self.state.digital_in(number)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered as the inputs are."""
        return self.state.digital_out(number)

    # what went wrong

    def _check_safety(self, doing: str) -> None:
        mode = self.driver.robot.safety_mode
        if mode not in MOVABLE:
            kind = ProtectiveStopError if mode is SafetyMode.PROTECTIVE_STOP else SafetyStopError
            raise kind(doing, mode, self._reported(), _ADVICE.get(mode, "the pendant says what has to be done"))

    async def _refuse_in_stop(self, doing: str) -> None:
        """As _check_safety, with the cause, which comes by another connection than the mode."""
        if self.driver.robot.safety_mode not in MOVABLE:
            await self._hear(lambda: bool(self._reported()))
        self._check_safety(doing)

    @property
    def _paused(self) -> bool:
        return bool(self.driver.state["runtime_state"] in (RuntimeState.PAUSING, RuntimeState.PAUSED))

    async def _next_state(self, doing: str) -> None:
        try:
            await self.driver.next_state()
        except ClientError:
            raise self._unreachable(doing) from None

    def _safety_changed(self, mode: SafetyMode) -> None:
        if mode in MOVABLE:
            self.driver.robot.reports.clear()  # of a stop that is over
        else:
            self._trouble.set()

    def _fell_silent(self) -> None:
        self._last_words = self.driver.state
        self._trouble.set()

    def _unreachable(self, doing: str) -> RobotUnreachableError:
        config = self.driver.config
        reason = f"it was lost, or the robot fell silent, during {doing}"
        return RobotUnreachableError(config.robot, config.robot_ports["rtde"], reason)

    async def _explanation(self, doing: str) -> Exception:
        """Why this has ended, as far as the robot says so."""
        failure = await self._last_failure()
        if self._silent:
            return self._unreachable(doing)
        try:
            self._check_safety(doing)
        except SafetyStopError as stop:
            return stop
        if failure is not None and _means_out_of_reach(failure):
            self._started = False  # the caller's target, and nobody's wish to end the program: it may start by itself
            return OutOfReachError(doing, failure.text)
        advice = "make_ready() starts it again"
        if self.driver.lost_why and not self.driver.pulse.bitten:
            advice = "the next motion starts it again"
        return ProgramEndedError(self.driver.reverse.port, doing, self._why(failure), advice)

    async def _last_failure(self) -> ScriptFailedError | None:
        """The script error that ended the program, if one did; what else explains an end has then come too."""
        failures: list[ScriptFailedError] = []

        def heard() -> bool:
            if failure := self.driver.robot.take_script_error():
                failures.append(failure)
            stopped = self.driver.robot.safety_mode not in MOVABLE and self._reported()
            return bool(failures or self._silent or stopped or self.driver.lost_why)

        await self._hear(heard)
        return failures[0] if failures else None

    async def _hear(self, heard: Callable[[], bool]) -> None:
        """Wait for what the robot says by another connection, as long as that may take."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_WORDS_S):
                while not heard():
                    await asyncio.sleep(_LISTEN_EVERY_S)

    def _why(self, failure: ScriptFailedError | None) -> str:
        if failure is not None:
            return str(failure)
        if self.driver.lost_why:
            return self.driver.lost_why
        mode = self.driver.robot.robot_mode
        if mode is not RobotMode.RUNNING:
            return f"the robot's mode is {mode.name}"
        return self._reported() or "somebody stopped it on the robot, or another program took its place"

    @property
    def _silent(self) -> bool:
        return self.driver.state is self._last_words

    def _reported(self) -> str:
        """The last error the robot has reported since the program was started."""
        grave = [
            report
            for report in self.driver.robot.reports
            if ReportLevel.WARNING <= report.level < ReportLevel.DEVELOPER_DEBUG
        ]
        return _described(grave[-1]) if grave else ""


def _described(report: ErrorCodeMessage) -> str:
    return f"{report.label} {report.text}".strip()


def _means_out_of_reach(failure: ScriptFailedError) -> bool:
    """By its text, which is the robot's: "unable to find an inverse kinematics solution" and the like."""
    text = failure.text.lower()
    return "inverse kin" in text or "out of reach" in text or "joint limits" in text
