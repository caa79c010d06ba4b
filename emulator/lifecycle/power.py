"""Power life cycle of the arm as a table.

    DISCONNECTED --timer--> CONTROLLER_BOOTING --timer--> OFF
    OFF --power on--> BOOTING --timer--> POWERED --timer--> IDLE
    IDLE --brake release--> RELEASING --timer--> RUNNING
    any --power off--> OFF

Releasing the brakes of an arm that is off powers it on first. Each state determines what
robot mode, joints and tool report; RELEASING is reported as IDLE.

Until the safety setup is confirmed, an arm that is off is UNCONFIRMED instead, which is reported
as CONFIRM_SAFETY. It can be powered on all the same, as a simulator by its dashboard (a public
report of URSim 5.26); only RTDE sends no data.
"""

from dataclasses import dataclass, replace
from enum import Enum, auto
from math import inf
from typing import Final

from emulator.snapshot import Snapshot
from urproto.compat import Self
from urproto.facts import Situation, find
from urproto.modes import JointMode, RobotMode, ToolMode

_STEPS: Final = (
    "boot.disconnected",
    "boot.booting",
    "boot.confirm_safety",
    "power_on.joints_boot",
    "power_on.idle",
    "brake_release",
)


class PowerState(Enum):
    """Stages of the arm between off and running."""

    DISCONNECTED = auto()
    CONTROLLER_BOOTING = auto()
    UNCONFIRMED = auto()
    OFF = auto()
    BOOTING = auto()
    POWERED = auto()
    IDLE = auto()
    RELEASING = auto()
    RUNNING = auto()


class PowerEvent(Enum):
    """Events of the arm's power. CONFIRM: of the safety setup. TIMEOUT: the timed step in progress is complete."""

    POWER_ON = auto()
    BRAKE_RELEASE = auto()
    POWER_OFF = auto()
    CONFIRM = auto()
    TIMEOUT = auto()


@dataclass(frozen=True, slots=True)
class PowerReport:
    """What the interfaces report in a power state."""

    robot_mode: RobotMode
    joint_mode: JointMode
    tool_mode: ToolMode
    powered: bool


@dataclass(frozen=True, slots=True)
class PowerTimings:
    """Durations of the steps [s]. Those of 0 are left out.

    confirm_safety_s: time after boot in which PolyScope confirms the safety setup; infinite if it never does.
    """

    disconnected_s: float = 0.0
    controller_boot_s: float = 0.0
    confirm_safety_s: float = 0.0
    joint_boot_s: float = 0.0
    power_on_s: float = 0.0
    brake_release_s: float = 0.0

    @classmethod
    def of(cls, situation: Situation) -> Self:
        """Those of a simulator or an arm, from the ledger of facts."""
        return cls(*(find(name, situation).number for name in _STEPS))


REPORTS: Final[dict[PowerState, PowerReport]] = {
    PowerState.DISCONNECTED: PowerReport(RobotMode.DISCONNECTED, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.UNCONFIRMED: PowerReport(RobotMode.CONFIRM_SAFETY, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.CONTROLLER_BOOTING: PowerReport(RobotMode.BOOTING, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.OFF: PowerReport(RobotMode.POWER_OFF, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.BOOTING: PowerReport(RobotMode.BOOTING, JointMode.BOOTING, ToolMode.BOOTING, True),
    PowerState.POWERED: PowerReport(RobotMode.POWER_ON, JointMode.IDLE, ToolMode.IDLE, True),
    PowerState.IDLE: PowerReport(RobotMode.IDLE, JointMode.IDLE, ToolMode.RUNNING, True),
    PowerState.RELEASING: PowerReport(RobotMode.IDLE, JointMode.IDLE, ToolMode.RUNNING, True),
    PowerState.RUNNING: PowerReport(RobotMode.RUNNING, JointMode.RUNNING, ToolMode.RUNNING, True),
}

POWER_TABLE: Final[dict[tuple[PowerState, PowerEvent], PowerState]] = {
    (PowerState.DISCONNECTED, PowerEvent.TIMEOUT): PowerState.CONTROLLER_BOOTING,
    (PowerState.CONTROLLER_BOOTING, PowerEvent.TIMEOUT): PowerState.OFF,
    (PowerState.UNCONFIRMED, PowerEvent.TIMEOUT): PowerState.OFF,
    (PowerState.UNCONFIRMED, PowerEvent.CONFIRM): PowerState.OFF,
    (PowerState.UNCONFIRMED, PowerEvent.POWER_ON): PowerState.BOOTING,
    (PowerState.UNCONFIRMED, PowerEvent.BRAKE_RELEASE): PowerState.BOOTING,
    (PowerState.OFF, PowerEvent.POWER_ON): PowerState.BOOTING,
    (PowerState.OFF, PowerEvent.BRAKE_RELEASE): PowerState.BOOTING,
    (PowerState.BOOTING, PowerEvent.POWER_OFF): PowerState.OFF,
    (PowerState.BOOTING, PowerEvent.TIMEOUT): PowerState.POWERED,
    (PowerState.POWERED, PowerEvent.POWER_OFF): PowerState.OFF,
    (PowerState.POWERED, PowerEvent.TIMEOUT): PowerState.IDLE,
    (PowerState.IDLE, PowerEvent.BRAKE_RELEASE): PowerState.RELEASING,
    (PowerState.IDLE, PowerEvent.POWER_OFF): PowerState.OFF,
    (PowerState.RELEASING, PowerEvent.POWER_OFF): PowerState.OFF,
    (PowerState.RELEASING, PowerEvent.TIMEOUT): PowerState.RUNNING,
    (PowerState.RUNNING, PowerEvent.POWER_OFF): PowerState.OFF,
}

# a brake release that arrives in these states is carried out once IDLE is reached
_ON_THE_WAY: Final = frozenset({PowerState.UNCONFIRMED, PowerState.OFF, PowerState.BOOTING, PowerState.POWERED})


class Power:
    """The power state, its timer, and whether the brakes are to be released on reaching IDLE."""

    def __init__(self, timings: PowerTimings, *, running: bool = False) -> None:
        self.timings = timings
        self._release_wanted = False
        self._remaining_s: float | None = None
        self.state = PowerState.OFF
        self.report = REPORTS[self.state]
        """What robot mode, joints and tool report."""
        self.running = False
        """Whether the brakes are released and the arm may move."""
        self.switched_on = False
        """Whether it has been on at any time."""
        self.safety_confirmed = running or timings.confirm_safety_s == 0.0
        """Whether the safety setup is confirmed."""
        if running:
            self._enter(PowerState.RUNNING)
        elif timings.disconnected_s > 0.0:
            self._enter(PowerState.DISCONNECTED)
        elif timings.controller_boot_s > 0.0:
            self._enter(PowerState.CONTROLLER_BOOTING)
        elif not self.safety_confirmed:
            self._enter(PowerState.UNCONFIRMED)

    @property
    def robot_mode(self) -> RobotMode:
        return self.report.robot_mode

    def handle(self, event: PowerEvent) -> None:
        """Apply an event; a pair that is not in the table changes nothing."""
        if event is PowerEvent.BRAKE_RELEASE and self.state in _ON_THE_WAY:
            self._release_wanted = True
        if event is PowerEvent.POWER_OFF:
            self._release_wanted = False
        if event is PowerEvent.CONFIRM or (self.state is PowerState.UNCONFIRMED and event is PowerEvent.TIMEOUT):
            self.safety_confirmed = True
        state = POWER_TABLE.get((self.state, event), self.state)
        if state is not self.state:
            self._enter(state)

    def revoke_confirmation(self) -> None:
        """The safety setup is no longer confirmed, and PolyScope does not confirm it by itself."""
        self.timings = replace(self.timings, confirm_safety_s=inf)
        self.safety_confirmed = False
        if self.state is PowerState.OFF:
            self._enter(PowerState.OFF)

    def put(self, state: PowerState) -> None:
        """Enter a state immediately, without the steps that lead there."""
        self._release_wanted = False
        self._enter(state)

    def advance(self, period_s: float) -> None:
        """Advance the timed step in progress by one control period."""
        if self._remaining_s is None:
            return
        self._remaining_s -= period_s
        if self._remaining_s <= period_s / 2:  # rounding errors must not add a period
            self.handle(PowerEvent.TIMEOUT)

    def publish(self, snapshot: Snapshot) -> None:
        report = self.report
        snapshot.robot_mode, snapshot.tool_mode = report.robot_mode, report.tool_mode
        snapshot.joint_mode = (report.joint_mode,) * 6
        snapshot.switched_on, snapshot.safety_confirmed = self.switched_on, self.safety_confirmed

    def _enter(self, state: PowerState) -> None:
        if state is PowerState.OFF and not self.safety_confirmed:
            state = PowerState.UNCONFIRMED
        self.state = state
        self.report, self.running = REPORTS[state], state is PowerState.RUNNING
        self.switched_on |= self.report.powered
        self._remaining_s = self._duration_s(state)
        if state is PowerState.IDLE and self._release_wanted:
            self._release_wanted = False
            self.handle(PowerEvent.BRAKE_RELEASE)

    def _duration_s(self, state: PowerState) -> float | None:
        return {
            PowerState.DISCONNECTED: self.timings.disconnected_s,
            PowerState.CONTROLLER_BOOTING: self.timings.controller_boot_s,
            PowerState.UNCONFIRMED: self.timings.confirm_safety_s,
            PowerState.BOOTING: self.timings.joint_boot_s,
            PowerState.POWERED: self.timings.power_on_s,
            PowerState.RELEASING: self.timings.brake_release_s,
        }.get(state)
