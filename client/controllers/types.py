"""All types of controllers there are, by name, and those of ROS 2 that are not had here."""

from difflib import get_close_matches
from typing import Any, Final

from client.controllers import (
    broadcasters,
    compliance,
    forward,
    io_and_status,
    joint_trajectory,
    passthrough,
    settings,
)
from client.controllers.controller import CONTROLLER_TYPES, Controller
from client.errors import ControllerError

__all__ = ["REFUSED", "find", "help_of"]

_ALL: Final = (broadcasters, compliance, forward, io_and_status, joint_trajectory, passthrough, settings)
REFUSED: Final = {
    "motion_primitives_controllers/MotionPrimitivesForwardController": "moves one by one: use Robot.sequence",
    "ur_controllers/MotionPrimitivesController": "moves one by one: use Robot.sequence",
}
"""Type name -> what to do instead."""


def find(controller: str, type_name: str) -> type[Controller[Any]]:
    """The class of a type. Raises ControllerError, for the controller that wants it."""
    if type_name in CONTROLLER_TYPES:
        return CONTROLLER_TYPES[type_name]
    if type_name in REFUSED:
        raise ControllerError(controller, f"the type {type_name} is not had here ({REFUSED[type_name]})")
    close = get_close_matches(type_name, CONTROLLER_TYPES, 1, 0.4)
    hint = f"did you mean {close[0]}?" if close else "`ur-client controllers types` lists them"
    raise ControllerError(controller, f"there is no type {type_name}: {hint}")


def help_of(kind: type[Controller[Any]]) -> str:
    """What a type is for, in a line."""
    return (kind.__doc__ or "").strip().partition("\n")[0]
