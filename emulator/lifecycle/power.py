"""Power life cycle of the arm as a table.

    OFF --power on--> BOOTING --timer--> POWERED --timer--> IDLE
    IDLE --brake release--> RELEASING --timer--> RUNNING
    any --power off--> OFF

Releasing the brakes of an arm that is off powers it on first. Each state determines what
robot mode, joints and tool report; RELEASING is reported as IDLE.
"""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from emulator.snapshot import Snapshot
from urproto.modes import JointMode, RobotMode, ToolMode


class PowerState(Enum):
    """Stages of the arm between off and running."""

    CONTROLLER_BOOTING = auto()
    OFF = auto()
    BOOTING = auto()
    POWERED = auto()
    IDLE = auto()
    RELEASING = auto()
    RUNNING = auto()


class PowerEvent(Enum):
    """Events of the arm's power. TIMEOUT: the timed step in progress is complete."""

    POWER_ON = auto()
    BRAKE_RELEASE = auto()
    POWER_OFF = auto()
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
    """Durations of the steps [s].

    No recording of a simulator is public. Upper bounds are given by test suites that pass on simulators: ur_rtde's
    allows an arm that is off 3 s from `brake release` until it moves; the official C++ library's sends a script 0.7 s
    after it, and after loading a program, which takes less than a second. How the time is split is a guess. A real arm
    takes longer: its users wait 5 s for each of both (shadow-robot/sr_interface, pull request 493).
    """

    controller_boot_s: float = 0.0  # 0: the controller is up as soon as the emulator is
    joint_boot_s: float = 0.4
    power_on_s: float = 0.2
    brake_release_s: float = 0.5


REPORTS: Final[dict[PowerState, PowerReport]] = {
    PowerState.CONTROLLER_BOOTING: PowerReport(RobotMode.BOOTING, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.OFF: PowerReport(RobotMode.POWER_OFF, JointMode.POWER_OFF, ToolMode.POWER_OFF, False),
    PowerState.BOOTING: PowerReport(RobotMode.BOOTING, JointMode.BOOTING, ToolMode.BOOTING, True),
    PowerState.POWERED: PowerReport(RobotMode.POWER_ON, JointMode.IDLE, ToolMode.IDLE, True),
    PowerState.IDLE: PowerReport(RobotMode.IDLE, JointMode.IDLE, ToolMode.RUNNING, True),
    PowerState.RELEASING: PowerReport(RobotMode.IDLE, JointMode.IDLE, ToolMode.RUNNING, True),
    PowerState.RUNNING: PowerReport(RobotMode.RUNNING, JointMode.RUNNING, ToolMode.RUNNING, True),
}

POWER_TABLE: Final[dict[tuple[PowerState, PowerEvent], PowerState]] = {
    (PowerState.CONTROLLER_BOOTING, PowerEvent.TIMEOUT): PowerState.OFF,
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
_ON_THE_WAY: Final = frozenset({PowerState.OFF, PowerState.BOOTING, PowerState.POWERED})


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
        if running:
            self._enter(PowerState.RUNNING)
        elif timings.controller_boot_s > 0.0:
            self._enter(PowerState.CONTROLLER_BOOTING)

    @property
    def robot_mode(self) -> RobotMode:
        """The robot mode all interfaces report."""
        return self.report.robot_mode

    def handle(self, event: PowerEvent) -> None:
        """Apply an event; a pair that is not in the table changes nothing."""
        if event is PowerEvent.BRAKE_RELEASE and self.state in _ON_THE_WAY:
            self._release_wanted = True
        if event is PowerEvent.POWER_OFF:
            self._release_wanted = False
        state = POWER_TABLE.get((self.state, event), self.state)
        if state is not self.state:
            self._enter(state)

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
        """Write what robot, joints and tool report to a snapshot."""
        report = self.report
        snapshot.robot_mode, snapshot.tool_mode = report.robot_mode, report.tool_mode
        snapshot.joint_mode = (report.joint_mode,) * 6
        snapshot.switched_on = self.switched_on

    def _enter(self, state: PowerState) -> None:
        self.state = state
        self.report, self.running = REPORTS[state], state is PowerState.RUNNING
        self.switched_on |= self.report.powered
        self._remaining_s = self._duration_s(state)
        if state is PowerState.IDLE and self._release_wanted:
            self._release_wanted = False
            self.handle(PowerEvent.BRAKE_RELEASE)

    def _duration_s(self, state: PowerState) -> float | None:
        return {
            PowerState.CONTROLLER_BOOTING: self.timings.controller_boot_s,
            PowerState.BOOTING: self.timings.joint_boot_s,
            PowerState.POWERED: self.timings.power_on_s,
            PowerState.RELEASING: self.timings.brake_release_s,
        }.get(state)
