"""A robot in this process, in virtual time, with the options given by a test."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

from emulator.config import controller_config
from emulator.control.control import VirtualRobot
from emulator.faults.catalogue import describe, parse_fault
from emulator.machine import ControllerConfig
from emulator.options import CONTROLLER_OPTIONS, ROBOT_OPTIONS

_IRRELEVANT: Final = {*ROBOT_OPTIONS, "log_level"} - {*CONTROLLER_OPTIONS}  # without ports and real time
_RENAMED: Final = {"model", "version", "programs_dir", "gripper_object_mm"}  # fields of a configuration


def virtual_robot(model: str | None = None, *, fault: str | Sequence[str] = (), **options: Any) -> VirtualRobot:
    """A robot with the options of ``ur-emulator``; those for ports and speed are ignored.

    fault: one or several, as on the command line; they use the robot's seed unless they have their own. Raises
    ValueError for an invalid value, TypeError for an unknown option, NotPossible for a fault that affects ports.
    """
    known = {*CONTROLLER_OPTIONS} - {"model"}
    known |= {field.name for field in fields(ControllerConfig)} - _RENAMED
    given = {name: value for name, value in options.items() if name not in _IRRELEVANT and value is not None}
    for option in given:
        if option not in known:
            names = ", ".join(sorted(known))
            raise TypeError(f"a robot in virtual time has no option {option!r}: choose from {names}")
    robot = VirtualRobot(controller_config(model, **given))
    for text in [fault] if isinstance(fault, str) else fault:
        chosen = parse_fault(text)
        robot.inject_fault(chosen.kind, **{"seed": given.get("seed", 0), **describe(chosen)})
    return robot
