"""How stops go: each is followed until the arm stands, and watched for taking too long."""

from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING, Final

from emulator.lifecycle.safety import StopCategory
from urproto.modes import SafetyMode

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["StopMonitor", "StopRecord"]

_STOP_WITHIN_S: Final = 0.524  # CB3 manual: braking begins within 24 ms and takes 500 ms at most
_REST_RAD_S: Final = 0.2  # CB3 manual: slower than this a joint counts as standing


@dataclass(slots=True)
class StopRecord:
    """How the last stop went: category, how long it took and how far the tool travelled [m]."""

    category: StopCategory
    mode: SafetyMode
    began_s: float
    duration_s: float = 0.0
    distance_m: float = 0.0
    done: bool = False


class StopMonitor:
    """last: the stop under way, or the last one."""

    def __init__(self, controller: "Controller") -> None:
        self._controller = controller
        self.last: StopRecord | None = None

    def begin(self, category: StopCategory, mode: SafetyMode) -> None:
        """The arm is being stopped from now on."""
        self.last = StopRecord(category, mode, self._controller.time_s)

    def end(self) -> None:
        """The stop is over, also one that was released before the arm stood: it may move again."""
        if self.last is not None:
            self.last.done = True

    def follow(self) -> bool:
        """Once a control period; True when the stop takes too long."""
        stop, controller = self.last, self._controller
        if stop is None or stop.done:
            return False
        stop.duration_s = controller.time_s - stop.began_s
        stop.distance_m += hypot(*controller.arm.tcp_speed[:3]) * controller.period_s
        stop.done = controller.standing
        if stop.done:
            controller.messages.note(
                f"{stop.mode.name}: stop category {stop.category.value} took {stop.duration_s:.3f} s, "
                f"the tool travelled {stop.distance_m:.3f} m"
            )
            return False
        stop.done = stop.duration_s > _STOP_WITHIN_S and self._too_slow(stop)
        return stop.done

    def _too_slow(self, stop: StopRecord) -> bool:
        """Asked when a stop should be over: the arm still moves, and neither its brakes nor a soft stop are at work."""
        controller = self._controller
        monitored = stop.category is not StopCategory.POWER_REMOVED and controller.motion.hard_transitions
        return monitored and max(map(abs, controller.arm.qd)) > _REST_RAD_S
