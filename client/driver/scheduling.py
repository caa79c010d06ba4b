"""Real-time priority for the threads that feed a robot, and notice of the times in which this process stood still."""

import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from urproto.errors import LocalProtocolError

RealTime = Literal["auto", "on", "off"]
"""``auto`` takes real-time priority if it is allowed, ``on`` requires it, ``off`` does without."""

_PRIORITY: Final = 20  # guess: above anything that is not real time, below a driver's interrupt threads
_HINT: Final = "allow it (ulimit -r 99, or the capability CAP_SYS_NICE), or use realtime='auto'"

_logger = logging.getLogger(__name__)

_SHORTEST_S: Final = 0.2  # guess: a shorter pause has no consequences, as a robot waits this long for a setpoint
_REMEMBERED_S: Final = 10.0  # guess: the consequences are reported within this
_CLOCK: Final = getattr(time, "CLOCK_BOOTTIME", None)  # also runs while the machine is asleep


def real_time_thread(how: RealTime) -> bool:
    """Give the calling thread real-time priority (SCHED_FIFO), and return whether it has it.

    Raises LocalProtocolError for any other word, and OSError with ``on`` if it is not allowed.
    """
    if how not in ("auto", "on", "off"):
        raise LocalProtocolError(f"realtime is 'auto', 'on' or 'off', not {how!r}")
    if how == "off":
        return False
    try:
        _take_priority()
    except OSError as error:
        if how == "on":
            raise OSError(f"no real-time priority for {threading.current_thread().name} ({error}): {_HINT}") from None
        _logger.info("no real-time priority for %s: %s", threading.current_thread().name, error)
        return False
    return True


def _take_priority() -> None:
    if sys.platform != "linux":
        raise OSError("supported on Linux only")
    # reset on fork: processes that this program starts must not inherit the priority
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))


@contextmanager
def real_time(how: RealTime) -> Iterator[bool]:
    """Give the calling thread real-time priority for the duration of the block, if that is allowed."""
    if sys.platform != "linux":
        yield real_time_thread(how)
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    granted = real_time_thread(how)
    try:
        yield granted
    finally:
        if granted:
            os.sched_setscheduler(0, *before)


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
