"""Emulators for tests: the building blocks of the pytest plugin, also for other test runners.

    from urproto.testing import EmulatorProcess

    with EmulatorProcess(["--model", "ur5e", "--running"]) as robot:
        print(robot.host, robot.ports["rtde"])
        robot.press_emergency_stop()

Verbs raise ``NotPossible`` and ``BadArguments``. Everything is imported on first use, so that the plugin does not delay
other tests. Only ``virtual_robot`` imports the emulator into the process of the test.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from emulator.virtual import virtual_robot
    from urproto.controlapi import BadArguments, NotPossible
    from urproto.testing.process import EmulatorProcess

__all__ = ["BadArguments", "EmulatorProcess", "NotPossible", "virtual_robot"]


def __getattr__(name: str) -> Any:
    if name == "EmulatorProcess":
        from urproto.testing.process import EmulatorProcess

        return EmulatorProcess
    if name == "virtual_robot":
        try:
            from emulator.virtual import virtual_robot
        except ModuleNotFoundError as error:
            raise ImportError(
                f"{error}: a robot in virtual time needs the package `emulator` of ur-emulator. If Python finds "
                "another of that name, use EmulatorProcess (the fixture ur_emulator), or rename that package"
            ) from error

        return virtual_robot
    if name in ("BadArguments", "NotPossible"):
        from urproto import controlapi

        return getattr(controlapi, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
