"""Time, and what stops the robot."""

from emulator.builtins.host import Frames, ProgramHost
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.runstate import SCRIPT_PROTECTIVE_STOP
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Num, Struct

LIBRARY = Library("flow", host=True, physical=True)


@LIBRARY.builtin()
def sleep(host: ProgramHost, t: Num) -> Frames[None]:
    """Wait for `t` [s], in whole control periods and at least one."""
    for _ in range(host.frames(t)):
        yield


@LIBRARY.builtin(cb3=None, e="5.10", note="the wall clock was set at the controller's start and goes at its pace")
def time(host: ProgramHost, mode: Int = 0) -> Struct:
    """Time as a struct of `sec` and `nanosec`: uptime (mode 0), or since 1970 in GMT (mode 2)."""
    if mode not in (0, 2):
        raise RuntimeFault(f"time: mode must be 0 (uptime) or 2 (system time), not {mode}")
    nanoseconds = host.machine.uptime_ns if mode == 0 else host.machine.wall_clock_ns
    return Struct({"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000})


@LIBRARY.builtin()
def protective_stop(host: ProgramHost) -> None:
    """Cause a protective stop; the program pauses where it next takes time, and may end before that.

    The official client library waits for the end of a program that does nothing else.
    """
    host.machine.protective_stop(SCRIPT_PROTECTIVE_STOP)


@LIBRARY.builtin()
def powerdown(host: ProgramHost) -> Frames[None]:
    """Switch the arm off and end the controller, as the dashboard's shutdown does."""
    host.machine.power_event(PowerEvent.POWER_OFF)
    host.machine.shutdown_requested = True
    yield
