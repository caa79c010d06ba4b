"""Real-time priority and locked memory, which keep a control loop punctual on a machine with other work.

They apply to this process, on Linux only; on other systems nothing is granted.
"""

import asyncio
import contextlib
import ctypes
import gc
import logging
import os
import re
import sys
import time
from dataclasses import dataclass
from typing import Final

from urproto.compat import StrEnum

SHARED_CLOCK: Final = "UR_LOCKSTEP"
"""Environment variable that names the clock of `ur-emulator exec`, for processes that share it."""

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # MCL_ flags of mlockall(2)
_PRIORITY: Final = 1  # the lowest real-time priority
_DESCRIPTORS: Final = 4096  # for which room is made in advance (guess): more clients than in any test
_CHECK_EVERY_S: Final = 0.5  # interval between checks of the load
_TOO_MUCH: Final = 0.75  # of a core: more would leave too little for other programs on it (guess)
_CALM: Final = 0.5  # of a core (guess)
_CALM_FOR_S: Final = 10.0  # before the priority is claimed again (guess)
_MAPPING: Final = re.compile(r"[0-9a-f]+-[0-9a-f]+ ")  # in /proc/self/smaps
_UNWRITTEN_FILE: Final = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-[-x]p \S+ \S+ \d+ +/")  # read only, private
_SOCKET: Final = re.compile(r"socket:\[(\d+)\]")
_HOW: Final = (
    "permit it to the user (/etc/security/limits.d: '@realtime - rtprio 99' and '@realtime - memlock unlimited', in a "
    "container --cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1), or use --realtime auto"
)

_logger = logging.getLogger(__name__)


class RealTime(StrEnum):
    """What an emulator requests: auto: whatever is granted; on: everything, or it does not start; off: nothing.

    With auto, it gives its priority up while clients without real-time priority overload it.
    """

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class RealTimeRefused(Exception):  # noqa: N818 - as RobotRefused
    """The system does not grant what `RealTime.ON` demands."""


def claim_real_time(wanted: RealTime = RealTime.AUTO) -> list[str]:
    """Request real-time priority and locked memory; return what was granted, as readable names.

    For processes that run nothing but emulators: the scheduling class applies to the calling thread, locked memory and
    the frozen heap to the whole process. Raises RealTimeRefused.
    """
    freeze_heap()
    if sys.platform != "linux":
        if wanted is RealTime.ON:
            raise RealTimeRefused("--realtime on requires Linux: use --realtime auto")
        return []
    _set_timer_slack()
    _reserve_descriptors()
    if wanted is not RealTime.ON:  # which loads every page
        _return_code_of_startup()
    if wanted is RealTime.OFF or SHARED_CLOCK in os.environ:
        return []  # a clock that waits for everyone needs no priority
    granted = {"SCHED_FIFO": _take_priority(), "memory locked": _lock_memory(everything=wanted is RealTime.ON)}
    missing = [name for name, given in granted.items() if not given]
    if missing and wanted is RealTime.ON:
        raise RealTimeRefused(f"--realtime on: the system does not grant {' and '.join(missing)}: {_HOW}")
    return [name for name, given in granted.items() if given]


def freeze_heap() -> None:
    """Exclude all existing objects from garbage collection: a full collection takes many control periods."""
    gc.collect()
    gc.freeze()


def _take_priority() -> bool:
    """Get real-time priority for this thread, but not for its children; it keeps one with which it was started."""
    if sys.platform != "linux":
        return False
    with contextlib.suppress(OSError):  # needs CAP_SYS_NICE or a limit
        policy, priority = os.SCHED_FIFO, os.sched_param(_PRIORITY)
        if _is_real_time(0):
            policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, priority)
        return True
    return False


def _is_real_time(thread: int) -> bool:
    if sys.platform != "linux":
        return False
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)


def _drop_priority() -> None:
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _lock_memory(*, everything: bool) -> bool:
    """Keep used pages in memory, including code of libraries. everything: also pages that were never touched.

    Otherwise the kernel may drop pages of code when memory is short, and read them from the disk in the middle of a
    control period.
    """
    if sys.platform == "win32":
        return False
    import resource

    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if not unlimited and os.geteuid() != 0:
        return False  # locking would succeed, but allocations beyond the limit would then fail
    try:
        return bool(ctypes.CDLL(None).mlockall(_CURRENT | _FUTURE | (0 if everything else _ON_FAULT)) == 0)
    except (OSError, AttributeError):
        return False


def _return_code_of_startup() -> None:
    """Unmap the pages of libraries that this process has not changed; those that are used again are mapped again.

    Most of them were used once, while the library was loaded: symbols, relocations, the registration of thousands of
    functions with Python. Without this they count as this process's memory, and would be locked with the rest.
    """
    do_not_need = 4  # MADV_DONTNEED of madvise(2)
    with contextlib.suppress(OSError, AttributeError), open("/proc/self/smaps", encoding="utf-8") as lines:
        madvise = ctypes.CDLL(None).madvise
        madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
        mapping: re.Match[str] | None = None
        for line in lines:  # for each mapping a line with addresses, permissions and file, then its figures
            if _MAPPING.match(line):
                mapping = _UNWRITTEN_FILE.match(line)
            elif mapping and line.startswith("Anonymous:") and line.split()[1] == "0":  # no page was changed
                begin, end = (int(address, 16) for address in mapping.groups())
                madvise(begin, end - begin, do_not_need)


def _set_timer_slack() -> None:
    """Make timers fire when they are due instead of up to 50 us later."""
    set_timer_slack, slack_ns = 29, 1  # PR_SET_TIMERSLACK of prctl(2)
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(set_timer_slack, slack_ns, 0, 0, 0)


def _reserve_descriptors() -> None:
    """Make the kernel enlarge the table of open files now; it never shrinks it again.

    Otherwise it would do so when the 256th, 512th and 1024th client connect, and a process with threads waits for that:
    10 to 27 ms were measured each time.
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
    """Whether a loop uses so much of its core that it should have no priority over other programs.

    It begins immediately when the load is too high, and ends after the load was low for a while.
    """

    over: bool = False
    _calm_s: float = 0.0

    def see(self, share: float, seconds: float) -> bool:
        """Add a measurement. share: fraction of a core that was used for ``seconds``. True if ``over`` has changed."""
        self._calm_s = self._calm_s + seconds if share < _CALM else 0.0
        before = self.over
        if share > _TOO_MUCH:
            self.over = True
        elif self._calm_s >= _CALM_FOR_S:
            self.over = False
        return self.over != before


async def yield_under_overload(wanted: RealTime) -> None:
    """Until cancelled: give up the priority of this thread while its event loop is flooded with work.

    Clients with real-time priority would then starve it: as long as one is connected, it keeps its place below them.
    It also keeps what was insisted on: by ``on``, or by another priority with which it was started (chrt).
    """
    if sys.platform != "linux" or wanted is RealTime.ON or os.sched_getparam(0).sched_priority > _PRIORITY:
        return
    overload, yields = Overload(), False
    used_s, now_s = time.thread_time(), time.monotonic()
    while True:
        await asyncio.sleep(_CHECK_EVERY_S)
        used_before_s, before_s = used_s, now_s
        used_s, now_s = time.thread_time(), time.monotonic()
        share = (used_s - used_before_s) / (now_s - before_s)
        changed = overload.see(share, now_s - before_s)
        clients = await asyncio.to_thread(real_time_clients) if overload.over else []
        busy = f"clients keep this emulator busy ({100.0 * share:.0f} % of a core)"
        if overload.over and not clients and not yields:
            yields = True
            _drop_priority()
            _logger.warning(
                "%s: it gives up real-time priority, so that other programs get their share, and claims it again "
                "%.0f s after the load has dropped",
                busy,
                _CALM_FOR_S,
            )
        elif yields and (clients or not overload.over):
            yields = False
            if _take_priority():
                _logger.warning("real-time priority is in force again")
        elif changed and clients:
            _logger.warning("%s: it keeps real-time priority, as its client %s has it, too", busy, clients[0])


def real_time_clients() -> list[str]:
    """Programs with real-time priority on this machine that are connected to this process; takes milliseconds.

    Those of other users, and in other containers, are not seen. Linux only.
    """
    peers = _inodes_of_peers()
    found = []
    for process in (entry for entry in os.listdir("/proc") if entry.isdigit() and int(entry) != os.getpid()):
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            threads = os.listdir(f"/proc/{process}/task")
            if any(map(_is_real_time, map(int, threads))) and not peers.isdisjoint(_inodes(process)):
                with open(f"/proc/{process}/comm", encoding="utf-8", errors="replace") as name:
                    found.append(f"{name.read().strip()} (process {process})")
    return found


def _inodes_of_peers() -> set[str]:
    """Inodes of the sockets at the other ends of this process's connections, as far as they are on this machine."""
    own = _inodes("self")
    connections: dict[tuple[str, str], str] = {}
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError), open(f"/proc/self/net/{table}", encoding="ascii") as lines:
            for line in lines:
                _, here, there, *_, inode = line.split()[:10]
                connections[here, there] = inode
    return {connections.get((there, here), "") for (here, there), inode in connections.items() if inode in own} - {""}


def _inodes(process: str) -> set[str]:
    """Inodes of the sockets that a process has open. Raises OSError if it may not be inspected."""
    inodes = set()
    for descriptor in os.listdir(f"/proc/{process}/fd"):
        with contextlib.suppress(OSError):  # just closed
            if match := _SOCKET.match(os.readlink(f"/proc/{process}/fd/{descriptor}")):
                inodes.add(match[1])
    return inodes


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
