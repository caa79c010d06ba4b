"""A robot in this process, in virtual time, from the options a test names."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from urproto.testing.installed import load

if TYPE_CHECKING:
    from emulator.control.control import VirtualRobot


# option of ur-emulator that has another name, or wants another form, as a configuration: name there, form
_Form = Callable[[Any, Any], Any]  # of the value and the arm
_FORMS: Final[Mapping[str, tuple[str, _Form]]] = {
    "polyscope": ("version", lambda value, model: _config().choose_version(value, model)),
    "initial_q": ("initial_q", lambda value, model: tuple(map(float, value))),
    "initial_positions": (
        "initial_q",
        lambda value, model: _config().read_initial_positions(Path(value), model),
    ),
    "programs": ("programs_dir", lambda value, model: _config().read_programs_dir(Path(value))),
    "gripper": ("gripper", lambda value, model: _config().choose_gripper(value, None)),
    "gripper_object": ("gripper_object_mm", lambda value, model: value),
    "enforce_remote_control": (
        "enforce_remote_control",
        lambda value, model: _config().check_enforced_remote_control(value, model),
    ),
    "external_control": ("external_control", lambda value, model: _config().read_driver_address(value)),
}
_NO_MATTER: Final = {"speed", "control_token", "log_level", "ephemeral_ports"}  # of a robot without ports or pace


def virtual_robot(model: str | None = None, *, calibration: str | Path | None = None, **options: Any) -> "VirtualRobot":
    """The arm of this name, with options as ``ur-emulator`` has them; those of ports and pace do not matter here.

    Raises ValueError for a value, TypeError for an option that there is not.
    """
    controller = load("emulator.controller")
    arm = _config().choose_model(model, options.get("polyscope"))
    arm = _config().read_calibration(None if calibration is None else Path(calibration), arm)
    known = {field.name for field in fields(controller.ControllerConfig)}
    wanted: dict[str, Any] = {}
    for option, value in options.items():
        name, form = _FORMS.get(option, (option, _as_it_is))
        if option in _NO_MATTER or value is None:
            continue
        if name not in known or name == "model":
            names = sorted(
                (known | _FORMS.keys() | {"calibration"}) - {"version", "model", "programs_dir", "gripper_object_mm"}
            )
            raise TypeError(f"a robot in virtual time has no option {option!r}: it has {', '.join(names)}")
        wanted[name] = form(value, arm)
    config = controller.ControllerConfig(model=arm, **wanted)
    robot: VirtualRobot = load("emulator.control.control").VirtualRobot(config)
    return robot


def _config() -> Any:
    return load("emulator.config")


def _as_it_is(value: Any, arm: Any) -> Any:
    return value
