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

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from enum import Enum
from math import pi
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

from urproto.robots.model import RobotModel
from urproto.vectors import is_number
from urproto.versions import Series
from urproto.yamltext import InvalidYamlError, load_yaml
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

_KEYS: Final = (
    *("preset", "normal", "reduced", "planes", "tool_orientation", "tool_spheres"),
    *("inputs", "outputs", "safe_home", "manual_high_speed"),
)
_STRICTER: Final = dict(zip(PRESETS, [*list(PRESETS)[1:], list(PRESETS)[-1]], strict=True))
_LIMITS: Final = tuple(field.name for field in fields(LimitSet))
_ONLY_E: Final = ("elbow_speed", "elbow_force", "stopping_time", "stopping_distance")


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
    table = _mapping(content if content is not None else {}, "the file", _KEYS)
    preset = _word(table.get("preset", "default"), "preset", PRESETS)
    orientation = table.get("tool_orientation")
    home = table.get("safe_home")
    return SafetyConfiguration(
        normal=_limits(table.get("normal", {}), "normal", preset, model),
        reduced=_limits(table.get("reduced", {}), "reduced", _STRICTER[preset], model),
        planes=tuple(_plane(row, f"planes, no. {n}") for n, row in enumerate(_rows(table, "planes"), 1)),
        tool_orientation=None if orientation is None else _orientation(orientation),
        tool_spheres=tuple(
            _sphere(row, f"tool_spheres, no. {n}") for n, row in enumerate(_rows(table, "tool_spheres"), 1)
        ),
        inputs=_inputs(table, model),
        outputs=MappingProxyType(_pins(table.get("outputs", {}), "outputs", SafetyOutput)),
        safe_home=None if home is None else _joints(home, "safe_home"),
        manual_high_speed=_flag(table.get("manual_high_speed", True), "manual_high_speed"),
    )


def _inputs(table: Mapping[str, Any], model: RobotModel) -> Mapping[SafetyInput, tuple[int, int]]:
    if "inputs" not in table:
        return factory_configuration(model).inputs
    return MappingProxyType(_pins(table["inputs"], "inputs", SafetyInput))


def _limits(content: Any, where: str, preset: str, model: RobotModel) -> LimitSet:
    table = dict(_mapping(content, where, ("preset", *_LIMITS)))
    limits = preset_of(_word(table.pop("preset", preset), f"{where}: preset", PRESETS), model)
    for name, value in table.items():
        if name in _ONLY_E and model.series is Series.CB3:
            raise SafetySettingsError(f"{where}: {model.title} has no limit {name}; only e-Series arms have it")
        of_joints = name.startswith("joint_")
        given = _joints(value, f"{where}: {name}") if of_joints else _positive(value, f"{where}: {name}")
        changed: dict[str, Any] = {name: given}
        limits = replace(limits, **changed)
    if any(low >= high for low, high in zip(limits.joint_min, limits.joint_max, strict=True)):
        raise SafetySettingsError(f"{where}: joint_min must be below joint_max for each joint")
    if min(limits.joint_speed) <= 0.0:
        raise SafetySettingsError(f"{where}: joint_speed must be positive for each joint")
    return limits


def _plane(content: Any, where: str) -> Plane:
    row = _mapping(content, where, ("name", "normal", "distance", "mode", "elbow"))
    mode = BoundaryMode[_word(row.get("mode", "both"), f"{where}: mode", _words(BoundaryMode)).upper()]
    return Plane(
        str(row.get("name", where)),
        _direction(row.get("normal"), f"{where}: normal"),
        _number(row.get("distance", 0.0), f"{where}: distance"),
        mode,
        elbow=_flag(row.get("elbow", False), f"{where}: elbow"),
    )


def _orientation(content: Any) -> ToolOrientation:
    where = "tool_orientation"
    row = _mapping(content, where, ("direction", "deviation", "mode", "tool_direction"))
    words = [word for word in _words(BoundaryMode) if word != "trigger"]
    deviation = _positive(row.get("deviation"), f"{where}: deviation")
    if deviation >= pi:
        raise SafetySettingsError(f"{where}: deviation must be less than pi, not {deviation:g} rad")
    return ToolOrientation(
        _direction(row.get("direction"), f"{where}: direction"),
        deviation,
        BoundaryMode[_word(row.get("mode", "both"), f"{where}: mode", words).upper()],
        _direction(row.get("tool_direction", [0, 0, 1]), f"{where}: tool_direction"),
    )


def _sphere(content: Any, where: str) -> ToolSphere:
    row = _mapping(content, where, ("centre", "radius"))
    x, y, z = _numbers(row.get("centre"), f"{where}: centre", 3)
    return ToolSphere((x, y, z), _positive(row.get("radius"), f"{where}: radius"))


def _pins(content: Any, where: str, functions: type[_Function]) -> dict[_Function, tuple[int, int]]:
    table = _mapping(content, where, _words(functions))
    taken: dict[int, str] = {}
    found: dict[_Function, tuple[int, int]] = {}
    for name, value in table.items():
        pair = _numbers(value, f"{where}: {name}", 2)
        if any(pin not in range(CHANNELS) for pin in pair) or pair[0] == pair[1]:
            raise SafetySettingsError(f"{where}: {name} needs two different configurable pins from 0 to {CHANNELS - 1}")
        for pin in map(int, pair):
            if taken.setdefault(pin, name) != name:
                raise SafetySettingsError(f"{where}: {name} and {taken[pin]} share pin {pin}")
        found[functions[name.upper()]] = (int(pair[0]), int(pair[1]))
    return found


# values


def _words(kind: type[Enum]) -> list[str]:
    return [member.name.lower() for member in kind]


def _mapping(content: Any, where: str, known: Iterable[str]) -> Mapping[str, Any]:
    known = list(known)
    if not isinstance(content, dict):
        raise SafetySettingsError(f"{where} must be a mapping with the keys {', '.join(known)}")
    for name in content:
        if name not in known:
            raise SafetySettingsError(f"{where}: unknown key {str(name)[:40]!r}: use {', '.join(known)}")
    return content


def _rows(table: Mapping[str, Any], name: str) -> list[Any]:
    rows = table.get(name, [])
    if not isinstance(rows, list):
        raise SafetySettingsError(f"{name} must be a list")
    return rows


def _word(value: Any, where: str, known: Iterable[str]) -> str:
    if value not in list(known):
        raise SafetySettingsError(f"{where} is {str(value)[:40]!r}: use one of {', '.join(known)}")
    return str(value)


def _flag(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise SafetySettingsError(f"{where} must be true or false")
    return value


def _number(value: Any, where: str) -> float:
    if not is_number(value):
        raise SafetySettingsError(f"{where} must be a number, not {str(value)[:40]!r}")
    return float(value)


def _positive(value: Any, where: str) -> float:
    number = _number(value, where)
    if number <= 0.0:
        raise SafetySettingsError(f"{where} must be positive, not {number:g}")
    return number


def _numbers(value: Any, where: str, count: int) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count:
        raise SafetySettingsError(f"{where} must be a list of {count} numbers")
    return tuple(_number(part, where) for part in value)


def _joints(value: Any, where: str) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = _numbers(value, where, 6)
    return (a, b, c, d, e, f)


def _direction(value: Any, where: str) -> tuple[float, float, float]:
    x, y, z = _numbers(value, where, 3)
    length: float = (x * x + y * y + z * z) ** 0.5
    if length < 1e-9:
        raise SafetySettingsError(f"{where} must not be zero")
    return (x / length, y / length, z / length)
