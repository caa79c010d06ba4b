"""The files of PolyScope as lines of text that people and git can compare: one line for each node or setting.

Lines contain nothing that depends on other files, and no numbers that shift when a line is inserted. Lengths are in mm,
angles in degrees, rotation vectors in rad.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import degrees
from typing import Any, Final

from urproto.versions import DEFAULT_VERSION, Series
from urscript.polyscope.document import DocumentError, Element, link, read_document
from urscript.polyscope.expressions import expression_shown
from urscript.polyscope.installation_file import InstallationFile, read_variables
from urscript.polyscope.installation_sections import UNITS, Row
from urscript.polyscope.installation_sections import Field as Setting
from urscript.polyscope.installation_settings import SECTIONS, read_settings
from urscript.polyscope.numbers import six
from urscript.polyscope.places import Places, Spot
from urscript.polyscope.surroundings import VARIABLE_TAGS, Surroundings
from urscript.polyscope.tree import ProgramTree, tag_of
from urscript.polyscope.urpx import read_urpx, urpx_parts

_JSON: Final = (b"{", b"\xef\xbb\xbf{")
_VARIABLES: Final = "InstallationVariables"
_DERIVED: Final = ("crcValue", "class", "referenceName")  # of the file's bytes, or of a place in it
_IN_TITLE: Final = ("text", "choice", "expression", "variable", "pin", "feature")  # numbers may occur there by chance
_SECTION_OF: Final = {"PayloadSettings": "payloads", "Features": "features", "GeomFeatures": "features", "IOs": "io",
                      "SafetySettings": "safety_limits", "DefaultProgramSettings": "default_program"}  # fmt: skip
_SAVED: Final = {"installationRelativePath": "Installation", "createdIn": "Created in", "lastSavedIn": "Saved in",
                 "robotSerialNumber": "Robot", "directory": "Folder"}  # fmt: skip


@dataclass(slots=True, eq=False)
class Line:
    """A node or a setting.

    kind: lines of different kinds are never versions of the same one. name: what identifies it among those of its kind,
    if it has a name. values: what is shown of it. content: all of it, by its place in the file, without the lines below
    it. spot: its place in a program.
    """

    kind: str
    name: str
    title: str
    values: dict[str, str] = field(default_factory=dict)
    content: dict[str, str] = field(default_factory=dict)
    children: "list[Line]" = field(default_factory=list)
    parent: "Line | None" = None
    spot: Spot | None = None

    def add(self, child: "Line") -> "Line":
        """Add a line below this one."""
        child.parent = self
        self.children.append(child)
        return child

    def walk(self, depth: int = 0) -> "Iterator[tuple[int, Line]]":
        """This line and all below it, with their depths."""
        waiting = [(depth, self)]
        while waiting:
            depth, line = waiting.pop()
            yield depth, line
            waiting.extend((depth + 1, child) for child in reversed(line.children))

    @property
    def text(self) -> str:
        """The line without its indentation."""
        values = [f"{key}: {value}" for key, value in self.values.items()]
        return " | ".join([self.title, *values]).replace("\n", "\\n").replace("\r", "")


def read_lines(data: bytes) -> Line:
    """The lines of a program, an installation, its variables, or a program of PolyScope X: the contents say which.

    Raises DocumentError, TreeError or UrpxError for anything else.
    """
    if data.lstrip().startswith(_JSON):
        return _urpx_lines(data)
    if not data.startswith(b"\x1f\x8b") and not data.lstrip().startswith(b"<"):
        return _variables_lines(data)
    root = link(read_document(data))
    if root.tag == _VARIABLES:
        return _variables_lines(data)
    return installation_lines(root) if root.tag == "Installation" else program_lines(root)


# programs


def program_lines(root: Element) -> Line:
    """The lines of a program tree, whose document is linked. Raises TreeError for another document."""
    tree = ProgramTree(root, root.get("name"))
    surroundings = Surroundings(root, InstallationFile(), DEFAULT_VERSION[Series.E])
    top = Line("program", "", f"Program {tree.name}".rstrip(), content=flat(root))
    top.values = {title: root.get(key) for key, title in _SAVED.items() if root.get(key)}
    by_id: dict[str, Line] = {}
    for spot in Places(root).all():
        above = by_id[spot.parent.id] if spot.parent else top
        by_id[spot.id] = above.add(_node_line(spot, surroundings))
    return top


def _node_line(spot: Spot, program: Surroundings) -> Line:
    element, tag = spot.node, tag_of(spot.written)
    line = Line(tag, element.get("name"), _title(spot), content=flat(element), spot=spot)
    if tag == "InitVariablesNode":
        line.content = line.values = first_values(program.root)
        return line
    suppressed = spot.place is not spot.written
    if suppressed:
        line.content["suppressed"] = line.values["Suppressed"] = "yes"
    if spot.kind is None or (not spot.kind.fields and tag != "Comment"):
        titled = ("suppressed", "name" if spot.kind is None else "")
        line.values |= {key: _raw_text(key, each) for key, each in line.content.items() if each and key not in titled}
        return line
    for each in spot.kind.fields:
        value = each.value(element, program) if each.shown(element) else None
        if value in (None, "", False) or (each.kind in _IN_TITLE and str(value) in line.title):
            continue
        shown = dict(each.choices).get(value, value) if isinstance(value, str) else value
        line.values[each.title] = f"{_value_text(shown)}{f' {each.unit}' if each.unit else ''}"
    return line


def _title(spot: Spot) -> str:
    title = spot.title
    return title if spot.kind is None or title.startswith(spot.kind.title) else f"{spot.kind.title} {title}"


def _value_text(value: Any) -> str:
    if isinstance(value, dict):
        return f"{_joints_text(value['joints'])}, TCP {_pose_text(value['pose'])}"
    return {True: "yes"}.get(value, str(value)) if isinstance(value, bool) else str(value)


def _raw_text(path: str, value: str) -> str:
    """A value of a node without fields, as in its file; positions, which all nodes store alike, in mm and degrees."""
    shown = _joints_text if path.endswith("angles") else _pose_text if path.endswith("pose") else None
    try:
        return shown(six(value)) if shown is not None else value
    except DocumentError:
        return value


def _joints_text(joints: Any) -> str:
    return f"[{', '.join(f'{degrees(angle) + 0.0:.3f}' for angle in joints)}] °"


def _pose_text(pose: Any) -> str:
    lengths = ", ".join(f"{part * 1000 + 0.0:.3f}" for part in pose[:3])
    return f"[{lengths}] mm, rotation [{', '.join(f'{part + 0.0:.5f}' for part in pose[3:])}]"


def first_values(root: Element) -> dict[str, str]:
    """The first value of each variable of a program that has one, as PolyScope shows it."""
    found = {
        place.get("name"): expression_shown(place.child("expression", "initializeExpression"))
        for place in root.walk()
        if place.tag in VARIABLE_TAGS and place.shared is None
    }
    return {name: shown.strip() for name, shown in sorted(found.items()) if shown.strip()}


def object_key(place: Element) -> tuple[str, str] | None:
    """Kind and name of what nodes share by its name: a variable, an input or output, a TCP or a feature."""
    element = place.resolved()
    name = element.attributes.get("referencedName") or element.attributes.get("featureName")
    if name:
        return "reference", name
    name = element.attributes.get("name")
    is_variable = place.tag in VARIABLE_TAGS and element.child("expression") is None
    return ("variable", name) if name and is_variable else None


def flat(place: Element, prefix: str = "") -> dict[str, str]:
    """The contents of a place by their paths, without the nodes below it; shared objects count as their names."""
    found: dict[str, str] = {}
    _flatten(place, prefix, found)
    return found


def _flatten(place: Element, prefix: str, found: dict[str, str]) -> None:
    element = place.resolved()
    if prefix and (key := object_key(place)):
        found[prefix] = key[1]
        return
    if prefix and element.tag in ("Waypoint", "subprogram", "SubProgram"):
        found[prefix] = element.get("name")
        return
    if "xpression" in element.tag and any(child.tag.startswith("Expression") for child in element.children):
        found[prefix] = expression_shown(element)
        return
    for name, value in element.attributes.items():
        if name not in _DERIVED:
            found[f"{prefix}.{name}" if prefix else name] = value
    if text := element.text.strip():
        found[prefix or "text"] = text
    counts: dict[str, int] = {}
    for child in element.children:
        number = counts[child.tag] = counts.get(child.tag, 0) + 1
        if prefix or child.tag != "children":
            name = child.tag if number == 1 else f"{child.tag}[{number}]"
            _flatten(child, f"{prefix}.{name}" if prefix else name, found)


# installations


def installation_lines(root: Element) -> Line:
    """The lines of an installation: its sections, then everything that belongs to none."""
    top = Line("installation", "", f"Installation {root.get('fileName')}".rstrip(), content=dict(root.attributes))
    sections = {name: top.add(Line("section", name, SECTIONS[name].title)) for name in SECTIONS}
    for name, rows in read_settings(root).items():
        key = SECTIONS[name].fields[0].name
        for row in nonempty_rows(name, rows):
            page, content = SECTIONS[name], {each: str(value) for each, value in row.items()}
            values = {each.title: setting_text(each, row[each.name]) for each in page.fields[page.listed :]}
            label = str(row[key]) if page.listed else page.title
            sections[name].add(Line(name, label, label, values, content))
    for element in root:
        section = "tcps" if "activePose" in element.attributes else _SECTION_OF.get(element.tag, "")
        content = flat(element, element.tag)
        if section:
            sections[section].content |= content  # the rows show most of it
        elif content:
            _spread(top.add(Line("element", element.tag, element.tag)), content, element.tag)
    return top


def _spread(line: Line, content: dict[str, str], prefix: str) -> None:
    """Give each of many values its own line."""
    for path, value in content.items():
        short = path.removeprefix(prefix).lstrip(".") or path
        line.add(Line("value", short, short, {"Value": value}, {"value": value}))


def nonempty_rows(name: str, rows: list[Row]) -> list[Row]:
    """The rows worth printing: most I/O signals have neither a name nor an action."""
    return rows if name != "io" else [row for row in rows if row["name"] or row["action"] not in ("", "NONE")]


def setting_text(setting: Setting, value: Any) -> str:
    """A value of an installation as shown to users."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or value == "":
        return "-"
    unit, factor = UNITS.get(setting.unit, (setting.unit, 1.0))
    if isinstance(value, list):
        lengths, rest = value[:3], value[3:]  # a rotation vector stays in rad
        return f"[{', '.join([f'{part * factor:g}' for part in lengths] + [f'{part:g}' for part in rest])}]" + (
            f" {unit}" if unit else ""
        )
    if isinstance(value, int | float):
        return f"{value * factor:g}" + (f" {unit}" if unit else "")
    return str(value)


def _variables_lines(data: bytes) -> Line:
    top = Line("variables", "", "Installation variables")
    for name, value in sorted(read_variables(data).items()):
        top.add(Line("variable", name, name, {"Value": value}, {"value": value}))
    return top


# PolyScope X


def _urpx_lines(data: bytes) -> Line:
    _, application = urpx_parts(data)
    urpx = read_urpx(data)
    top = Line("urpx", "", f"Program {urpx.name}", content={"description": urpx.information.description})
    by_depth = [top]
    for node in urpx.root.walk():
        values = _json_flat(node.parameters)
        line = by_depth[node.depth].add(Line(node.type, node.guid, node.label, values, values))
        by_depth[node.depth + 1 :] = [line]
    content = application.get("applicationContent")
    parts = content.get("applicationContributions") if isinstance(content, Mapping) else None
    for name, part in sorted(parts.items()) if isinstance(parts, Mapping) else ():
        _spread(top.add(Line("application", name, f"Application {name}")), _json_flat(part), "")
    return top


def _json_flat(value: Any, prefix: str = "") -> dict[str, str]:
    if isinstance(value, Mapping) and value:
        parts: Iterator[tuple[Any, Any]] = iter(value.items())
    elif isinstance(value, list) and any(isinstance(part, Mapping | list) for part in value):
        parts = iter(enumerate(value, 1))
    else:
        return {} if value in (None, "", {}) else {prefix: value if isinstance(value, str) else json.dumps(value)}
    return {path: text for key, part in parts for path, text in _json_flat(part, f"{prefix}.{key}".lstrip(".")).items()}
