"""Copy nodes of a program, and paste them into the same or another one.

Copies share nothing with the originals. When they are pasted, the names of variables, inputs, outputs, TCPs, features
and subprograms in them refer to the objects of the target program.
"""

from dataclasses import dataclass
from typing import Final

from urscript.polyscope.document import Element, sharing
from urscript.polyscope.surroundings import VARIABLE_TAGS, FieldError, Surroundings
from urscript.polyscope.tree import tag_of

_NAMED: Final = ("pin", "tcp", "feature")
_UNIQUE: Final = {"Thread": "Thread", "SubProgram": "SubProgram"}


@dataclass(frozen=True, slots=True)
class Clip:
    """Copied nodes."""

    places: tuple[Element, ...]

    def __len__(self) -> int:
        return len(self.places)


def clipped(places: list[Element]) -> Clip:
    """Copy nodes. An object shared by several places is also shared by the copies; if it belongs to a node that is not
    copied, the first place contains it completely."""
    return Clip(tuple(_copies(places)))


def planted(clip: Clip, program: Surroundings) -> list[Element]:
    """Copies of the nodes in a clip, bound to the objects of a program by name. Raises FieldError."""
    places = _copies(clip.places)
    _bind(places, program)
    return places


def _copies(places: list[Element] | tuple[Element, ...]) -> list[Element]:
    copies: dict[int, Element] = {}

    def copied(place: Element, parent: Element | None) -> Element:
        element = place.resolved()
        copy = Element(place.tag, dict(place.attributes), parent)
        if id(element) in copies:
            copy.shared = copies[id(element)]
            return copy
        copies[id(element)] = copy
        if element is not place:
            of_object = {name: value for name, value in element.attributes.items() if name not in ("class",)}
            copy.attributes = {**copy.attributes, **of_object}
        copy.text, copy.open = element.text, element.open
        copy.children = [copied(child, copy) for child in element.children]
        return copy

    return [copied(place, None) for place in places]


def _bind(places: list[Element], program: Surroundings) -> None:
    inside = {place.get("name") for each in places for place in each.places() if tag_of(place) == "Waypoint"}
    waypoints = {place.get("name"): place.resolved() for place in program.root.places() if tag_of(place) == "Waypoint"}
    made: dict[str, Element] = {}
    for each in places:
        for place in list(each.places()):
            place.children = [_bound(child, place, program, made, waypoints, inside) for child in place.children]
        node = each if each.tag != "SuppressedNode" else each.children[0]
        if stem := _UNIQUE.get(tag_of(node)):
            taken = program.names(tag_of(node))
            if node.get("name") in taken:
                node.resolved().attributes["name"] = program.unused(stem, taken)


def _bound(
    child: Element,
    parent: Element,
    program: Surroundings,
    made: dict[str, Element],
    waypoints: dict[str, Element],
    inside: set[str],
) -> Element:
    """The child, or the object of the program that replaces it."""
    name = child.get("name")
    if child.tag in VARIABLE_TAGS and name and child.child("expression") is None:
        found = made.get(name)
        if found is not None:
            bound = sharing(child.tag, found)
        else:
            try:
                bound = program.variable(name, child.tag)
            except FieldError:  # a name that PolyScope accepts, but we do not
                return child
            if bound.shared is None:
                made[name] = bound
    elif child.tag in _NAMED and child.get("referencedName"):
        of_place = {"class_": child.attributes["class"]} if "class" in child.attributes else {}
        bound = program.named(child.tag, child.get("referencedName"), **of_place)
    elif child.tag == "Waypoint" and parent.tag == "ExpressionWaypoint" and name in waypoints and name not in inside:
        bound = sharing("Waypoint", waypoints[name], referenceName=name)
    elif child.tag == "subprogram":
        found = next(
            (
                place.resolved()
                for place in program.root.places()
                if tag_of(place) in ("SubProgram", "subprogram") and place.get("name") == name
            ),
            None,
        )
        if found is None:
            return child
        bound = sharing("subprogram", found)
    else:
        return child
    bound.parent = parent
    return bound
