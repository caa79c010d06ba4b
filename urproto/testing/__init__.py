"""Emulators for tests: the building blocks of the pytest plugin, also for other test runners.

    from urproto.testing import EmulatorProcess

    with EmulatorProcess(["--model", "ur5e", "--running"]) as robot:
        print(robot.host, robot.ports["rtde"])
        robot.press_emergency_stop()

Verbs raise ``NotPossible`` and ``BadArguments``. Everything is imported on first use.
"""

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from emulator.control.verbs import BadArguments, NotPossible
    from urproto.testing.process import EmulatorProcess
    from urproto.testing.virtual import virtual_robot

__all__ = ["BadArguments", "EmulatorProcess", "NotPossible", "virtual_robot"]

_HOMES: Final = {
    "BadArguments": "emulator.control.verbs",
    "EmulatorProcess": "urproto.testing.process",
    "NotPossible": "emulator.control.verbs",
    "virtual_robot": "urproto.testing.virtual",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from urproto.testing.launch import load

    return getattr(load(_HOMES[name]), name)
