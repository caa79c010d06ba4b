"""Copy nodes of a program, and paste them into the same or another one.

Copies share nothing with the originals. When they are pasted, the names of variables, inputs, outputs, TCPs, features
and subprograms in them refer to the objects of the target program.
"""

from collections.abc import Sequence
from typing import Final

from urscript.polyscope.document import Element, sharing
from urscript.polyscope.surroundings import VARIABLE_TAGS, FieldError, Surroundings
from urscript.polyscope.tree import tag_of

Clip = tuple[Element, ...]
"""Copied nodes."""

_NAMED: Final = ("pin", "tcp", "feature")
_UNIQUE: Final = ("Thread", "SubProgram")  # nodes that need a name of their own


def clipped(places: Sequence[Element], copies: dict[int, Element] | None = None) -> Clip:
    """Copy nodes. An object shared by several places is also shared by the copies; if it belongs to a node that is not
    copied, the first place contains it completely.

    copies: what stands for objects, by their identities, and is not copied; the new copies are added.
    """
    copies = {} if copies is None else copies

    def copied(place: Element, parent: Element | None) -> Element:
        element = place.resolved()
        copy = Element(place.tag, dict(place.attributes), parent)
        if id(element) in copies:
            copy.shared = copies[id(element)]
            return copy
        copies[id(element)] = copy
        if element is not place:
            copy.attributes |= {name: value for name, value in element.attributes.items() if name != "class"}
        copy.text, copy.open = element.text, element.open
        copy.children = [copied(child, copy) for child in element.children]
        return copy

    return tuple(copied(place, None) for place in places)


def planted(clip: Clip, program: Surroundings) -> list[Element]:
    """Copies of the nodes in a clip, bound to the objects of a program by name. Raises FieldError."""
    places = list(clipped(clip))
    binding = _Binding(places, program)
    for each in places:
        for place in list(each.places()):
            place.children = [binding.bound(child, place) for child in place.children]
        node = each if each.tag != "SuppressedNode" else each.children[0]
        tag = tag_of(node)
        if tag in _UNIQUE and node.get("name") in (taken := program.names(tag)):
            node.resolved().attributes["name"] = program.unused(tag, taken)
    return places


class _Binding:
    """The objects of a program to which the names in copies refer, and the new ones among the copies."""

    def __init__(self, copies: list[Element], program: Surroundings) -> None:
        self._program = program
        copied = {place.get("name") for each in copies for place in each.places() if tag_of(place) == "Waypoint"}
        waypoints = self._objects("Waypoint")
        self._waypoints = {name: waypoints[name] for name in waypoints.keys() - copied}
        self._subprograms = self._objects("SubProgram", "subprogram")
        self._new_variables: dict[str, Element] = {}

    def bound(self, child: Element, parent: Element) -> Element:
        """The child, or a place that refers to an object of the program instead."""
        place = self._place(child, parent)
        if place is None:
            return child
        place.parent = parent
        return place

    def _objects(self, *tags: str) -> dict[str, Element]:
        places = (place for place in self._program.root.places() if tag_of(place) in tags)
        return {place.get("name"): place.resolved() for place in places}

    def _place(self, child: Element, parent: Element) -> Element | None:
        name = child.get("name")
        if child.tag in VARIABLE_TAGS and name and child.child("expression") is None:
            return self._variable(child.tag, name)
        if child.tag in _NAMED and child.get("referencedName"):
            of_place = {"class_": child.attributes["class"]} if "class" in child.attributes else {}
            return self._program.named(child.tag, child.get("referencedName"), **of_place)
        if child.tag == "Waypoint" and parent.tag == "ExpressionWaypoint" and name in self._waypoints:
            return sharing("Waypoint", self._waypoints[name], referenceName=name)
        if child.tag == "subprogram" and name in self._subprograms:
            return sharing("subprogram", self._subprograms[name])
        return None

    def _variable(self, tag: str, name: str) -> Element | None:
        if name in self._new_variables:
            return sharing(tag, self._new_variables[name])
        try:
            place = self._program.variable(name, tag)
        except FieldError:  # a name that PolyScope accepts, but we do not
            return None
        if place.shared is None:
            self._new_variables[name] = place
        return place
