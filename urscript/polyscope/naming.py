"""Names and strings as PolyScope writes them into scripts."""

import re
from typing import Final

_DROPPED: Final = re.compile(r"[^A-Za-z0-9_]")
_FOREIGN: Final = re.compile(r"[^\W\d_]", re.UNICODE)
_UNNAMED: Final = "unnamed"


def identifier(name: str) -> str:
    """Convert a name in PolyScope to a name in a script.

    Blanks become underscores, letters outside ASCII their numbers (seen: Cyrillic), and other characters that a name
    cannot contain are dropped (seen in 464 pairs of files).
    """
    text = _FOREIGN.sub(lambda letter: letter[0] if letter[0].isascii() else f"u{ord(letter[0])}", name)
    text = _DROPPED.sub("", text.replace(" ", "_"))
    if not text:
        return _UNNAMED
    return f"_{text}" if text[0].isdigit() else text


def quoted(text: str) -> str:
    """A string literal. URScript has no escapes, so double quotes inside become single quotes."""
    return '"' + text.replace('"', "'") + '"'


def truth(text: str) -> str:
    """A digital value in URScript; files contain 1 and 0, or true and false."""
    return "True" if text.strip().lower() in ("1", "true", "on", "high", "hi") else "False"


def tag_in_words(tag: str) -> str:
    """The tag of a node as its title: of a Java class, ``gui.program.direction.MoveDirectionNode``, Move direction."""
    words = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in tag.rpartition(".")[2])
    return words.removesuffix(" node").strip().capitalize()
