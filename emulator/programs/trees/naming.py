"""Names and texts, as PolyScope writes them into scripts."""

import re
from typing import Final

__all__ = ["identifier", "quoted", "truth"]

_DROPPED: Final = re.compile(r"\W")
_UNNAMED: Final = "unnamed"


def identifier(name: str) -> str:
    """A program's or subprogram's name as the name of a function.

    Blanks become underscores, whatever else cannot be in a name goes (seen in 464 pairs of files).
    """
    text = _DROPPED.sub("", name.replace(" ", "_"))
    if not text:
        return _UNNAMED
    return f"_{text}" if text[0].isdigit() else text


def quoted(text: str) -> str:
    """A text between quotation marks; URScript has no escapes, so marks within become single ones."""
    return '"' + text.replace('"', "'") + '"'


def truth(text: str) -> str:
    """A digital value as URScript: files have 1 and 0, true and false."""
    return "True" if text.strip().lower() in ("1", "true", "on", "high", "hi") else "False"
