"""PolyScope's expressions: one element per character typed, and one per thing chosen from a list."""

import re
from typing import TYPE_CHECKING, Final

from emulator.programs.trees.document import DocumentError, Element
from emulator.programs.trees.naming import identifier
from emulator.programs.trees.pins import pin_reading

if TYPE_CHECKING:
    from emulator.programs.trees.writer import Writer

__all__ = ["expression_label", "expression_text", "variable_name"]

# what the editor shows -> what the language has; the four that files have
_SYMBOLS: Final = {"≟": " == ", "≠": " != ", "≤": " <= ", "≥": " >= "}
_SYMBOL: Final = re.compile("|".join(_SYMBOLS))
_STRING: Final = re.compile(r'("[^"]*")')
_VARIABLES: Final = ("ProgramVariable", "InstallationVariable", "GeomFeatureVariable")


def expression_text(writer: "Writer", element: Element | None) -> str:
    """URScript of an expression. Raises DocumentError for a part that is not known."""
    if element is None:
        return ""
    text = "".join(_part(writer, part) for part in element.resolved())
    pieces = _STRING.split(text)
    return "".join(piece if index % 2 else _in_script(piece) for index, piece in enumerate(pieces)).strip()


def expression_label(writer: "Writer", element: Element | None) -> str:
    """An expression as the program tree shows it."""
    return "" if element is None else "".join(_part(writer, part) for part in element.resolved())


def variable_name(element: Element | None) -> str:
    """Name, in scripts, of a variable or of a feature used as one. Raises DocumentError when there is none."""
    name = "" if element is None else element.get("name") or element.get("featureName")
    if not name:
        raise DocumentError("a variable has no name")
    return identifier(name)


def _in_script(text: str) -> str:
    return _SYMBOL.sub(lambda match: _SYMBOLS[match[0]], text)


def _part(writer: "Writer", part: Element) -> str:
    if part.tag == "ExpressionChar":
        return part.get("character")
    if part.tag == "ExpressionToken":
        return part.get("token")
    if part.tag == "ExpressionVariable":
        return variable_name(part.child(*_VARIABLES))
    if part.tag == "ExpressionIO" and (pin := part.child("pin")):
        return pin_reading(writer, pin)
    if part.tag == "ExpressionWaypoint" and (waypoint := part.child("Waypoint")):
        return writer.waypoint(waypoint)[0]
    if part.tag == "ExpressionGeomFeature":
        return writer.feature(part.child("feature"), variable=True)
    raise DocumentError(f"an expression has a <{part.tag}>, which is not known")
