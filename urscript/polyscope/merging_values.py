"""Merge the values of two versions of a file: attributes and elements of XML, properties, and JSON.

Where both versions changed a value differently, the result has ours, and the path of the value is a conflict.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from urproto.text import from_bytes, to_bytes
from urscript.polyscope.document import Element
from urscript.polyscope.lines import flat, object_key
from urscript.polyscope.transplant import clipped

_OF_PLACE: Final = ("class", "referenceName")
_SAVED: Final = frozenset({"crcValue", "lastSavedIn", "lastSavedInPolycopeProgramVersion", "robotSerialNumber"})
_WHOLE: Final = ("position", "relativeFromPosition", "expression", "SafetySettings")  # parts make no sense alone
_DATES: Final = ("createdDate", "lastSavedDate", "lastModifiedDate")
_NOTHING: Final = object()  # no value in JSON
_SHOWN: Final = 60  # characters of a value in a conflict
_LISTED: Final = 3  # values of an element in conflicts


class ElementMerge:
    """Merges what theirs changed into the elements of ours.

    copies: the element of ours for one of theirs, by its identity. named: named objects count as their names.
    """

    def __init__(self, copies: dict[int, Element] | None = None, *, named: bool = False) -> None:
        self.copies = {} if copies is None else copies
        self.conflicts: list[str] = []
        self._named = named

    def run(self, base: Element, ours: Element, theirs: Element) -> list[str]:
        """Merge a document; returns the conflicts."""
        self.merge(base, ours, theirs, ours.tag)
        return self.conflicts

    def take_conflicts(self) -> list[str]:
        """The conflicts since the last call."""
        found, self.conflicts = self.conflicts, []
        return found

    def merge(self, base: Element, ours: Element, theirs: Element, path: str, skip: Sequence[str] = ()) -> None:
        """Merge attributes, text and children, except those with the tags ``skip``."""
        base, ours, theirs = base.resolved(), ours.resolved(), theirs.resolved()
        self.copies.setdefault(id(theirs), ours)
        before, after = (
            {name: value for name, value in each.attributes.items() if name not in _SAVED} for each in (base, theirs)
        )
        ours.attributes = self.mapping(before, ours.attributes, after, path)
        ours.text = self._value(base.text, ours.text, theirs.text, f"{path} text".strip()) or ""
        first, second, third = (_parts(each, skip) for each in (base, ours, theirs))
        for key in dict.fromkeys([*second, *third]):
            where = f"{path}.{key[0]} {key[1]}".strip(". ")
            self._child(ours, key, first.get(key), second.get(key), third.get(key), where)

    def _child(self, parent: Element, key: tuple[str, str], b: Any, o: Any, t: Any, path: str) -> None:
        base, ours, theirs = (self.content(each) for each in (b, o, t))
        if theirs in (base, ours):
            return
        if key[0] not in _WHOLE and None not in (b, o, t) and not (self._named and object_key(o) is not None):
            self.merge(b, o, t, path)
            return
        if ours != base:
            self.conflicts += _of_places(path, o, t)
            if o is not None:
                return
        new = list(clipped([t], self.copies)) if t is not None else []
        for each in new:
            each.parent = parent
        at = parent.children.index(o) if o is not None else self._place_of(parent, t)
        parent.children[at : at + (o is not None)] = new

    def _place_of(self, parent: Element, theirs: Element) -> int:
        """Where a new child goes: after the one that it follows in theirs."""
        keys, last = _parts(parent, ()), None
        for key, child in (_parts(theirs.parent, ()) if theirs.parent is not None else {}).items():
            if child is theirs:
                break
            last = keys.get(key, last)
        return parent.children.index(last) + 1 if last is not None else 0

    def mapping(
        self, base: Mapping[str, str], ours: Mapping[str, str], theirs: Mapping[str, str], path: str
    ) -> dict[str, str]:
        """Merge key by key."""
        merged = dict(ours)
        for key in dict.fromkeys([*ours, *theirs]):
            if key in _SAVED:
                continue
            value = self._value(base.get(key), ours.get(key), theirs.get(key), f"{path}.{key}".strip("."))
            if value is None:
                merged.pop(key, None)
            else:
                merged[key] = value
        return merged

    def _value(self, base: str | None, ours: str | None, theirs: str | None, path: str) -> str | None:
        if ours != base and theirs not in (base, ours):
            self.conflicts.append(_conflict(path, ours, theirs))
            return ours
        return ours if theirs == base else theirs

    def content(self, place: Element | None, *around: int) -> Any:
        """What a place contains, to compare; None for no place."""
        if place is None:
            return None
        element = place.resolved()
        if self._named and (key := object_key(place)):
            return place.tag, key
        if id(element) in around:
            return place.tag, around.index(id(element))
        attributes = {name: value for name, value in element.attributes.items() if name not in _OF_PLACE}
        below = [self.content(child, *around, id(element)) for child in element.children]
        return place.tag, attributes, element.text.strip(), below


def _parts(element: Element, skip: Sequence[str]) -> dict[tuple[str, str], Element]:
    """The children by tag and what identifies them: their id, their name, or their number."""
    found: dict[tuple[str, str], Element] = {}
    for child in element.resolved().children:
        if child.tag not in skip:
            name = child.get("id") or child.get("name")
            number = 1
            while (key := (child.tag, name or str(number) * (number > 1))) in found:
                name, number = "", number + 1
            found[key] = child
    return found


def _conflict(path: str, ours: object, theirs: object) -> str:
    """Both values of a conflict; long ones from shortly before the first difference."""
    texts = [value if isinstance(value, str) else json.dumps(value, ensure_ascii=False) for value in (ours, theirs)]
    same = next((at for at, (a, b) in enumerate(zip(*texts, strict=False)) if a != b), 0)
    start = max(0, same - _SHOWN // 3) if max(map(len, texts)) > _SHOWN else 0
    first, second = (
        "-"
        if value is None
        else repr("..." * bool(start) + text[start:][:_SHOWN] + "..." * (len(text) > start + _SHOWN))
        for value, text in zip((ours, theirs), texts, strict=True)
    )
    return f"{path}: {first} in ours, {second} in theirs"


def _of_places(path: str, ours: Element | None, theirs: Element | None) -> list[str]:
    """The conflicts of an element that is merged as a whole: who deleted it, or the first values that differ."""
    first, second = (flat(each, path) if each is not None else {} for each in (ours, theirs))
    if ours is None or theirs is None:
        gone, there = ("ours", "theirs") if ours is None else ("theirs", "ours")
        values = ", ".join(
            f"{key.removeprefix(path).lstrip('.')} {value}".strip() for key, value in (first | second).items()
        )
        return [f"{path}: {gone} deleted it, {there} changed it: {values[: 2 * _SHOWN]}"]
    keys = [key for key in {**first, **second} if first.get(key) != second.get(key)]
    found = [_conflict(key, first.get(key), second.get(key)) for key in keys[:_LISTED]]
    return found or [f"{path}: both versions changed it"]


# other files


def merge_properties(base: bytes, ours: bytes, theirs: bytes) -> tuple[bytes, list[str]]:
    """Merge installation variables in the form of properties, a line for each."""
    first, second, third = (dict(map(_property, from_bytes(each).splitlines())) for each in (base, ours, theirs))
    merge = ElementMerge()
    merged = merge.mapping(first, second, third, "variables")
    return to_bytes("".join(f"{line}\n" for line in merged.values())), merge.conflicts


def _property(line: str) -> tuple[str, str]:
    return line.partition("=")[0].strip(), line


def merge_json(base: bytes, ours: bytes, theirs: bytes) -> tuple[bytes, list[str]]:
    """Merge programs of PolyScope X. Their URScript stays ours: PolyScope X writes it anew when it saves."""
    conflicts: list[str] = []
    first, second, third = (json.loads(from_bytes(each)) for each in (base, ours, theirs))
    merged = _json(first, second, third, "", conflicts)
    return to_bytes(json.dumps(merged, ensure_ascii=False, separators=(",", ":"))), conflicts


def _json(base: Any, ours: Any, theirs: Any, path: str, conflicts: list[str]) -> Any:
    if theirs in (base, ours) or path.endswith("urscript"):
        return ours
    if ours == base:
        return theirs
    if all(isinstance(each, dict) for each in (base, ours, theirs)):
        merged = {}
        for key in dict.fromkeys([*ours, *theirs]):
            first, second, third = (each.get(key, _NOTHING) for each in (base, ours, theirs))
            merged[key] = _json(first, second, third, f"{path}.{key}".lstrip("."), conflicts)
        return {key: value for key, value in merged.items() if value is not _NOTHING}
    rows = [_by_guid(each) for each in (base, ours, theirs)]
    if None not in rows:
        first, second, third = (row or {} for row in rows)
        if [key for key in second if key in first and key in third] == [
            key for key in third if key in first and key in second
        ]:
            merged_rows = _json(first, second, _in_order(second, third), path, conflicts)
            return list(merged_rows.values())
    if not path.endswith(_DATES):
        conflicts.append(_conflict(path, *(None if each is _NOTHING else each for each in (ours, theirs))))
    return ours


def _by_guid(value: Any) -> dict[str, Any] | None:
    """The nodes of a list by their ids; None for another list."""
    if not isinstance(value, list) or not all(isinstance(each, dict) and "guid" in each for each in value):
        return None
    return {each["guid"]: each for each in value}


def _in_order(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    """The nodes of theirs in the order of ours."""
    return {key: theirs[key] for key in [*(key for key in ours if key in theirs), *theirs]}
