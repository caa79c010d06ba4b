"""Controllers files, such as ros2_control's ``ur_controllers.yaml``.

``controller_manager`` names the controllers and their types, one more section each has their
parameters. Parameters are below ``ros__parameters``; with single underscores it is understood
too. ``/**`` stands for all. ``$(var name)``, which launch files of ROS fill in, is filled in here.
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
    settings,
)
from client.controllers.controller import CONTROLLER_TYPES, Controller
from client.errors import ControllerError
from urproto.yamltext import NotYaml, load_yaml

_ALL: Final = (
    broadcasters,
    compliance,
    forward,
    io_and_status,
    joint_trajectory,
    motion_primitives,
    passthrough,
    settings,
)


def find(controller: str, type_name: str) -> type[Controller[Any]]:
    """The class of a type. Raises ControllerError, for the controller that wants it."""
    if type_name in CONTROLLER_TYPES:
        return CONTROLLER_TYPES[type_name]
    close = get_close_matches(type_name, CONTROLLER_TYPES, 1, 0.4)
    hint = f"did you mean {close[0]}?" if close else "`ur-client controllers types` lists them"
    raise ControllerError(controller, f"there is no type {type_name}: {hint}")


def help_of(kind: type[Controller[Any]]) -> str:
    """What a type is for, in a line."""
    return (kind.__doc__ or "").strip().partition("\n")[0]


_MANAGER: Final = "controller_manager"
_PARAMETERS: Final = ("ros__parameters", "ros_parameters")
_ANY: Final = "**"
_VARIABLE: Final = re.compile(r"\$\((\w+) *([^)]*)\)")
_WITHOUT_EFFECT: Final = {
    "update_rate": "controllers are updated with each state of the robot",
    "enforce_command_limits": "the robot has limits of its own",
    "use_sim_time": "time is the robot's",
}


@dataclass(frozen=True, slots=True)
class ControllersFile:
    """Types and parameters of controllers by name; notes: what else the file says, which is ignored."""

    name: str
    types: Mapping[str, str]
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def type_of(self, controller: str) -> str:
        """Raises ControllerError."""
        if controller not in self.types:
            raise ControllerError(controller, f"{self.name} has {', '.join(self.types) or 'no controllers'}")
        return self.types[controller]

    def parameters_of(self, controller: str) -> Mapping[str, Any]:
        """Empty where the file says nothing."""
        return self.parameters.get(controller, {})


def usual_controllers(tf_prefix: str = "") -> ControllersFile:
    """The controllers of a UR arm under the names the ROS 2 driver gives them."""
    text = resources.files("client.controllers").joinpath("ur_controllers.yaml").read_text("utf-8")
    return _parse(text, "the usual controllers", {"tf_prefix": tf_prefix})


def read_controllers(path: Path, tf_prefix: str = "") -> ControllersFile:
    """Read a controllers file. Raises ControllerError, OSError."""
    return _parse(text_of(path), str(path), {"tf_prefix": tf_prefix})


def text_of(path: Path) -> str:
    """What stands in a parameter file. Raises ControllerError, OSError."""
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ControllerError(str(path), f"it is not text: {error}") from None


def _parse(text: str, name: str, variables: Mapping[str, str]) -> ControllersFile:
    found = sections(text, name, variables)
    if _MANAGER not in found:
        raise ControllerError(name, f"it has no section {_MANAGER}, which names the controllers")
    types: dict[str, str] = {}
    notes: list[str] = []
    for key, value in found[_MANAGER].items():
        if isinstance(value, Mapping) and isinstance(value.get("type"), str):
            types[key] = value["type"]
            notes += [f"{_MANAGER}: {key}.{other} is not known: it is ignored" for other in value if other != "type"]
        elif key in _WITHOUT_EFFECT:
            notes.append(f"{_MANAGER}: {key} has no effect ({_WITHOUT_EFFECT[key]})")
        else:
            notes.append(f"{_MANAGER}: {key} is not a controller with a type: it is ignored")
    known = {_MANAGER, _ANY, *types}
    notes += [
        f"the section {section} belongs to no controller: it is ignored" for section in found if section not in known
    ]
    general = found.get(_ANY, {})
    parameters = {controller: {**general, **found.get(controller, {})} for controller in types}
    return ControllersFile(name, types, parameters, tuple(notes))


def sections(text: str, name: str, variables: Mapping[str, str]) -> dict[str, Mapping[str, Any]]:
    """The parameters of each node of a parameter file of ROS 2. Raises ControllerError."""
    try:
        content = load_yaml(_filled(text, name, variables))
    except NotYaml as error:
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
            raise ControllerError(name, f"{found[0]} cannot be filled in: write what it stands for")
        return variables[variable]

    return _VARIABLE.sub(fill, text)
