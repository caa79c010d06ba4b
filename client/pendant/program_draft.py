"""The program that is being edited: one for all browsers of a station, saved on this machine after each change.

An edit is one operation on a node, identified by an id that does not change when other nodes are moved. Simultaneous
edits of two users are applied one after the other, and none is lost. An edit that is not possible raises a ValueError
with the reason.
"""

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import PurePosixPath
from typing import Any, Final, TypeVar

from client.errors import FileError
from client.pendant.program_view import ProgramView
from client.pendant.saved import ProgramFile, SavedDraft
from urproto.robots import RobotModel, load_model
from urproto.text import to_bytes
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.document import DocumentError, Element, packed, read_document
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.files import new_program, outline_text
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.places import EditError
from urscript.polyscope.transplant import Clip
from urscript.polyscope.tree import ProgramTree, TreeError

_SAVE_DELAY_S: Final = 0.3  # a change is on the disk within a second, even under load
_UNNAMED: Final = "unnamed"
_EXTENSION: Final = ".urp"
_DEFAULT_MODEL: Final = "ur5e"
_START_POSITION: Final = "from"  # key of the position that a relative waypoint starts from


_Answer = TypeVar("_Answer")


class ProgramDraft:
    """The program that is being edited. path: in the robot's programs folder, "" before the program is saved there.

    version: counts the changes that pages show. view: what pages show. played_version: the version that the robot got
    last. report_error: called with errors of the file that keeps the program. on_change: called when something to show
    has changed. robot_info: returns version and arm of the robot, None while they are unknown.
    """

    def __init__(
        self,
        file: ProgramFile,
        report_error: Callable[[str], object],
        on_change: Callable[[], object],
        robot_info: Callable[[], tuple[PolyscopeVersion | None, RobotModel | None]],
    ) -> None:
        self._file = file
        self._report_error = report_error
        self._on_change = on_change
        self._robot_info = robot_info
        self._edited = asyncio.Event()
        self._editor: ProgramEditor | None = None
        self._unsaved = False  # whether it had unsaved changes when it was opened
        self._clip: Clip | None = None
        self._installation = InstallationFile()
        self.view = ProgramView(lambda: self.editor)
        self.path = ""
        self.version = 0
        self.played_version = -1

    # the program

    @property
    def editor(self) -> ProgramEditor:
        """The program; at first, the one that was saved on this machine."""
        if self._editor is None:
            self._editor = self._restore() or self._create_empty()
        version, model = self._robot_info()
        program = self._editor.program
        if (version is not None and version != program.version) or model != program.model:
            self._editor.version = program.version = version or program.version
            program.model = model
            self._editor.revision += 1
            self.version += 1
        return self._editor

    def _create_empty(self) -> ProgramEditor:
        version, model = self._robot_or_default()
        return self._create_editor(new_program(_UNNAMED, version, model), _UNNAMED)

    def _robot_or_default(self) -> tuple[PolyscopeVersion, RobotModel]:
        """Version and model of the connected robot, or defaults before it is connected."""
        version, model = self._robot_info()
        return version or DEFAULT_VERSION[model.series if model else Series.E], model or load_model(_DEFAULT_MODEL)

    def _create_editor(self, root: Element, name: str) -> ProgramEditor:
        version, model = self._robot_or_default()
        return ProgramEditor(root, name, self._installation, version, model)

    def _parse(self, data: bytes, name: str) -> ProgramEditor:
        """Parse the bytes of a ``.urp``. Raises ValueError if they are not a program."""
        try:
            return self._create_editor(read_document(data), name)
        except (DocumentError, TreeError) as error:
            raise ValueError(f"{name}.urp cannot be opened: {error}") from error

    def _restore(self) -> ProgramEditor | None:
        try:
            saved_draft = self._file.read()
        except FileError as error:
            self._report_error(str(error))
            return None
        if saved_draft is None:
            return None
        try:
            editor = self._parse(saved_draft.data, PurePosixPath(saved_draft.path or _UNNAMED).stem)
        except ValueError as error:
            self._report_error(f"{error}: {self._file.move_aside()}")
            return None
        self.path, self._unsaved = saved_draft.path, saved_draft.changed
        return editor

    def use_installation(self, installation: InstallationFile) -> None:
        """Set the TCPs, features, payloads and signals of the robot that nodes can refer to."""
        self._installation = self.editor.installation = installation
        self._mark_changed(edited=False)

    @property
    def title(self) -> str:
        return self.path or _UNNAMED

    @property
    def changed(self) -> bool:
        """Whether it has changed since it was saved."""
        return self._unsaved or self.editor.modified

    def data(self) -> bytes:
        """The program as the bytes of a ``.urp``."""
        return packed(self.editor.document())

    def tree(self) -> ProgramTree:
        return self.editor.tree

    def files(self, stem: str) -> dict[str, bytes | None]:
        """The files to save under a name: program, script and tree; the script is None if the program cannot run."""
        editor = self.editor
        editor.name_program(stem)
        try:
            script = to_bytes(editor.written().text())
        except TreeError:
            script = None
        text = to_bytes(outline_text(editor))
        return {f"{stem}.script": script, f"{stem}.txt": text, f"{stem}{_EXTENSION}": self.data()}

    def new(self) -> None:
        self._replace(self._create_empty(), "")

    def open(self, data: bytes, path: str) -> None:
        """Replace the program by the bytes of a ``.urp``. Raises ValueError if they are not a program."""
        self._replace(self._parse(data, PurePosixPath(path).stem), path)

    def _replace(self, editor: ProgramEditor, path: str) -> None:
        self._editor, self.path, self._unsaved = editor, path, False
        self.view.breakpoints = frozenset()
        self.played_version = -1
        self._mark_changed()

    def mark_saved(self, path: str, version: int) -> None:
        """Record that a version was saved; later edits are still unsaved."""
        self.path, self._unsaved = path, version != self.version
        self.editor.saved()
        self._mark_changed(edited=False)

    async def keep_saving(self) -> None:
        """Save every change on this machine, forever."""
        while True:
            await self._edited.wait()
            await asyncio.sleep(_SAVE_DELAY_S)
            self._edited.clear()
            try:
                await asyncio.to_thread(self._file.write, SavedDraft(self.path, self.changed, self.data()))
            except FileError as error:
                self._report_error(f"the program is not saved on this machine: {error}")

    def _mark_changed(self, *, edited: bool = True) -> None:
        if edited:
            self.version += 1
        self._edited.set()
        self._on_change()

    def notify_pages(self) -> None:
        self._on_change()

    # edits

    def insert(self, kind: str, at: str) -> str:
        """Insert a new node into the selected one, after it, or as close as permitted; returns its id."""
        node = self._insert_near(at, partial(self.editor.insert, kind))
        self._mark_changed()
        return node

    def paste(self, at: str) -> str:
        """Paste the nodes copied last, like `insert`; returns the id of the first node."""
        clip = self._clip
        if clip is None:
            raise ValueError("nothing was copied yet: copy a node first")
        nodes = self._insert_near(at, partial(self.editor.paste, clip))
        self._mark_changed()
        return nodes[0]

    def _insert_near(self, at: str, insert: Callable[..., _Answer]) -> _Answer:
        """Try the possible places, from the selected node outwards."""
        first: EditError | None = None
        row = self.view.row(at)
        places = [{"into": at}] if row is not None and row.holds_nodes else []
        while row is not None:
            places.append({"after": row.id})
            row = self.view.row(row.parent)
        for place in places:
            try:
                return insert(**place)
            except EditError as error:
                first = first or error
        raise first or ValueError("this node is no longer in the program")

    def delete(self, node: str) -> None:
        self.editor.delete(node)
        self._mark_changed()

    def copy(self, node: str) -> None:
        """Copy a node for `paste`, in this program or the next; all browsers share the clipboard."""
        self._clip = self.editor.copy(node)

    def move_by(self, node: str, offset: int) -> None:
        """Move a node before its previous sibling (-1) or after its next one (1), or out of its parent."""
        row = self.view.row(node)
        if row is None:
            raise ValueError("this node is no longer in the program")
        siblings = [other.id for other in self.view.rows() if other.parent == row.parent]
        index = siblings.index(node) + offset
        anchor = siblings[index] if 0 <= index < len(siblings) else row.parent
        if offset < 0:
            self.editor.move(node, before=anchor)
        else:
            self.editor.move(node, after=anchor)
        self._mark_changed()

    def drop(self, node: str, at: str, place: str) -> None:
        """Move a node ``before`` or ``after`` another one, or ``onto`` it: into it if possible, else after it."""
        row = self.view.row(at)
        if row is None or not self.view.has(node):
            raise ValueError("this node is no longer in the program")
        if place == "onto":
            place = "into" if row.holds_nodes else "after"
        self.editor.move(node, **{place: at})
        self._mark_changed()

    def suppress(self, node: str) -> None:
        """Suppress a node, or no longer."""
        row = self.view.row(node)
        self.editor.suppress(node, on=row is None or not row.suppressed_itself)
        self._mark_changed()

    def set(self, node: str, key: str, value: Any) -> None:
        """Set a field. Raises ValueError if the value is invalid."""
        self.editor.set(node, key, value)
        self._mark_changed()

    def teach(self, node: str, key: str, joints: Sequence[float], pose: Sequence[float], tcp: Sequence[float]) -> None:
        """Teach the present position. joints [rad]; pose: of the TCP; tcp: flange to TCP [m, rad]."""
        self.editor.teach(node, joints, pose, tcp, start=key == _START_POSITION)
        self._mark_changed()

    @property
    def can_undo(self) -> bool:
        return bool(self.editor.can_undo)

    @property
    def can_redo(self) -> bool:
        return bool(self.editor.can_redo)

    def undo(self) -> None:
        """Undo the last edit of any user."""
        self.editor.undo()
        self._mark_changed()

    def redo(self) -> None:
        """Redo the edit that was undone last."""
        self.editor.redo()
        self._mark_changed()

    def toggle_breakpoint(self, node: str) -> None:
        self.view.number(node)
        self.view.breakpoints ^= {node}
        self._on_change()


class Selection:
    """The selected node of one browser; the robot program if that node was deleted."""

    def __init__(self, draft: ProgramDraft) -> None:
        self._draft = draft
        self._node = draft.view.first()

    @property
    def node(self) -> str:
        """The id of the selected node, which always exists."""
        if not self._draft.view.has(self._node):
            self._node = self._draft.view.first()
        return self._node

    def choose(self, node: str) -> None:
        if self._draft.view.has(node):
            self._node = node
            self._draft.notify_pages()
