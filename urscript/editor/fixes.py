"""Changes of a text that repair a finding, where the checker says exactly what to write."""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from urscript.check.checking import Finding
from urscript.check.rules.registry import SYNTAX
from urscript.editor.document import Document
from urscript.hints import SIGNS

_SIMILAR: Final = re.compile(r"did you mean '(\w+)'\?$")
_WRITE: Final = re.compile(r"; write '?(True|False|None|and|or|elif|\*)'?$")
_DEGREES: Final = "degrees"
_ROTATION: Final = "the rotation of a pose"
_SIGN: Final = frozenset("+-")
_IGNORED: Final = re.compile(r"(#.*\burscript:[ \t]*ignore\[)([\w, \t]*)\]")


class Fix(NamedTuple):
    """A repair: what to show, whether it is likely what the author wants, and the replacements (offsets and text)."""

    title: str
    likely: bool
    edits: list[tuple[int, int, str]]


def fixes(document: Document, finding: Finding) -> Iterator[Fix]:
    """The repairs of a finding."""
    start, end = document.shown(finding)
    similar, write = _SIMILAR.search(finding.message), _WRITE.search(finding.message)
    if similar:
        yield Fix(f"Write '{similar[1]}'", True, [(start, end, similar[1])])
    elif write:
        while document.text[start - 1 : end] in SIGNS:  # of '&&', the second character may be what does not fit
            start -= 1
        while document.text[start : end + 1] in SIGNS:
            end += 1
        yield Fix(f"Write '{write[1]}'", True, [(start, end, write[1])])
    if _DEGREES in finding.message and (edits := _in_degrees(document, finding)):
        yield Fix("Convert to radians with d2r()", True, edits)
    if finding.code != SYNTAX and (edit := _ignoring(document, finding)):
        yield Fix(f"Ignore {finding.code} on this line", False, [edit])


def _in_degrees(document: Document, finding: Finding) -> list[tuple[int, int, str]]:
    """d2r() around the numbers of the value at a finding; of a pose, around the last three."""
    tokens = document.tokens
    at = first = document.first_token(finding)
    depth, numbers = 0, list[tuple[int, int]]()
    while at < len(tokens) - 1:
        kind = tokens[at].kind
        depth += (kind in "[(") - (kind in "])")
        if kind == "number":
            signed = at > first and tokens[at - 1].kind in _SIGN and tokens[at - 2].kind in ("[", ",", "=", "(")
            numbers.append((document.span(at - signed)[0], document.span(at)[1]))
        at += 1
        if depth <= 0 and kind not in _SIGN and not (kind == "name" and tokens[at].kind == "["):
            break
    numbers = numbers[3:] if _ROTATION in finding.message else numbers
    texts = [(start, end, document.text[start:end]) for start, end in numbers]
    return [(start, end, f"d2r({text})") for start, end, text in texts if float(text.replace(" ", ""))]


def _ignoring(document: Document, finding: Finding) -> tuple[int, int, str] | None:
    """The comment that leaves out a finding; None where a line ends within a string."""
    start = document.places.offset(finding.line, 1)
    line = document.text[start:].split("\n", 1)[0].rstrip("\r")
    known = _IGNORED.search(line)
    if known:
        at = start + known.end(2)
        return at, at, f", {finding.code}" if known[2].strip() else finding.code
    end = start + len(line)
    at = document.token_at(end)
    if document.span(at)[0] < end < document.span(at)[1]:
        return None
    return end, end, f"  # urscript: ignore[{finding.code}]"
