"""Expressions of programs: showing them as PolyScope does, and creating them from text."""

from collections.abc import Iterator, Sequence
from typing import Final

from urscript.polyscope.document import Element, make, sharing
from urscript.polyscope.surroundings import FEATURE_TITLES, Surroundings
from urscript.polyscope.tree import tag_of
from urscript.polyscope.writer import PINS

_TOKENS: Final = {"True", "False", "and", "or", "xor", "not"}  # PolyScope's editor inserts these as one token
_SYMBOLS: Final = {"==": "≟", "!=": "≠", "<=": "≤", ">=": "≥"}


def expression_shown(element: Element | None) -> str:
    """An expression as PolyScope shows it."""
    return "" if element is None else "".join(_part_shown(part) for part in element.resolved())


def _part_shown(part: Element) -> str:
    if part.tag == "ExpressionChar":
        return part.get("character")
    if part.tag == "ExpressionToken":
        return part.get("token")
    for child in part.resolved().children:
        name = child.get("name") or child.get("featureName") or child.get("referencedName")
        return FEATURE_TITLES.get(name, name)
    return ""


def expression_of(text: str, program: Surroundings) -> Element:
    """Create an expression from its text. Variables, inputs, outputs and waypoints of the program become places that
    share them, words for which PolyScope's editor has a key become tokens, and all else stays single characters."""
    element = make("expression")
    for part in _parts(text, program):
        part.parent = element
        element.children.append(part)
    return element


def _parts(text: str, program: Surroundings) -> Iterator[Element]:
    variables = set(program.variables())
    waypoints = {place.get("name"): place for place in program.root.places() if tag_of(place) == "Waypoint"}
    pieces = _pieces(text, sorted(program.installation.pins, key=len, reverse=True))
    for index, (piece, is_pin) in enumerate(pieces):
        if is_pin:
            yield make("ExpressionIO", program.named("pin", piece))
        elif piece in variables:
            yield make("ExpressionVariable", program.variable(piece, "ProgramVariable"))
        elif piece in waypoints:
            yield make("ExpressionWaypoint", sharing("Waypoint", waypoints[piece], referenceName=piece))
        elif piece in _TOKENS:
            yield make("ExpressionToken", token=f" {piece} ")
        elif piece in _SYMBOLS:
            yield make("ExpressionChar", character=_SYMBOLS[piece])
        elif piece == " " and any(0 <= at < len(pieces) and pieces[at][0] in _TOKENS for at in (index - 1, index + 1)):
            continue  # the token contains its own blanks
        else:
            for letter in piece:
                yield make("ExpressionChar", character=letter)


def _pieces(text: str, named_pins: Sequence[str]) -> list[tuple[str, bool]]:
    """Words, symbols and strings, each with whether it is an input or output."""
    pieces: list[tuple[str, bool]] = []
    at = 0
    while at < len(text):
        length, is_pin = _piece_length(text, at, named_pins)
        pieces.append((text[at : at + length], is_pin))
        at += length
    return pieces


def _piece_length(text: str, at: int, named_pins: Sequence[str]) -> tuple[int, bool]:
    if text[at] == '"':
        end = text.find('"', at + 1)
        return (end + 1 if end >= 0 else len(text)) - at, False
    starts_word = at == 0 or not _in_word(text[at - 1])
    if starts_word:
        for name in named_pins:
            if text.startswith(name, at) and not _in_word(text[at + len(name) : at + len(name) + 1]):
                return len(name), True
        end = at
        while end < len(text) and _in_word(text[end]):
            end += 1
        word = text[at:end]
        close = text.find("]", end)
        if word in PINS and text[end : end + 1] == "[" and text[end + 1 : close].isdecimal():
            return close + 1 - at, True
        if word:
            return len(word), False
    return (2, False) if text[at : at + 2] in _SYMBOLS else (1, False)


def _in_word(letter: str) -> bool:
    return letter.isalnum() or letter == "_"


def lacks_expression(element: Element) -> bool:
    """Whether a node's expression is empty, which PolyScope shows as undefined."""
    return not expression_shown(element.child("expression")).strip()
