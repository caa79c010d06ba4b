"""Merge two versions of a file that come from the same earlier one, by nodes and settings.

The result is always a file that PolyScope can open. What both versions changed differently is a conflict: the result
has ours, and a program also has theirs, as a suppressed node between comments or in the text of a comment, so that it
runs as ours until someone decides.

A program is merged in four steps: nodes that only theirs has get an empty shell, so that everything can refer to them;
their places among ours are found; what they deleted goes; then contents are merged, attribute by attribute.
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
    """A version of a program compared with the base. back: the base of a line; moved: lines of the base."""

    top: Line
    matches: Matches
    back: dict[Line, Line] = field(init=False)
    moved: set[Line] = field(init=False)

    def __post_init__(self) -> None:
        self.back = {new: old for old, new in self.matches.items()}
        self.moved = moved_lines(self.matches)

    def changed(self, line: Line) -> bool:
        """Whether a line or one below it differs from the base."""
        return any(self._differs(each) for _, each in line.walk())

    def _differs(self, line: Line) -> bool:
        old = self.back.get(line)
        below = [self.matches.get(child) for child in old.children] if old else []
        return old is None or old in self.moved or _own(old) != _own(line) or below != line.children


def _node(line: Line, root: Element) -> Element:
    return line.spot.node if line.spot is not None else root


def _own(line: Line) -> Any:
    return line.kind, line.content


class _ProgramMerge:
    """A merge into the document of ours. Lines of ours, and lines that only theirs has, stand for the merged nodes."""

    def __init__(self, base: Element, ours: Element, theirs: Element) -> None:
        self._roots = base, ours, theirs
        self._base, self._ours, self._theirs = map(program_lines, (base, ours, theirs))
        self._o = _Version(self._ours, match_lines(self._base, self._ours))
        self._t = _Version(self._theirs, match_lines(self._base, self._theirs))
        self._conflicts: list[str] = []
        self._notes: dict[Line, _Note] = {}
        self._below: dict[Line, list[Line]] = {line: list(line.children) for _, line in self._ours.walk()}
        self._above: dict[Line, Line] = {child: line for line in self._below for child in line.children}
        self._places = {line: line.spot.place for _, line in self._ours.walk() if line.spot is not None}
        self._new: dict[Line, None] = {}  # lines of theirs that are inserted
        self._introduced = set[str]()  # variables that are new in both versions
        self._same: dict[Line, Line] = {}  # lines that both versions inserted
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
        first, second, third = (self._objects(root) for root in self._roots)
        for key, theirs in third.items():
            if key in second and key not in first and _counts_in(self._roots[2], theirs):
                taken = {place.get("name") for root in self._roots for place in root.places()}
                theirs.attributes["name"] = _unused(key[1], taken)  # two new loops count in a variable of one name
            elif key[0] == "variable" and key in first and key in second:
                self._elements.merge(first[key], second[key], theirs, f"variable {key[1]}")
                self._mark(self._main, self._taken_conflicts())
        for place in self._roots[2].places():
            if (ours := second.get(object_key(place) or ("", ""))) is not None:
                self._copies[id(place.resolved())] = ours
        self._introduced = {
            name
            for kind, name in (second.keys() & self._objects(self._roots[2]).keys()) - first.keys()
            if kind == "variable"
        }

    @staticmethod
    def _objects(root: Element) -> dict[tuple[str, str], Element]:
        found: dict[tuple[str, str], Element] = {}
        for place in root.places():
            if (key := object_key(place)) is not None:
                found.setdefault(key, place.resolved())
        return found

    @property
    def _main(self) -> Line:
        return next((line for line in self._ours.children if line.kind == "MainProgram"), self._ours)

    def _key(self, theirs: Line) -> Line | None:
        """The merged node of a line of theirs; None if it is not in the result."""
        if theirs in self._new:
            return theirs
        if theirs in self._same:
            return self._same[theirs]
        return self._o.matches.get(self._t.back[theirs]) if theirs in self._t.back else None

    def _choose_new(self) -> None:
        """Find what theirs inserts, and what ours deleted and theirs changed; create their shells, then their contents.

        A shell exists before the contents, because contents can refer to other nodes.
        """
        for _, line in self._theirs.walk():
            old = self._t.back.get(line)
            if old is None and line not in self._same and not self._inserted_by_both(line):
                self._add_shell(line)
            elif old is None or old in self._o.matches:
                if (key := self._key(line)) is not None:
                    self._copies[id(_node(line, self._roots[2]))] = self._node(key)
            elif self._t.changed(line):
                self._add_shell(line)
                self._notes[line] = _Note("ours deleted it, theirs changed it")
        for line in list(self._new):
            self._add_called(line)
        for line in self._new:
            self._fill(line)
            twice = {place.get("name") for place in _own_places(_node(line, self._roots[2]))} & self._introduced
            self._mark(line, [f"both versions have a new variable {name}" for name in sorted(twice)])

    def _inserted_by_both(self, line: Line) -> bool:
        above = self._key(line.parent) if line.parent else None
        for other in above.children if above is not None and above not in self._new else ():
            if other not in self._o.back and _tree(other) == _tree(line):
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

    def _add_called(self, line: Line) -> None:
        """Keep what ours deleted and a new node of theirs refers to, such as a subprogram."""
        nodes = {id(_node(each, self._roots[2])): each for _, each in self._theirs.walk()}
        for place in _own_places(_node(line, self._roots[2])):
            called = nodes.get(id(place.resolved()))
            if called is not None and called.spot is not None and self._key(called) is None:
                for _, each in called.walk():
                    if self._key(each) is None:
                        self._add_shell(each)
                self._notes[called] = _Note("ours deleted it, theirs calls it")

    def _fill(self, line: Line) -> None:
        node = _node(line, self._roots[2])
        shell = self._copies[id(node)]
        shell.text, shell.open = node.text, node.open
        for child in node.children:
            copy = make(_HOLDER) if child.tag == _HOLDER else clipped([child], self._copies)[0]
            copy.parent = shell
            shell.children.append(copy)
        if line.kind == "Waypoint" and line.spot is not None:
            self._rename_waypoint(shell)

    def _rename_waypoint(self, shell: Element) -> None:
        """Waypoints of the same name are one position: a new one gets another name if ours has another position."""
        taken: dict[str, Any] = {}
        for _, line in self._ours.walk():
            if line.kind == "Waypoint":
                taken.setdefault(line.name, self._position(_node(line, self._roots[1])))
        known = {line.name for _, line in self._base.walk() if line.kind == "Waypoint"}
        name = shell.get("name")
        if name and name in taken and name not in known and taken[name] != self._position(shell):
            others = {each.get("name") for each in self._copies.values()}
            shell.attributes["name"] = _unused(name, {*taken, *known, *others})

    def _position(self, node: Element) -> Any:
        return self._elements.content(node.child("position"))

    # where nodes go

    def _arrange(self) -> None:
        """Insert and move nodes as theirs did."""
        for _, line in self._theirs.walk():
            above, last = self._key(line), None
            if above is None:
                continue
            for child in line.children:
                key = self._key(child)
                if key is None:
                    continue
                old = self._t.back.get(child)
                if key is child and key not in self._above:
                    self._insert(key, above, last)
                    self._check_order(key, child, above)
                elif old in self._t.moved and key is not child and self._move(key, old, above, last):
                    self._check_order(key, child, above)
                if self._above.get(key) is above:
                    last = key

    def _move(self, key: Line, old: Line | None, above: Line, last: Line | None) -> bool:
        """Move a node after another one, unless ours moved it, too; returns whether it did."""
        row = self._below[self._above[key]]
        if old in self._o.moved:
            at = row.index(key)
            if self._above[key] is not above or (row[at - 1] if at else None) is not last:
                self._mark(key, [f"both versions moved it; theirs is in {above.title}"])
            return False
        around: Line | None = above
        while around is not None:
            if around is key:
                self._mark(key, [f"theirs moved it into {above.title}, which ours moved into it"])
                return False
            around = self._above.get(around)
        row.remove(key)
        self._insert(key, above, last)
        return True

    def _check_order(self, key: Line, theirs: Line, above: Line) -> None:
        """Mark a node that is now before or after others than in theirs, because ours moved them."""
        assert theirs.parent is not None
        beside, row = theirs.parent.children, self._below[above]
        place, at = beside.index(theirs), row.index(key)
        earlier, later = ({self._key(line) for line in part} for part in (beside[:place], beside[place + 1 :]))
        if _holds(above) == "nodes" and (not later.isdisjoint(row[:at]) or not earlier.isdisjoint(row[at + 1 :])):
            self._mark(key, ["ours moved the nodes around it"])

    def _insert(self, key: Line, above: Line, last: Line | None) -> None:
        """Put a node after another one; if ours has new nodes there as well, their order is a conflict."""
        row = self._below[above]
        at = row.index(last) + 1 if last is not None and last in row else 0
        end = at
        while end < len(row) and self._from_ours(row[end]):
            end += 1
        ours = row[at:end]
        while end < len(row) and _stands(row[end]) == "if" and _stands(key) != "if":
            end += 1  # an If and its branches stay together
        row.insert(end, key)
        self._above[key] = above
        if [line for line in ours if line.kind != _EMPTY] and key.kind != _EMPTY and _holds(above) == "nodes":
            self._mark(key, ["both versions inserted nodes here: those before are ours, these are theirs"])

    def _from_ours(self, line: Line) -> bool:
        if line in self._new:
            return False
        old = self._o.back.get(line)
        return old is None or (old in self._o.moved and old not in self._t.moved)

    def _delete(self) -> None:
        for _, old in reversed(list(self._base.walk())):
            key = self._o.matches.get(old)
            if key is None or old in self._t.matches:
                continue
            changed = "changed" if self._below[key] or _own(old) != _own(key) else "calls" if self._calls(key) else ""
            if changed and key.kind != _EMPTY:
                self._mark(key, [f"theirs deleted it, ours {changed} it"])
            else:
                self._below[self._above[key]].remove(key)

    def _calls(self, line: Line) -> bool:
        """Whether a new node of ours refers to a subprogram."""
        node = self._node(line)
        new = (each for _, each in self._ours.walk() if each not in self._o.back)
        return line.kind == "SubProgram" and any(
            place.resolved() is node for each in new for place in _own_places(self._node(each))
        )

    # contents

    def _merge_contents(self) -> None:
        for old, ours in self._o.matches.items():
            theirs = self._t.matches.get(old)
            if theirs is None or ours in self._new:
                continue
            roots = self._roots
            before, here, there = _node(old, roots[0]), _node(ours, roots[1]), _node(theirs, roots[2])
            copy = self._copy(theirs) if _own(ours) != _own(old) != _own(theirs) != _own(ours) else None
            self._elements.merge(before, here, there, "", (_HOLDER,))
            if conflicts := self._taken_conflicts():
                self._mark(ours, conflicts, copy)
            self._suppress(old, ours, theirs)

    def _teach_the_same(self) -> None:
        """Give waypoints of the same name one position: that of the version which taught it anew."""
        points = [[line for _, line in top.walk() if line.kind == "Waypoint"] for top in (self._base, self._ours)]
        before = {line.name: self._position(_node(line, self._roots[0])) for line in points[0]}
        merged: dict[str, list[Line]] = {}
        for line in [*points[1], *(line for line in self._new if line.kind == "Waypoint")]:
            merged.setdefault(self._node(line).get("name"), []).append(line)
        for name in before.keys() & merged.keys():
            taught = [line for line in merged[name] if self._position(self._node(line)) != before[name]]
            if taught and any(self._position(self._node(line)) == before[name] for line in merged[name]):
                self._teach(taught[0], [line for line in merged[name] if line not in taught])

    def _teach(self, source: Line, lines: Sequence[Line]) -> None:
        for line in lines:
            node, taught = self._node(line), self._node(source)
            for tag in TAUGHT:
                Changes().set_child(node, tag, None)
                if (child := taught.child(tag)) is not None:
                    Changes().set_child(node, tag, clipped([child])[0], ORDERS["Waypoint"][1])

    def _copy(self, line: Line) -> Element | None:
        """A separate copy of a node of theirs, suppressed; None for one that cannot be suppressed or holds others."""
        if line.spot is None or _stands(line) not in ("nodes", "move") or _node(line, self._roots[2]).child(_HOLDER):
            return None
        node = line.spot.node
        known = {key: value for key, value in self._copies.items() if key != id(node)}
        copy = clipped([line.spot.written], known)[0]
        if copy.tag != INNER:
            copy.attributes = {"class": copy.tag, **copy.attributes}
            copy.tag = INNER
        return make(SUPPRESSED, copy)

    def _suppress(self, old: Line, ours: Line, theirs: Line) -> None:
        before, here, there = ("suppressed" in line.content for line in (old, ours, theirs))
        if there in (before, here) or ours.spot is None:
            return
        written = ours.spot.written
        if there:
            written.attributes = {"class": written.tag, **written.attributes}
            written.tag = INNER
            self._places[ours] = make(SUPPRESSED, written)
        else:
            written.tag = written.attributes["class"]
            written.attributes = {name: value for name, value in written.attributes.items() if name != "class"}
            self._places[ours] = written

    def _taken_conflicts(self) -> list[str]:
        found, self._elements.conflicts = self._elements.conflicts, []
        return found

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
        for above in self._kept():
            places = first.get(above, [])
            for line in self._below[above]:
                before, after = around.get(line, ([], []))
                places = [*places, *before, self._places[line], *after]
            self._set_children(above, places)

    def _kept(self) -> Iterator[Line]:
        waiting = [self._ours]
        while waiting:
            line = waiting.pop()
            yield line
            waiting += self._below[line]

    def _anchor(self, line: Line) -> Line | None:
        """The node next to which comments about a node can stand; None if they can only stand inside one."""
        anchor: Line | None = line
        while anchor is not None and not (anchor in self._above and _is_among_nodes(anchor, self._above[anchor])):
            anchor = self._above.get(anchor)
        return anchor

    def _within(self, line: Line) -> Line:
        """The top-level node that holds the comments about a node."""
        while line in self._above and self._above[line] is not self._ours:
            line = self._above[line]
        return line if _holds(line) == "nodes" else self._main

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

    def _node(self, key: Line) -> Element:
        """The element of a merged node."""
        node = key.spot.node if key.spot is not None else self._roots[1]
        return self._copies[id(node)] if key in self._new else node


def _is_among_nodes(line: Line, above: Line) -> bool:
    return _holds(above) == "nodes" and _stands(line) in ("nodes", "move")


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


def _counts_in(root: Element, variable: Element) -> bool:
    return any(place.tag == "loopVariable" and place.resolved() is variable for place in root.places())


def _unused(name: str, taken: set[str]) -> str:
    stem, number = name.rstrip("0123456789").rstrip("_"), 1
    while f"{stem}_{number}" in taken:
        number += 1
    return f"{stem}_{number}"


def _comment(text: str) -> Element:
    return make("Comment", comment=f"MERGE CONFLICT {text}".replace("\n", " ")[:_LONGEST])
