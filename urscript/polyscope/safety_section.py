"""Read the safety part of PolyScope's installation files: sections of ``key = value`` lines inside the XML.

The meaning of the keys follows from 139 public files. A joint position is stored as an angle within a turn and a number
of turns.
"""

import re
from collections.abc import Iterable, Mapping
from math import cos, inf, isfinite, sin, tau
from types import MappingProxyType
from typing import Final, TypeVar

from urproto.robots.model import Joints
from urproto.text import lines
from urproto.vectors import as_six
from urscript.polyscope.safety_configuration import (
    CHANNELS,
    LIMITS,
    BoundaryMode,
    LimitSet,
    Plane,
    SafetyConfiguration,
    SafetyInput,
    SafetyOutput,
    ToolOrientation,
    ToolSphere,
)

Sections = Mapping[str, Mapping[str, str]]
_Function = TypeVar("_Function", SafetyInput, SafetyOutput)
_SECTION: Final = re.compile(r"\[([^\]\[=]+)\]")
_NUMBER: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|true|false")
_WORDS: Final = {"true": 1.0, "false": 0.0}
PLANES: Final = 8
_ONLY_E: Final = ("elbow_speed", "elbow_force", "stopping_time", "stopping_distance")
LIMIT_KEYS: Final = {f"max{name.title().replace('_', '')}": name for name in LIMITS}
"""Key in the file, such as maxTcpSpeed, -> attribute of a LimitSet."""


class SafetySettingsError(ValueError):
    """The text is not a safety configuration; the message gives the place and the reason."""


def read_safety_settings(text: str) -> SafetyConfiguration:
    """Parse the content of <SafetySettings>; ignores settings added by newer versions. Raises SafetySettingsError."""
    sections = _sections(text)
    setup = _numbers(sections, "SafetySetup", "withPositionLimits", 6, fallback=(1.0,) * 6)
    sphere_rows = _numbers(sections, "WorkpieceConfiguration", "toolSpheres", None, fallback=())
    return SafetyConfiguration(
        normal=_limits(sections, "Normal", setup),
        reduced=_limits(sections, "Reduced", setup),
        planes=tuple(plane for n in range(PLANES) if (plane := _plane(sections, n)) is not None),
        tool_orientation=_orientation(sections),
        tool_spheres=_spheres(sphere_rows, sections),
        inputs=MappingProxyType(_pins(sections, "Inputs", SafetyInput)),
        outputs=MappingProxyType(_pins(sections, "Outputs", SafetyOutput)),
        safe_home=_safe_home(sections),
        manual_high_speed=_numbers(sections, "ThreePositionEnabling", "allowManualHighSpeed", 1, fallback=(1.0,))[0]
        != 0.0,
        crc=int(_numbers(sections, "Safety Checksum", "crc", 1, fallback=(0.0,))[0]) & 0xFFFFFFFF or None,
    )


def _sections(text: str) -> Sections:
    sections: dict[str, dict[str, str]] = {}
    current: dict[str, str] | None = None
    for line in map(str.strip, lines(text)):
        if match := _SECTION.fullmatch(line):
            current = sections.setdefault(match[1], {})
        elif line and current is not None and " = " in line:
            key, value = line.split(" = ", 1)
            current[key.strip()] = value.strip()
    if "SafetyLimits Normal Values" not in sections:
        raise SafetySettingsError("the section [SafetyLimits Normal Values] is missing")
    return sections


def _numbers(
    sections: Sections, section: str, key: str, count: int | None, fallback: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    """All numbers of a value, with booleans as 1 and 0. count: how many there must be, None for any number."""
    value = sections.get(section, {}).get(key)
    if value is None:
        if fallback is None:
            raise SafetySettingsError(f"[{section}] has no {key}")
        return fallback
    words = _NUMBER.findall(value)
    numbers = tuple(_WORDS[word] if word in _WORDS else float(word) for word in words)
    if not all(map(isfinite, numbers)) or (count is not None and len(numbers) != count):
        raise SafetySettingsError(f"[{section}] {key} = {value[:60]}: {count or 'finite'} numbers are required")
    return numbers


def _limits(sections: Sections, name: str, limited: tuple[float, ...]) -> LimitSet:
    values, joints = f"SafetyLimits {name} Values", f"SafetyLimits {name} Joints"
    given = {
        attribute: _numbers(sections, values, key, 1, fallback=(inf,) if attribute in _ONLY_E else None)[0]
        for key, attribute in LIMIT_KEYS.items()
    }
    low = _positions(sections, joints, "min")
    high = _positions(sections, joints, "max")
    return LimitSet(
        **given,
        joint_speed=as_six(_numbers(sections, joints, "maxJointSpeed", 6)),
        joint_min=as_six(tuple(at if has else -inf for at, has in zip(low, limited, strict=True))),
        joint_max=as_six(tuple(at if has else inf for at, has in zip(high, limited, strict=True))),
    )


def _positions(sections: Sections, section: str, which: str) -> tuple[float, ...]:
    angles = _numbers(sections, section, f"{which}JointPosition", 6)
    turns = _numbers(sections, section, f"{which}JointRevolutions", 6)
    return tuple(angle + turn * tau for angle, turn in zip(angles, turns, strict=True))


def _mode(sections: Sections, section: str) -> BoundaryMode:
    word = sections.get(section, {}).get("mode", "DISABLED")
    try:
        return BoundaryMode[word]
    except KeyError:
        known = ", ".join(mode.name for mode in BoundaryMode)
        raise SafetySettingsError(f"[{section}] mode = {word[:40]}: must be one of {known}") from None


def _plane(sections: Sections, index: int) -> Plane | None:
    section = f"SafetyLimits BoundaryPlane{index}"
    mode = _mode(sections, section)
    if mode is BoundaryMode.DISABLED:
        return None
    x, y, z = _unit(_numbers(sections, section, "planeNormal", 3), section)
    (distance,) = _numbers(sections, section, "distanceToOrigin", 1)
    (elbow,) = _numbers(sections, section, "elbowRestricted", 1, fallback=(0.0,))
    return Plane(sections[section].get("name", f"plane {index}"), (x, y, z), distance, mode, elbow=bool(elbow))


def _orientation(sections: Sections) -> ToolOrientation | None:
    section = "SafetyLimits ToolOrientation"
    mode = _mode(sections, section)
    if mode is BoundaryMode.DISABLED:
        return None
    direction = _unit(_numbers(sections, section, "tcpOrientationVector", 3), section)
    (deviation,) = _numbers(sections, section, "maximumTcpOrientationDeviation", 1)
    (tilt,) = _numbers(sections, "WorkpieceConfiguration", "toolDirectionInclination", 1, fallback=(0.0,))
    (azimuth,) = _numbers(sections, "WorkpieceConfiguration", "toolDirectionAzimuth", 1, fallback=(0.0,))
    tool = (sin(tilt) * cos(azimuth), sin(tilt) * sin(azimuth), cos(tilt))  # angles from the flange's z: guess
    return ToolOrientation(direction, deviation, mode, tool)


def _unit(vector: tuple[float, ...], section: str) -> tuple[float, float, float]:
    x, y, z = vector
    length: float = (x * x + y * y + z * z) ** 0.5
    if length < 1e-6:
        raise SafetySettingsError(f"[{section}] is in use but has no direction")
    return x / length, y / length, z / length


def _spheres(numbers: tuple[float, ...], sections: Sections) -> tuple[ToolSphere, ...]:
    """Rows of x, y, z, radius, and in newer files a kind: 0 is disabled."""
    text = sections.get("WorkpieceConfiguration", {}).get("toolSpheres", "")
    rows = max(text.count("[") - 1, 0)
    if not rows or len(numbers) % rows:
        return ()
    width = len(numbers) // rows
    found = [numbers[at : at + width] for at in range(0, len(numbers), width)]
    used = [row for row in found if len(row) == 4 or (len(row) == 5 and row[4] != 0.0)]
    return tuple(ToolSphere((row[0], row[1], row[2]), row[3]) for row in used if any(row[:4]))


def _pins(sections: Sections, which: str, functions: Iterable[_Function]) -> dict[_Function, tuple[int, int]]:
    section = f"SafetyIOConfiguration {which}"
    pins: dict[_Function, tuple[int, int]] = {}
    for function in functions:
        (a,) = _numbers(sections, section, f"{function.value}A", 1, fallback=(255.0,))
        (b,) = _numbers(sections, section, f"{function.value}B", 1, fallback=(255.0,))
        if a < CHANNELS and b < CHANNELS:
            pins[function] = (int(a), int(b))
    return pins


def _safe_home(sections: Sections) -> Joints | None:
    (enabled,) = _numbers(sections, "SafeHome", "safeHomeEnabled", 1, fallback=(1.0,))
    home = _numbers(sections, "SafeHome", "safeHomePosition", 6, fallback=(-1.0,) * 6)
    return as_six(home) if enabled and min(home) >= 0.0 else None  # -1: none
