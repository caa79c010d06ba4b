"""The clocks that drive a controller; the only module that reads the time.

A clock calls the tick once per control period: ``RealClock`` in real time, or a multiple of it; ``FastClock`` as fast
as possible.

Deadlines are absolute, so lateness does not accumulate. After a late tick, the next ones follow at slightly less than
the control period until they have caught up, but never in a burst: clients that expect a package every 2 ms treat two
packages within 1 ms as an error. After a long standstill the missed periods are dropped, and the robot's time falls
behind the wall clock.

On Linux a timerfd in the event loop triggers the tick. On a two-core machine its median lateness was 0.04 ms; asyncio's
own timers, which round to the milliseconds of epoll, were 0.6 ms late. The timer is armed once, and again only where
deadlines are not one period apart.
"""

import asyncio
import contextlib
import ctypes
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

Tick = Callable[[], object]

_NS: Final = 1_000_000_000
_MIN_GAP: Final = 0.6  # of a period, between two ticks while catching up: 1.2 ms at 500 Hz, above the 1 ms of clients
_MAX_BEHIND_NS: Final = 250_000_000  # guess: after a longer standstill the missed periods are dropped
_REVIEW_EVERY_NS: Final = 10 * _NS
_TOO_MANY_MISSED: Final = 0.01  # of all ticks, before it is worth a warning (guess)
_BURST: Final = 50  # ticks of a fast clock before the event loop runs
_BIN_NS: Final = 10_000
_BINS: Final = 2_000  # for a lateness of up to 20 ms

_logger = logging.getLogger(__name__)


class Clock(Protocol):
    """Drives a controller."""

    @property
    def last_tick_s(self) -> float: ...

    def start(self, tick: Tick) -> None:
        """Start to call ``tick`` once per control period. Needs a running event loop."""

    def close(self) -> None:
        """Stop the clock; does nothing if it is not running."""


@dataclass
class ClockStatistics:
    """Statistics of the punctuality of ticks.

    missed: ticks that began at least a whole period late, and periods that were dropped.
    """

    ticks: int = 0
    missed: int = 0
    latest_ns: int = 0
    _bins: list[int] = field(default_factory=lambda: [0] * (_BINS + 1), repr=False)

    def record(self, lateness_ns: int, period_ns: int) -> None:
        self.ticks += 1
        self._bins[min(max(lateness_ns, 0) // _BIN_NS, _BINS)] += 1
        if lateness_ns >= period_ns:
            self.missed += 1
        self.latest_ns = max(self.latest_ns, lateness_ns)

    def lateness_s(self, share: float) -> float:
        """The lateness [s] that this fraction of the ticks (0..1) did not exceed, with a resolution of 0.01 ms."""
        return _percentile(self._bins, share) * _BIN_NS / _NS


def _percentile(bins: Sequence[int], share: float) -> int:
    """Upper edge of the bin at which this fraction of all counts is reached."""
    wanted = share * sum(bins)
    seen = 0
    for index, count in enumerate(bins):
        seen += count
        if seen >= wanted and count:
            return index + 1
    return 0


class RealClock:
    """One tick per ``period_s / speed`` seconds of real time; at infinite speed one after the other.

    ``paused``: no ticks until ``resume``.
    """

    def __init__(self, period_s: float, speed: float = 1.0) -> None:
        self.statistics = ClockStatistics()
        self.last_tick_s = 0.0
        self.paused = False
        self._period_s = period_s
        self._tick: Tick = lambda: None
        self._timer: _Timer | None = None
        self._deadline_ns = 0
        self._next_ns = 0  # when the timer expires unless it is armed again
        self._reviewed_ns = 0
        self._missed_when_reviewed = 0
        self._given_up_ns = 0  # time of dropped periods since the last review
        self._drift = 0.0
        self._late_s = 0.0  # for the next tick
        self._late_for_good = False
        self.set_speed(speed)

    @property
    def speed(self) -> float:
        """Simulated seconds per second."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """Set the speed from now on. Raises ValueError unless it is positive."""
        if not speed > 0.0:
            raise ValueError(f"the speed must be a positive number, not {speed}")
        self._speed = speed
        period_s = self._period_s / (speed * (1.0 + self._drift))
        self._period_ns = max(1, round(period_s * _NS)) if speed < math.inf else 0
        self._least_gap_ns = int(self._period_ns * _MIN_GAP)
        self._begin()

    def set_drift(self, share: float) -> None:
        """Make the robot's clock fast by this fraction, or slow if it is negative: a fault."""
        self._drift = share
        self.set_speed(self._speed)

    def delay_next(self, seconds: float, *, made_up: bool) -> None:
        """Delay the next tick [s of robot time]; made_up: the following ones catch up. A fault."""
        self._late_s, self._late_for_good = seconds, not made_up

    def pause(self) -> None:
        self.paused = True

    def resume(self) -> None:
        """Continue; the time of the pause is not caught up."""
        if self.paused:
            self.paused = False
            self._begin()

    def start(self, tick: Tick) -> None:
        self._tick = tick
        self._timer = _timer(asyncio.get_running_loop(), self._expired)
        self._begin()

    def close(self) -> None:
        timer, self._timer = self._timer, None
        if timer is not None:
            timer.close()

    def _begin(self) -> None:
        """Restart deadlines and review from now."""
        self._reviewed_ns = time.monotonic_ns()
        self._missed_when_reviewed, self._given_up_ns = self.statistics.missed, 0
        self._deadline_ns = self._reviewed_ns + self._period_ns
        if self._timer is not None and not self.paused:
            self._arm(self._timer, self._deadline_ns)

    def _arm(self, timer: "_Timer", due_ns: int) -> None:
        self._next_ns = due_ns
        timer.arm(due_ns, self._period_ns)

    def _expired(self) -> None:
        if self.paused:
            if self._timer is not None:
                self._timer.disarm()
            return
        began_ns = time.monotonic_ns()
        self._next_ns += self._period_ns
        if self._period_ns:
            self.statistics.record(began_ns - self._deadline_ns, self._period_ns)
        try:
            self._tick()
        finally:
            now_ns = time.monotonic_ns()
            self.last_tick_s = (now_ns - began_ns) / _NS
            self._plan_next(began_ns, now_ns)

    def _plan_next(self, began_ns: int, now_ns: int) -> None:
        self._deadline_ns += self._period_ns
        behind_ns = now_ns - self._deadline_ns
        if not self._period_ns:
            self._deadline_ns = now_ns
        elif behind_ns > 0:
            self._fell_behind(behind_ns, now_ns)
        late_ns = 0
        if self._late_s:
            late_ns = self._take_lateness()
        due_ns = max(self._deadline_ns, began_ns + self._least_gap_ns) + late_ns
        if due_ns != self._next_ns and self._timer is not None and not self.paused:
            self._arm(self._timer, due_ns)

    def _take_lateness(self) -> int:
        """The additional delay of the next tick [ns], if a fault demands one."""
        late_ns = round(self._late_s / self._speed * _NS)
        self._late_s = 0.0
        if self._late_for_good:
            self._deadline_ns += late_ns
            return 0
        return late_ns

    def _fell_behind(self, behind_ns: int, now_ns: int) -> None:
        if behind_ns > _MAX_BEHIND_NS:
            given_up = behind_ns // self._period_ns
            self.statistics.missed += given_up
            self._deadline_ns += given_up * self._period_ns
            self._given_up_ns += given_up * self._period_ns
        if now_ns - self._reviewed_ns > _REVIEW_EVERY_NS:
            self._review(now_ns)

    def _review(self, now_ns: int) -> None:
        wall_ns = now_ns - self._reviewed_ns
        periods = wall_ns / self._period_ns
        missed = self.statistics.missed - self._missed_when_reviewed
        if missed > _TOO_MANY_MISSED * periods:
            _logger.warning(
                "this machine is too slow or too busy: %d of %d control periods were late, "
                "time ran %.2f times as fast as the wall clock",
                missed,
                periods,
                self._speed * (1.0 - self._given_up_ns / wall_ns),
            )
        self._reviewed_ns, self._missed_when_reviewed, self._given_up_ns = now_ns, self.statistics.missed, 0


class FastClock:
    """As fast as possible, but in real time while ``has_peers()``, because outside peers live in real time.

    The event loop gets its turn after every tick in real time, otherwise after every few dozen ticks.
    """

    def __init__(self, period_s: float, has_peers: Callable[[], bool]) -> None:
        self._real = RealClock(period_s)
        self._has_peers = has_peers
        self._tick: Tick = lambda: None
        self._next: asyncio.Handle | None = None
        self._running = False

    @property
    def last_tick_s(self) -> float:
        return self._real.last_tick_s

    def start(self, tick: Tick) -> None:
        self._tick = tick
        self._running = True
        self._schedule_burst()

    def close(self) -> None:
        self._running = False
        self._real.close()
        if self._next is not None:
            self._next.cancel()

    def _schedule_burst(self) -> None:
        self._next = asyncio.get_running_loop().call_soon(self._burst)

    def _burst(self) -> None:
        for _ in range(_BURST):
            if self._has_peers():
                self._real.start(self._tick_with_peers)
                return
            self._tick()
            if not self._running:
                return
        self._schedule_burst()

    def _tick_with_peers(self) -> None:
        self._tick()
        if self._running and not self._has_peers():
            self._real.close()
            self._schedule_burst()


class _Timer(Protocol):
    def arm(self, deadline_ns: int, period_ns: int) -> None:
        """Expire at the deadline, and then once per period; only at the deadline if the period is 0."""

    def disarm(self) -> None: ...

    def close(self) -> None: ...


def _timer(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> _Timer:
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError, NotImplementedError):
            # the values of TFD_NONBLOCK and TFD_CLOEXEC
            return _TimerFd(loop, callback, time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    return _LoopTimer(loop, callback)


class _LoopTimer:
    """A timer of the event loop, which uses the monotonic clock too."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._handle: asyncio.TimerHandle | None = None

    def arm(self, deadline_ns: int, period_ns: int) -> None:
        self.disarm()
        self._handle = self._loop.call_at(deadline_ns / _NS, self._expired, deadline_ns, period_ns)

    def disarm(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def close(self) -> None:
        self.disarm()

    def _expired(self, deadline_ns: int, period_ns: int) -> None:
        self._handle = None
        if period_ns:
            self.arm(deadline_ns + period_ns, period_ns)
        self._callback()


class _Times(ctypes.Structure):
    """struct itimerspec: the time of expiry, and the interval of further ones."""

    _fields_ = (
        ("interval_s", ctypes.c_long),
        ("interval_ns", ctypes.c_long),
        ("value_s", ctypes.c_long),
        ("value_ns", ctypes.c_long),
    )


class _TimerFd:
    """Linux timerfd_create(2), which Python provides only since 3.13."""

    _ABSOLUTE: Final = 1  # TFD_TIMER_ABSTIME
    _EXPIRATIONS: Final = 8  # bytes of the counter read from it

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None], clock: int, flags: int) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._settime = libc.timerfd_settime
        self._times = _Times()
        self._reference = ctypes.byref(self._times)
        self._fd: int = _checked(libc.timerfd_create(clock, flags))
        self._loop = loop
        self._callback = callback
        loop.add_reader(self._fd, self._expired)

    def arm(self, deadline_ns: int, period_ns: int) -> None:
        times = self._times
        times.value_s, times.value_ns = divmod(deadline_ns, _NS)
        times.interval_s, times.interval_ns = divmod(period_ns, _NS)
        _checked(self._settime(self._fd, self._ABSOLUTE, self._reference, None))

    def disarm(self) -> None:
        self.arm(0, 0)

    def close(self) -> None:
        self._loop.remove_reader(self._fd)
        os.close(self._fd)

    def _expired(self) -> None:
        try:
            os.read(self._fd, self._EXPIRATIONS)
        except BlockingIOError:  # re-armed between wake-up and read
            return
        self._callback()


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
