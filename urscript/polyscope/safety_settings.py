"""The safety configuration of an installation file, as rows that can be changed.

A change invalidates the controller's checksum, whose rule is not public: files with the same checksum have their
sections in different orders, so it is not a checksum of the text. A change sets it to 0, which no active configuration
has, so that no robot accepts the file's safety configuration as its own. That of a real robot is set on its own
pendant, behind its password.
"""

from collections.abc import Sequence
from math import isfinite, pi
from typing import Any, ClassVar, Final, TypeAlias

from urproto.robots.model import RobotModel
from urscript.polyscope.document import Element
from urscript.polyscope.installation_sections import Field, Row, Section, SettingError, new_element
from urscript.polyscope.numbers import double_text
from urscript.polyscope.safety_configuration import CHANNELS, LIMITS, PRESETS, BoundaryMode, SafetyConfiguration
from urscript.polyscope.safety_section import LIMIT_KEYS, PLANES, SafetySettingsError, read_safety_settings
from urscript.polyscope.safety_text import (
    UNASSIGNED,
    home_text,
    keys_of,
    list_text,
    settings_text,
    turns_of,
    value_of,
    with_value,
)

Lines: TypeAlias = list[tuple[str, str, str | None]]  # section, key and value, None to remove the line
TAG: Final = "SafetySettings"
_MODES: Final = ("Normal", "Reduced")
_JOINTS: Final = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")
_TURNS_RAD: Final = 363.0 * pi / 180.0  # the widest position limit in public files
_FASTEST_RAD_S: Final = 8.0  # guess: above every arm's limit
_FAR_M: Final = (-10.0, 10.0)  # guess: no plane is of use farther away
_WIDEST_RAD: Final = 181.0 * pi / 180.0  # of the tool direction where it is not limited
_DEVIATION: Final = "maximumTcpOrientationDeviation"
_PAIRS: Final = tuple(f"{pin}, {pin + 1}" for pin in range(0, CHANNELS, 2))


class SafetySection(Section):
    """A page of the safety configuration. A change is checked together with the whole text, and clears the checksum."""

    applied: ClassVar[str] = (
        "immediately: the arm is powered off. The checksum in the file becomes 0, so no robot accepts it as its own: "
        "change the safety settings of a real robot on its own pendant"
    )

    def rows(self, root: Element) -> list[Row]:
        settings = root.child(TAG)
        if settings is None:
            return []
        try:
            return self.rows_of(settings.text, read_safety_settings(settings.text))
        except SafetySettingsError as error:
            raise SettingError(f"the safety settings cannot be read: {error}") from error

    def write(self, root: Element, row: Row, changes: Row) -> None:
        settings = root.child(TAG)
        assert settings is not None
        text = settings.text
        for section, key, value in self.lines(text, row, {**row, **changes}, changes):
            text = with_value(text, section, key, value)
        try:
            read_safety_settings(text)
        except SafetySettingsError as error:
            raise SettingError(f"{self.title}: {error}") from error
        settings.text = with_value(text, "Safety Checksum", "crc", "0")

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        """The rows of this page."""
        raise NotImplementedError

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        """Section, key and value of each line that a change affects. Raises SettingError."""
        raise NotImplementedError

    def row_in(self, text: str, section: str, **others: Any) -> Row:
        """The row of a section with a line for each field. others: values of fields without a line."""
        return {
            field.name: field.read(value_of(text, section, field.attribute) or "")
            if field.attribute
            else others[field.name]
            for field in self.fields
        }

    def lines_in(self, section: str, changes: Row) -> Lines:
        """The lines for the changes to such a row."""
        changed = ((field, changes[field.name]) for field in self.fields if field.name in changes)
        return [
            (section, field.attribute, list_text(value) if field.kind == "vector" else field.text(value))
            for field, value in changed
        ]


def _mode(*modes: BoundaryMode) -> Field:
    return Field(
        "mode", "Restricts", "choice", choices=tuple(mode.name for mode in modes), attribute="mode", default="DISABLED"
    )


class RobotLimits(SafetySection):
    """Limits of the robot as a whole."""

    name, title = "safety_limits", "Safety: robot limits"
    fields = (
        Field("limit", "Limit", fixed=True),
        Field("normal", "Normal mode", "number", low=0.0),
        Field("reduced", "Reduced mode", "number", low=0.0),
    )
    listed = True
    places = "`SafetySettings`, `[SafetyLimits Normal Values]` and `[SafetyLimits Reduced Values]`"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        return [
            {"limit": f"{title} [{unit}]", "normal": normal, "reduced": reduced}
            for name, (title, unit) in LIMITS.items()
            if isfinite(normal := getattr(safety.normal, name)) and isfinite(reduced := getattr(safety.reduced, name))
        ]

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        key, name = next(item for item in LIMIT_KEYS.items() if row["limit"].startswith(f"{LIMITS[item[1]][0]} ["))
        most = getattr(PRESETS["least restricted"], name)
        for mode, value in changes.items():
            if not 0.0 < value <= most:
                raise SettingError(
                    f"{row['limit']} in {mode} mode must be more than 0 and at most {most:g}, not {value:g}"
                )
        return [
            (f"SafetyLimits {mode} Values", key, double_text(changes[mode.lower()]))
            for mode in _MODES
            if mode.lower() in changes
        ]


class JointLimits(SafetySection):
    """Position and speed limits of each joint."""

    name, title = "safety_joints", "Safety: joint limits"
    fields = (
        Field("joint", "Joint", fixed=True),
        Field("limited", "Positions are limited", "flag"),
        *(
            Field(f"{mode.lower()}_{what}", f"{mode} mode, {word}", "number", unit, low, high)
            for mode in _MODES
            for what, word, unit, low, high in (
                ("min", "lowest", "rad", -_TURNS_RAD, _TURNS_RAD),
                ("max", "highest", "rad", -_TURNS_RAD, _TURNS_RAD),
                ("speed", "speed", "rad/s", 0.0, _FASTEST_RAD_S),
            )
        ),
    )
    listed = True
    places = "`[SafetyLimits Normal Joints]`, `[SafetyLimits Reduced Joints]`, `withPositionLimits` of `[SafetySetup]`"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        rows = []
        for n, joint in enumerate(_JOINTS):
            row: Row = {"joint": joint, "limited": isfinite(safety.normal.joint_min[n])}
            for mode, limits in zip(_MODES, (safety.normal, safety.reduced), strict=True):
                row[f"{mode.lower()}_min"] = _or_zero(limits.joint_min[n])
                row[f"{mode.lower()}_max"] = _or_zero(limits.joint_max[n])
                row[f"{mode.lower()}_speed"] = limits.joint_speed[n]
            rows.append(row)
        return rows

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        n = _JOINTS.index(row["joint"])
        found: Lines = []
        for mode in _MODES:
            section, own = f"SafetyLimits {mode} Joints", mode.lower()
            if updated["limited"] and updated[f"{own}_min"] >= updated[f"{own}_max"]:
                raise SettingError(f"{row['joint']}: the minimum position of {own} mode must be below the maximum")
            if updated[f"{own}_speed"] <= 0.0:
                raise SettingError(f"{row['joint']}: the speed of {own} mode must be more than 0")
            for side in ("min", "max"):
                if f"{own}_{side}" in changes:
                    angle, turns = turns_of(changes[f"{own}_{side}"])
                    for key, value in ((f"{side}JointPosition", angle), (f"{side}JointRevolutions", turns)):
                        found.append((section, key, _nth(text, section, key, n, value)))
            if f"{own}_speed" in changes:
                key = "maxJointSpeed"
                found.append((section, key, _nth(text, section, key, n, changes[f"{own}_speed"])))
        if "limited" in changes:
            flags = (value_of(text, "SafetySetup", "withPositionLimits") or str(["true"] * 6)).strip("[]").split(",")
            flags = [flag.strip(" '") for flag in flags]
            flags[n] = "true" if changes["limited"] else "false"
            found.append(("SafetySetup", "withPositionLimits", f"[{', '.join(flags)}]"))
        return found


class Planes(SafetySection):
    """Safety planes: a point p is inside if normal . p + distance is not negative, in the base frame."""

    name, title = "safety_planes", "Safety: planes"
    fields = (
        Field("plane", "Plane", fixed=True),
        Field("name", "Name", attribute="name"),
        _mode(*BoundaryMode),
        Field("normal", "Normal, to the inside", "vector", "", -1.0, 1.0, attribute="planeNormal"),
        Field("distance", "Distance of the base from it", "number", "m", *_FAR_M, attribute="distanceToOrigin"),
        Field("elbow", "Restricts the elbow too", "flag", attribute="elbowRestricted"),
    )
    listed = True
    places = "`[SafetyLimits BoundaryPlane0]` to 7; a plane that is moved here no longer follows its feature"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        sections = {str(n): f"SafetyLimits BoundaryPlane{n}" for n in range(PLANES)}
        return [self.row_in(text, section, plane=n) for n, section in sections.items() if keys_of(text, section)]

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        section = f"SafetyLimits BoundaryPlane{row['plane']}"
        x, y, z = updated["normal"]
        length = (x * x + y * y + z * z) ** 0.5
        if updated["mode"] != "DISABLED" and length < 1e-6:
            raise SettingError(f"plane {row['plane']} is active but has no normal: set its normal")
        if changes.get("elbow") is not None and "elbowRestricted" not in keys_of(text, section):
            raise SettingError("planes of this PolyScope version do not restrict the elbow")
        if "normal" in changes:
            changes = {**changes, "normal": [part / (length or 1.0) for part in (x, y, z)]}
        found = self.lines_in(section, changes)
        if "normal" in changes or "distance" in changes:
            found += [(section, "sourceFeatureId", None), (section, "displacement", "0.0")]
        return found


class ToolDirection(SafetySection):
    """Limit of the angle between the tool and a direction in the base frame."""

    name, title = "safety_tool_direction", "Safety: tool direction"
    fields = (
        _mode(BoundaryMode.DISABLED, BoundaryMode.NORMAL, BoundaryMode.REDUCED, BoundaryMode.BOTH),
        Field("direction", "Direction", "vector", "", -1.0, 1.0, attribute="tcpOrientationVector", default="0, 0, 1"),
        Field("deviation", "Deviation", "number", "rad", 0.0, _WIDEST_RAD, attribute=_DEVIATION, default=repr(pi)),
    )
    places = "`[SafetyLimits ToolOrientation]`"
    _SECTION: Final = "SafetyLimits ToolOrientation"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        return [self.row_in(text, self._SECTION)] if keys_of(text, self._SECTION) else []

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        x, y, z = updated["direction"]
        length = (x * x + y * y + z * z) ** 0.5
        if length < 1e-6:
            raise SettingError("the tool direction must not be a zero vector")
        if updated["mode"] != "DISABLED" and not 0.0 < updated["deviation"] < pi:
            raise SettingError("the limit of the tool direction must be more than 0° and less than 180°")
        if "direction" in changes:
            changes = {**changes, "direction": [x / length, y / length, z / length]}
        return self.lines_in(self._SECTION, changes)


class SafetySignals(SafetySection):
    """Safety functions of pairs of configurable inputs and outputs."""

    name, title = "safety_io", "Safety: I/O"
    fields = (
        Field("function", "Function", fixed=True),
        Field("pins", "Configurable pins", "choice", choices=("", *_PAIRS)),
    )
    listed = True
    places = "`[SafetyIOConfiguration Inputs]` and `[SafetyIOConfiguration Outputs]`, 255 for none"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        rows = []
        for which in ("Inputs", "Outputs"):
            section = f"SafetyIOConfiguration {which}"
            for key in keys_of(text, section):
                if key.endswith(("InputA", "OutputA")):
                    pins = [int(value_of(text, section, f"{key[:-1]}{channel}") or UNASSIGNED) for channel in "AB"]
                    used = f"{pins[0]}, {pins[1]}" if max(pins) < CHANNELS else ""
                    rows.append({"function": key[:-1], "pins": used})
        return rows

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        function, pins = row["function"], updated["pins"]
        which = "Inputs" if function.endswith("Input") else "Outputs"
        section = f"SafetyIOConfiguration {which}"
        for other in self.rows_of(text, read_safety_settings(text)):
            same_side = other["function"].endswith(which[:-1])
            if pins and same_side and other["function"] != function and other["pins"] == pins:
                raise SettingError(f"the pins {pins} already have the function {other['function']}")
        a, b = pins.split(", ") if pins else (str(UNASSIGNED),) * 2
        return [(section, f"{function}A", a), (section, f"{function}B", b)]


class SafeHome(SafetySection):
    """Joint angles at which the safe home output is high."""

    name, title = "safety_home", "Safety: safe home"
    fields = (
        Field("defined", "Defined", "flag"),
        *(Field(f"q{n}", joint, "number", "rad", -2.0 * pi, 2.0 * pi) for n, joint in enumerate(_JOINTS)),
    )
    places = "`[SafeHome]`: `safeHomePosition`, each angle within a turn, -1 for none"

    def rows_of(self, text: str, safety: SafetyConfiguration) -> list[Row]:
        if "safeHomePosition" not in keys_of(text, "SafeHome"):
            return []
        home = safety.safe_home
        return [{"defined": home is not None} | {f"q{n}": angle for n, angle in enumerate(home or (0.0,) * 6)}]

    def lines(self, text: str, row: Row, updated: Row, changes: Row) -> Lines:
        home = [updated[f"q{n}"] for n in range(6)] if updated["defined"] else None
        lines: Lines = [("SafeHome", "safeHomePosition", home_text(home))]
        if "safeHomeEnabled" in keys_of(text, "SafeHome"):
            lines.append(("SafeHome", "safeHomeEnabled", "1" if updated["defined"] else "0"))
        return lines


SAFETY_SECTIONS: Final[Sequence[SafetySection]] = (
    RobotLimits(), JointLimits(), Planes(), ToolDirection(), SafetySignals(), SafeHome(),
)  # fmt: skip


def add_safety(root: Element, configuration: SafetyConfiguration, model: RobotModel) -> None:
    """Add the safety settings of an arm to an installation that has none."""
    if root.child(TAG) is None:
        new_element(root, TAG, {}).text = settings_text(configuration, model)


def _nth(text: str, section: str, key: str, n: int, value: float) -> str:
    """The text of a list with one number replaced; the others keep their digits."""
    parts = [part.strip() for part in (value_of(text, section, key) or "").strip("[]").split(",")]
    if len(parts) != len(_JOINTS):
        raise SettingError(f"[{section}] {key} has not one number for each joint")
    parts[n] = str(value) if isinstance(value, int) else double_text(value)
    return f"[{', '.join(parts)}]"


def _or_zero(angle: float) -> float:
    return angle if isfinite(angle) else 0.0
