"""Positions of the nodes in a program by their ids, and the rules for where nodes may be placed."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from urscript.polyscope.document import Element
from urscript.polyscope.numbers import tag_in_words
from urscript.polyscope.registry import Kind, kind_of
from urscript.polyscope.tree import tag_of

ROOT: Final = "program"  # id of the program itself, which contains threads and subprograms
SUPPRESSED: Final = "SuppressedNode"
INNER: Final = "suppressedNode"


class EditError(ValueError):
    """An edit is not possible. node: id of the node; field: key of its field; both may be empty."""

    def __init__(self, message: str, node: str = "", field: str = "") -> None:
        super().__init__(message)
        self.node, self.field = node, field


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A node at its position in the tree.

    holder: the element that has it as a child. place: the child of the holder, which may share its object with other
    places. node: that object. written: the place of the node itself, inside the wrapper of a suppressed node.
    """

    id: str
    place: Element
    written: Element
    node: Element
    holder: Element
    parent: "Spot | None"
    depth: int
    suppressed: bool
    kind: Kind | None

    @property
    def title(self) -> str:
        """The text of its line in the tree."""
        if self.kind is None:
            return " ".join(filter(None, (tag_in_words(tag_of(self.written)), self.node.get("name"))))
        return self.kind.shown(self.node) or self.kind.title

    @property
    def lacks(self) -> str:
        """What is missing for the node to run, as text; empty when it is complete."""
        return self.kind.undefined(self.node) if self.kind else ""


@dataclass(frozen=True, slots=True)
class Target:
    """A position for nodes: after the child ``behind`` of a node, or before all of them (None)."""

    parent: Element
    parent_spot: Spot | None
    behind: Element | None


class Places:
    """The positions of all nodes in a program. Ids stay valid even while a node is deleted and restored."""

    def __init__(self, root: Element) -> None:
        self.root = root
        self._ids: dict[int, str] = {id(root): ROOT}
        self._known: dict[str, Element] = {ROOT: root}  # keeps elements alive, so that no id() is reused
        self._spots: dict[str, Spot] | None = None

    def invalidate(self) -> None:
        """Discard cached positions because the tree may have changed."""
        self._spots = None

    def id_of(self, element: Element) -> str:
        """The id of a node; assigns one if it has none yet."""
        element = element.resolved()
        found = self._ids.get(id(element))
        if found is None:
            found = self._ids[id(element)] = f"n{len(self._ids)}"
            self._known[found] = element
        return found

    def known(self, element: Element) -> str:
        """The id of a node; empty for an element that never was one."""
        return self._ids.get(id(element.resolved()), "")

    def all(self) -> list[Spot]:
        """All nodes in the order of the tree."""
        return list(self._by_id().values())

    def _by_id(self) -> dict[str, Spot]:
        if self._spots is None:
            self._spots = {spot.id: spot for spot in self._walk()}
        return self._spots

    def _walk(self) -> Iterator[Spot]:
        """All nodes in the order of the tree; a node shared by several places counts at the first one."""
        seen = set[int]()
        stack: list[tuple[Element, Element, Spot | None, int, bool]] = [
            (place, holder, None, 0, False) for place, holder in reversed(children_of(self.root))
        ]
        while stack:
            place, holder, parent, depth, suppressed = stack.pop()
            written = node_place(place)
            node = written.resolved()
            if id(node) in seen:
                continue
            seen.add(id(node))
            left_out = suppressed or written is not place
            spot = Spot(self.id_of(node), place, written, node, holder, parent, depth, left_out, kind_of(written))
            yield spot
            stack.extend((child, among, spot, depth + 1, left_out) for child, among in reversed(children_of(node)))

    def spot(self, node: str) -> Spot:
        """The node with an id. Raises EditError if it is not in the program."""
        spot = self._by_id().get(node)
        if spot is None:
            gone = self._known.get(node)
            if gone is self.root:
                raise EditError("that is the program itself: name one of its nodes", node)
            shown = f" ({tag_of(gone)})" if gone is not None else ""
            raise EditError(f"the node {node}{shown} is no longer in the program", node)
        return spot

    def whole(self, nodes: Iterable[str]) -> list[Spot]:
        """The nodes in the order of the tree, without those inside other ones; an If includes its branches."""
        selected = {self.spot(node).id for node in nodes}
        if not selected:
            raise EditError("name at least one node")
        for spot in self.all():
            if spot.id in selected and spot.kind is not None and spot.kind.key == "if":
                selected.update(other.id for other in self.branches(spot))
        found = []
        for spot in self.all():
            around = spot.parent
            while around is not None and around.id not in selected:
                around = around.parent
            if spot.id in selected and around is None:
                found.append(spot)
        return found

    def branches(self, spot: Spot) -> list[Spot]:
        """The ElseIf and Else nodes that belong to an If."""
        beside = [other for other in self.all() if other.holder is spot.holder]
        found = []
        for other in beside[beside.index(spot) + 1 :]:
            if other.kind is None or other.kind.stands != "if":
                break
            found.append(other)
        return found

    # where nodes may go

    def target(self, into: str, before: str, after: str, kind: Kind) -> Target:
        """The position for a new node of a kind. Raises EditError if it is not allowed there."""
        if sum(map(bool, (into, before, after))) != 1 and kind.stands != "program":
            raise EditError("name exactly one place: into, before or after a node")
        if kind.stands == "program":
            return self._in_program(before, after, kind)
        if into == ROOT:
            main = next(spot for spot in self.all() if spot.kind is not None and spot.kind.key == "robot_program")
            into = main.id
        anchor = self.spot(into or before or after)
        if kind.stands == "if":
            return self._behind_if(anchor, kind)
        if into:
            parent: Spot | None = anchor
            behind = _last_place(anchor.node)
        else:
            parent, behind = anchor.parent, self._neighbour(anchor, first=bool(before))
        if parent is None:
            raise EditError(f"a {kind.title} cannot be placed next to {anchor.title}: put it into one", anchor.id)
        self._may_hold(parent, kind)
        if kind.key == "default_case" and any(s.kind is kind and s.parent == parent for s in self.all()):
            raise EditError(f"{parent.title} already has a default case", parent.id)
        return Target(parent.node, parent, behind)

    def group_target(self, places: list[Element], into: str, before: str, after: str) -> Target:
        """The common position for several nodes. Raises EditError if one of them is not allowed there."""
        target = None
        chain = False
        for place in places:
            kind = kind_of(node_place(place))
            if kind is None:
                raise EditError(f"<{tag_of(node_place(place))}> is an unknown node and cannot be moved")
            if not (chain and kind.stands == "if"):
                found = self.target(into, before, after, kind)
                if target is not None and target.parent is not found.parent:
                    raise EditError("these nodes cannot go to the same place: move them one by one")
                target = target or found
            chain = kind.key == "if" or (chain and kind.key == "elseif")
        if target is None:
            raise EditError("there are no nodes to insert")
        return target

    def _neighbour(self, anchor: Spot, *, first: bool) -> Element | None:
        """The place after which to insert something before or after a node, but never between branches of an If."""
        beside = [spot for spot in self.all() if spot.holder is anchor.holder]
        at = beside.index(anchor)
        if first:
            while beside[at].kind is not None and beside[at].kind.stands == "if" and at:  # type: ignore[union-attr]
                at -= 1
            return beside[at - 1].place if at else None
        while at + 1 < len(beside) and (behind := beside[at + 1].kind) is not None and behind.stands == "if":
            at += 1
        return beside[at].place

    def _in_program(self, before: str, after: str, kind: Kind) -> Target:
        """A position at the top level: fixed for nodes that come first, else at the end or at the requested place."""
        top = [spot for spot in self.all() if spot.parent is None]
        keys = [spot.kind.key if spot.kind else "" for spot in top]
        once = ("variables_setup", "before_start", "robot_program")
        if kind.key in once:
            if kind.key in keys:
                raise EditError(f"the program already has its {kind.title}")
            earlier = [spot.place for spot, key in zip(top, keys, strict=True) if key in once[: once.index(kind.key)]]
            return Target(self.root, None, earlier[-1] if earlier else None)
        anchor = self.spot(before or after) if before or after else None
        while anchor is not None and anchor.parent is not None:
            anchor = anchor.parent
        if anchor is None or (anchor.kind is not None and anchor.kind.key in once):
            return Target(self.root, None, top[-1].place)
        return Target(self.root, None, self._neighbour(anchor, first=bool(before)))

    def _behind_if(self, anchor: Spot, kind: Kind) -> Target:
        """A position after an If or one of its branches."""
        if anchor.kind is None or anchor.kind.key not in ("if", "elseif", "else"):
            raise EditError(f"an {kind.title} must follow an If, not {anchor.title}", anchor.id)
        chain = [anchor, *self.branches(anchor)]
        if any(spot.kind is not None and spot.kind.key == "else" for spot in chain):
            if kind.key == "else":
                raise EditError("the If already has an Else", anchor.id)
            chain = chain[:-1]
            if not chain:
                raise EditError("an ElseIf must come before the Else", anchor.id)
        at = chain[-1] if kind.key == "else" or anchor.kind.key == "if" else anchor
        return Target(anchor.parent.node if anchor.parent else self.root, anchor.parent, at.place)

    def _may_hold(self, parent: Spot, kind: Kind) -> None:
        """Raise EditError if a node must not contain nodes of a kind."""
        holds = parent.kind.contains if parent.kind else ""
        if parent.kind is not None and parent.kind.key == "until" and parent.node.get("allowActions") != "true":
            raise EditError(f"{parent.title} has no actions: enable them first", parent.id, "actions")
        if kind.stands in ("switch", "direction"):
            if holds != kind.stands:
                where = "Switch" if kind.stands == "switch" else "Direction"
                raise EditError(f"a {kind.title} must be inside a {where}, not inside {parent.title}", parent.id)
        elif holds != "nodes":
            what = {"switch": "only cases", "direction": "only Untils", "circle": "only its two waypoints"}.get(holds)
            raise EditError(f"{parent.title} can contain {what or 'no nodes'}", parent.id)

    def in_move(self, spot: Spot | None) -> bool:
        """Whether a node is a Move or inside one."""
        while spot is not None:
            if spot.node.get("motionType"):
                return True
            spot = spot.parent
        return False

    def may_go(self, spot: Spot, how: str) -> None:
        """Raise EditError if a node cannot be deleted, moved, copied or suppressed; ``how`` is the participle."""
        key = spot.kind.key if spot.kind else ""
        if key in ("robot_program", "empty") or (key == "variables_setup" and how != "deleted"):
            raise EditError(f"{spot.title} cannot be {how}", spot.id)
        if how == "copied" and key == "before_start":
            raise EditError(f"{spot.title} cannot be {how}: a program has only one", spot.id)
        if how != "copied" and spot.parent is not None and spot.parent.kind and spot.parent.kind.contains == "circle":
            raise EditError(f"{spot.title} cannot be {how}: the CircleMove around it needs two waypoints", spot.id)


def node_place(place: Element) -> Element:
    """The place of the node itself, which is inside the wrapper of a suppressed node."""
    if place.tag != SUPPRESSED:
        return place
    return next((child for child in place.resolved().children if child.tag == INNER), place)


def children_of(node: Element) -> list[tuple[Element, Element]]:
    """The child places of a node, with the element that has them as children."""
    holder = node.child("children")
    return [(place, holder) for place in holder.children] if holder is not None else []


def _last_place(node: Element) -> Element | None:
    found = children_of(node)
    return found[-1][0] if found else None
