"""Real-time priority of the threads that feed a robot, where this machine allows it."""

import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from urproto.errors import LocalProtocolError

RealTime = Literal["auto", "on", "off"]
"""``auto`` takes real-time priority where it is allowed, ``on`` insists on it, ``off`` does without."""

_PRIORITY: Final = 20  # guess: above anything that is not real time, below a driver's interrupt threads
_HINT: Final = "allow it (ulimit -r 99, or the capability CAP_SYS_NICE), or use realtime='auto'"

_logger = logging.getLogger(__name__)


def real_time_thread(how: RealTime) -> bool:
    """Give the calling thread SCHED_FIFO; whether it has it now.

    Raises LocalProtocolError for a word that is none of the three, OSError with ``on`` where it is not allowed.
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
        raise OSError("only Linux has it")
    # reset on fork: processes that this program starts are no part of the bargain
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))


@contextmanager
def real_time(how: RealTime) -> Iterator[bool]:
    """The calling thread has real-time priority for as long as the block lasts, where that is allowed."""
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
