"""Threads that compute without ever using time: an endless loop without ``sync()``.

A thread whose budget is empty goes on in the next frame, so a long calculation only takes
long. One that does not come to an end is told of, then stopped. How long a controller waits
is not known, and it computes faster than this interpreter does in its share of a frame: the
limits are guesses on the generous side, counted in frames, which no program that ends or
waits now and then has been seen to reach.
"""

from typing import TYPE_CHECKING, Final

from emulator.lifecycle.errorcodes import BUSY_PROTECTIVE_STOP
from urproto.modes import ReportLevel
from urproto.versions import Series
from urscript.runtime import Runtime, ScriptThread

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["watch"]

_LONG_S: Final = 1.0
_TOO_LONG_S: Final = 10.0

_TOO_BUSY: Final = "The program used too much time without moving the robot or waiting: add sync() or sleep()"
"""Our words for the runtime error that CB3 controllers end such a program with."""


def watch(main: Runtime, thread: ScriptThread, controller: "Controller") -> None:
    """A thread of the main program computes on and on: say so, then end the program (CB3) or stop the arm (e-Series).

    Called in every period in which it went on; again after as long a time, if it was left to go on.
    """
    if thread.parked_frames == round(_LONG_S / controller.period_s):
        argument, text = _describe(thread)
        controller.messages.error(218, argument, ReportLevel.INFO, text)
    if thread.parked_frames % round(_TOO_LONG_S / controller.period_s) != 0:
        return
    if controller.version.series is Series.E:
        controller.protective_stop(BUSY_PROTECTIVE_STOP)
    else:
        controller.messages.runtime_exception(*thread.position, _TOO_BUSY)
        main.stop()


def _describe(thread: ScriptThread) -> tuple[int, str]:
    """Argument and text of the error log's entry about it (C218)."""
    if thread.id == 0:
        return 0, f"The main program used a lot of time near line {thread.line}"
    return 1, f"Thread {thread.name} used a lot of time near line {thread.line}"
