"""What makes a control loop punctual on a machine that has other work: priority, and memory that stays where it is.

Linux only, and of this process; elsewhere nothing is granted.
"""

import asyncio
import contextlib
import ctypes
import gc
import logging
import os
import sys
import time
from dataclasses import dataclass
from typing import Final

from urproto.compat import StrEnum

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # MCL_ flags of mlockall(2)
_PRIORITY: Final = 1  # the lowest above all that has none
_DESCRIPTORS: Final = 4096  # room made for them at once (guess): more clients than any test brings
_LOOK_S: Final = 0.5  # how often the load is looked at
_TOO_MUCH: Final = 0.75  # of a core: more leaves too little for whoever else lives on it (guess)
_CALM: Final = 0.5  # of a core (guess)
_CALM_FOR_S: Final = 10.0  # before the priority is taken again (guess)
_HOW: Final = (
    "let the user have it (/etc/security/limits.d: '@realtime - rtprio 99' and '@realtime - memlock unlimited', in a "
    "container --cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1), or leave it at --realtime auto"
)

_logger = logging.getLogger(__name__)


class RealTime(StrEnum):
    """Whether an emulator asks for it: what is granted, all of it or no start, or nothing."""

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class RealTimeRefused(Exception):  # noqa: N818 - as RobotRefused
    """The system does not grant what `RealTime.ON` demands."""


def claim_real_time(wanted: RealTime = RealTime.AUTO) -> list[str]:
    """Ask the system for punctual wake-ups of this process; what was granted, for people.

    For a process that is nothing but emulators: the scheduling class, the locked memory and the frozen heap concern
    the whole process, or the thread that calls. Raises RealTimeRefused.
    """
    freeze_heap()
    if sys.platform != "linux":
        if wanted is RealTime.ON:
            raise RealTimeRefused("--realtime on needs Linux: leave it at auto")
        return []
    _set_timer_slack()
    _make_room_for_descriptors()
    if wanted is RealTime.OFF:
        return []
    granted = {"SCHED_FIFO": _take_priority(), "memory locked": _lock_memory(everything=wanted is RealTime.ON)}
    missing = [name for name, given in granted.items() if not given]
    if missing and wanted is RealTime.ON:
        raise RealTimeRefused(f"--realtime on: the system grants no {' and no '.join(missing)}: {_HOW}")
    return [name for name, given in granted.items() if given]


def freeze_heap() -> None:
    """What lives now is not looked at by the garbage collector any more: a whole look takes many control periods."""
    gc.collect()
    gc.freeze()


def _take_priority() -> bool:
    """Run before all that has no real-time priority; threads and children of this one do not."""
    if sys.platform != "linux":
        return False
    with contextlib.suppress(OSError):  # needs CAP_SYS_NICE or a limit
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
        return True
    return False


def _give_priority_up() -> None:
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _lock_memory(*, everything: bool) -> bool:
    """Keep in memory what is or will be used, code of libraries too. everything: also what was never touched yet.

    Without it the kernel may drop pages of code while the machine is short of memory, and read them from the disk in
    the middle of a control period.
    """
    if sys.platform == "win32":
        return False
    import resource

    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if not unlimited and os.geteuid() != 0:
        return False  # up to the limit it would succeed, and then the process could not allocate any more
    try:
        return bool(ctypes.CDLL(None).mlockall(_CURRENT | _FUTURE | (0 if everything else _ON_FAULT)) == 0)
    except (OSError, AttributeError):
        return False


def _set_timer_slack() -> None:
    """Let timers fire when they are due instead of up to 50 us later."""
    set_timer_slack, slack_ns = 29, 1  # PR_SET_TIMERSLACK of prctl(2)
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(set_timer_slack, slack_ns, 0, 0, 0)


def _make_room_for_descriptors() -> None:
    """Let the kernel enlarge the table of open files now, which it never makes smaller again.

    It would do so when the 256th, the 512th, the 1024th client comes, and a process with threads waits for that: 10 to
    27 ms each were measured.
    """
    if sys.platform == "win32":
        return
    import fcntl
    import resource

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    highest = _DESCRIPTORS if limit == resource.RLIM_INFINITY else min(limit, _DESCRIPTORS)
    with contextlib.suppress(OSError), open(os.devnull, "rb") as null:
        os.close(fcntl.fcntl(null, fcntl.F_DUPFD_CLOEXEC, highest - 1))


@dataclass
class Overload:
    """Whether a loop uses so much of its core that it should have no priority over others there.

    At once when it is too much, and until it was calm for a while.
    """

    over: bool = False
    _calm_s: float = 0.0

    def see(self, share: float, seconds: float) -> bool:
        """share: of a core that was used, for so long. True when ``over`` has changed."""
        self._calm_s = self._calm_s + seconds if share < _CALM else 0.0
        before = self.over
        if share > _TOO_MUCH:
            self.over = True
        elif self._calm_s >= _CALM_FOR_S:
            self.over = False
        return self.over != before


async def yield_under_overload() -> None:
    """Until it is cancelled: give the priority of this thread up while its event loop is flooded with work."""
    overload = Overload()
    used_s, now_s = time.thread_time(), time.monotonic()
    while True:
        await asyncio.sleep(_LOOK_S)
        used_before_s, before_s = used_s, now_s
        used_s, now_s = time.thread_time(), time.monotonic()
        share = (used_s - used_before_s) / (now_s - before_s)
        if overload.see(share, now_s - before_s):
            if overload.over:
                _give_priority_up()
                _logger.warning(
                    "clients keep this emulator busy (%.0f %% of a core): real-time priority is given up, so that "
                    "others get their share. It comes back %.0f s after that ends",
                    100.0 * share,
                    _CALM_FOR_S,
                )
            elif _take_priority():
                _logger.warning("real-time priority is back")


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
