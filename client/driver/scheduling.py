"""Real-time priority for the threads that feed a robot, if this machine allows it."""

import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from urproto.errors import LocalProtocolError

RealTime = Literal["auto", "on", "off"]
"""``auto`` takes real-time priority if it is allowed, ``on`` requires it, ``off`` does without."""

_PRIORITY: Final = 20  # guess: above anything that is not real time, below a driver's interrupt threads
_HINT: Final = "allow it (ulimit -r 99, or the capability CAP_SYS_NICE), or use realtime='auto'"

_logger = logging.getLogger(__name__)


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
