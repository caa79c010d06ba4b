"""Threads that compute without ever using time: an endless loop without ``sync()``.

A thread whose budget is empty goes on in the next frame, so a long calculation only takes
long. One that does not come to an end is told of, then stopped. How long a controller waits
is not known, and it computes faster than this interpreter does in its share of a frame: the
limits are guesses on the generous side, counted in frames, which no program that ends or
waits now and then has been seen to reach.
"""

from typing import Final

from urscript.runtime import ScriptThread

__all__ = ["TOO_BUSY", "busy_long", "busy_too_long", "describe"]

_LONG_S: Final = 1.0
_TOO_LONG_S: Final = 10.0

TOO_BUSY: Final = "The program used too much time without moving the robot or waiting: add sync() or sleep()"
"""Our words for the runtime error that CB3 controllers end such a program with."""


def busy_long(thread: ScriptThread, period_s: float) -> bool:
    """True in the one frame in which a thread has been computing so long that it is worth a warning."""
    return thread.parked_frames == round(_LONG_S / period_s)


def busy_too_long(thread: ScriptThread, period_s: float) -> bool:
    """True when a thread must be stopped; again after as long a time, if it was left to go on."""
    return thread.parked_frames % round(_TOO_LONG_S / period_s) == 0


def describe(thread: ScriptThread) -> tuple[int, str]:
    """Argument and text of the error log's entry about it (C218)."""
    if thread.id == 0:
        return 0, f"The main program used a lot of time near line {thread.line}"
    return 1, f"Thread {thread.name} used a lot of time near line {thread.line}"
