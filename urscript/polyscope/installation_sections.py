"""Sections of an installation file: the base class, and the sections for tool, payload, mounting and features.

`urscript.polyscope.installation_settings` has the whole table.
"""

import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, ClassVar, Final, Literal, TypeAlias

from urproto.vectors import ZERO3, is_number
from urscript.polyscope.document import Element
from urscript.polyscope.features import read_features
from urscript.polyscope.installation_file import tcp_settings
from urscript.polyscope.numbers import double_text, doubles_text, number, numbers, six

Row: TypeAlias = dict[str, Any]
Kind = Literal["text", "number", "whole", "flag", "choice", "vector", "pose"]

UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "m": ("mm", 1000.0),
    "rad": ("°", 180.0 / pi),
    "rad/s": ("°/s", 180.0 / pi),
}
"""SI unit -> unit shown to users, and factor. A rotation vector stays in rad."""

_ZEROS: Final = {"number": "0", "whole": "0", "vector": "0, 0, 0"}
_LONGEST: Final = 60  # characters of a name; guess
_FARTHEST: Final = 10.0  # m; guess: farther than any tool or feature
_HEAVIEST: Final = 100.0  # kg; guess: more than any UR arm carries


class SettingError(ValueError):
    """A setting cannot be changed like this; the message names the setting and the reason."""


@dataclass(frozen=True, slots=True)
class Field:
    """A value of a row. low, high: limits, in ``unit``. choices: values of a choice; "" stands for none.

    fixed: shown, but not changeable. A vector has three numbers, a pose six: x, y, z [m], rotation vector [rad].
    attribute: where the file has the value, empty if the section reads and writes it itself. default: its text where
    the file does not have it, if not empty or zero.
    """

    name: str
    title: str
    kind: Kind = "text"
    unit: str = ""
    low: float = -1e6
    high: float = 1e6
    choices: tuple[str, ...] = ()
    fixed: bool = False
    attribute: str = ""
    default: str = ""

    def read(self, text: str) -> Any:
        """The value for a text of the file, empty for the default. Raises DocumentError."""
        text = text or self.default or _ZEROS.get(self.kind, "")
        if self.kind == "flag":
            return text == "true"
        if self.kind in ("number", "whole"):
            return int(number(text)) if self.kind == "whole" else number(text)
        if self.kind in ("vector", "pose"):
            return list(six(text)) if self.kind == "pose" else numbers(text.strip("[]"))
        return text

    def text(self, value: Any) -> str:
        """The text of the file for a value."""
        if self.kind == "flag":
            return flag_text(value)
        if self.kind in ("vector", "pose"):
            return doubles_text(value)
        return double_text(value) if self.kind == "number" else str(value)

    def checked(self, value: Any) -> Any:
        """Check a value; returns it as it is stored. Raises SettingError."""
        if self.kind == "flag":
            return self._require(isinstance(value, bool), value, "true or false")
        if self.kind == "choice":
            return self._require(value in self.choices, value, f"one of {', '.join(self.choices)}")
        if self.kind == "text":
            self._require(isinstance(value, str) and len(value) <= _LONGEST, value, f"at most {_LONGEST} characters")
            return self._require(value.isprintable(), value, "text without control characters").strip()
        if self.kind in ("vector", "pose"):
            size = 3 if self.kind == "vector" else 6
            whole = isinstance(value, Sequence) and not isinstance(value, str) and len(value) == size
            self._require(whole, value, f"{size} numbers")
            return [self._number(part) for part in value]
        return self._number(value)

    def _number(self, value: Any) -> float:
        self._require(is_number(value), value, "a number")
        if self.kind == "whole":
            self._require(float(value).is_integer(), value, "a whole number")
            value = int(value)
        limits = f"between {self.low:g} and {self.high:g}{' ' * bool(self.unit)}{self.unit}"
        return self._require(self.low <= value <= self.high, value, limits)  # type: ignore[no-any-return]

    def _require(self, right: bool, value: Any, requirement: str) -> Any:
        if not right:
            raise SettingError(f"{self.title} must be {requirement}, not {value!r:.60}")
        return value


_NAME: Final = Field("name", "Name", attribute="name")


class Section(ABC):
    """A page of settings.

    fields: of each row; where ``listed``, the first field is the name of the row. applied: when a change takes effect
    on an emulated robot. places: where the settings are in the file.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    fields: ClassVar[tuple[Field, ...]]
    listed: ClassVar[bool] = False
    grows: ClassVar[bool] = False  # rows can be added and removed
    applied: ClassVar[str]
    places: ClassVar[str]

    @abstractmethod
    def rows(self, root: Element) -> list[Row]:
        """Read the rows from the file. Raises DocumentError."""

    @abstractmethod
    def write(self, root: Element, row: Row, changes: Row) -> None:
        """Change some values of a row; `row` is as returned by `rows`. Raises SettingError."""

    def add(self, root: Element, row: Row) -> None:
        """Add a row with a value for each field. Raises SettingError."""
        raise SettingError(f"{self.title}: entries cannot be added")

    def remove(self, root: Element, row: Row) -> None:
        """Remove a row. Raises SettingError."""
        raise SettingError(f"{self.title}: entries cannot be removed")

    @property
    def key(self) -> str:
        """The field that identifies a row."""
        return self.fields[0].name

    def row(self, root: Element, name: str) -> Row:
        """The row with this name, or the only row of a section without a list. Raises SettingError."""
        rows = self.rows(root)
        found = next((row for row in rows if not self.listed or row[self.key] == name), None)
        if found is None:
            raise SettingError(
                f"{self.title}: there is no {name!r}: there are {', '.join(r[self.key] for r in rows[:20])}"
            )
        return found

    def read(self, element: Element | None, **others: Any) -> Row:
        """The row of an element with its values as attributes. others: values of fields without an attribute."""
        row = {}
        for field in self.fields:
            text = element.get(field.attribute) if element is not None else ""
            row[field.name] = field.read(text) if field.attribute else others[field.name]
        return row

    def put(self, element: Element, changes: Row) -> None:
        """Set the attributes for the changes to a row."""
        for field in self.fields:
            if field.attribute and field.name in changes:
                element.attributes[field.attribute] = field.text(changes[field.name])

    def checked(self, values: Mapping[str, Any]) -> Row:
        """Check values by the names of their fields; returns them as they are stored. Raises SettingError."""
        fields = {field.name: field for field in self.fields}
        for name in values:
            if name not in fields or fields[name].fixed:
                known = ", ".join(field.name for field in self.fields if not field.fixed)
                raise SettingError(f"{self.title} has no setting {name!r} that can be changed: there are {known}")
        return {name: fields[name].checked(value) for name, value in values.items()}


def new_element(parent: Element, tag: str, attributes: dict[str, str]) -> Element:
    """Append a child element."""
    element = Element(tag, attributes, parent)
    parent.children.append(element)
    return element


def flag_text(value: bool) -> str:
    """A boolean as written in the files."""
    return "true" if value else "false"


class Tcps(Section):
    """Tool centre points."""

    name, title = "tcps", "TCP"
    fields = (
        _NAME,
        Field("pose", "Position and rotation", "pose", "m", -_FARTHEST, _FARTHEST, attribute="offset"),
        Field("active", "Active", "flag"),
    )
    listed = grows = True
    applied = "immediately for the active TCP, with the next program for the others"
    places = "`TCPSettings` (its class's whole name in 3.5 and 5.1): `activePose`, `availablePoses/tcp`"

    def rows(self, root: Element) -> list[Row]:
        active = tcp_settings(root).get("activePose")
        return [self.read(tcp, active=tcp.get("name") == active) for tcp in self._tcps(root)]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        tcp = next(tcp for tcp in self._tcps(root) if tcp.get("name") == row["name"])
        settings = tcp_settings(root).attributes
        if changes.get("active") is False and row["active"]:
            raise SettingError(f"TCP {row['name']} is the active one: make another TCP active instead")
        self.put(tcp, changes)
        if row["active"] or changes.get("active"):
            settings["activePose"] = tcp.attributes["name"]

    def add(self, root: Element, row: Row) -> None:
        poses = tcp_settings(root).child("availablePoses")
        assert poses is not None
        offset = doubles_text(row["pose"])
        new_element(poses, "tcp", {"id": str(uuid.uuid4()), "name": row["name"], "offset": offset})
        if row.get("active"):
            tcp_settings(root).attributes["activePose"] = row["name"]

    def remove(self, root: Element, row: Row) -> None:
        if row["active"]:
            raise SettingError(f"TCP {row['name']} is the active one: make another TCP active first")
        poses = tcp_settings(root).child("availablePoses")
        assert poses is not None
        poses.children = [tcp for tcp in poses.children if tcp.get("name") != row["name"]]

    def _tcps(self, root: Element) -> Iterator[Element]:
        return (tcp.resolved() for tcp in tcp_settings(root).walk() if tcp.tag == "tcp" and tcp.get("offset"))


class Payloads(Section):
    """Payloads at the flange."""

    name, title = "payloads", "Payload"
    fields = (
        _NAME,
        Field("mass", "Mass", "number", "kg", 0.0, _HEAVIEST, attribute="mass"),
        Field("cog", "Centre of gravity", "vector", "m", -_FARTHEST, _FARTHEST, attribute="centerOfGravity"),
        Field("default", "Default", "flag", attribute="defaultPayload"),
    )
    listed = grows = True
    applied = "immediately for the default payload, with the next program for the others"
    places = (
        "`PayloadSettings/Payload` since 5.10; before that, and on CB3, only one: `toolPayload` and `centerOfGravity` "
        "of `TCPSettings`"
    )
    _ONE = "Payload"  # name of the payload in files that contain only one

    def rows(self, root: Element) -> list[Row]:
        if (settings := root.child("PayloadSettings")) is not None:
            return [self.read(payload) for payload in settings]
        old = tcp_settings(root)
        cog = numbers(old.get("centerOfGravity", "0, 0, 0"))
        return [{"name": self._ONE, "mass": number(old.get("toolPayload", "0")), "cog": cog, "default": True}]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        settings = root.child("PayloadSettings")
        if settings is None:
            self._write_only(tcp_settings(root), row, changes)
            return
        payload = next(payload for payload in settings if payload.get("name") == row["name"])
        if changes.get("default") is False and row["default"]:
            raise SettingError(f"Payload {row['name']} is the default: make another payload the default instead")
        self.put(payload, changes)
        if changes.get("default"):
            self._make_default(settings, payload.get("name"))

    def add(self, root: Element, row: Row) -> None:
        settings = root.child("PayloadSettings")
        if settings is None:
            raise SettingError("this file can contain only one payload (several since PolyScope 5.10): change that one")
        attributes = {
            "name": row["name"],
            "mass": double_text(row["mass"]),
            "defaultPayload": "false",
            "centerOfGravity": doubles_text(row["cog"]),
            "inertiaParameters": doubles_text((0.0,) * 6),
            "customInertiaEnabled": "false",
        }
        new_element(settings, "Payload", attributes)
        if row.get("default"):
            self._make_default(settings, row["name"])

    def remove(self, root: Element, row: Row) -> None:
        settings = root.child("PayloadSettings")
        if settings is None or row["default"]:
            raise SettingError(f"Payload {row['name']} is the default: make another payload the default first")
        settings.children = [payload for payload in settings if payload.get("name") != row["name"]]

    def _write_only(self, old: Element, row: Row, changes: Row) -> None:
        if changes.get("name", row["name"]) != row["name"] or changes.get("default") is False:
            raise SettingError(
                "this file can contain only one payload (several since PolyScope 5.10): it cannot be renamed"
            )
        if "mass" in changes:
            old.attributes["toolPayload"] = double_text(changes["mass"])
        if "cog" in changes and (changes["cog"] != list(ZERO3) or "centerOfGravity" in old.attributes):
            old.attributes["centerOfGravity"] = doubles_text(changes["cog"])

    def _make_default(self, settings: Element, name: str) -> None:
        for payload in settings:
            payload.attributes["defaultPayload"] = flag_text(payload.get("name") == name)


class Mounting(Section):
    """Orientation of the base."""

    name, title = "mounting", "Mounting"
    fields = (
        Field("tilt", "Tilt", "number", "rad", -pi, pi, attribute="tiltAngle"),
        Field("turn", "Rotation of the base", "number", "rad", -2 * pi, 2 * pi, attribute="baseAngle"),
    )
    applied = "immediately"
    places = "`WorldtoMarshal` below `CameraView`: `tiltAngle`, `baseAngle`"

    def rows(self, root: Element) -> list[Row]:
        return [self.read(self._place(root))]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        self.put(self._place(root), changes)

    def _place(self, root: Element) -> Element:
        place = next((element for element in root.walk() if "tiltAngle" in element.attributes), None)
        if place is None:
            raise SettingError("the installation does not say how the arm is mounted")
        return place


class Features(Section):
    """Points, lines and planes that programs move relative to."""

    name, title = "features", "Feature"
    fields = (
        _NAME,
        Field("kind", "Kind", fixed=True),
        Field("pose", "Pose in the base frame", "pose", "m", -_FARTHEST, _FARTHEST),
        Field("variable", "Variable", "flag", attribute="isVariable"),
    )
    listed = grows = True
    applied = "with the next program"
    places = "`Features` (`GeomFeatures` before 3.13 and 5.9): `GeomPoseNode`, `GeomLineNode`, `GeomPlaneNode`"
    _KINDS: Final = {"GeomPoseNode": "point", "GeomLineNode": "line", "GeomPlaneNode": "plane"}

    def rows(self, root: Element) -> list[Row]:
        features, variables = read_features(root)
        kinds = {element.get("name"): self._KINDS[element.tag] for element in self._elements(root)}
        return [
            {"name": name, "kind": kinds[name], "pose": list(pose), "variable": name in variables}
            for name, pose in features.items()
            if name in kinds
        ]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        element = next(found for found in self._elements(root) if found.get("name") == row["name"])
        if "pose" in changes:
            if row["kind"] != "point":
                raise SettingError(f"the {row['kind']} {row['name']} is defined by its points: move those instead")
            self._move(element, changes["pose"])
        self.put(element, changes)

    def add(self, root: Element, row: Row) -> None:
        tree = root.child("Features", "GeomFeatures")
        if tree is None:
            raise SettingError("the installation has no list of features")
        holder = tree.child("SetupFeatureContainerNode") or tree
        outer = new_element(holder, "GeomPoseNode", {})
        attributes = {
            "showAxes": "true",
            "joggable": "true",
            "isVariable": flag_text(bool(row.get("variable", True))),
            "id": str(uuid.uuid4()),
            "name": row["name"],
        }
        point = new_element(outer, "GeomPoseNode", attributes)
        new_element(point, "jointPositionVector", {"value": ""})
        new_element(point, "toolPosition", {"value": ""})
        new_element(point, "toolAxisAngle", {"value": ""})
        self._move(point, row["pose"])

    def remove(self, root: Element, row: Row) -> None:
        element = next(found for found in self._elements(root) if found.get("name") == row["name"])
        outer = element.parent
        assert outer is not None
        if outer.tag != element.tag or outer.parent is None:
            raise SettingError(f"{row['name']} is a part of <{outer.tag}>: remove that instead")
        outer.parent.children.remove(outer)

    def _move(self, point: Element, pose: Sequence[float]) -> None:
        for tag, values in (("toolPosition", pose[:3]), ("toolAxisAngle", pose[3:])):
            child = point.child(tag)
            assert child is not None
            child.attributes["value"] = doubles_text(values)
        joints = point.child("jointPositionVector")
        if joints is not None:  # the new pose was not taught: as PolyScope writes a point that was typed in
            joints.attributes["value"] = ", ".join(["NaN"] * 6)

    def _elements(self, root: Element) -> Iterator[Element]:
        tree = root.child("Features", "GeomFeatures")
        return (
            element for element in (tree.walk() if tree else ()) if element.tag in self._KINDS and element.get("name")
        )
