"""State of the running program as a table.

PAUSING and STOPPING last while the arm comes to rest or the script's sockets close, RESUMING a
tenth of a second; SETTLED ends each of them. While PAUSING and RESUMING, the program's time
slows down and gains its pace again together with the arm (`emulator.motion.program_time`).
Names and numbers are those of RTDE's runtime-state enumeration. Which events a state ignores is a guess, chosen so
that pressing a button twice does no harm.
"""

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from emulator.snapshot import Snapshot
from urproto.compat import Self
from urproto.facts import code_of
from urproto.modes import RuntimeState

READ_ONLY_SOCKET: Final = code_of("read_only_socket")[0]
# Ramp of a program's time when it starts. Measured: target speeds of a UR3 and a UR5 that start a program with a movel
# (el-Lennard/Robotik, Modularbeit/Aufgabe4 and Modularbeit Code/A2_movel.csv: a t (t / 0.16 s)^2 / 2 in each of 20
# periods, to the last digit), angles of a UR10e (shamilmamedov/dynamic_calibration, the first moves of two files)
START_S: Final = 0.16


@dataclass(frozen=True, slots=True)
class StopCause:
    """Cause of a protective stop: ``C<code>A<argument>``, an optional text, and the joint that caused it, if any."""

    code: int
    argument: int = 0
    text: str = ""
    joint: int | None = None

    @classmethod
    def of(cls, situation: str) -> Self:
        """The cause that the ledger of facts has for a situation, such as ``busy_program``."""
        return cls(*code_of(situation))


SCRIPT_PROTECTIVE_STOP: Final = StopCause.of("script_protective_stop")
BUSY_PROTECTIVE_STOP: Final = StopCause.of("busy_program")
RTDE_WATCHDOG: Final = StopCause.of("rtde_watchdog")


class Speed:
    """Speed slider and scaling. ``slider`` is the value that clients set and read (target_speed_fraction),
    ``scaling`` the factor of the limiter (speed_scaling). The motion follows their product smoothly.

    ``start_periods``: control periods in which a starting program's time gains its full pace, linearly.
    """

    def __init__(self, start_periods: int = 1) -> None:
        self.slider = 1.0
        self.scaling = 1.0
        self._start_periods = self._periods = start_periods

    @property
    def fraction(self) -> float:
        """Fraction of full speed to move at."""
        return self.slider * self.scaling * self._gained

    @property
    def _gained(self) -> float:
        return self._periods / self._start_periods

    def program_started(self) -> None:
        self._periods = 0

    def advance(self) -> None:
        if self._periods < self._start_periods:
            self._periods += 1

    def set_slider(self, fraction: float) -> None:
        """Set the slider, clipped to 0..1; NaN is ignored."""
        if not math.isnan(fraction):
            self.slider = min(max(float(fraction), 0.0), 1.0)

    def publish(self, snapshot: Snapshot, path_share: float) -> None:
        """Write slider and scaling to a snapshot that already has the program's state.

        ``path_share``: fraction of the commanded speed that the joints' limits permit.
        """
        snapshot.target_speed_fraction = self.slider
        # captures of controllers show 0 while no program plays, and 1 while one plays undisturbed
        snapshot.speed_scaling = self.scaling * self._gained * path_share if snapshot.program_running else 0.0


class RunEvent(Enum):
    """Events of a program."""

    START = auto()  # a program begins
    PAUSE = auto()  # operator, watchdog or safety system requests a pause
    RESUME = auto()  # a paused program is to continue
    STOP = auto()  # stop, halt, error, or another program replaces it
    FINISH = auto()  # the program has reached its end
    SETTLED = auto()  # the transition in progress is complete


RUN_TABLE: dict[tuple[RuntimeState, RunEvent], RuntimeState] = {
    (RuntimeState.STOPPED, RunEvent.START): RuntimeState.PLAYING,
    (RuntimeState.PLAYING, RunEvent.PAUSE): RuntimeState.PAUSING,
    (RuntimeState.PLAYING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.PLAYING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.PAUSING, RunEvent.SETTLED): RuntimeState.PAUSED,
    (RuntimeState.PAUSING, RunEvent.RESUME): RuntimeState.RESUMING,
    (RuntimeState.PAUSING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.PAUSING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.PAUSED, RunEvent.RESUME): RuntimeState.RESUMING,
    (RuntimeState.PAUSED, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.RESUMING, RunEvent.SETTLED): RuntimeState.PLAYING,
    (RuntimeState.RESUMING, RunEvent.PAUSE): RuntimeState.PAUSING,
    (RuntimeState.RESUMING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.RESUMING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.STOPPING, RunEvent.SETTLED): RuntimeState.STOPPED,
}


def next_run_state(state: RuntimeState, event: RunEvent) -> RuntimeState:
    """The state after the event; a pair that is not in the table changes nothing."""
    return RUN_TABLE.get((state, event), state)


def is_running(state: RuntimeState) -> bool:
    """Whether a program is loaded into the interpreter and neither paused nor over."""
    return state in (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING)
