"""The program that is being made: one for all browsers of a station, kept on this machine as it changes.

Every edit is one operation on a node, known by an id that stays when others are moved; so what two people do at once is
done one after the other, and nothing is lost. What cannot be done raises a ValueError that says why.
"""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import PurePosixPath
from typing import Any, Final, TypeVar

from client.errors import FileError
from client.pendant.program_file import KeptProgram, ProgramFile
from urproto.robots import RobotModel, load_model
from urproto.text import to_bytes
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.document import DocumentError, Element, packed, read_document
from urscript.polyscope.editing import EditError, ProgramEditor, Row
from urscript.polyscope.files import new_program, outline_text
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.registry import NODES, kinds
from urscript.polyscope.transplant import Clip
from urscript.polyscope.tree import ProgramTree, TreeError

_SAVED_AFTER_S: Final = 0.3  # a change is on the disk within a second, also on a busy machine
_UNNAMED: Final = "unnamed"
_EXTENSION: Final = ".urp"
_ANY: Final = "ur5e"
_FROM: Final = "from"  # key of the position that a relative waypoint starts from
_GROUPS: Final = ("Basic", "Advanced", "Templates", "URCaps", "Program")


@dataclass(frozen=True, slots=True)
class FormField:
    """A field of a node: see `urscript.polyscope.forms.Field`. choices: value and title."""

    key: str
    title: str
    kind: str
    unit: str
    optional: bool
    help: str
    choices: tuple[tuple[str, str], ...]
    value: Any


@dataclass(frozen=True, slots=True)
class PaletteEntry:
    """A kind of node that can be inserted."""

    name: str
    title: str
    icon: str
    doc: str


_ICONS: Final = {  # of Material Icons, by the key of the kind; what has none here gets that of its group
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


def palette(version: PolyscopeVersion | None) -> dict[str, list[PaletteEntry]]:
    """What can be inserted, by group, in the order of the registry; for all versions while none is known."""
    groups: dict[str, list[PaletteEntry]] = {group: [] for group in _GROUPS}
    for found in NODES.values():
        for kind in found.kinds:
            if kind.group in groups and kind.new is not None and (version is None or kind.exists_in(version)):
                icon = _ICONS.get(kind.key, _GROUP_ICONS[kind.group])
                groups[kind.group].append(PaletteEntry(kind.key, kind.title, icon, found.doc))
    return {group: entries for group, entries in groups.items() if entries}


_Answer = TypeVar("_Answer")


class ProgramDraft:
    """path: of the file in the robot's programs folder, "" before the first save.

    version: counts the changes of all that pages show. breakpoints: ids of nodes. played_version: which of them the
    robot got last. note: told what goes wrong with the file that keeps the program. tell: called when there is news to
    show. known: the robot's version and arm, None while they are not known.
    """

    def __init__(
        self,
        file: ProgramFile,
        note: Callable[[str], object],
        tell: Callable[[], object],
        known: Callable[[], tuple[PolyscopeVersion | None, RobotModel | None]],
    ) -> None:
        self._file = file
        self._note = note
        self._tell = tell
        self._known = known
        self._edited = asyncio.Event()
        self._editor: ProgramEditor | None = None
        self._changed_before = False  # when it was taken up
        self._clip: Clip | None = None
        self._memory = dict[str, tuple[int, Any]]()
        self.path = ""
        self.version = 0
        self.played_version = -1
        self.breakpoints = frozenset[str]()

    # the program

    @property
    def editor(self) -> ProgramEditor:
        """The program; what was kept on this machine, at first."""
        if self._editor is None:
            self._editor = self._restored() or self._empty()
        version, model = self._known()
        program = self._editor.program
        if (version is not None and version != program.version) or model != program.model:
            self._editor.version = program.version = version or program.version
            program.model = model
            self._editor.revision += 1
            self.version += 1
        return self._editor

    def _empty(self) -> ProgramEditor:
        version, model = self._robot()
        return self._editor_of(new_program(_UNNAMED, version, model), _UNNAMED)

    def _robot(self) -> tuple[PolyscopeVersion, RobotModel]:
        """The one that is connected; before that, any."""
        version, model = self._known()
        return version or DEFAULT_VERSION[model.series if model else Series.E], model or load_model(_ANY)

    def _editor_of(self, root: Element, name: str) -> ProgramEditor:
        version, model = self._robot()
        return ProgramEditor(root, name, InstallationFile(), version, model)

    def _made(self, data: bytes, name: str) -> ProgramEditor:
        """Raises ValueError for what is no program."""
        try:
            return self._editor_of(read_document(data), name)
        except (DocumentError, TreeError) as error:
            raise ValueError(f"{name}.urp cannot be opened: {error}") from error

    def _restored(self) -> ProgramEditor | None:
        try:
            kept = self._file.read()
        except FileError as error:
            self._note(str(error))
            return None
        if kept is None:
            return None
        try:
            editor = self._made(kept.data, PurePosixPath(kept.path or _UNNAMED).stem)
        except ValueError as error:
            self._note(f"{error}: {self._file.set_aside()}")
            return None
        self.path, self._changed_before = kept.path, kept.changed
        return editor

    @property
    def title(self) -> str:
        """What it is called."""
        return self.path or _UNNAMED

    @property
    def changed(self) -> bool:
        """Since it was saved."""
        return self._changed_before or self.editor.modified

    def data(self) -> bytes:
        """The bytes of its ``.urp``."""
        return packed(self.editor.document())

    def tree(self) -> ProgramTree:
        """For the translation."""
        return self.editor.tree

    def files(self, stem: str) -> dict[str, bytes | None]:
        """What is saved under a name: program, script and tree; None for the script of a program that cannot be run."""
        editor = self.editor
        editor.name = stem
        try:
            script = to_bytes(editor.written().text())
        except TreeError:
            script = None
        text = to_bytes(outline_text(editor))
        return {f"{stem}.script": script, f"{stem}.txt": text, f"{stem}{_EXTENSION}": self.data()}

    def new(self) -> None:
        """An empty program instead."""
        self._take_up(self._empty(), "")

    def open(self, data: bytes, path: str) -> None:
        """Another program instead: the bytes of a ``.urp``. Raises ValueError for what is none."""
        self._take_up(self._made(data, PurePosixPath(path).stem), path)

    def _take_up(self, editor: ProgramEditor, path: str) -> None:
        self._editor, self.path, self._changed_before = editor, path, False
        self.breakpoints = frozenset()
        self.played_version = -1
        self._touch()

    def saved(self, path: str, version: int) -> None:
        """It was saved as it was in a version; whoever edited it meanwhile has more to save."""
        self.path, self._changed_before = path, version != self.version
        self.editor.saved()
        self._touch(edited=False)

    async def keep(self) -> None:
        """Write every change to the disk soon, for ever."""
        while True:
            await self._edited.wait()
            await asyncio.sleep(_SAVED_AFTER_S)
            self._edited.clear()
            try:
                await asyncio.to_thread(self._file.write, KeptProgram(self.path, self.changed, self.data()))
            except FileError as error:
                self._note(f"the program is not kept on this machine: {error}")

    def _touch(self, *, edited: bool = True) -> None:
        """There is something new to show, and to keep."""
        if edited:
            self.version += 1
        self._memory.clear()
        self._edited.set()
        self._tell()

    def wake(self) -> None:
        """Let the pages look: something of a page has changed."""
        self._tell()

    def _remembered(self, what: str, make: Callable[[], _Answer]) -> _Answer:
        """Made once for each revision: thirty times a second somebody looks."""
        revision = self.editor.revision
        found = self._memory.get(what)
        if found is None or found[0] != revision:
            found = self._memory[what] = (revision, make())
        answer: _Answer = found[1]
        return answer

    # what is shown

    def rows(self) -> list[Row]:
        """The nodes in the order of the tree."""
        return self._remembered("rows", self.editor.rows)

    def _row(self, node: str) -> Row | None:
        rows = self._remembered("by id", lambda: {row.id: row for row in self.rows()})
        return rows.get(node)

    def has(self, node: str) -> bool:
        """Whether there is such a node."""
        return self._row(node) is not None

    def first(self) -> str:
        """Where a selection begins: the robot program."""
        rows = self.rows()
        return next((row.id for row in rows if row.kind == "robot_program"), rows[0].id)

    def shown_rows(self) -> list[list[Any]]:
        """For static/screen_program.js: id, number, depth, icon, text, marks, problem."""
        return self._remembered(f"shown {sorted(self.breakpoints)}", self._show_rows)

    def _show_rows(self) -> list[list[Any]]:
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
        return " ".join(word for word, there in marks.items() if there)

    def number(self, node: str) -> int:
        """By which labels name a node. Raises ValueError for one that is gone."""
        row = self._row(node)
        if row is None:
            raise ValueError("this node is not in the program any more")
        return row.number

    def text(self, node: str) -> str:
        """What a node is called."""
        row = self._row(node)
        return "" if row is None else row.title

    def doc(self, node: str) -> str:
        """What a kind of node is for."""
        row = self._row(node)
        return "" if row is None else _docs().get(row.kind, "")

    def problem(self, node: str) -> str:
        """What is wrong with a node."""
        row = self._row(node)
        return "" if row is None else row.problem

    def problems(self) -> list[str]:
        """What keeps the program from being played."""
        names = {row.id: f"node {row.number}: " for row in self.rows()}
        return [f"{names.get(problem.node, '')}{problem.message}" for problem in self.editor.problems()]

    def form(self, node: str) -> tuple[FormField, ...]:
        """The fields of a node that have a meaning now."""
        return self._remembered(f"form {node}", partial(self._read_form, node))

    def _read_form(self, node: str) -> tuple[FormField, ...]:
        if not self.has(node):
            return ()
        return tuple(
            FormField(
                field["key"],
                field["title"],
                field["kind"],
                field["unit"],
                field["optional"],
                field["help"],
                tuple((choice["value"], choice["title"]) for choice in field["choices"]),
                field["value"],
            )
            for field in self.editor.form(node)["fields"]
        )

    def value(self, node: str, key: str) -> Any:
        """Of a field, None when there is none."""
        return next((field.value for field in self.form(node) if field.key == key), None)

    def joints(self, node: str, key: str) -> tuple[float, ...] | None:
        """Of a taught position [rad], None before it is taught."""
        value = self.value(node, key)
        return None if value is None else tuple(value["joints"])

    def waypoints(self) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """Where the taught waypoints are that are not suppressed: id of the node, x, y, z in the base frame [m]."""
        return self._remembered("waypoints", self._find_waypoints)

    def _find_waypoints(self) -> tuple[tuple[str, tuple[float, ...]], ...]:
        found = list[tuple[str, tuple[float, ...]]]()
        for row in self.rows():
            if row.kind == "waypoint" and not row.suppressed and (value := self.value(row.id, "position")):
                found.append((row.id, tuple(value["pose"][:3])))
        return tuple(found)

    # edits

    def insert(self, kind: str, at: str) -> str:
        """Put a new node into the selected one or behind it, or as near as it may stand; its id."""
        node = self._near(at, partial(self.editor.insert, kind))
        self._touch()
        return node

    def paste(self, at: str) -> str:
        """What was copied last, as `insert`; the id of the first node."""
        clip = self._clip
        if clip is None:
            raise ValueError("nothing was copied yet: copy a node first")
        nodes = self._near(at, partial(self.editor.paste, clip))
        self._touch()
        return nodes[0]

    def _near(self, at: str, put: Callable[..., _Answer]) -> _Answer:
        """Try the places by which somebody may have meant it, from the selected node outwards."""
        first: EditError | None = None
        row = self._row(at)
        places = [{"into": at}] if row is not None and row.holds_nodes else []
        while row is not None:
            places.append({"after": row.id})
            row = self._row(row.parent)
        for place in places:
            try:
                return put(**place)
            except EditError as error:
                first = first or error
        raise first or ValueError("this node is not in the program any more")

    def delete(self, node: str) -> None:
        """With all below it."""
        self.editor.delete(node)
        self._touch()

    def copy(self, node: str) -> None:
        """For `paste`, in this program or the next; one clipboard for all browsers."""
        self._clip = self.editor.copy(node)

    def neighbour(self, node: str) -> str:
        """Which node is selected when this one goes."""
        row = self._row(node)
        if row is None:
            return self.first()
        beside = [other.id for other in self.rows() if other.parent == row.parent]
        index = beside.index(node)
        return (beside[index + 1 : index + 2] or beside[max(0, index - 1) : index] or [row.parent])[0]

    def shift(self, node: str, by: int) -> None:
        """Move a node before the one above it (-1) or behind the one below it (1), or out of the one around it."""
        row = self._row(node)
        if row is None:
            raise ValueError("this node is not in the program any more")
        beside = [other.id for other in self.rows() if other.parent == row.parent]
        index = beside.index(node) + by
        anchor = beside[index] if 0 <= index < len(beside) else row.parent
        if by < 0:
            self.editor.move(node, before=anchor)
        else:
            self.editor.move(node, after=anchor)
        self._touch()

    def suppress(self, node: str) -> None:
        """Leave a node out, or not any more."""
        row = self._row(node)
        self.editor.suppress(node, on=row is None or not row.suppressed_itself)
        self._touch()

    def set(self, node: str, key: str, value: Any) -> None:
        """Set a field. Raises ValueError for what it cannot take."""
        self.editor.set(node, key, value)
        self._touch()

    def teach(self, node: str, key: str, joints: Sequence[float], pose: Sequence[float], tcp: Sequence[float]) -> None:
        """Let a position be where the arm is. joints [rad]; pose: of the TCP, and tcp: flange to TCP [m, rad]."""
        self.editor.teach(node, joints, pose, tcp, start=key == _FROM)
        self._touch()

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to take back."""
        return bool(self.editor.can_undo)

    @property
    def can_redo(self) -> bool:
        """Whether one was taken back."""
        return bool(self.editor.can_redo)

    def undo(self) -> None:
        """Take back the last edit, whoever made it."""
        self.editor.undo()
        self._touch()

    def redo(self) -> None:
        """Do again what was taken back last."""
        self.editor.redo()
        self._touch()

    def toggle_breakpoint(self, node: str) -> None:
        """Pause at a node, or not any more."""
        self.number(node)
        self.breakpoints ^= {node}
        self._tell()


def _icon(kind: str) -> str:
    found = kinds().get(kind)
    return _ICONS.get(kind, _GROUP_ICONS[found.group] if found else "help_outline")


@cache
def _docs() -> dict[str, str]:
    """What kinds of nodes are for, by their keys."""
    return {kind.key: found.doc for found in NODES.values() for kind in found.kinds}
