"""Notices when this process stood still: it was stopped, got no share of the CPU, or its machine was asleep."""

import sys
import threading
import time
from typing import Final

_SHORTEST_S: Final = 0.2  # guess: a shorter pause has no consequences, as a robot waits this long for a setpoint
_REMEMBERED_S: Final = 10.0  # guess: the consequences are reported within this
_CLOCK: Final = getattr(time, "CLOCK_BOOTTIME", None)  # also runs while the machine is asleep


class Standstill:
    """The last time in which this process did nothing.

    A thread calls `beat` every few hundredths of a second; a longer time between two calls is a standstill.
    """

    def __init__(self) -> None:
        self._beat_s: float | None = None
        self._lasted_s = 0.0
        self._ended_s = 0.0
        self._lock = threading.Lock()

    def beat(self) -> None:
        """Note that the process is running."""
        with self._lock:
            now_s = _now_s()
            if self._beat_s is not None and now_s - self._beat_s > _SHORTEST_S:
                self._lasted_s, self._ended_s = now_s - self._beat_s, now_s
            self._beat_s = now_s

    def describe(self) -> str:
        """Say how long this process stood still, if that was recently; otherwise ""."""
        if self._beat_s is not None:
            self.beat()  # the thread may not have had its turn since
        if not self._lasted_s or _now_s() - self._ended_s > _REMEMBERED_S:
            return ""
        return f"this program stood still for {self._lasted_s:.1f} s, stopped or without CPU time"


def _now_s() -> float:
    if sys.platform == "win32" or _CLOCK is None:
        return time.monotonic()
    return time.clock_gettime(_CLOCK)
