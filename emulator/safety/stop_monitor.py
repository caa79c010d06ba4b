"""Monitors whether a stop of the arm ends in time, and records it."""

from dataclasses import dataclass
from math import hypot
from typing import Final

from emulator.lifecycle.safety import StopCategory
from emulator.machine import Machine
from urproto.modes import SafetyMode

_STOP_WITHIN_S: Final = 0.524  # CB3 manual: braking begins within 24 ms and takes at most 500 ms
_REST_RAD_S: Final = 0.2  # CB3 manual: a slower joint counts as standing


@dataclass(slots=True)
class StopRecord:
    """Record of a stop: category, duration, and the distance travelled by the tool [m]."""

    category: StopCategory
    mode: SafetyMode
    began_s: float
    duration_s: float = 0.0
    distance_m: float = 0.0
    done: bool = False


class StopMonitor:
    """Monitors stops. last: the stop in progress, or the last one."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.last: StopRecord | None = None

    def begin(self, category: StopCategory, mode: SafetyMode) -> None:
        """A stop of the arm begins."""
        self.last = StopRecord(category, mode, self._machine.time_s)

    def end(self) -> None:
        """The stop is over, even if it was released before the arm stood still: the arm may move again."""
        if self.last is not None:
            self.last.done = True

    def follow(self) -> bool:
        """Advance one control period; returns True if the stop takes too long."""
        stop, machine = self.last, self._machine
        if stop is None or stop.done:
            return False
        stop.duration_s = machine.time_s - stop.began_s
        stop.distance_m += hypot(*machine.arm.tcp_speed[:3]) * machine.period_s
        stop.done = machine.standing
        if stop.done:
            machine.messages.note(
                f"{stop.mode.name}: stop category {stop.category.value} took {stop.duration_s:.3f} s, "
                f"the tool travelled {stop.distance_m:.3f} m"
            )
            return False
        stop.done = stop.duration_s > _STOP_WITHIN_S and self._too_slow(stop)
        return stop.done

    def _too_slow(self, stop: StopRecord) -> bool:
        """Whether the arm, when a stop should be over, still moves without its brakes or a soft stop being active."""
        machine = self._machine
        soft = stop.mode is SafetyMode.SAFEGUARD_STOP and not machine.motion.hard_transitions
        monitored = stop.category is not StopCategory.POWER_REMOVED and not soft
        return monitored and max(map(abs, machine.arm.qd)) > _REST_RAD_S
