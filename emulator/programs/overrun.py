"""Reactions of a controller to a program that computes endlessly without moving the arm or waiting."""

from typing import Final

from emulator.lifecycle.runstate import BUSY_PROTECTIVE_STOP
from emulator.machine import Machine
from urproto.modes import ReportLevel
from urproto.versions import Series
from urscript.runtime import Runtime, ScriptThread

_LONG_S: Final = 1.0
_TOO_LONG_S: Final = 10.0
# A loop that commands the arm without ever waiting, as ur_rtde's speedL with a time of 0: C271A1 according to files of
# users of a real robot. After how long is a guess; less than the two seconds in which they notice.
_RUSHED_S: Final = 1.0

_TOO_BUSY: Final = "The program used too much time without moving the robot or waiting: add sync() or sleep()"
"""Text of the runtime error with which CB3 controllers end such a program; the wording is the emulator's own."""


def watch(main: Runtime, thread: ScriptThread, machine: Machine, *, rushes: bool) -> None:
    """Report a thread that computes endlessly; later end the program (CB3) or stop the arm (e-Series).

    ``rushes``: it commands the arm meanwhile, for no time. Called in every period in which it continues; repeats after
    the same time if the thread is allowed to continue.
    """
    if thread.parked_frames == round(_LONG_S / machine.period_s):
        argument, text = _describe(thread)
        machine.messages.error(218, argument, ReportLevel.INFO, text)
    if thread.parked_frames % round((_RUSHED_S if rushes else _TOO_LONG_S) / machine.period_s) != 0:
        return
    if machine.version.series is Series.E:
        machine.protective_stop(BUSY_PROTECTIVE_STOP)
    else:
        machine.messages.runtime_exception(*thread.position, _TOO_BUSY)
        main.stop()


def _describe(thread: ScriptThread) -> tuple[int, str]:
    """Argument and text of the error log's entry about it (C218)."""
    if thread.id == 0:
        return 0, f"The main program used a lot of time near line {thread.line}"
    return 1, f"Thread {thread.name} used a lot of time near line {thread.line}"
