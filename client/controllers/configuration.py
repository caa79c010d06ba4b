"""Reads controllers files, such as ros2_control's ``ur_controllers.yaml``.

The section ``controller_manager`` lists the controllers and their types; each controller has a section with its
parameters. Parameters are below ``ros__parameters``; the spelling with single underscores is accepted too. ``/**``
applies to all controllers. ``$(var name)``, which ROS launch files substitute, is substituted here.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, Final

from client.controllers import (
    broadcasters,
    compliance,
    forward,
    io_and_status,
    joint_trajectory,
    motion_primitives,
    passthrough,
)
from client.controllers.controller import CONTROLLER_TYPES, Controller
from client.errors import ControllerError
from urproto.structures import InvalidYamlError, load_yaml

_TYPES: Final = (broadcasters, compliance, forward, io_and_status, joint_trajectory, motion_primitives, passthrough)
_MANAGER: Final = "controller_manager"
_PARAMETERS: Final = ("ros__parameters", "ros_parameters")
_ANY: Final = "**"
_VARIABLE: Final = re.compile(r"\$\((\w+) *([^)]*)\)")
_WITHOUT_EFFECT: Final = {  # with values that describe what happens anyway
    "update_rate": ("controllers are updated with each state of the robot", (125, 500)),
    "enforce_command_limits": ("the robot has its own limits", (False,)),
    "use_sim_time": ("the robot's time is used", (False,)),
}
_TRAJECTORY_CONTROLLERS: Final = ("scaled_joint_trajectory_controller", "joint_trajectory_controller")
_UPDATE_RATE_HZ: Final = "500"  # for files that leave it to a launch file


def find(controller: str, type_name: str) -> type[Controller[Any]]:
    """The class of a controller type. Raises ControllerError, which names the controller, for an unknown type."""
    if type_name in CONTROLLER_TYPES:
        return CONTROLLER_TYPES[type_name]
    close = get_close_matches(type_name, CONTROLLER_TYPES, 1, 0.4)
    hint = f"did you mean {close[0]}?" if close else "`ur-client controllers types` lists them"
    raise ControllerError(controller, f"there is no type {type_name}: {hint}")


def help_of(kind: type[Controller[Any]]) -> str:
    """One-line description of a controller type."""
    return (kind.__doc__ or "").strip().partition("\n")[0]


@dataclass(frozen=True, slots=True)
class ControllersFile:
    """Types and parameters of controllers by name; notes: entries of the file that are ignored."""

    name: str
    types: Mapping[str, str]
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def type_of(self, controller: str) -> str:
        """Type of a controller. Raises ControllerError for an unknown controller."""
        if controller not in self.types:
            raise ControllerError(controller, f"{self.name} has {', '.join(self.types) or 'no controllers'}")
        return self.types[controller]

    def parameters_of(self, controller: str) -> Mapping[str, Any]:
        """Parameters of a controller; empty if the file has none."""
        return self.parameters.get(controller, {})


def trajectory_controller(types: Mapping[str, str]) -> str:
    """Name of the trajectory controller in a file's list of types; "" if it has none.

    The scaled controller comes first: files of the official driver have had it until Jazzy, newer ones have another.
    """
    usual = [name for name in _TRAJECTORY_CONTROLLERS if name in types]
    return next(iter(usual + [name for name, kind in types.items() if kind.endswith("JointTrajectoryController")]), "")


def usual_controllers(tf_prefix: str = "") -> ControllersFile:
    """The controllers of a UR arm, with the names that the ROS 2 driver uses."""
    text = resources.files("client.controllers").joinpath("ur_controllers.yaml").read_text("utf-8")
    return _parse(text, "the usual controllers", {"tf_prefix": tf_prefix})


def read_controllers(path: Path, tf_prefix: str = "") -> ControllersFile:
    """Read a controllers file. Raises ControllerError, OSError."""
    return _parse(text_of(path), str(path), {"tf_prefix": tf_prefix, "update_rate": _UPDATE_RATE_HZ})


def text_of(path: Path) -> str:
    """Text of a parameter file. Raises ControllerError, OSError."""
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ControllerError(str(path), f"it is not text: {error}") from None


def _parse(text: str, name: str, variables: Mapping[str, str]) -> ControllersFile:
    found = sections(text, name, variables)
    if _MANAGER not in found:
        raise ControllerError(name, f"it has no section {_MANAGER}, which lists the controllers")
    types: dict[str, str] = {}
    notes: list[str] = []
    for key, value in found[_MANAGER].items():
        if isinstance(value, Mapping) and isinstance(value.get("type"), str):
            types[key] = value["type"]
            notes += [f"{_MANAGER}: {key}.{other} is unknown and ignored" for other in value if other != "type"]
        elif key in _WITHOUT_EFFECT:
            why, harmless = _WITHOUT_EFFECT[key]
            notes += [f"{_MANAGER}: {key} has no effect ({why})"] if value not in harmless else []
        else:
            notes.append(f"{_MANAGER}: {key} is not a controller with a type, and is ignored")
    known = {_MANAGER, _ANY, *types}
    notes += [
        f"the section {section} belongs to no controller, and is ignored" for section in found if section not in known
    ]
    general = found.get(_ANY, {})
    parameters = {controller: {**general, **found.get(controller, {})} for controller in types}
    return ControllersFile(name, types, parameters, tuple(notes))


def sections(text: str, name: str, variables: Mapping[str, str]) -> dict[str, Mapping[str, Any]]:
    """The parameters of each node in a ROS 2 parameter file. Raises ControllerError."""
    try:
        content = load_yaml(_filled(text, name, variables))
    except InvalidYamlError as error:
        raise ControllerError(name, f"it is not YAML: {error}") from None
    if not isinstance(content, Mapping):
        raise ControllerError(name, "it has no sections")
    return {str(key).strip("/"): _parameters(str(key), value, name) for key, value in content.items()}


def _parameters(section: str, value: Any, name: str) -> Mapping[str, Any]:
    if isinstance(value, Mapping):
        for key in _PARAMETERS:
            inner = (value[key] or {}) if key in value else None
            if isinstance(inner, Mapping):
                return inner
    raise ControllerError(name, f"the section {section} has no {_PARAMETERS[0]}")


def _filled(text: str, name: str, variables: Mapping[str, str]) -> str:
    def fill(found: re.Match[str]) -> str:
        kind, variable = found.groups()
        if kind != "var" or variable not in variables:
            raise ControllerError(name, f"{found[0]} cannot be substituted: write its value")
        return variables[variable]

    return _VARIABLE.sub(fill, text)
