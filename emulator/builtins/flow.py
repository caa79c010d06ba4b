"""Time, and what stops the robot."""

from emulator.errorcodes import SCRIPT_PROTECTIVE_STOP
from emulator.power import PowerEvent
from emulator.programs.host import Frames, ProgramHost
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Num, Struct

__all__ = ["LIBRARY"]

LIBRARY = Library("flow", host=True)


@LIBRARY.builtin()
def sleep(host: ProgramHost, t: Num) -> Frames[None]:
    """Wait for `t` [s], in whole control periods and at least one."""
    for _ in range(host.frames(t)):
        yield


@LIBRARY.builtin(cb3=None, e="5.10", status="partial", note="uptime only: the emulator has no wall clock")
def time(host: ProgramHost, mode: Int = 0) -> Struct:
    """The controller's uptime as a struct of `sec` and `nanosec` (mode 0)."""
    if mode != 0:
        raise RuntimeFault(f"time: only mode 0 (uptime) is emulated, not {mode}")
    seconds = host.controller.step_count * host.period_s
    return Struct({"sec": int(seconds), "nanosec": round((seconds % 1.0) * 1e9)})


@LIBRARY.builtin()
def protective_stop(host: ProgramHost) -> None:
    """Cause a protective stop; the program pauses where it next takes time, and may end before that.

    The official client library waits for the end of a program that does nothing else.
    """
    host.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)


@LIBRARY.builtin(status="partial", note="switches the arm off; the controller stays up")
def powerdown(host: ProgramHost) -> Frames[None]:
    """Switch the robot off."""
    host.controller.power_event(PowerEvent.POWER_OFF)
    yield
