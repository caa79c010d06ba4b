"""Time, the protective stop and shutdown."""

from emulator.builtins.host import Frames, ProgramHost
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.runstate import SCRIPT_PROTECTIVE_STOP
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Num, Struct

LIBRARY = Library("flow", host=True, physical=True)


@LIBRARY.builtin()
def sleep(host: ProgramHost, t: Num) -> Frames[None]:
    """Wait for `t` [s], rounded up to whole control periods, at least one."""
    for _ in range(host.frames(t)):
        yield


@LIBRARY.builtin(cb3=None, e="5.10", note="the wall clock is set when the controller starts and runs at its pace")
def time(host: ProgramHost, mode: Int = 0) -> Struct:
    """Time as a struct of `sec` and `nanosec`: uptime (mode 0), or since 1970 in GMT (mode 2)."""
    if mode not in (0, 2):
        raise RuntimeFault(f"time: mode must be 0 (uptime) or 2 (system time), not {mode}")
    nanoseconds = host.machine.uptime_ns if mode == 0 else host.machine.wall_clock_ns
    return Struct({"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000})


@LIBRARY.builtin()
def protective_stop(host: ProgramHost) -> None:
    """Trigger a protective stop; the program pauses at the next call that takes time, and may end before that.

    A program that only calls this one therefore ends, which the official client library waits for.
    """
    host.machine.protective_stop(SCRIPT_PROTECTIVE_STOP)


@LIBRARY.builtin()
def powerdown(host: ProgramHost) -> Frames[None]:
    """Power the arm off and shut the controller down, like the dashboard's shutdown."""
    host.machine.power_event(PowerEvent.POWER_OFF)
    host.machine.shutdown_requested = True
    yield
