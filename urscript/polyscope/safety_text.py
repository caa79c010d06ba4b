"""The text of <SafetySettings>: writing it for a configuration, and changing single values without touching the rest.

`urscript.polyscope.safety_section` reads the lines and documents their meaning.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import floor, isfinite, tau
from typing import Final

from urproto.robots.model import RobotModel
from urproto.vectors import as_six
from urproto.versions import Series
from urscript.polyscope.numbers import double_text, doubles_text
from urscript.polyscope.safety_configuration import (
    LimitSet,
    Pins,
    SafetyConfiguration,
    SafetyInput,
    SafetyOutput,
    preset_of,
)
from urscript.polyscope.safety_section import LIMIT_KEYS, PLANES

UNASSIGNED: Final = 255
NO_DEVIATION: Final = 3.159045946109736  # of the tool direction when it is not limited
_ONLY_E: Final = (
    SafetyInput.ENABLING_DEVICE, SafetyInput.OPERATIONAL_MODE, SafetyInput.AUTOMATIC_SAFEGUARD,
    SafetyInput.AUTOMATIC_SAFEGUARD_RESET, SafetyInput.FREEDRIVE, SafetyOutput.SAFE_HOME,
)  # fmt: skip


def value_of(text: str, section: str, key: str) -> str | None:
    """The value of a key in a section; None if it is missing."""
    return next((line.partition("=")[2].strip() for _, line in _lines_of(text, section, key)), None)


def with_value(text: str, section: str, key: str, value: str | None) -> str:
    """The text with a new value for a key, or without its line (None). Every other line is unchanged."""
    lines = text.split("\n")
    at = next((index for index, _ in _lines_of(text, section, key)), None)
    if at is not None:
        lines[at : at + 1] = [] if value is None else [f"{key} = {value}"]
    elif value is not None:
        begin = next((n for n, line in enumerate(lines) if line.strip() == f"[{section}]"), None)
        if begin is None:
            lines[-1:-1] = [f"[{section}]", f"{key} = {value}", ""]
        else:
            lines.insert(begin + 1, f"{key} = {value}")
    return "\n".join(lines)


def keys_of(text: str, section: str) -> list[str]:
    """The keys of a section."""
    return [line.partition("=")[0].strip() for _, line in _lines_of(text, section, None)]


def _lines_of(text: str, section: str, key: str | None) -> Iterator[tuple[int, str]]:
    inside = False
    for number, line in enumerate(text.split("\n")):
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]") and "=" not in stripped:
            inside = stripped == f"[{section}]"
        elif inside and "=" in stripped and key in (None, stripped.partition("=")[0].strip()):
            yield number, stripped


def list_text(values: Sequence[float]) -> str:
    """Numbers in brackets."""
    return f"[{doubles_text(values)}]"


def turns_of(angle: float) -> tuple[float, int]:
    """A joint position as stored in the files: an angle within one turn from 0, and the number of turns."""
    turns = floor(angle / tau)
    return angle - turns * tau, turns


def settings_text(configuration: SafetyConfiguration, model: RobotModel) -> str:
    """The complete text for an arm, in the form of 3.2 or 5.5. Unlimited values are written as the widest limit."""
    e_series = model.series is Series.E
    widest = preset_of("least restricted", model)
    normal, reduced = (_bounded(limits, widest) for limits in (configuration.normal, configuration.reduced))
    limited = ", ".join("true" if isfinite(low) else "false" for low in configuration.normal.joint_min)
    sections = [
        ("SafetySetup", {"verified": "true", "withPositionLimits": f"[{limited}]"}),
        ("Safety Checksum", {"version": "5.5" if e_series else "3.2", "crc": str(configuration.crc or 0)}),
        ("SafetyIOConfiguration Inputs", _pins(configuration.inputs, SafetyInput, e_series=e_series)),
        ("SafetyIOConfiguration Outputs", _pins(configuration.outputs, SafetyOutput, e_series=e_series)),
        *((f"SafetyLimits BoundaryPlane{n}", _plane(configuration, n, e_series=e_series)) for n in range(PLANES)),
        ("SafetyLimits ToolOrientation", _orientation(configuration)),
        *_limits("Normal", normal),
        *_limits("Reduced", reduced),
    ]
    if e_series:
        fast = "1" if configuration.manual_high_speed else "0"
        sections += [
            ("ThreePositionEnabling", {"useTP3PE": "0", "allowManualHighSpeed": fast}),
            ("SafeHome", {"safeHomePosition": home_text(configuration.safe_home)}),
        ]
    pieces = [f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in rows.items()) for name, rows in sections]
    return "\n" + "\n".join(pieces) + "\n"


def home_text(home: Sequence[float] | None) -> str:
    """Joint angles of the safe home position, each within a turn; -1 for none."""
    return list_text((-1.0,) * 6 if home is None else [turns_of(angle)[0] for angle in home])


def _bounded(limits: LimitSet, widest: LimitSet) -> LimitSet:
    least = {name: min(getattr(limits, name), getattr(widest, name)) for name in LIMIT_KEYS.values()}
    low, high = (
        as_six(tuple(at if isfinite(at) else 0.0 for at in side)) for side in (limits.joint_min, limits.joint_max)
    )
    return replace(limits, **least, joint_min=low, joint_max=high)


def _limits(name: str, limits: LimitSet) -> Iterator[tuple[str, dict[str, str]]]:
    values = {key: getattr(limits, attribute) for key, attribute in LIMIT_KEYS.items()}
    yield f"SafetyLimits {name} Values", {key: double_text(value) for key, value in values.items() if isfinite(value)}
    low, high = (list(map(turns_of, side)) for side in (limits.joint_min, limits.joint_max))
    yield (
        f"SafetyLimits {name} Joints",
        {
            "maxJointSpeed": list_text(limits.joint_speed),
            "minJointPosition": list_text([angle for angle, _ in low]),
            "maxJointPosition": list_text([angle for angle, _ in high]),
            "minJointRevolutions": str([turns for _, turns in low]),
            "maxJointRevolutions": str([turns for _, turns in high]),
        },
    )


def _pins(
    assigned: Mapping[SafetyInput, Pins] | Mapping[SafetyOutput, Pins],
    functions: Iterable[SafetyInput | SafetyOutput],
    *,
    e_series: bool,
) -> dict[str, str]:
    written = dict[str, str]()
    for function in functions:
        if e_series or function not in _ONLY_E:
            pins = dict(assigned).get(function, (UNASSIGNED, UNASSIGNED))  # type: ignore[arg-type]
            written |= {f"{function.value}{channel}": str(pin) for channel, pin in zip("AB", pins, strict=True)}
    return written


def _plane(configuration: SafetyConfiguration, number: int, *, e_series: bool) -> dict[str, str]:
    planes = configuration.planes
    plane = planes[number] if number < len(planes) else None
    return {
        "name": plane.name if plane else f"Safety plane {number}",
        "displacement": "0.0",
        "mode": plane.mode.name if plane else "DISABLED",
        "planeNormal": list_text(plane.normal if plane else (0.0,) * 3),
        "distanceToOrigin": double_text(plane.distance if plane else 0.0),
    } | ({"elbowRestricted": "true" if plane is None or plane.elbow else "false"} if e_series else {})


def _orientation(configuration: SafetyConfiguration) -> dict[str, str]:
    orientation = configuration.tool_orientation
    return {
        "tcpOrientationVector": list_text(orientation.direction if orientation else (0.0, 0.0, 1.0)),
        "maximumTcpOrientationDeviation": double_text(orientation.deviation if orientation else NO_DEVIATION),
        "mode": orientation.mode.name if orientation else "DISABLED",
    }
