"""Edit a program: insert, move, copy, suppress, set and teach nodes, with undo and redo.

Nodes have ids that stay valid for the lifetime of an editor, even while a node is deleted and restored. Several people
can therefore edit the same program: an operation on a node that is gone is refused. The tree is that of PolyScope's
file, and unmodified parts stay the same byte for byte. An editor must be used from one thread only.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from urproto.robots import RobotModel
from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import DocumentError, Element, link, make, write_document
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.nodes.waypoints import teach
from urscript.polyscope.places import INNER, ROOT, SUPPRESSED, EditError, Places, Spot, Target, node_place
from urscript.polyscope.program import write_steps
from urscript.polyscope.registry import kind_of, kinds
from urscript.polyscope.saved_script import NO_SAVED_SCRIPT, SavedScript
from urscript.polyscope.surroundings import FieldError, Surroundings, check_name
from urscript.polyscope.transplant import Clip, clipped, planted
from urscript.polyscope.tree import ProgramTree, TreeError, tag_of
from urscript.polyscope.writer import ExternalControlCode, Writer
from urscript.work import run_to_end

_EMPTY: Final = "Placeholder"
_MAX_STEPS: Final = 10_000  # operations that can be undone; far more than a day's work
_NO_CODE: Final = ExternalControlCode("", "")


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the tree.

    number: as counted by PolyScope and used in the labels of scripts, from 1. title: as PolyScope shows it.
    kind: key of `urscript.polyscope.registry.kinds`, empty for an unknown kind. parent: id of the node that contains
    it. suppressed: it, or a node that contains it, is suppressed. defined: the node and all nodes below are complete;
    PolyScope shows others in yellow. problem: what is wrong with it.
    """

    id: str
    number: int
    depth: int
    title: str
    kind: str
    parent: str
    suppressed: bool
    suppressed_itself: bool
    holds_nodes: bool
    defined: bool
    problem: str


@dataclass(frozen=True, slots=True)
class Problem:
    """A problem of a program. node: id of the node at fault, empty for the program itself."""

    node: str
    message: str


@dataclass(frozen=True, slots=True)
class _Operation:
    """An operation that was carried out. steps: as in `urscript.polyscope.document.Changes`."""

    title: str
    steps: list[tuple[Element, str, Any, Any]]


class ProgramEditor:
    """A program that is being edited. ``revision`` increases with every change, including undo and redo.

    root: of a ``.urp``. name: of the program, without extension. installation: provides the names that nodes may use.
    version: of the PolyScope it is for. model: the arm used for teaching. Raises TreeError or DocumentError for a
    document that is not a program.
    """

    def __init__(
        self,
        root: Element,
        name: str,
        installation: InstallationFile,
        version: PolyscopeVersion,
        model: RobotModel | None = None,
        *,
        saved_script: SavedScript = NO_SAVED_SCRIPT,
        folder: ProgramsFolder | None = None,
    ) -> None:
        ProgramTree(root, name)
        self.root, self.name, self.version = link(root), name, version
        self.saved_script, self.folder = saved_script, folder
        self.program = Surroundings(self.root, installation, version, model, folder)
        self.revision = 0
        self._places = Places(self.root)
        self._done: list[_Operation] = []
        self._undone: list[_Operation] = []
        self._saved: _Operation | None = None
        self._problems: tuple[int, list[Problem]] | None = None

    # reading

    @property
    def installation(self) -> InstallationFile:
        """The installation with the names that nodes may use; a new one takes effect immediately."""
        return self.program.installation

    @installation.setter
    def installation(self, installation: InstallationFile) -> None:
        self.program.installation = installation
        self.revision += 1

    @property
    def tree(self) -> ProgramTree:
        """The current program, for translation to URScript."""
        return ProgramTree(self.root, self.name, self.saved_script, self.folder)

    def name_program(self, name: str) -> None:
        """Name the program, here and in its file; this is not an edit."""
        self.name = self.root.attributes["name"] = name

    def document(self) -> bytes:
        """The XML of its file."""
        return write_document(self.root)

    def rows(self) -> list[Row]:
        """The lines of the tree as PolyScope shows them."""
        problems = {problem.node: problem.message for problem in reversed(self.problems())}
        spots = self._places.all()
        undefined = set[str]()
        for spot in reversed(spots):
            if not spot.suppressed and (spot.id in undefined or spot.lacks):
                undefined.add(spot.id)
                if spot.parent is not None:
                    undefined.add(spot.parent.id)
        return [
            Row(
                id=spot.id,
                number=number,
                depth=spot.depth,
                title=self._title(spot),
                kind=spot.kind.key if spot.kind else "",
                parent=spot.parent.id if spot.parent else ROOT,
                suppressed=spot.suppressed,
                suppressed_itself=spot.place is not spot.written,
                holds_nodes=bool(spot.kind and spot.kind.contains),
                defined=spot.id not in undefined,
                problem=problems.get(spot.id, ""),
            )
            for number, spot in enumerate(spots, 1)
        ]

    def _title(self, spot: Spot) -> str:
        by_installation = spot.kind.shown_by if spot.kind else None
        return by_installation(self.installation) if by_installation else spot.title

    def problems(self) -> list[Problem]:
        """The problems that prevent the program from running: incomplete nodes, and nodes that cannot be translated."""
        if self._problems is None or self._problems[0] != self.revision:
            self._problems = (self.revision, self._find_problems())
        return self._problems[1]

    def _find_problems(self) -> list[Problem]:
        found = [
            Problem(spot.id, f"{spot.title} lacks {lack}")
            for spot in self._places.all()
            if not spot.suppressed and (lack := spot.lacks)
        ]
        seen = {problem.node for problem in found}
        wrong: list[tuple[Element, str]] = []
        try:
            run_to_end(
                write_steps(
                    self.tree,
                    self.installation,
                    version=self.version,
                    external_control=_NO_CODE,
                    problems=wrong,
                )
            )
        except (TreeError, DocumentError) as error:
            found.append(Problem("", str(error)))
        for element, message in wrong:
            node = self._places.known(element)
            if node not in seen:
                found.append(Problem(node, message))
        return found

    def written(self, external_control: ExternalControlCode | None = _NO_CODE) -> Writer:
        """The URScript, with the node that wrote each line. Raises TreeError for a program that cannot be run."""
        steps = write_steps(self.tree, self.installation, version=self.version, external_control=external_control)
        return run_to_end(steps)

    def node_of(self, element: Element) -> str:
        """Id of a node by its element; empty for an element that is not a node of the tree."""
        return self._places.known(element)

    def form(self, node: str) -> dict[str, Any]:
        """The settings of a node, ready for JSON: id, kind, title, shown, fields. Raises EditError."""
        spot = self._places.spot(node)
        fields = [
            {**field.description(spot.node, self.program), "node": node}
            for field in (spot.kind.fields if spot.kind else ())
            if field.shown(spot.node)
        ]
        return {
            "id": node,
            "kind": spot.kind.key if spot.kind else "",
            "title": spot.kind.title if spot.kind else tag_of(spot.written),
            "shown": self._title(spot),
            "suppressed": spot.place is not spot.written,
            "revision": self.revision,
            "fields": fields,
        }

    def palette(self) -> list[dict[str, str]]:
        """The kinds of nodes that can be inserted: key, title and group, in the order of the table."""
        return [
            {"key": kind.key, "title": kind.title, "group": kind.group}
            for kind in kinds().values()
            if kind.new is not None and kind.exists_in(self.version)
        ]

    # operations

    def insert(
        self,
        kind: str,
        *,
        into: str = "",
        before: str = "",
        after: str = "",
        values: dict[str, Any] | None = None,
    ) -> str:
        """Insert a new node at the end of another one, or before or after it; returns its id.

        values: of its fields, by their keys. Nodes at the top level of a program (threads, subprograms, events) go
        there whatever place is named, and a waypoint outside a Move gets a Move around it. Raises EditError.
        """
        found = kinds().get(kind)
        if found is None or found.new is None:
            raise EditError(
                f"there is no node {kind!r} to insert: choose one of {', '.join(k['key'] for k in self.palette())}"
            )
        if not found.exists_in(self.version):
            raise EditError(f"{found.title} is not available in PolyScope {self.version.short} ({found.available})")
        with self._operation(f"Insert {found.title}"):
            element = found.new(self.program)
            self._put([element], self._places.target(into, before, after, found))
            node = self._places.id_of(element)
            self._places.invalidate()
            for key, value in (values or {}).items():
                self._set(node, key, value)
        return node

    def set(self, node: str, key: str, value: Any) -> None:
        """Set a field of a node. Raises EditError, with the node and the field, for an invalid value."""
        self.set_all(node, {key: value})

    def set_all(self, node: str, values: dict[str, Any]) -> None:
        """Set several fields of a node, in this order, or none of them. Raises EditError."""
        with self._operation(f"Change {self._places.spot(node).title}"):
            for key, value in values.items():
                self._set(node, key, value)

    def teach(
        self,
        node: str,
        joints: Sequence[float],
        pose: Sequence[float],
        tcp: Sequence[float],
        *,
        start: bool = False,
    ) -> None:
        """Set a waypoint, and all waypoints of the same name, to the current position of the arm.

        joints [rad]; pose: TCP in the base frame; tcp: TCP in the flange frame [m, rad]. start: set the position from
        which a relative waypoint starts. Raises EditError.
        """
        spot = self._places.spot(node)
        if spot.kind is None or spot.kind.key != "waypoint":
            raise EditError(f"{spot.title} is not a waypoint and cannot be taught", node)
        kind, name = spot.node.get("type"), spot.node.get("name")
        same = [
            other.node
            for other in self._places.all()
            if other.kind is spot.kind and other.node.get("name") == name and other.node.get("type") == kind
        ]
        with self._operation(f"Teach {spot.title}"):
            for element in same:
                try:
                    teach(element, self.program, joints, pose, tcp, start=start)
                except FieldError as error:
                    raise EditError(f"{spot.title}: {error}", node, "position") from None

    def rename(self, node: str, name: str) -> None:
        """Rename a node. If its name is that of a variable, the variable is renamed everywhere."""
        spot = self._places.spot(node)
        variable = spot.node.child("variable", "loopVariable")
        if spot.kind is not None and spot.kind.field("name") and not (variable and spot.kind.key == "waypoint"):
            self.set(node, "name", name)
        elif variable is not None and variable.get("name"):
            self.rename_variable(variable.get("name"), name)
        else:
            raise EditError(f"{spot.title} has no name", node)

    def rename_variable(self, old: str, new: str) -> None:
        """Rename a variable of the program everywhere. Raises EditError."""
        variable = self.program.variable_objects().get(old)
        if variable is None or old in self.installation.variables:
            raise EditError(f"there is no variable {old!r} in the program")
        try:
            check_name(new, "variable")
        except FieldError as error:
            raise EditError(str(error)) from None
        if new != old and new in self.program.variables():
            raise EditError(f"there is already a variable called {new!r}")
        with self._operation(f"Rename {old}"):
            for place in list(self.root.places()):
                element = place.resolved()
                if element.get("name") == old and element.child("initializeExpression", "expression") is not None:
                    self.program.set_attribute(element, "name", new)

    def delete(self, *nodes: str) -> None:
        """Delete nodes; an If is deleted with its branches. Raises EditError."""
        spots = self._places.whole(nodes)
        with self._operation(f"Delete {spots[0].title}"):
            for spot in spots:
                self._places.may_go(spot, "deleted")
                if spot.kind is not None and spot.kind.key == "variables_setup":
                    self._flag_variables("false")
                self._take_out(spot.place, spot.holder)
                self._no_calls_of(spot)

    def move(self, *nodes: str, into: str = "", before: str = "", after: str = "") -> None:
        """Move nodes, keeping their order; an If is moved with its branches. Raises EditError."""
        spots = self._places.whole(nodes)
        for spot in spots:
            self._places.may_go(spot, "moved")
        moved = {id(spot.node) for spot in spots}
        anchor = self._places.spot(into or before or after) if (into or before or after) != ROOT else None
        around = anchor
        while around is not None:
            if id(around.node) in moved:
                raise EditError(f"{around.title} cannot be moved into or next to itself", around.id)
            around = around.parent
        with self._operation(f"Move {spots[0].title}"):
            places = [spot.place for spot in spots]
            target = self._places.group_target(places, into, before, after)
            for spot in spots:
                self._take_out(spot.place, spot.holder, keep=target.parent)
            self._put(places, target)

    def copy(self, *nodes: str) -> Clip:
        """Copy nodes, to paste them here or into another program. Raises EditError."""
        spots = self._places.whole(nodes)
        for spot in spots:
            self._places.may_go(spot, "copied")
        return clipped([spot.place for spot in spots])

    def paste(self, clip: Clip, *, into: str = "", before: str = "", after: str = "") -> list[str]:
        """Insert copies; returns their ids. Names in them refer to the objects of this program. Raises EditError."""
        with self._operation("Paste"):
            try:
                places = planted(clip, self.program)
            except FieldError as error:
                raise EditError(str(error)) from None
            self._put(places, self._places.group_target(places, into, before, after))
            return [self._places.id_of(node_place(place).resolved()) for place in places]

    def suppress(self, *nodes: str, on: bool = True) -> None:
        """Suppress nodes, or no longer (``on=False``); an If is suppressed with its branches."""
        spots = self._places.whole(nodes)
        with self._operation(f"{'Suppress' if on else 'Unsuppress'} {spots[0].title}"):
            for spot in spots:
                if on and (spot.place is spot.written):
                    self._places.may_go(spot, "suppressed")
                    self._wrap(spot)
                elif not on and spot.place is not spot.written:
                    self._unwrap(spot)

    # undoing

    @property
    def can_undo(self) -> str:
        """The title of the operation that `undo` would undo; empty for none."""
        return self._done[-1].title if self._done else ""

    @property
    def can_redo(self) -> str:
        """The title of the operation that `redo` would redo; empty for none."""
        return self._undone[-1].title if self._undone else ""

    @property
    def modified(self) -> bool:
        """Whether the program differs from its last saved state."""
        return (self._done[-1] if self._done else None) is not self._saved

    def saved(self) -> None:
        """Mark the current state as saved."""
        self._saved = self._done[-1] if self._done else None

    def undo(self) -> str:
        """Undo the last operation exactly; returns its title. Raises EditError when there is none."""
        if not self._done:
            raise EditError("there is nothing to undo")
        operation = self._done.pop()
        for element, slot, before, _ in reversed(operation.steps):
            setattr(element, slot, before)
        self._undone.append(operation)
        self._changed()
        return operation.title

    def redo(self) -> str:
        """Redo the operation undone last; returns its title. Raises EditError when there is none."""
        if not self._undone:
            raise EditError("there is nothing to redo")
        operation = self._undone.pop()
        for element, slot, _, value in operation.steps:
            setattr(element, slot, value)
        self._done.append(operation)
        self._changed()
        return operation.title

    @contextmanager
    def _operation(self, title: str) -> Iterator[None]:
        """Carry out the changes in the context completely, or undo them on an error."""
        changes = self.program.changes
        try:
            yield
        except BaseException:
            changes.undo()
            self._places.invalidate()
            raise
        steps, changes.steps = changes.steps, []
        self._places.invalidate()
        if steps:
            self._done.append(_Operation(title, steps))
            if len(self._done) > _MAX_STEPS:
                oldest = self._done.pop(0)
                self._saved = self._saved or oldest  # the program as opened can no longer be restored
            self._undone.clear()
            self._changed()

    def _changed(self) -> None:
        self.revision += 1
        self._places.invalidate()

    def _set(self, node: str, key: str, value: Any) -> None:
        spot = self._places.spot(node)
        field = spot.kind.field(key) if spot.kind else None
        if field is None or not field.shown(spot.node):
            shown = [f.key for f in spot.kind.fields if f.shown(spot.node)] if spot.kind else []
            what = f"; it has {', '.join(shown)}" if shown else ""
            raise EditError(f"{spot.title} has no field {key!r}{what}", node, key)
        try:
            field.set(spot.node, value, self.program)
        except (FieldError, DocumentError) as error:
            raise EditError(f"{spot.title}, {field.title}: {error}", node, key) from None

    def _put(self, places: list[Element], target: Target) -> None:
        """Insert places among the children of a node, inside a new Move if they need one."""
        loose = [place for place in places if (kind := kind_of(node_place(place))) and kind.stands == "move"]
        if loose and not self._places.in_move(target.parent_spot):
            move = kinds()["move"].new
            assert move is not None
            around = move(self.program)
            inner = around.child("children")
            assert inner is not None
            inner.children = []
            for place in loose:
                self._adopt(place, inner)
            inner.children = loose
            at = places.index(loose[0])
            places = [place for place in places if place not in loose]
            places.insert(at, around)
        holder = self._holder(target.parent)
        children = [child for child in holder.children if child.tag != _EMPTY or child is target.behind]
        at = children.index(target.behind) + 1 if target.behind is not None and target.behind in children else 0
        for place in places:
            self._adopt(place, holder)
        children[at:at] = places
        self.program.changes.put(holder, "children", [child for child in children if child.tag != _EMPTY] or children)
        for place in places:
            if (kind := kind_of(node_place(place))) is not None and kind.key == "variables_setup":
                self._flag_variables("true")

    def _adopt(self, place: Element, holder: Element) -> None:
        self.program.changes.put(place, "parent", holder)

    def _holder(self, node: Element) -> Element:
        """The element that contains a node's child nodes."""
        holder = node.child("children")
        if holder is None:
            self.program.set_child(node, "children", make("children"))
            holder = node.child("children")
        assert holder is not None
        return holder

    def _take_out(self, place: Element, holder: Element, keep: Element | None = None) -> None:
        """Remove a place; leaves an empty line if nothing else remains. keep: a node that will not stay empty."""
        children = [child for child in holder.children if child is not place]
        stays_empty = holder.parent is not None and holder.parent.resolved() is keep
        if not children and holder.parent is not None and not stays_empty and tag_of(holder.parent) != "Switch":
            empty = make(_EMPTY)
            empty.parent = holder
            children = [empty]
        self.program.changes.put(holder, "children", children)

    def _wrap(self, spot: Spot) -> None:
        changes, place = self.program.changes, spot.place
        wrapper = make(SUPPRESSED)
        wrapper.parent = spot.holder
        children = [wrapper if child is place else child for child in spot.holder.children]
        changes.put(place, "attributes", {"class": place.tag, **place.attributes})
        changes.put(place, "tag", INNER)
        self._adopt(place, wrapper)
        wrapper.children = [place]
        changes.put(spot.holder, "children", children)

    def _unwrap(self, spot: Spot) -> None:
        changes, place = self.program.changes, spot.written
        children = [place if child is spot.place else child for child in spot.holder.children]
        changes.put(place, "tag", place.attributes["class"])
        changes.put(place, "attributes", {n: value for n, value in place.attributes.items() if n != "class"})
        self._adopt(place, spot.holder)
        changes.put(spot.holder, "children", children)

    def _flag_variables(self, value: str) -> None:
        """Set the flag of the robot program that says whether variables are initialized."""
        main = next((spot for spot in self._places.all() if tag_of(spot.written) == "MainProgram"), None)
        if main is not None and main.node.get("InitVariablesNode"):
            self.program.set_attribute(main.node, "InitVariablesNode", value)

    def _no_calls_of(self, spot: Spot) -> None:
        """Clear the Calls of a subprogram that is deleted (guess: PolyScope shows them in yellow)."""
        if spot.kind is None or spot.kind.key != "subprogram":
            return
        for place in list(self.root.places()):
            if tag_of(place) == "CallSubProgram":
                called = place.child("subprogram")
                if called is not None and called is spot.node:
                    self.program.set_child(place, "subprogram", None)
