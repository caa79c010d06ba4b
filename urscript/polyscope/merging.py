"""Merge two versions of a file that come from the same earlier one, by nodes and settings.

The result is always a file that PolyScope can open. What both versions changed differently is a conflict: the result
has ours, and a program also has theirs, as a suppressed node between comments or in the text of a comment, so that it
runs as ours until someone decides.

A program is merged into the document of ours, in steps: names mean the same in both; nodes that only theirs has get an
empty shell, so that everything can refer to them, and then their contents; they find their places among ours; what
theirs deleted goes; the contents of nodes that both have are merged, attribute by attribute.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from urscript.polyscope.comparing import Matches, match_lines, moved_lines
from urscript.polyscope.document import (
    Changes,
    DocumentError,
    Element,
    link,
    make,
    packed,
    read_document,
    write_document,
)
from urscript.polyscope.lines import Line, object_key, program_lines, read_lines
from urscript.polyscope.merging_values import ElementMerge, merge_json, merge_properties
from urscript.polyscope.nodes.waypoints import TAUGHT
from urscript.polyscope.places import INNER, SUPPRESSED
from urscript.polyscope.surroundings import ORDERS
from urscript.polyscope.transplant import clipped

_GZIP: Final = b"\x1f\x8b"
_EMPTY: Final = "Placeholder"
_HOLDER: Final = "children"
_LONGEST: Final = 400  # characters of a comment; guess: PolyScope shows them in one line


@dataclass(frozen=True, slots=True)
class Merged:
    """The merged file, and a line for each conflict."""

    data: bytes
    conflicts: list[str]


def merge_files(base: bytes, ours: bytes, theirs: bytes) -> Merged:
    """Merge the contents of files. Raises DocumentError, TreeError or UrpxError if one of them cannot be read."""
    if theirs in (base, ours):
        return Merged(ours, [])
    if ours == base:
        return Merged(theirs, [])
    if not base:
        raise DocumentError("both versions have a new file of this name: keep one of them")
    kinds = {read_lines(version).kind for version in (base, ours, theirs)}
    if len(kinds) > 1:
        raise DocumentError(f"the versions are of different kinds: {', '.join(sorted(kinds))}")
    if kinds == {"urpx"} or not any(version.lstrip().startswith((_GZIP, b"<")) for version in (base, ours, theirs)):
        data, conflicts = (merge_json if kinds == {"urpx"} else merge_properties)(base, ours, theirs)
        read_lines(data)
        return Merged(data, conflicts)
    roots = [link(read_document(version)) for version in (base, ours, theirs)]
    conflicts = _ProgramMerge(*roots).run() if kinds == {"program"} else ElementMerge().run(*roots)
    xml = write_document(roots[1])
    read_lines(xml)  # a file that cannot be read is none
    return Merged(packed(xml) if ours.startswith(_GZIP) else xml, conflicts)


# programs


@dataclass(slots=True)
class _Note:
    """Comments around a node. theirs: a suppressed copy of their version of it, if there is one."""

    text: str
    theirs: Element | None = None


@dataclass(slots=True)
class _Version:
    """A version of a program, and the lines of the base that it still has.

    matches: from the base, none for the base itself. back: the base of a line. moved: lines of the base.
    """

    root: Element
    top: Line
    matches: Matches
    back: dict[Line, Line] = field(init=False)
    moved: set[Line] = field(init=False)

    def __post_init__(self) -> None:
        self.back = {new: old for old, new in self.matches.items()}
        self.moved = moved_lines(self.matches)

    @classmethod
    def of(cls, root: Element, base: "_Version | None" = None) -> "_Version":
        top = program_lines(root)
        return cls(root, top, match_lines(base.top, top) if base is not None else {})

    def lines(self, kind: str = "") -> Iterator[Line]:
        """All lines, or those of a kind."""
        return (line for _, line in self.top.walk() if kind in ("", line.kind))

    def node(self, line: Line) -> Element:
        """The element of a line of this version."""
        return line.spot.node if line.spot is not None else self.root

    def changed(self, line: Line) -> bool:
        """Whether a line or one below it differs from the base."""
        return any(self._differs(each) for _, each in line.walk())

    def _differs(self, line: Line) -> bool:
        old = self.back.get(line)
        below = [self.matches.get(child) for child in old.children] if old else []
        return old is None or old in self.moved or _own(old) != _own(line) or below != line.children


def _own(line: Line) -> Any:
    return line.kind, line.content


class _ProgramMerge:
    """A merge into the document of ours.

    A merged node is known by its line in ours or, if only theirs has it, by its line in theirs. Its element is that of
    ours, or else a copy, which begins as an empty shell. The merged tree is in ``_below`` and ``_above``.
    """

    def __init__(self, base: Element, ours: Element, theirs: Element) -> None:
        self._base = _Version.of(base)
        self._ours, self._theirs = _Version.of(ours, self._base), _Version.of(theirs, self._base)
        self._conflicts: list[str] = []
        self._notes: dict[Line, _Note] = {}
        self._below: dict[Line, list[Line]] = {line: list(line.children) for line in self._ours.lines()}
        self._above: dict[Line, Line] = {child: line for line in self._below for child in line.children}
        self._places = {line: line.spot.place for line in self._ours.lines() if line.spot is not None}
        self._new: dict[Line, None] = {}  # lines of theirs that are inserted, in their order
        self._introduced = set[str]()  # variables that are new in both versions
        self._same: dict[Line, Line] = {}  # lines that both versions inserted: those of theirs, and ours
        self._copies: dict[int, Element] = {id(theirs): ours}
        self._elements = ElementMerge(self._copies, named=True)

    def run(self) -> list[str]:
        """Merge; returns the conflicts."""
        self._share_names()
        self._choose_new()
        self._arrange()
        self._delete()
        self._merge_contents()
        self._teach_the_same()
        self._write()
        return self._conflicts

    # what theirs has

    def _share_names(self) -> None:
        """Let variables, inputs, outputs, TCPs and features of theirs be those of ours with the same name."""
        roots = self._base.root, self._ours.root, self._theirs.root
        first, second, third = map(_shared_objects, roots)
        for key, theirs in third.items():
            if key in second and key not in first and _counts_in(self._theirs.root, theirs):
                taken = {place.get("name") for root in roots for place in root.places()}
                theirs.attributes["name"] = _unused(key[1], taken)  # two new loops count in a variable of one name
            elif key[0] == "variable" and key in first and key in second:
                self._elements.merge(first[key], second[key], theirs, f"variable {key[1]}")
                self._mark(self._main, self._elements.take_conflicts())
        for place in self._theirs.root.places():
            if (ours := second.get(object_key(place) or ("", ""))) is not None:
                self._copies[id(place.resolved())] = ours
        self._introduced = {
            name
            for kind, name in (second.keys() & _shared_objects(self._theirs.root).keys()) - first.keys()
            if kind == "variable"
        }

    @property
    def _main(self) -> Line:
        return next((line for line in self._ours.lines("MainProgram")), self._ours.top)

    def _merged(self, theirs: Line) -> Line | None:
        """The merged node of a line of theirs; None if it is not in the result."""
        if theirs in self._new:
            return theirs
        if theirs in self._same:
            return self._same[theirs]
        return self._ours.matches.get(self._theirs.back[theirs]) if theirs in self._theirs.back else None

    def _choose_new(self) -> None:
        """Find what theirs inserts, and what ours deleted and theirs changed; create their shells, then their contents.

        A shell exists before the contents, because contents can refer to other nodes.
        """
        for line in self._theirs.lines():
            old = self._theirs.back.get(line)
            if old is None and line not in self._same and not self._inserted_by_both(line):
                self._add_shell(line)
            elif old is None or old in self._ours.matches:
                if (merged := self._merged(line)) is not None:
                    self._copies[id(self._theirs.node(line))] = self._node(merged)
            elif self._theirs.changed(line):
                self._add_shell(line)
                self._notes[line] = _Note("ours deleted it, theirs changed it")
        self._add_called()
        for line in self._new:
            self._fill(line)
            twice = {place.get("name") for place in _own_places(self._theirs.node(line))} & self._introduced
            self._mark(line, [f"both versions have a new variable {name}" for name in sorted(twice)])
        self._rename_waypoints()

    def _inserted_by_both(self, line: Line) -> bool:
        above = self._merged(line.parent) if line.parent else None
        for other in above.children if above is not None and above not in self._new else ():
            if other not in self._ours.back and _tree(other) == _tree(line):
                self._same |= {t: o for (_, t), (_, o) in zip(line.walk(), other.walk(), strict=True)}
                return True
        return False

    def _add_shell(self, line: Line) -> None:
        assert line.spot is not None
        written = line.spot.written
        shell = Element(written.tag, {**line.spot.node.attributes, **written.attributes}, None)
        self._copies[id(line.spot.node)] = shell
        self._new[line] = None
        self._places[line] = shell if written is line.spot.place else make(SUPPRESSED, shell)
        self._below[line] = []

    def _add_called(self) -> None:
        """Keep what ours deleted and a new node of theirs refers to, such as a subprogram."""
        nodes = {id(self._theirs.node(line)): line for line in self._theirs.lines()}
        for place in (place for line in list(self._new) for place in _own_places(self._theirs.node(line))):
            called = nodes.get(id(place.resolved()))
            if called is not None and called.spot is not None and self._merged(called) is None:
                for _, line in called.walk():
                    if self._merged(line) is None:
                        self._add_shell(line)
                self._notes[called] = _Note("ours deleted it, theirs calls it")

    def _fill(self, line: Line) -> None:
        node = self._theirs.node(line)
        shell = self._copies[id(node)]
        shell.text, shell.open = node.text, node.open
        for child in node.children:
            copy = make(_HOLDER) if child.tag == _HOLDER else clipped([child], self._copies)[0]
            copy.parent = shell
            shell.children.append(copy)

    def _rename_waypoints(self) -> None:
        """Waypoints of the same name are one position: a new one gets another name if ours has another position."""
        taken: dict[str, Any] = {}
        for line in self._ours.lines("Waypoint"):
            taken.setdefault(line.name, self._position(self._ours.node(line)))
        known = {line.name for line in self._base.lines("Waypoint")}
        renamed: dict[str, str] = {}
        for shell in (self._node(line) for line in self._new if line.kind == "Waypoint"):
            name = shell.get("name")
            if name and name in taken and name not in known and taken[name] != self._position(shell):
                others = {each.get("name") for each in self._copies.values()}
                shell.attributes["name"] = renamed.setdefault(name, _unused(name, {*taken, *known, *others}))

    def _position(self, node: Element) -> Any:
        return self._elements.content(node.child("position"))

    # where nodes go

    def _arrange(self) -> None:
        """Insert and move nodes as theirs did."""
        for parent in self._theirs.lines():
            above, last = self._merged(parent), None
            if above is None:
                continue
            for theirs in parent.children:
                line = self._merged(theirs)
                if line is None:
                    continue
                old = self._theirs.back.get(theirs)
                if line is theirs and line not in self._above:
                    self._insert(line, above, last)
                    self._check_order(line, theirs, above)
                elif old in self._theirs.moved and line is not theirs and self._move(line, old, above, last):
                    self._check_order(line, theirs, above)
                if self._above.get(line) is above:
                    last = line

    def _move(self, line: Line, old: Line | None, above: Line, last: Line | None) -> bool:
        """Move a node after another one, unless ours moved it, too; returns whether it did."""
        row = self._below[self._above[line]]
        if old in self._ours.moved:
            at = row.index(line)
            if self._above[line] is not above or (row[at - 1] if at else None) is not last:
                self._mark(line, [f"both versions moved it; theirs is in {above.title}"])
            return False
        if line in self._around(above):
            self._mark(line, [f"theirs moved it into {above.title}, which ours moved into it"])
            return False
        row.remove(line)
        self._insert(line, above, last)
        return True

    def _around(self, line: Line) -> Iterator[Line]:
        """A merged node and those around it, from the inside."""
        around: Line | None = line
        while around is not None:
            yield around
            around = self._above.get(around)

    def _check_order(self, line: Line, theirs: Line, above: Line) -> None:
        """Mark a node that is now before or after others than in theirs, because ours moved them."""
        assert theirs.parent is not None
        beside, row = theirs.parent.children, self._below[above]
        place, at = beside.index(theirs), row.index(line)
        earlier, later = ({self._merged(each) for each in part} for part in (beside[:place], beside[place + 1 :]))
        if _holds(above) == "nodes" and (not later.isdisjoint(row[:at]) or not earlier.isdisjoint(row[at + 1 :])):
            self._mark(line, ["ours moved the nodes around it"])

    def _insert(self, line: Line, above: Line, last: Line | None) -> None:
        """Put a node after another one; if ours has new nodes there as well, their order is a conflict."""
        row = self._below[above]
        at = row.index(last) + 1 if last is not None and last in row else 0
        end = at
        while end < len(row) and self._from_ours(row[end]):
            end += 1
        ours = row[at:end]
        while end < len(row) and _stands(row[end]) == "if" and _stands(line) != "if":
            end += 1  # an If and its branches stay together
        row.insert(end, line)
        self._above[line] = above
        if any(each.kind != _EMPTY for each in ours) and line.kind != _EMPTY and _holds(above) == "nodes":
            self._mark(line, ["both versions inserted nodes here: those before are ours, these are theirs"])

    def _from_ours(self, line: Line) -> bool:
        if line in self._new:
            return False
        old = self._ours.back.get(line)
        return old is None or (old in self._ours.moved and old not in self._theirs.moved)

    def _delete(self) -> None:
        """Remove what theirs deleted, from the inside, unless ours changed or calls it."""
        for old in reversed(list(self._base.lines())):
            line = self._ours.matches.get(old)
            if line is None or old in self._theirs.matches:
                continue
            changed = self._below[line] or _own(old) != _own(line)
            if line.kind != _EMPTY and (changed or self._calls(line)):
                self._mark(line, [f"theirs deleted it, ours {'changed' if changed else 'calls'} it"])
            else:
                self._below[self._above[line]].remove(line)

    def _calls(self, line: Line) -> bool:
        """Whether a new node of ours refers to a subprogram."""
        node = self._node(line)
        new = (each for each in self._ours.lines() if each not in self._ours.back)
        return line.kind == "SubProgram" and any(
            place.resolved() is node for each in new for place in _own_places(self._node(each))
        )

    # contents

    def _merge_contents(self) -> None:
        for old, ours in self._ours.matches.items():
            theirs = self._theirs.matches.get(old)
            if theirs is None or ours in self._new:
                continue
            nodes = self._base.node(old), self._ours.node(ours), self._theirs.node(theirs)
            copy = self._suppressed_copy(theirs) if _own(ours) != _own(old) != _own(theirs) != _own(ours) else None
            self._elements.merge(*nodes, "", (_HOLDER,))
            if conflicts := self._elements.take_conflicts():
                self._mark(ours, conflicts, copy)
            self._suppress(old, ours, theirs)

    def _teach_the_same(self) -> None:
        """Give waypoints of the same name one position: that of the version which taught it anew."""
        before = {line.name: self._position(self._base.node(line)) for line in self._base.lines("Waypoint")}
        merged: dict[str, list[Line]] = {}
        for line in [*self._ours.lines("Waypoint"), *(line for line in self._new if line.kind == "Waypoint")]:
            merged.setdefault(self._node(line).get("name"), []).append(line)
        for name in before.keys() & merged.keys():
            taught, kept = list[Line](), list[Line]()
            for line in merged[name]:
                (kept if self._position(self._node(line)) == before[name] else taught).append(line)
            if taught:
                self._teach(taught[0], kept)

    def _teach(self, source: Line, lines: Sequence[Line]) -> None:
        for line in lines:
            node, taught = self._node(line), self._node(source)
            for tag in TAUGHT:
                Changes().set_child(node, tag, None)
                if (child := taught.child(tag)) is not None:
                    Changes().set_child(node, tag, clipped([child])[0], ORDERS["Waypoint"][1])

    def _suppressed_copy(self, line: Line) -> Element | None:
        """A separate copy of a node of theirs, suppressed; None for one that cannot be suppressed or holds others."""
        if line.spot is None or _stands(line) not in ("nodes", "move") or self._theirs.node(line).child(_HOLDER):
            return None
        node = line.spot.node
        known = {key: value for key, value in self._copies.items() if key != id(node)}
        return _suppressed(clipped([line.spot.written], known)[0])

    def _suppress(self, old: Line, ours: Line, theirs: Line) -> None:
        before, here, there = ("suppressed" in line.content for line in (old, ours, theirs))
        if there in (before, here) or ours.spot is None:
            return
        written = ours.spot.written
        if there:
            self._places[ours] = _suppressed(written)
        else:
            written.tag = written.attributes["class"]
            written.attributes = {name: value for name, value in written.attributes.items() if name != "class"}
            self._places[ours] = written

    def _mark(self, line: Line, conflicts: Sequence[str], theirs: Element | None = None) -> None:
        if conflicts:
            before = [self._notes[line].text] if line in self._notes else []
            self._notes[line] = _Note("; ".join([*before, *conflicts]), theirs)

    # the result

    def _write(self) -> None:
        """Write the rows of nodes, with the comments, into the document."""
        around: dict[Line, tuple[list[Element], list[Element]]] = {}
        first: dict[Line, list[Element]] = {}
        for line, note in self._notes.items():
            text = f"{line.title}: {note.text}"
            self._conflicts.append(text)
            anchor = self._anchor(line)
            if anchor is None:
                first.setdefault(self._within(line), []).append(_comment(text))
                continue
            before, after = around.setdefault(anchor, ([], []))
            before.append(_comment(text))
            if note.theirs is not None and anchor is line:
                after += [_comment("end of ours, theirs is suppressed"), note.theirs, _comment("end of theirs")]
        for above in self._merged_lines():
            places = first.get(above, [])
            for line in self._below[above]:
                before, after = around.get(line, ([], []))
                places = [*places, *before, self._places[line], *after]
            self._set_children(above, places)

    def _merged_lines(self) -> Iterator[Line]:
        waiting = [self._ours.top]
        while waiting:
            line = waiting.pop()
            yield line
            waiting += self._below[line]

    def _anchor(self, line: Line) -> Line | None:
        """The node next to which comments about a node can stand; None if they can only stand inside one."""
        return next((each for each in self._around(line) if self._is_among_nodes(each)), None)

    def _is_among_nodes(self, line: Line) -> bool:
        return line in self._above and _holds(self._above[line]) == "nodes" and _stands(line) in ("nodes", "move")

    def _within(self, line: Line) -> Line:
        """The top-level node that holds the comments about a node."""
        top = next(each for each in self._around(line) if self._above.get(each) in (None, self._ours.top))
        return top if _holds(top) == "nodes" else self._main

    def _set_children(self, above: Line, places: list[Element]) -> None:
        node = self._node(above)
        holder = node.child(_HOLDER)
        places = [place for place in places if place.tag != _EMPTY] or places[:1]
        if not places and _holds(above) == "nodes":
            places = [make(_EMPTY)]
        if holder is None:
            if not places:
                return
            holder = make(_HOLDER)
            holder.parent = node
            node.children.append(holder)
        for place in places:
            place.parent = holder
        holder.children = places

    def _node(self, line: Line) -> Element:
        """The element of a merged node."""
        return self._copies[id(self._theirs.node(line))] if line in self._new else self._ours.node(line)


def _holds(line: Line) -> str:
    return line.spot.kind.contains if line.spot is not None and line.spot.kind is not None else ""


def _stands(line: Line) -> str:
    return line.spot.kind.stands if line.spot is not None and line.spot.kind is not None else "nodes"


def _tree(line: Line) -> Any:
    return [(depth, each.kind, each.content) for depth, each in line.walk()]


def _own_places(node: Element) -> Iterator[Element]:
    """The places in a node, without the nodes below it."""
    for child in node.children:
        if child.tag != _HOLDER:
            yield from child.walk()


def _suppressed(node: Element) -> Element:
    """The place of a node with the wrapper of a suppressed one, unless it has that already."""
    if node.tag != INNER:
        node.attributes = {"class": node.tag, **node.attributes}
        node.tag = INNER
    return make(SUPPRESSED, node)


def _shared_objects(root: Element) -> dict[tuple[str, str], Element]:
    """What nodes share by its name, by kind and name."""
    found: dict[tuple[str, str], Element] = {}
    for place in root.places():
        if (key := object_key(place)) is not None:
            found.setdefault(key, place.resolved())
    return found


def _counts_in(root: Element, variable: Element) -> bool:
    return any(place.tag == "loopVariable" and place.resolved() is variable for place in root.places())


def _unused(name: str, taken: set[str]) -> str:
    stem, number = name.rstrip("0123456789").rstrip("_"), 1
    while f"{stem}_{number}" in taken:
        number += 1
    return f"{stem}_{number}"


def _comment(text: str) -> Element:
    return make("Comment", comment=f"MERGE CONFLICT {text}".replace("\n", " ")[:_LONGEST])
