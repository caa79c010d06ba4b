"""A program while it is made: nodes put in, moved, copied, left out, set and taught; undone and done again.

Nodes are named by ids that hold for the life of an editor, also while a node is deleted and comes back, so that several
people can edit the same program: who speaks of a node that is gone is told so. The tree is that of PolyScope's file,
and what is not touched stays as it was, byte for byte. An editor is for one thread.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from urproto.robots import RobotModel
from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import DocumentError, Element, link, make, write_document
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.forms import FieldError, Surroundings, check_name
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.nodes.moves import teach
from urscript.polyscope.program import write_steps
from urscript.polyscope.registry import NODES, Kind, kinds
from urscript.polyscope.saved_script import NO_SAVED_SCRIPT, SavedScript
from urscript.polyscope.transplant import Clip, clipped, planted
from urscript.polyscope.tree import ProgramTree, TreeError, tag_of
from urscript.polyscope.writer import ExternalControlCode, Writer
from urscript.work import run_to_end

ROOT: Final = "program"  # id of the program itself, in which threads and subprograms stand
_SUPPRESSED: Final = "SuppressedNode"
_INNER: Final = "suppressedNode"
_EMPTY: Final = "Placeholder"
_MOST_STEPS: Final = 10_000  # operations that can be undone; far more than a day's work
_NO_CODE: Final = ExternalControlCode("", "")


class EditError(ValueError):
    """What was asked for cannot be done. ``node``: id of the node; ``field``: key of its field, empty for none."""

    def __init__(self, message: str, node: str = "", field: str = "") -> None:
        super().__init__(message)
        self.node, self.field = node, field


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the tree. number: as PolyScope counts and the labels of scripts name it, from 1.

    title: as PolyScope shows it. kind: key of `urscript.polyscope.registry.kinds`, empty for a node of no known kind.
    parent: id of the node it stands in. suppressed: it is left out, by itself or with a node around it.
    defined: nothing is missing in it nor below; PolyScope shows the others yellow. problem: what is wrong with it.
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
    """Something wrong with a program. node: id of the node that has it, empty for the program."""

    node: str
    message: str


@dataclass(frozen=True, slots=True)
class _Spot:
    """A node where it stands. place: in the list of its holder; node: what is there, which a place may share;
    holder: the element whose children it is among. written: place of the node itself, within a suppression."""

    id: str
    place: Element
    written: Element
    node: Element
    holder: Element
    parent: "_Spot | None"
    depth: int
    suppressed: bool
    kind: Kind | None

    @property
    def title(self) -> str:
        if self.kind is None:
            return tag_of(self.written)
        return self.kind.shown(self.node) or self.kind.title


@dataclass(frozen=True, slots=True)
class _Operation:
    """Something that was done. steps: as in `urscript.polyscope.document.Changes`."""

    title: str
    steps: list[tuple[Element, str, Any, Any]]


@dataclass(frozen=True, slots=True)
class _Target:
    """Where nodes go: behind ``behind`` among the children of a node, or at the beginning (None)."""

    parent: Element
    parent_spot: _Spot | None
    behind: Element | None


class ProgramEditor:
    """A program that is edited. ``revision``: grows with everything that changes it, also when it is undone.

    root: of a ``.urp``. name: of the program, without extension. installation: what its nodes may name. version: of the
    PolyScope it is for. model: the arm that teaches. Raises TreeError or DocumentError for what is no program.
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
        self._ids: dict[int, str] = {id(self.root): ROOT}
        self._known: dict[str, Element] = {ROOT: self.root}  # keeps them alive, so that no identity is used twice
        self._done: list[_Operation] = []
        self._undone: list[_Operation] = []
        self._saved: _Operation | None = None
        self._spots: tuple[int, list[_Spot], dict[str, _Spot]] | None = None
        self._problems: tuple[int, list[Problem]] | None = None

    # what is there

    @property
    def installation(self) -> InstallationFile:
        """What the nodes may name; another one takes effect at once."""
        return self.program.installation

    @installation.setter
    def installation(self, installation: InstallationFile) -> None:
        self.program.installation = installation
        self.revision += 1

    @property
    def tree(self) -> ProgramTree:
        """The program as it is now, for the translation."""
        return ProgramTree(self.root, self.name, self.saved_script, self.folder)

    def document(self) -> bytes:
        """The XML of its file."""
        return write_document(self.root)

    def rows(self) -> list[Row]:
        """The tree line by line, as PolyScope shows it."""
        problems = {problem.node: problem.message for problem in reversed(self.problems())}
        spots = self._all()
        undefined = set[str]()
        for spot in reversed(spots):
            if not spot.suppressed and (spot.id in undefined or self._lacks(spot)):
                undefined.add(spot.id)
                if spot.parent is not None:
                    undefined.add(spot.parent.id)
        return [
            Row(
                id=spot.id,
                number=number,
                depth=spot.depth,
                title=spot.title,
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

    def problems(self) -> list[Problem]:
        """What keeps the program from being run: what nodes lack, and what cannot be translated, at its node."""
        if self._problems is None or self._problems[0] != self.revision:
            self._problems = (self.revision, self._find_problems())
        return self._problems[1]

    def _find_problems(self) -> list[Problem]:
        found = [
            Problem(spot.id, f"{spot.title} lacks {lack}")
            for spot in self._all()
            if not spot.suppressed and (lack := self._lacks(spot))
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
            node = self._ids.get(id(element.resolved()), "")
            if node not in seen:
                found.append(Problem(node, message))
        return found

    def written(self, external_control: ExternalControlCode | None = _NO_CODE) -> Writer:
        """The URScript, with the node that wrote each line. Raises TreeError for a program that cannot be run."""
        steps = write_steps(self.tree, self.installation, version=self.version, external_control=external_control)
        return run_to_end(steps)

    def node_of(self, element: Element) -> str:
        """Id of a node by its element, empty for what is none of the tree."""
        return self._ids.get(id(element.resolved()), "")

    def form(self, node: str) -> dict[str, Any]:
        """What can be set at a node, ready for JSON: id, kind, title, shown, fields. Raises EditError."""
        spot = self._spot(node)
        fields = [
            {**field.description(spot.node, self.program), "node": node}
            for field in (spot.kind.fields if spot.kind else ())
            if field.shown(spot.node)
        ]
        return {
            "id": node,
            "kind": spot.kind.key if spot.kind else "",
            "title": spot.kind.title if spot.kind else tag_of(spot.written),
            "shown": spot.title,
            "suppressed": spot.place is not spot.written,
            "revision": self.revision,
            "fields": fields,
        }

    def palette(self) -> list[dict[str, str]]:
        """The kinds of nodes that can be put in: key, title and group, in the order of the table."""
        return [
            {"key": kind.key, "title": kind.title, "group": kind.group}
            for kind in kinds().values()
            if kind.new is not None and kind.exists_in(self.version)
        ]

    # what can be done

    def insert(
        self,
        kind: str,
        *,
        into: str = "",
        before: str = "",
        after: str = "",
        values: dict[str, Any] | None = None,
    ) -> str:
        """Put in a new node at the end of one, before or after one; its id. values: of its fields, by their keys.

        What stands directly in a program (threads, subprograms, events) goes there whatever is named, and a waypoint
        outside a Move gets one around it. Raises EditError.
        """
        found = kinds().get(kind)
        if found is None or found.new is None:
            raise EditError(
                f"there is no node {kind!r} to put in; there are {', '.join(k['key'] for k in self.palette())}"
            )
        if not found.exists_in(self.version):
            raise EditError(f"PolyScope {self.version.short} has no {found.title} ({found.available})")
        with self._operation(f"Insert {found.title}"):
            element = found.new(self.program)
            self._put([element], self._target(into, before, after, found))
            node = self._id(element)
            self._forget()
            for key, value in (values or {}).items():
                self._set(node, key, value)
        return node

    def set(self, node: str, key: str, value: Any) -> None:
        """Set a field of a node. Raises EditError, which names node and field, for a value it cannot take."""
        self.set_all(node, {key: value})

    def set_all(self, node: str, values: dict[str, Any]) -> None:
        """Set several fields of a node, in this order, or none of them. Raises EditError."""
        with self._operation(f"Change {self._spot(node).title}"):
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
        """Give a waypoint the position where the arm is; all of its name get it, since they are one.

        joints [rad]; pose: TCP in the base frame, tcp: TCP in the flange frame [m, rad]. start: the position that a
        relative waypoint starts from. Raises EditError.
        """
        spot = self._spot(node)
        if spot.kind is None or spot.kind.key != "waypoint":
            raise EditError(f"{spot.title} is no waypoint, and cannot be taught", node)
        kind, name = spot.node.get("type"), spot.node.get("name")
        same = [
            other.node
            for other in self._all()
            if other.kind is spot.kind and other.node.get("name") == name and other.node.get("type") == kind
        ]
        with self._operation(f"Teach {spot.title}"):
            for element in same:
                try:
                    teach(element, self.program, joints, pose, tcp, start=start)
                except FieldError as error:
                    raise EditError(f"{spot.title}: {error}", node, "position") from None

    def rename(self, node: str, name: str) -> None:
        """Give a node another name; where its name is that of a variable, the variable, wherever it is used."""
        spot = self._spot(node)
        variable = spot.node.child("variable", "loopVariable")
        if spot.kind is not None and spot.kind.field("name") and not (variable and spot.kind.key == "waypoint"):
            self.set(node, "name", name)
        elif variable is not None and variable.get("name"):
            self.rename_variable(variable.get("name"), name)
        else:
            raise EditError(f"{spot.title} has no name", node)

    def rename_variable(self, old: str, new: str) -> None:
        """Give a variable of the program another name, everywhere. Raises EditError."""
        variable = self.program.variable_objects().get(old)
        if variable is None or old in self.installation.variables:
            raise EditError(f"there is no variable {old!r} in the program")
        try:
            check_name(new, "variable")
        except FieldError as error:
            raise EditError(str(error)) from None
        if new != old and new in self.program.variables():
            raise EditError(f"there is a variable called {new!r} already")
        with self._operation(f"Rename {old}"):
            for place in list(self.root.places()):
                element = place.resolved()
                if element.get("name") == old and element.child("initializeExpression", "expression") is not None:
                    self.program.set_attribute(element, "name", new)

    def delete(self, *nodes: str) -> None:
        """Take nodes out, an If with its branches. Raises EditError."""
        spots = self._whole(nodes)
        with self._operation(f"Delete {spots[0].title}"):
            for spot in spots:
                self._may_go(spot, "deleted")
                if spot.kind is not None and spot.kind.key == "variables_setup":
                    self._flag_variables("false")
                self._take_out(spot.place, spot.holder)
                self._no_calls_of(spot)

    def move(self, *nodes: str, into: str = "", before: str = "", after: str = "") -> None:
        """Put nodes elsewhere, an If with its branches, in the order in which they stand. Raises EditError."""
        spots = self._whole(nodes)
        for spot in spots:
            self._may_go(spot, "moved")
        moved = {id(spot.node) for spot in spots}
        anchor = self._spot(into or before or after) if (into or before or after) != ROOT else None
        around = anchor
        while around is not None:
            if id(around.node) in moved:
                raise EditError(f"{around.title} cannot be put beside or into itself", around.id)
            around = around.parent
        with self._operation(f"Move {spots[0].title}"):
            places = [spot.place for spot in spots]
            target = self._group_target(places, into, before, after)
            for spot in spots:
                self._take_out(spot.place, spot.holder, keep=target.parent)
            self._put(places, target)

    def copy(self, *nodes: str) -> Clip:
        """Nodes to be pasted, here or into another program. Raises EditError."""
        spots = self._whole(nodes)
        for spot in spots:
            self._may_go(spot, "copied")
        return clipped([spot.place for spot in spots])

    def paste(self, clip: Clip, *, into: str = "", before: str = "", after: str = "") -> list[str]:
        """Put in copies; their ids. What they name is what the program has under these names. Raises EditError."""
        with self._operation("Paste"):
            try:
                places = planted(clip, self.program)
            except FieldError as error:
                raise EditError(str(error)) from None
            self._put(places, self._group_target(places, into, before, after))
            return [self._id(_inner(place).resolved()) for place in places]

    def suppress(self, *nodes: str, on: bool = True) -> None:
        """Leave nodes out of the program without taking them away, an If with its branches; or not any more."""
        spots = self._whole(nodes)
        with self._operation(f"{'Suppress' if on else 'Unsuppress'} {spots[0].title}"):
            for spot in spots:
                if on and (spot.place is spot.written):
                    self._may_go(spot, "suppressed")
                    self._wrap(spot)
                elif not on and spot.place is not spot.written:
                    self._unwrap(spot)

    # undoing

    @property
    def can_undo(self) -> str:
        """What would be undone, in words; empty for nothing."""
        return self._done[-1].title if self._done else ""

    @property
    def can_redo(self) -> str:
        """What would be done again, in words; empty for nothing."""
        return self._undone[-1].title if self._undone else ""

    @property
    def modified(self) -> bool:
        """Whether it is another program than when it was last saved."""
        return (self._done[-1] if self._done else None) is not self._saved

    def saved(self) -> None:
        """It has been saved as it is now."""
        self._saved = self._done[-1] if self._done else None

    def undo(self) -> str:
        """Take back what was done last, exactly; what it was. Raises EditError when there is nothing."""
        if not self._done:
            raise EditError("there is nothing to undo")
        operation = self._done.pop()
        for element, slot, before, _ in reversed(operation.steps):
            setattr(element, slot, before)
        self._undone.append(operation)
        self._changed()
        return operation.title

    def redo(self) -> str:
        """Do again what was undone last; what it was. Raises EditError when there is nothing."""
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
        """All of it, or nothing."""
        changes = self.program.changes
        try:
            yield
        except BaseException:
            changes.undo()
            self._forget()
            raise
        steps, changes.steps = changes.steps, []
        self._forget()
        if steps:
            self._done.append(_Operation(title, steps))
            del self._done[:-_MOST_STEPS]
            self._undone.clear()
            self._changed()

    def _changed(self) -> None:
        self.revision += 1
        self._forget()

    # nodes and where they stand

    def _forget(self) -> None:
        """The tree is another one, or may be."""
        self._spots = None

    def _id(self, element: Element) -> str:
        element = element.resolved()
        found = self._ids.get(id(element))
        if found is None:
            found = self._ids[id(element)] = f"n{len(self._ids)}"
            self._known[found] = element
        return found

    def _kind(self, place: Element) -> Kind | None:
        found = NODES.get(tag_of(place))
        node = place.resolved()
        return next((kind for kind in found.kinds if kind.matches(node)), None) if found else None

    def _all(self) -> list[_Spot]:
        return self._index()[1]

    def _index(self) -> tuple[int, list[_Spot], dict[str, _Spot]]:
        if self._spots is None:
            spots = list(self._walk())
            self._spots = (self.revision, spots, {spot.id: spot for spot in spots})
        return self._spots

    def _walk(self) -> Iterator[_Spot]:
        """Every node in the order of the tree; a node that several places have stands at the first."""
        seen = set[int]()
        waiting = [(place, holder, None, 0, False) for place, holder in reversed(_children(self.root))]
        stack: list[tuple[Element, Element, _Spot | None, int, bool]] = list(waiting)
        while stack:
            place, holder, parent, depth, suppressed = stack.pop()
            written = _inner(place)
            node = written.resolved()
            if id(node) in seen:
                continue
            seen.add(id(node))
            left_out = suppressed or written is not place
            spot = _Spot(self._id(node), place, written, node, holder, parent, depth, left_out, self._kind(written))
            yield spot
            stack.extend((child, inner, spot, depth + 1, left_out) for child, inner in reversed(_children(node)))

    def _spot(self, node: str) -> _Spot:
        spot = self._index()[2].get(node)
        if spot is None:
            gone = self._known.get(node)
            if gone is self.root:
                raise EditError("that is the whole program; name a node of it", node)
            shown = f" ({tag_of(gone)})" if gone is not None else ""
            raise EditError(f"the node {node}{shown} is not in the program any more", node)
        return spot

    def _lacks(self, spot: _Spot) -> str:
        return spot.kind.undefined(spot.node) if spot.kind else ""

    def _whole(self, nodes: Iterable[str]) -> list[_Spot]:
        """The nodes in the order of the tree, without those that lie in others, an If with its branches."""
        wanted = {self._spot(node).id for node in nodes}
        if not wanted:
            raise EditError("name a node")
        for spot in self._all():
            if spot.id in wanted and spot.kind is not None and spot.kind.key == "if":
                wanted.update(other.id for other in self._branches(spot))
        found = []
        for spot in self._all():
            around = spot.parent
            while around is not None and around.id not in wanted:
                around = around.parent
            if spot.id in wanted and around is None:
                found.append(spot)
        return found

    def _branches(self, spot: _Spot) -> list[_Spot]:
        """The ElseIf and Else nodes that belong to an If."""
        beside = [other for other in self._all() if other.holder is spot.holder]
        found = []
        for other in beside[beside.index(spot) + 1 :]:
            if other.kind is None or other.kind.stands != "if":
                break
            found.append(other)
        return found

    # where nodes may go

    def _target(self, into: str, before: str, after: str, kind: Kind) -> _Target:
        """Where a node of a kind goes. Raises EditError where it may not stand."""
        if sum(map(bool, (into, before, after))) != 1 and kind.stands != "program":
            raise EditError("say where: into a node, before or after one")
        if kind.stands == "program":
            return self._in_program(before, after, kind)
        if into == ROOT:
            main = next(spot for spot in self._all() if spot.kind is not None and spot.kind.key == "robot_program")
            into = main.id
        anchor = self._spot(into or before or after)
        if kind.stands == "if":
            return self._behind_if(anchor, kind)
        if into:
            parent: _Spot | None = anchor
            behind = _last_place(anchor.node)
        else:
            parent, behind = anchor.parent, self._neighbour(anchor, first=bool(before))
        if parent is None:
            raise EditError(f"a {kind.title} does not stand beside {anchor.title}; put it into one of these", anchor.id)
        self._may_hold(parent, kind)
        if kind.key == "default_case" and any(s.kind is kind and s.parent == parent for s in self._all()):
            raise EditError(f"{parent.title} has a default case already", parent.id)
        return _Target(parent.node, parent, behind)

    def _group_target(self, places: list[Element], into: str, before: str, after: str) -> _Target:
        """Where several nodes go together. Raises EditError where one of them may not stand."""
        target = None
        chain = False
        for place in places:
            kind = self._kind(_inner(place))
            if kind is None:
                raise EditError(f"<{tag_of(_inner(place))}> is not known, and stays where it is")
            if not (chain and kind.stands == "if"):
                found = self._target(into, before, after, kind)
                if target is not None and target.parent is not found.parent:
                    raise EditError("these nodes do not stand in the same place; take them one by one")
                target = target or found
            chain = kind.key == "if" or (chain and kind.key == "elseif")
        if target is None:
            raise EditError("there is nothing to put there")
        return target

    def _neighbour(self, anchor: _Spot, *, first: bool) -> Element | None:
        """The place behind which something goes that shall stand before or after a node: not between branches."""
        beside = [spot for spot in self._all() if spot.holder is anchor.holder]
        at = beside.index(anchor)
        if first:
            while beside[at].kind is not None and beside[at].kind.stands == "if" and at:  # type: ignore[union-attr]
                at -= 1
            return beside[at - 1].place if at else None
        while at + 1 < len(beside) and (behind := beside[at + 1].kind) is not None and behind.stands == "if":
            at += 1
        return beside[at].place

    def _in_program(self, before: str, after: str, kind: Kind) -> _Target:
        """In the program itself: the nodes that come first in their order, the others at the end or where asked."""
        top = [spot for spot in self._all() if spot.parent is None]
        keys = [spot.kind.key if spot.kind else "" for spot in top]
        once = ("variables_setup", "before_start", "robot_program")
        if kind.key in once:
            if kind.key in keys:
                raise EditError(f"the program has its {kind.title} already")
            earlier = [spot.place for spot, key in zip(top, keys, strict=True) if key in once[: once.index(kind.key)]]
            return _Target(self.root, None, earlier[-1] if earlier else None)
        anchor = self._spot(before or after) if before or after else None
        while anchor is not None and anchor.parent is not None:
            anchor = anchor.parent
        if anchor is None or (anchor.kind is not None and anchor.kind.key in once):
            return _Target(self.root, None, top[-1].place)
        return _Target(self.root, None, self._neighbour(anchor, first=bool(before)))

    def _behind_if(self, anchor: _Spot, kind: Kind) -> _Target:
        """Behind an If, or one of its branches."""
        if anchor.kind is None or anchor.kind.key not in ("if", "elseif", "else"):
            raise EditError(f"an {kind.title} stands behind an If, not at {anchor.title}", anchor.id)
        chain = [anchor, *self._branches(anchor)]
        if any(spot.kind is not None and spot.kind.key == "else" for spot in chain):
            if kind.key == "else":
                raise EditError("the If has its Else already", anchor.id)
            chain = chain[:-1]
            if not chain:
                raise EditError("an ElseIf stands before the Else", anchor.id)
        at = chain[-1] if kind.key == "else" or anchor.kind.key == "if" else anchor
        return _Target(anchor.parent.node if anchor.parent else self.root, anchor.parent, at.place)

    def _may_hold(self, parent: _Spot, kind: Kind) -> None:
        """Raises EditError where a node of a kind may not stand in another."""
        holds = parent.kind.contains if parent.kind else ""
        if parent.kind is not None and parent.kind.key == "until" and parent.node.get("allowActions") != "true":
            raise EditError(f"{parent.title} has no actions; allow them first", parent.id, "actions")
        if kind.stands in ("switch", "direction"):
            if holds != kind.stands:
                where = "Switch" if kind.stands == "switch" else "Direction"
                raise EditError(f"a {kind.title} stands in a {where}, not in {parent.title}", parent.id)
        elif holds != "nodes":
            what = {"switch": "only cases", "direction": "only Untils", "circle": "its two waypoints"}.get(holds)
            raise EditError(f"{parent.title} holds {what or 'no nodes'}", parent.id)

    def _in_move(self, spot: _Spot | None) -> bool:
        while spot is not None:
            if spot.node.get("motionType"):
                return True
            spot = spot.parent
        return False

    def _may_go(self, spot: _Spot, how: str) -> None:
        key = spot.kind.key if spot.kind else ""
        if key in ("robot_program", "empty") or (key == "variables_setup" and how != "deleted"):
            raise EditError(f"{spot.title} cannot be {how}", spot.id)
        if how == "copied" and key == "before_start":
            raise EditError(f"{spot.title} cannot be {how}: a program has one", spot.id)
        if how != "copied" and spot.parent is not None and spot.parent.kind and spot.parent.kind.contains == "circle":
            raise EditError(f"{spot.title} cannot be {how}: the CircleMove around it needs two waypoints", spot.id)

    # changing

    def _set(self, node: str, key: str, value: Any) -> None:
        spot = self._spot(node)
        field = spot.kind.field(key) if spot.kind else None
        if field is None or not field.shown(spot.node):
            shown = [f.key for f in spot.kind.fields if f.shown(spot.node)] if spot.kind else []
            what = f"; it has {', '.join(shown)}" if shown else ""
            raise EditError(f"{spot.title} has no field {key!r}{what}", node, key)
        try:
            field.set(spot.node, value, self.program)
        except (FieldError, DocumentError) as error:
            raise EditError(f"{spot.title}, {field.title}: {error}", node, key) from None

    def _put(self, places: list[Element], target: _Target) -> None:
        """Put places among the children of a node, in a Move of their own if they need one and none is there."""
        loose = [place for place in places if (kind := self._kind(_inner(place))) and kind.stands == "move"]
        if loose and not self._in_move(target.parent_spot):
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
            if (kind := self._kind(_inner(place))) is not None and kind.key == "variables_setup":
                self._flag_variables("true")

    def _adopt(self, place: Element, holder: Element) -> None:
        self.program.changes.put(place, "parent", holder)

    def _holder(self, node: Element) -> Element:
        """The element that holds the nodes in a node."""
        holder = node.child("children")
        if holder is None:
            self.program.set_child(node, "children", make("children"))
            holder = node.child("children")
        assert holder is not None
        return holder

    def _take_out(self, place: Element, holder: Element, keep: Element | None = None) -> None:
        """Take a place out, and leave an empty line where nothing else is. keep: a node that will not stay empty."""
        children = [child for child in holder.children if child is not place]
        stays_empty = holder.parent is not None and holder.parent.resolved() is keep
        if not children and holder.parent is not None and not stays_empty and self._wants_empty_line(holder):
            empty = make(_EMPTY)
            empty.parent = holder
            children = [empty]
        self.program.changes.put(holder, "children", children)

    def _wants_empty_line(self, holder: Element) -> bool:
        return holder.parent is not None and tag_of(holder.parent) not in ("Switch",)

    def _wrap(self, spot: _Spot) -> None:
        changes, place = self.program.changes, spot.place
        wrapper = make(_SUPPRESSED)
        wrapper.parent = spot.holder
        children = [wrapper if child is place else child for child in spot.holder.children]
        changes.put(place, "attributes", {"class": place.tag, **place.attributes})
        changes.put(place, "tag", _INNER)
        self._adopt(place, wrapper)
        wrapper.children = [place]
        changes.put(spot.holder, "children", children)

    def _unwrap(self, spot: _Spot) -> None:
        changes, place = self.program.changes, spot.written
        children = [place if child is spot.place else child for child in spot.holder.children]
        changes.put(place, "tag", place.attributes["class"])
        changes.put(place, "attributes", {n: value for n, value in place.attributes.items() if n != "class"})
        self._adopt(place, spot.holder)
        changes.put(spot.holder, "children", children)

    def _flag_variables(self, value: str) -> None:
        """The robot program says whether the variables are set up."""
        main = next((spot for spot in self._all() if tag_of(spot.written) == "MainProgram"), None)
        if main is not None and main.node.get("InitVariablesNode"):
            self.program.set_attribute(main.node, "InitVariablesNode", value)

    def _no_calls_of(self, spot: _Spot) -> None:
        """A Call of a subprogram that is deleted calls nothing any more (guess: PolyScope shows it yellow)."""
        if spot.kind is None or spot.kind.key != "subprogram":
            return
        for place in list(self.root.places()):
            if tag_of(place) == "CallSubProgram":
                called = place.child("subprogram")
                if called is not None and called is spot.node:
                    self.program.set_child(place, "subprogram", None)


def _inner(place: Element) -> Element:
    """The place of the node itself, which is within the suppression of one that is suppressed."""
    if place.tag != _SUPPRESSED:
        return place
    return next((child for child in place.resolved().children if child.tag == _INNER), place)


def _children(node: Element) -> list[tuple[Element, Element]]:
    """The places in a node, with the element whose children they are."""
    holder = node.child("children")
    return [(place, holder) for place in holder.children] if holder is not None else []


def _last_place(node: Element) -> Element | None:
    found = _children(node)
    return found[-1][0] if found else None
