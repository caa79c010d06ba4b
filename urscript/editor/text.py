"""Places in a text, as URScript counts them and as editors do.

URScript counts lines and columns from 1, in characters, and ends a line at a line feed only. Editors count from 0, in
units of UTF-16, and end a line at a carriage return as well. Between the two, a place is an offset in characters.
"""

import re
from bisect import bisect_right
from typing import Final, TypeAlias

from urscript.tokens import Token

EditorPlace: TypeAlias = tuple[int, int]
"""Line and column, from 0, the column in units of UTF-16."""

_LINE_END: Final = re.compile(r"\r\n|\r|\n")


class Places:
    """Converts the places of one text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._plain = text.isascii()
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        self._rows = [0, *(match.end() for match in _LINE_END.finditer(text))] if "\r" in text else self._starts

    def offset(self, line: int, column: int) -> int:
        """The offset of a place of URScript."""
        at = self._starts[min(max(line, 1), len(self._starts)) - 1]
        return min(at + max(column, 1) - 1, len(self.text))

    def line(self, offset: int) -> int:
        """URScript's line at an offset."""
        return bisect_right(self._starts, offset)

    def start(self, token: Token) -> int:
        """The offset at which a token begins."""
        return self.offset(token.line, token.column)

    def place(self, offset: int) -> EditorPlace:
        """The editor's place of an offset."""
        row = bisect_right(self._rows, offset) - 1
        start = self._rows[row]
        return row, offset - start if self._plain else _units(self.text[start:offset])

    def offset_of(self, place: EditorPlace) -> int:
        """The offset of an editor's place; a place beyond the end of a line is the end."""
        row, column = place
        if row >= len(self._rows):
            return len(self.text)
        start = self._rows[row]
        end = self._rows[row + 1] if row + 1 < len(self._rows) else len(self.text)
        line = self.text[start:end].rstrip("\r\n")
        if self._plain:
            return start + min(column, len(line))
        for at, letter in enumerate(line):
            if column <= 0:
                return start + at
            column -= 2 if letter > "\uffff" else 1
        return start + len(line)


def _units(text: str) -> int:
    """Length in units of UTF-16."""
    return len(text) + sum(letter > "\uffff" for letter in text)
