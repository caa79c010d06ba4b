"""A safety configuration from a file: PolyScope's ``.installation``, or YAML.

    preset: default             # for both sets; reduced mode uses the next stricter one
    normal: {tcp_speed: 1.0}    # limits by name override the preset's; also preset: ...
    reduced: {preset: very restricted}
    planes:
      - {name: table, normal: [0, 0, 1], distance: 0.1, mode: both, elbow: true}
    tool_orientation: {direction: [0, 0, -1], deviation: 0.5, mode: normal}
    tool_spheres: [{centre: [0, 0, 0.1], radius: 0.05}]
    inputs: {emergency_stop: [0, 1], reduced_mode: [2, 3]}
    outputs: {robot_moving: [0, 1]}
    safe_home: [0, -1.57, 0, -1.57, 0, 0]
    manual_high_speed: false

Lengths in m, angles in rad, forces in N, power in W, momentum in kg m/s, times in s.
"""

from dataclasses import replace
from math import pi
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar

from msgspec import Meta, Struct
from msgspec.structs import asdict

from urproto.robots.model import Joints, RobotModel
from urproto.structures import InvalidYamlError, converted, load_yaml
from urproto.text import unknown
from urproto.vectors import Vector3
from urproto.versions import Series
from urscript.polyscope.document import DocumentError, read_document
from urscript.polyscope.safety_configuration import (
    CHANNELS,
    PRESETS,
    BoundaryMode,
    LimitSet,
    Plane,
    SafetyConfiguration,
    SafetyInput,
    SafetyOutput,
    ToolOrientation,
    ToolSphere,
    factory_configuration,
    preset_of,
)
from urscript.polyscope.safety_section import SafetySettingsError, read_safety_settings

_Function = TypeVar("_Function", SafetyInput, SafetyOutput)
_Preset: TypeAlias = Literal["least restricted", "default", "restricted", "very restricted"]
_Mode: TypeAlias = Literal["disabled", "normal", "reduced", "both"]
_Positive: TypeAlias = Annotated[float, Meta(gt=0.0)]
_Pin: TypeAlias = Annotated[int, Meta(ge=0, lt=CHANNELS)]
_Pins: TypeAlias = dict[str, Any]

_STRICTER: Final = dict(zip(PRESETS, [*list(PRESETS)[1:], list(PRESETS)[-1]], strict=True))
_ONLY_E: Final = ("elbow_speed", "elbow_force", "stopping_time", "stopping_distance")


class _Limits(Struct, frozen=True, forbid_unknown_fields=True):
    preset: _Preset | None = None
    tcp_speed: _Positive | None = None
    force: _Positive | None = None
    power: _Positive | None = None
    momentum: _Positive | None = None
    elbow_speed: _Positive | None = None
    elbow_force: _Positive | None = None
    stopping_time: _Positive | None = None
    stopping_distance: _Positive | None = None
    joint_speed: Joints | None = None
    joint_min: Joints | None = None
    joint_max: Joints | None = None


class _Plane(Struct, forbid_unknown_fields=True):
    normal: Vector3
    name: str = ""
    distance: float = 0.0
    mode: _Mode | Literal["trigger"] = "both"
    elbow: bool = False


class _Orientation(Struct, forbid_unknown_fields=True):
    direction: Vector3
    deviation: Annotated[float, Meta(gt=0.0, lt=pi)]
    mode: _Mode = "both"
    tool_direction: Vector3 = (0.0, 0.0, 1.0)


class _Sphere(Struct, forbid_unknown_fields=True):
    centre: Vector3
    radius: _Positive


class _File(Struct, forbid_unknown_fields=True):
    preset: _Preset = "default"
    normal: _Limits = _Limits()
    reduced: _Limits = _Limits()
    planes: list[_Plane] = []
    tool_orientation: _Orientation | None = None
    tool_spheres: list[_Sphere] = []
    inputs: _Pins | None = None
    outputs: _Pins = {}
    safe_home: Joints | None = None
    manual_high_speed: bool = True


def load_safety_file(path: Path, model: RobotModel) -> SafetyConfiguration:
    """Load the configuration of this arm from a file. Raises OSError, or SafetySettingsError with the reason."""
    try:
        if path.suffix == ".installation":
            return _from_installation(path.read_bytes())
        return _from_yaml(path.read_bytes(), model)
    except SafetySettingsError as error:
        raise SafetySettingsError(f"{path}: {error}") from error


def _from_installation(data: bytes) -> SafetyConfiguration:
    try:
        root = read_document(data)
    except DocumentError as error:
        raise SafetySettingsError(f"not an installation file: {error}") from error
    settings = root.child("SafetySettings")
    if settings is None:
        raise SafetySettingsError("the installation has no safety settings")
    return read_safety_settings(settings.text)


def _from_yaml(text: bytes, model: RobotModel) -> SafetyConfiguration:
    try:
        content = load_yaml(text)
    except InvalidYamlError as error:
        raise SafetySettingsError(f"not YAML: {error}") from error
    given = converted({} if content is None else content, _File, "", SafetySettingsError)
    orientation = given.tool_orientation
    inputs = factory_configuration(model).inputs if given.inputs is None else _pins(given.inputs, "inputs", SafetyInput)
    return SafetyConfiguration(
        normal=_limits(given.normal, "normal", given.preset, model),
        reduced=_limits(given.reduced, "reduced", _STRICTER[given.preset], model),
        planes=tuple(_plane(row, f"planes, no. {n}") for n, row in enumerate(given.planes, 1)),
        tool_orientation=None if orientation is None else _orientation(orientation),
        tool_spheres=tuple(ToolSphere(row.centre, row.radius) for row in given.tool_spheres),
        inputs=MappingProxyType(inputs),
        outputs=MappingProxyType(_pins(given.outputs, "outputs", SafetyOutput)),
        safe_home=given.safe_home,
        manual_high_speed=given.manual_high_speed,
    )


def _limits(given: _Limits, where: str, preset: str, model: RobotModel) -> LimitSet:
    changed = {name: value for name, value in asdict(given).items() if value is not None}
    limits = preset_of(changed.pop("preset", preset), model)
    if model.series is Series.CB3 and (missing := [name for name in _ONLY_E if name in changed]):
        raise SafetySettingsError(f"{where}: {model.title} has no limit {missing[0]}; only e-Series arms have it")
    limits = replace(limits, **changed)
    if any(low >= high for low, high in zip(limits.joint_min, limits.joint_max, strict=True)):
        raise SafetySettingsError(f"{where}: joint_min must be below joint_max for each joint")
    if min(limits.joint_speed) <= 0.0:
        raise SafetySettingsError(f"{where}: joint_speed must be positive for each joint")
    return limits


def _plane(given: _Plane, where: str) -> Plane:
    normal = _direction(given.normal, f"{where}: normal")
    return Plane(given.name or where, normal, given.distance, BoundaryMode[given.mode.upper()], elbow=given.elbow)


def _orientation(given: _Orientation) -> ToolOrientation:
    return ToolOrientation(
        _direction(given.direction, "tool_orientation: direction"),
        given.deviation,
        BoundaryMode[given.mode.upper()],
        _direction(given.tool_direction, "tool_orientation: tool_direction"),
    )


def _pins(given: _Pins, where: str, functions: type[_Function]) -> dict[_Function, tuple[int, int]]:
    taken: dict[int, str] = {}
    found: dict[_Function, tuple[int, int]] = {}
    names = {function.name.lower(): function for function in functions}
    for name, value in given.items():
        if name not in names:
            raise SafetySettingsError(f"{where}: {unknown('function', name, names)}")
        pair = converted(value, tuple[_Pin, _Pin], f"{where}: {name}", SafetySettingsError)
        if pair[0] == pair[1]:
            raise SafetySettingsError(f"{where}: {name} needs two different configurable pins")
        for pin in pair:
            if taken.setdefault(pin, name) != name:
                raise SafetySettingsError(f"{where}: {name} and {taken[pin]} share pin {pin}")
        found[names[name]] = pair
    return found


def _direction(given: Vector3, where: str) -> Vector3:
    x, y, z = given
    length: float = (x * x + y * y + z * z) ** 0.5
    if length < 1e-9:
        raise SafetySettingsError(f"{where} must not be zero")
    return (x / length, y / length, z / length)
