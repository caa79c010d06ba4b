"""All causes of reactions of the safety system: description, report code, effect, and recovery.

Stop category, safety mode, robot mode and the effect on the program follow from the safety event by the tables of
`emulator.lifecycle.safety`. Source of the codes and their meaning: the vendor's error table, as copied in public
libraries, in whose terms C150 is "position close to joint limits", C153 "position deviates from path", C154 "position
in singularity", C157 "collision detected by joint", C191 "safety system violation". Seen by users: C153 and C157 (the
vendor's note on protective stops, and many others), C154A0 (URSim 5.12, 5.26), C204A3 (UR5e, UR3), C403A0 (UR5e 5.8).
For those marked as a guess there is no public example.
"""

from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Final

from emulator.lifecycle.safety import SAFETY_TABLE, STOP_CATEGORY, SafetyEvent, StopCategory
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode, SafetyStatus
from urproto.versions import Series


class Recovery(Enum):
    """A step of recovery, until the arm can move again; the texts appear in the documentation."""

    RELEASE = "release the device or input that causes it"
    RESET = "rising edge of the reset input"
    UNLOCK = "unlock protective stop, after 5 s at the earliest"
    RESTART = "restart safety"
    POWER_UP = "power on, brake release"
    MOVE_BACK = "freedrive or jog back inside the limits"
    PLAY = "play"


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseRow:
    """One cause. ``code`` and ``argument`` form C<code>A<argument>; None if only the mode is logged.

    per_joint: the joint (0-5) is added to the argument. own_status: the safety status if it is more specific than the
    mode. only: the series that has the cause, None for both.
    """

    what: str
    event: SafetyEvent
    recovery: tuple[Recovery, ...]
    code: int | None = None
    argument: int = 0
    per_joint: bool = False
    level: ReportLevel = ReportLevel.WARNING
    only: Series | None = None
    own_status: SafetyStatus | None = None

    @property
    def mode(self) -> SafetyMode:
        """The resulting safety mode, from normal operation."""
        return SAFETY_TABLE[SafetyMode.NORMAL, self.event]

    @property
    def status(self) -> SafetyStatus:
        return self.own_status or SafetyStatus(self.mode)

    @property
    def category(self) -> StopCategory | None:
        """Stop category; None if the arm is not stopped."""
        return STOP_CATEGORY.get(self.mode)

    @property
    def robot_mode(self) -> RobotMode:
        """The robot mode once the arm has stopped."""
        keeps_power = self.category in (None, StopCategory.CONTROLLED)
        return RobotMode.RUNNING if keeps_power else RobotMode.POWER_OFF

    @property
    def program(self) -> RuntimeState:
        """The resulting state of a program that was playing."""
        if self.category is StopCategory.POWER_REMOVED:
            return RuntimeState.STOPPED
        return RuntimeState.PLAYING if self.category is None else RuntimeState.PAUSED

    @property
    def label(self) -> str:
        if self.code is None:
            return "-"
        return f"C{self.code}A" + (f"{self.argument}-{self.argument + 5}" if self.per_joint else f"{self.argument}")


_R = Recovery
_EMERGENCY: Final = (_R.RELEASE, _R.POWER_UP, _R.PLAY)
_UNLOCK: Final = (_R.UNLOCK, _R.PLAY)
_HARD: Final = (_R.RESTART, _R.POWER_UP)


_protective: Final = partial(CauseRow, event=SafetyEvent.PROTECTIVE_STOP, recovery=_UNLOCK)
_violation: Final = partial(
    CauseRow, event=SafetyEvent.VIOLATION, recovery=_HARD, code=191, level=ReportLevel.VIOLATION
)
_fault: Final = partial(CauseRow, event=SafetyEvent.FAULT, recovery=_HARD, level=ReportLevel.FAULT)


class Cause(Enum):
    """Causes; the value is the row of the table."""

    ROBOT_EMERGENCY_STOP = CauseRow(
        what="emergency stop button, or the robot emergency stop input",
        event=SafetyEvent.ROBOT_EMERGENCY_STOP,
        recovery=_EMERGENCY,
    )
    SYSTEM_EMERGENCY_STOP = CauseRow(
        what="emergency stop of another machine, by a configurable input",
        event=SafetyEvent.SYSTEM_EMERGENCY_STOP,
        recovery=_EMERGENCY,
    )
    SAFEGUARD_STOP = CauseRow(
        what="safeguard input open; resumes by itself, or with the reset input where one is assigned",
        event=SafetyEvent.SAFEGUARD_OPEN,
        recovery=(_R.RELEASE, _R.RESET),
    )
    AUTOMATIC_MODE_SAFEGUARD_STOP = CauseRow(
        what="automatic mode safeguard open, in automatic mode",
        event=SafetyEvent.AUTOMATIC_SAFEGUARD_OPEN,
        recovery=(_R.RELEASE, _R.RESET),
        only=Series.E,
        own_status=SafetyStatus.AUTOMATIC_MODE_SAFEGUARD_STOP,
    )
    ENABLING_STOP = CauseRow(
        what="three-position enabling device released or pressed through, in manual mode",
        event=SafetyEvent.ENABLING_RELEASED,
        recovery=(_R.RELEASE,),
        only=Series.E,
        own_status=SafetyStatus.SYSTEM_THREE_POSITION_ENABLING_STOP,
    )
    REDUCED_MODE = CauseRow(
        what="reduced mode input low, or the tool beyond a trigger plane",
        event=SafetyEvent.REDUCED,
        recovery=(_R.RELEASE,),
    )
    OUTSIDE_LIMITS = CauseRow(
        what="the arm is outside its position limits when it is powered up or unlocked",
        event=SafetyEvent.OUTSIDE_LIMITS,
        recovery=(_R.MOVE_BACK,),
    )

    JOINT_LIMIT = _protective(what="a joint cannot stop before its position limit", code=150)
    TOOL_ORIENTATION = _protective(what="the tool is close to its orientation limit", code=151)
    SAFETY_PLANE = _protective(what="the tool is close to a safety plane", code=152)
    PATH_DEVIATION = _protective(what="a joint is too far from its target", code=153, per_joint=True)
    COLLISION = _protective(
        what="a joint's current is outside its window: a collision, if enabled also of the arm with itself",
        code=157,
        per_joint=True,
    )
    ELBOW_PLANE = _protective(
        what="the elbow is close to a safety plane", code=400, only=Series.E
    )  # code: guess, next to C403; another vendor's list has both in this order, two codes apart
    CLAMPING = _protective(what="the flange is so close to the lower arm that it could clamp", code=403, only=Series.E)
    UNREACHABLE = _protective(what="a pose out of reach of a straight or circular path", code=204, argument=3)
    SINGULARITY = _protective(what="a path through a singularity, or one that begins in one", code=154)
    WORLD_FAILURE = _protective(
        what="the world around the arm can no longer be computed (--physics)", code=116, argument=1
    )  # code: guess, as for a failure of the emulator
    PROGRAM = _protective(what="protective_stop() of a program", code=209)  # "triggered, for test purposes only"

    JOINT_POSITION_VIOLATION = _violation(what="joint position limit", argument=1)
    JOINT_SPEED_VIOLATION = _violation(what="joint speed limit", argument=32, per_joint=True)
    TCP_SPEED_VIOLATION = _violation(what="tool speed limit", argument=3)
    TCP_POSITION_VIOLATION = _violation(what="safety plane", argument=4)
    TCP_ORIENTATION_VIOLATION = _violation(what="tool orientation limit", argument=5)
    POWER_VIOLATION = _violation(what="power limit", argument=6)
    FORCE_VIOLATION = _violation(what="force limit of the tool", argument=7)  # instead of the torque windows: guess
    MOMENTUM_VIOLATION = _violation(what="momentum limit", argument=12)
    ELBOW_SPEED_VIOLATION = _violation(what="elbow speed limit", argument=3, only=Series.E)  # argument: guess
    STOP_TIME_VIOLATION = _violation(what="a stop that takes too long", argument=16)

    SAFETY_FAULT = _fault(what="the two safety processors disagree", code=192, argument=1)
    JOINT_FAULT = _fault(what="a joint reports a fault", code=193, per_joint=True)
    POWER_LOSS = _fault(what="the arm's 48 V supply is lost", code=50, argument=5)  # mode: guess
    STOP_COUNT = _fault(
        what="more than 50 protective stops on one joint within 8 h", code=163, per_joint=True
    )  # mode: guess
    EMULATOR_FAILURE = _fault(
        what="the emulator itself failed in a control period: a bug, see the log", code=116
    )  # code: guess, that of the real-time part


CAUSES: Final[dict[Cause, CauseRow]] = {cause: cause.value for cause in Cause}
