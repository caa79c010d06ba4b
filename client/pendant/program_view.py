"""What pages show of the edited program: the tree, the forms, the waypoints, and the nodes that can be inserted."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Final, TypeVar

from urproto.versions import PolyscopeVersion
from urscript.polyscope.editing import ProgramEditor, Row
from urscript.polyscope.registry import NODES, kinds

_GROUPS: Final = ("Basic", "Advanced", "Templates", "URCaps", "Program")
_ICONS: Final = {  # Material Icons by the key of the kind; other kinds get the icon of their group
    "move": "timeline", "waypoint": "place", "direction": "north_east", "until": "flag", "wait": "hourglass_empty",
    "set": "toggle_on", "set_payload": "scale", "force": "compress", "popup": "chat_bubble_outline", "halt": "stop",
    "comment": "notes", "folder": "folder_open",
    "if": "call_split", "elseif": "call_split", "else": "call_split", "loop": "loop", "call": "login",
    "subprogram": "integration_instructions", "assignment": "edit_note", "script": "code", "thread": "alt_route",
    "event": "bolt", "switch": "fork_right", "case": "subdirectory_arrow_right", "timer": "timer", "home": "home",
    "robot_program": "smart_toy", "variables_setup": "data_object", "before_start": "first_page",
    "default_case": "subdirectory_arrow_right", "circle_move": "rotate_right",
}  # fmt: skip
_GROUP_ICONS: Final = {
    "Basic": "crop_square",
    "Advanced": "widgets",
    "Templates": "grid_view",
    "URCaps": "extension",
    "Program": "smart_toy",
}


@dataclass(frozen=True, slots=True)
class FormField:
    """A field of a node: see `urscript.polyscope.forms.Field`. choices: value and title."""

    key: str
    title: str
    kind: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[tuple[str, str], ...]
    optional: bool
    help: str
    value: Any
    node: str


@dataclass(frozen=True, slots=True)
class PaletteEntry:
    """A kind of node that can be inserted."""

    name: str
    title: str
    icon: str
    doc: str


def palette(version: PolyscopeVersion | None) -> dict[str, list[PaletteEntry]]:
    """The kinds that can be inserted, by group, in the order of the registry; of all versions if it is unknown."""
    groups: dict[str, list[PaletteEntry]] = {group: [] for group in _GROUPS}
    for found in NODES.values():
        for kind in found.kinds:
            if kind.group in groups and kind.new is not None and (version is None or kind.exists_in(version)):
                icon = _ICONS.get(kind.key, _GROUP_ICONS[kind.group])
                groups[kind.group].append(PaletteEntry(kind.key, kind.title, icon, found.doc))
    return {group: entries for group, entries in groups.items() if entries}


_Value = TypeVar("_Value")


class ProgramView:
    """The view of one program. editor: the program; New and Open create another one. breakpoints: ids of nodes."""

    def __init__(self, editor: Callable[[], ProgramEditor]) -> None:
        self._editor = editor
        self._cache = dict[str, tuple[ProgramEditor, int, Any]]()
        self.breakpoints = frozenset[str]()

    def _cached(self, key: str, compute: Callable[[], _Value]) -> _Value:
        """A value computed once per revision, because pages read it thirty times a second."""
        editor = self._editor()
        found = self._cache.get(key)
        if found is None or found[0] is not editor or found[1] != editor.revision:
            if found is not None:
                self._cache.clear()  # values of an older revision
            found = self._cache[key] = (editor, editor.revision, compute())
        value: _Value = found[2]
        return value

    def rows(self) -> list[Row]:
        """The nodes in the order of the tree."""
        return self._cached("rows", lambda: self._editor().rows())

    def row(self, node: str) -> Row | None:
        """The row of a node, None if it was deleted."""
        rows = self._cached("by id", lambda: {row.id: row for row in self.rows()})
        return rows.get(node)

    def has(self, node: str) -> bool:
        return self.row(node) is not None

    def first(self) -> str:
        """The initial selection: the robot program."""
        rows = self.rows()
        return next((row.id for row in rows if row.kind == "robot_program"), rows[0].id)

    def shown_rows(self) -> list[list[Any]]:
        """Rows for static/screen_program.js: id, number, depth, icon, text, marks, problem."""
        return self._cached(f"shown {sorted(self.breakpoints)}", self._build_rows)

    def _build_rows(self) -> list[list[Any]]:
        return [
            [row.id, row.number, row.depth, _icon(row.kind), row.title, self._marks(row), row.problem]
            for row in self.rows()
        ]

    def _marks(self, row: Row) -> str:
        marks = {
            "undefined": not row.defined,
            "problem": bool(row.problem) and row.defined,
            "suppressed": row.suppressed,
            "breakpoint": row.id in self.breakpoints,
        }
        return " ".join(word for word, applies in marks.items() if applies)

    def number(self, node: str) -> int:
        """The number of a node in labels. Raises ValueError if it was deleted."""
        row = self.row(node)
        if row is None:
            raise ValueError("this node is no longer in the program")
        return row.number

    def text(self, node: str) -> str:
        row = self.row(node)
        return "" if row is None else row.title

    def doc(self, node: str) -> str:
        row = self.row(node)
        return "" if row is None else _kind_docs().get(row.kind, "")

    def problem(self, node: str) -> str:
        """The problem of a node, "" without one."""
        row = self.row(node)
        return "" if row is None else row.problem

    def problems(self) -> list[str]:
        """The problems that prevent the program from being played."""
        names = {row.id: f"node {row.number}: " for row in self.rows()}
        return [f"{names.get(problem.node, '')}{problem.message}" for problem in self._editor().problems()]

    def form(self, node: str) -> tuple[FormField, ...]:
        """The fields of a node that apply now."""
        return self._cached(f"form {node}", partial(self._build_form, node))

    def _build_form(self, node: str) -> tuple[FormField, ...]:
        if not self.has(node):
            return ()
        fields = self._editor().form(node)["fields"]
        return tuple(
            FormField(**field | {"choices": tuple((choice["value"], choice["title"]) for choice in field["choices"])})
            for field in fields
        )

    def value(self, node: str, key: str) -> Any:
        """The value of a field, None if the field does not exist."""
        return next((field.value for field in self.form(node) if field.key == key), None)

    def joints(self, node: str, key: str) -> tuple[float, ...] | None:
        """Joint angles of a taught position [rad], None before it is taught."""
        value = self.value(node, key)
        return None if value is None else tuple(value["joints"])

    def waypoints(self) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """The taught waypoints that are not suppressed: id of the node, x, y, z in the base frame [m]."""
        return self._cached("waypoints", self._read_waypoints)

    def _read_waypoints(self) -> tuple[tuple[str, tuple[float, ...]], ...]:
        found = list[tuple[str, tuple[float, ...]]]()
        for row in self.rows():
            if row.kind == "waypoint" and not row.suppressed and (value := self.value(row.id, "position")):
                found.append((row.id, tuple(value["pose"][:3])))
        return tuple(found)

    def neighbour(self, node: str) -> str:
        """The node to select when this one is deleted."""
        row = self.row(node)
        if row is None:
            return self.first()
        siblings = [other.id for other in self.rows() if other.parent == row.parent]
        index = siblings.index(node)
        return (siblings[index + 1 : index + 2] or siblings[max(0, index - 1) : index] or [row.parent])[0]


def _icon(kind: str) -> str:
    found = kinds().get(kind)
    return _ICONS.get(kind, _GROUP_ICONS[found.group] if found else "help_outline")


@cache
def _kind_docs() -> dict[str, str]:
    return {kind.key: found.doc for found in NODES.values() for kind in found.kinds}
