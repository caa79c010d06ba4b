"""Compare two versions of a file: which nodes or settings were added, removed, moved and changed.

Files have no ids for nodes, so `match_lines` finds the versions of a line: first unique equal subtrees wherever they
are, then, from the root down, equal lines, lines of the same name and lines of the same kind, in their order.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from html import escape
from itertools import chain
from typing import Any, Final, Literal

from urscript.polyscope.lines import Line

How = Literal["added", "removed", "moved", "changed", "moved and changed"]
_VOLATILE: Final = ("lastSavedIn", "lastSavedInPolycopeProgramVersion")
_PAGE: Final = """<!doctype html><html lang="en"><meta charset="utf-8"><title>TITLE</title>
<style>body{font:15px system-ui;margin:2em}td{padding:.3em .8em;vertical-align:top;border-top:1px solid #ccc}
.added td:first-child,ins{color:#060;background:#dfd}.removed td:first-child,del{color:#900;background:#fdd}</style>
<h1>TITLE</h1>"""
Matches = dict[Line, Line]
"""The later version of each earlier line that still exists."""


@dataclass(frozen=True, slots=True)
class Change:
    """A difference. path: the titles of the lines around it. before, after: the line; None if there is none.

    values: what differs, by its title: before and after, empty for nothing.
    """

    how: How
    path: tuple[str, ...]
    before: Line | None
    after: Line | None
    values: Mapping[str, tuple[str, str]]

    def as_dict(self) -> dict[str, Any]:
        """The change for JSON."""
        return {
            "how": self.how,
            "path": list(self.path),
            "before": self.before.text if self.before else None,
            "after": self.after.text if self.after else None,
            "values": {key: list(pair) for key, pair in self.values.items()},
        }


def differences(before: Line, after: Line) -> list[Change]:
    """All changes, in the order of the later version; removed lines come where they were."""
    matches = match_lines(before, after)
    earlier = {new: old for old, new in matches.items()}
    moved = moved_lines(matches)
    found = []
    for _, line in after.walk():
        old = earlier.get(line)
        if old is not None:
            found += [_change("removed", child, None) for child in old.children if child not in matches]
        if old is None:
            found.append(_change("added", None, line))
        elif (values := changed_values(old, line)) or old in moved:
            how: How = "moved and changed" if values and old in moved else "moved" if old in moved else "changed"
            found.append(Change(how, _path(line), old, line, values))
    return found


def _change(how: How, before: Line | None, after: Line | None) -> Change:
    line = after or before
    assert line is not None
    return Change(how, _path(line), before, after, {})


def _path(line: Line) -> tuple[str, ...]:
    path = []
    while line.parent is not None and line.parent.parent is not None:
        line = line.parent
        path.append(line.title)
    return tuple(reversed(path))


def changed_values(before: Line, after: Line) -> dict[str, tuple[str, str]]:
    """What differs between two versions of a line: of what is shown or, if that is equal, of its contents."""
    shown = _differing({"": before.title, **before.values}, {"": after.title, **after.values})
    return shown or _differing(before.content, after.content)


def _differing(before: Mapping[str, str], after: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    keys = dict.fromkeys([*before, *after])
    return {
        key: (before.get(key, ""), after.get(key, ""))
        for key in keys
        if key not in _VOLATILE and before.get(key) != after.get(key)
    }


def moved_lines(matches: Matches) -> set[Line]:
    """The earlier versions of lines that are elsewhere: below another line, or in another order."""
    moved = set()
    earlier = {new: old for old, new in matches.items()}
    for old, new in matches.items():
        if old.parent is not None and new.parent is not matches.get(old.parent):
            moved.add(old)
        here = [child for child in old.children if child in matches and matches[child].parent is new]
        there = [earlier[child] for child in new.children if child in earlier and earlier[child].parent is old]
        if here == there:  # nearly always
            continue
        blocks = SequenceMatcher(None, here, there, autojunk=False).get_matching_blocks()
        moved |= set(here) - {child for block in blocks for child in here[block.a : block.a + block.size]}
    return moved


def match_lines(before: Line, after: Line) -> Matches:
    """The versions of each line; lines that were added or removed have none."""
    return _Matching(before, after).matches


class _Matching:
    def __init__(self, before: Line, after: Line) -> None:
        self.matches: Matches = {}
        self._taken = set[Line]()
        self._before = [line for _, line in before.walk()]
        self._after = [line for _, line in after.walk()]
        self._tree: dict[Line, int] = {}
        numbers: dict[Hashable, int] = {}  # equal lines have the same, and so have equal trees
        self._own = {line: numbers.setdefault(_own(line), len(numbers)) for line in chain(self._before, self._after)}
        for line in chain(reversed(self._before), reversed(self._after)):
            below = (self._own[line], *(self._tree[child] for child in line.children))
            self._tree[line] = numbers.setdefault(below, len(numbers))
        self._match(before, after)
        self._everywhere(self._tree.__getitem__, whole=True)
        self._downwards((self._tree.__getitem__, self._own.__getitem__, _named))
        self._everywhere(_uniquely_named)
        self._everywhere(self._own.__getitem__)
        self._downwards((self._own.__getitem__, _named, _kind))

    def _match(self, old: Line, new: Line) -> None:
        self.matches[old] = new
        self._taken.add(new)

    def _free(self, lines: Sequence[Line], taken: Mapping[Line, Any] | set[Line]) -> list[Line]:
        return [line for line in lines if line not in taken]

    def _everywhere(self, key: Callable[[Line], Hashable | None], *, whole: bool = False) -> None:
        """Match lines whose key occurs once in each version. whole: the lines below them match as well."""
        old, new = self._free(self._before, self.matches), self._free(self._after, self._taken)
        once = {k for k, n in Counter(map(key, old)).items() if n == 1 and k is not None}
        found = {k: line for line in new if (k := key(line)) in once}
        many = Counter(k for line in new if (k := key(line)) in once)
        for line in old:
            k = key(line)
            if k in found and many[k] == 1 and line not in self.matches and found[k] not in self._taken:
                pairs = zip(line.walk(), found[k].walk(), strict=True) if whole else [((0, line), (0, found[k]))]
                for (_, first), (_, second) in pairs:
                    self._match(first, second)

    def _downwards(self, keys: Sequence[Callable[[Line], Hashable | None]]) -> None:
        """Match the lines below matched ones, with one key after the other."""
        for old in self._before:  # from the root down: each may match lines below it
            if (new := self.matches.get(old)) is None:
                continue
            for key in keys:
                self._in_order(old.children, new.children, key)

    def _in_order(self, old: Sequence[Line], new: Sequence[Line], key: Callable[[Line], Hashable | None]) -> None:
        """Match lines with equal keys between those that match already."""
        if all(line in self.matches for line in old) or all(line in self._taken for line in new):
            return
        places = {line: at for at, line in enumerate(new)}
        anchors = [
            (at, places[self.matches[line]])
            for at, line in enumerate(old)
            if line in self.matches and self.matches[line] in places
        ]
        first, second = 0, 0
        for stop_old, stop_new in [*anchors, (len(old), len(new))]:
            if stop_new < second:
                continue  # it has moved
            left = self._free(old[first:stop_old], self.matches)
            right = self._free(new[second:stop_new], self._taken)
            blocks = SequenceMatcher(None, [*map(key, left)], [*map(key, right)], autojunk=False).get_matching_blocks()
            for block in blocks:
                for a, b in zip(left[block.a :][: block.size], right[block.b :][: block.size], strict=True):
                    if key(a) is not None:
                        self._match(a, b)
            first, second = stop_old + 1, stop_new + 1


def _own(line: Line) -> Hashable:
    return (line.kind, line.name, tuple(line.content.items()))


def _named(line: Line) -> Hashable | None:
    return (line.kind, line.name or line.title)


def _uniquely_named(line: Line) -> Hashable | None:
    return (line.kind, line.name) if line.name else None


def _kind(line: Line) -> Hashable | None:
    return line.kind if not line.name or line.spot is not None else None


def change_table(changes: Sequence[Change]) -> str:
    """The changes as a table of HTML."""
    rows = []
    for change in changes:
        line = change.after or change.before
        assert line is not None
        shown = [f"<b>{escape(line.title)}</b>"]
        if change.how in ("added", "removed"):
            shown += [f"{escape(key)}: {escape(value)}" for key, value in line.values.items()]
        for key, pair in change.values.items():
            old, new = (escape(value or "-") for value in pair)
            shown.append(f"{escape(key or 'title')}: <del>{old}</del> <ins>{new}</ins>")
        path = escape(" > ".join(change.path))
        rows.append(f'<tr class="{change.how}"><td>{change.how}<td>{path}<td>{"<br>".join(shown)}')
    table = "\n".join(rows) or "<tr><td>no differences"
    return f"<table>\n{table}\n</table>\n"


def change_page(title: str, table: str) -> str:
    """A page for browsers that has nothing but a table of changes."""
    return f"{_PAGE.replace('TITLE', escape(title))}\n{table}"


def change_lines(changes: Sequence[Change]) -> Iterator[str]:
    """The changes as text: a line for each, and one for each value that differs."""
    added = set[Line | None]()
    for change in changes:
        line = change.after or change.before
        assert line is not None
        place = "".join(f"{title} > " for title in change.path)
        if change.how in ("added", "removed"):
            here = line.walk() if change.how == "removed" else [(0, line)]
            within = change.how == "added" and line.parent in added
            added.add(line)
            for depth, each in here:
                yield f"  {'  ' * depth}{each.text}" if depth or within else f"{change.how}: {place}{each.text}"
            continue
        yield f"{change.how}: {place}{line.title}"
        for key, (before, after) in change.values.items():
            yield f"  {key or 'title'}: {before or '-'} -> {after or '-'}"
