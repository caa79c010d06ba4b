"""Report of a comparison as Markdown, readable in a terminal and ready to paste into an issue."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

from client.decoding import formatting
from client.traffic.compare import Comparison, MessageComparison, MessageDifference, Source
from client.traffic.tracks import base_name
from client.traffic.trajectories import Difference, TrackPair

_ROWS = 15  # of a table
_PARTINGS = 3  # of a connection
_MESSAGES = 3  # of a place
_NAMES = 20
_EXACTLY = 1e-3  # in place of the tolerance of fields without one, such as modes


def report(comparison: Comparison) -> str:
    """The report as text."""
    return "\n".join(_report(comparison)) + "\n"


def as_object(comparison: Comparison) -> dict[str, Any]:
    """The report as an object for JSON."""
    return {
        "same": comparison.same,
        "sources": [
            {"path": str(source.path), "remarks": list(source.remarks), "problems": list(source.problems)}
            for source in (comparison.first, comparison.second)
        ],
        "states": [
            {
                "label": pair.first.label,
                "states": pair.states,
                "columns": pair.columns,
                "offset_s": pair.offset.seconds,
                "only_first": pair.only_first,
                "only_second": pair.only_second,
                "differences": [asdict(difference) for difference in pair.differences],
            }
            for pair in comparison.pairs
        ],
        "unpaired": comparison.unpaired,
        "messages": [asdict(item) for item in comparison.messages],
    }


def _report(comparison: Comparison) -> Iterator[str]:
    yield f"## {'No differences' if comparison.same else 'The recordings differ'}"
    yield ""
    yield from _source("A", comparison.first)
    yield from _source("B", comparison.second)
    yield from _first_difference(comparison)
    yield from _states(comparison)
    yield from _messages(comparison.messages)


def _source(name: str, source: Source) -> Iterator[str]:
    remarks = f" ({formatting.escaped('; '.join(source.remarks))})" if source.remarks else ""
    yield f"- {name}: {formatting.escaped(source.path.name)}{remarks}"
    for problem in source.problems:
        yield f"  - ! {formatting.escaped(problem)}"


def _first_difference(comparison: Comparison) -> Iterator[str]:
    if comparison.differences:
        pair, first = comparison.differences[0]
        moment, unit = first.begins, f" {first.unit}" if first.unit else ""
        yield ""
        yield (
            f"**They diverge {moment.time_s:.3f} s after the start of A, in `{first.column}`**: "
            f"A {moment.first:.6g}{unit}, B {moment.second:.6g}{unit} ({pair.first.label})."
        )


# states


def _states(comparison: Comparison) -> Iterator[str]:
    yield ""
    yield "### States"
    yield ""
    if not comparison.pairs:
        yield "Nothing to compare."
    for pair in comparison.pairs:
        yield from _pair(pair)
    for which, label in comparison.unpaired:
        yield f"- only {which} has {label}"
    if comparison.differences:
        yield from _table(comparison)


def _pair(pair: TrackPair) -> Iterator[str]:
    yield (
        f"- {pair.first.label}: {pair.states} states over {pair.seconds:.1f} s, {pair.columns} columns, "
        f"{len(pair.differences)} beyond their tolerance; {_offset(pair)}"
    )
    for which, names in (("A", pair.only_first), ("B", pair.only_second)):
        if names:
            yield f"  - only {which} has {', '.join(names[:_NAMES])}{_and_more(len(names) - _NAMES)}"
    if not pair.states:
        yield "  - ! the two do not overlap in time; set the offset of their clocks with --offset"


def _offset(pair: TrackPair) -> str:
    clock = f"B's clock is {pair.offset.seconds:+.3f} s against A's"
    return f"{clock}, by {', '.join(pair.offset.by)}" if pair.offset.by else f"{clock}, from the start: nothing moved"


def _table(comparison: Comparison) -> Iterator[str]:
    """For each field, the element furthest beyond its tolerance, from the first pair that has the field."""
    worst: dict[tuple[str, str], Difference] = {}
    for pair in comparison.pairs:
        found: dict[tuple[str, str], Difference] = {}
        for one in sorted(pair.differences, key=_severity):
            found[pair.first.source, base_name(one.column)] = one
        worst = found | worst
    rows = sorted(worst.items(), key=lambda item: _severity(item[1]), reverse=True)
    yield ""
    yield "| interface | column | unit | tolerance | largest | at [s] | A | B | from [s] | states |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    for (source, _), one in rows[:_ROWS]:
        at = one.largest
        yield (
            f"| {source} | {one.column} | {one.unit} | {one.tolerance:g} | {one.size:.4g} | {at.time_s:.3f} | "
            f"{at.first:.6g} | {at.second:.6g} | {one.begins.time_s:.3f} | {one.share:.1%} |"
        )
    if len(rows) > _ROWS:
        yield ""
        yield f"And {len(rows) - _ROWS} more fields."


def _severity(difference: Difference) -> float:
    return difference.size / (difference.tolerance or _EXACTLY)


def _and_more(count: int) -> str:
    return f", and {count} more" if count > 0 else ""


# messages


def _messages(messages: Iterable[MessageComparison]) -> Iterator[str]:
    found = list(messages)
    if not found:
        return
    yield ""
    yield "### Messages"
    yield ""
    for item in found:
        yield f"- {item.name}: {_verdict(item)}"
        for difference in item.partings[:_PARTINGS]:
            yield from _difference(difference)
        if len(item.partings) > _PARTINGS:
            yield f"  - and {len(item.partings) - _PARTINGS} more places"


def _verdict(item: MessageComparison) -> str:
    cut = ", only the first of which were compared" if item.cut else ""
    if not item.partings:
        return f"the same, {item.counts[0]} messages{cut}"
    places = len(item.partings)
    return f"they differ in {places} place{'s' * (places != 1)} ({item.counts[0]} in A, {item.counts[1]} in B{cut})"


def _difference(difference: MessageDifference) -> Iterator[str]:
    yield f"  - after {_code(difference.after)}" if difference.after else "  - at the beginning"
    for which, texts in (("A", difference.first), ("B", difference.second)):
        quoted = "; ".join(_code(text) for text in texts[:_MESSAGES]) or "nothing"
        yield f"    - {which}: {quoted}{_and_more(len(texts) - _MESSAGES)}"


def _code(text: str) -> str:
    return f"`{text.replace('`', chr(39))}`"
