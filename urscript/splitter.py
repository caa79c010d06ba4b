"""Split the byte stream of a script port into programs.

A unit is either a block (``def``, ``sec``, ``thread``, ``if`` or ``while`` with everything up to its ``end``) or a
line. The stream may arrive in chunks of any size. A unit is complete when the byte after it has arrived, so a line or a
closing ``end`` without a newline waits. Blank lines and lines with only a comment are dropped.

Inside a block, only words, strings, comments and nesting matter here; the parser decides whether it is a valid program.
A line outside blocks always ends at its newline, so invalid text never swallows the next command.

Every byte is examined a bounded number of times, whatever the chunks: blanks and comments are dropped on arrival, and
everything else is scanned from where the last scan ended.
"""

import re
from dataclasses import dataclass
from typing import Literal

from urproto.text import from_bytes

MAX_UNIT_BYTES = 4_000_000
"""Longest unit [bytes]. A guess: several times the longest real program seen."""

_BLANK = re.compile(rb"(?:[ \t\r\n\f\v]+|\xef\xbb\xbf|#[^\n]*\n)*")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_FIRST_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_]{0,6}")  # one character more than "thread", the longest
_WORD = re.compile(rb"[A-Za-z0-9_]+")
_DULL = re.compile(  # everything but strings, comments, words that nest, and a word that may be incomplete
    rb'(?:[^A-Za-z_"#]+|(?!(?:def|sec|thread|if|while|end)(?![A-Za-z0-9_]))[A-Za-z_][A-Za-z0-9_]*(?![A-Za-z0-9_]|\Z))'
    rb"{0,500}"  # bounded, because the regular expression engine remembers each repetition
)
_OPENING = frozenset([b"def", b"sec", b"thread", b"if", b"while"])
_LONGEST_WORD = max(map(len, _OPENING))  # of the words that matter


@dataclass(frozen=True, slots=True)
class Unit:
    """One program or command, as text.

    `complete` is False for an unfinished unit returned by `flush`. The `text` of a unit of kind ``error`` is the
    beginning of a unit that is too long; the rest of it is discarded up to the next newline.
    """

    text: str
    kind: Literal["block", "line", "error"]
    complete: bool = True


class ScriptSplitter:
    """The splitter of one connection."""

    def __init__(self, max_unit_bytes: int = MAX_UNIT_BYTES) -> None:
        self._max = max_unit_bytes
        self._buffer = bytearray()
        self._skipping = False  # discarding the rest of a unit that was too long
        self._restart()

    def _restart(self) -> None:
        """Reset the state: a new unit may begin at the start of the buffer."""
        self._scanned = 0
        self._start: int | None = None  # where the unit begins, once its kind is known
        self._is_block = False
        self._depth = 0  # open blocks
        self._inside = b""  # '"' in a string, '#' in a comment, 'a' in a word that is too long to matter

    @property
    def pending(self) -> bool:
        """True while an incomplete unit is waiting for more bytes."""
        return bool(bytes(self._buffer).strip())

    def feed(self, data: bytes) -> list[Unit]:
        """Add bytes; returns the units that they complete. Never raises."""
        self.add(data)
        return [*iter(self.next, None)]

    def add(self, data: bytes) -> None:
        """Add bytes, which `next` splits."""
        self._buffer += data

    def next(self) -> Unit | None:
        """The next complete unit; None until more bytes arrive. Never raises."""
        unit = self._next()
        return self._give_up() if unit is None and len(self._buffer) > self._max else unit

    def flush(self) -> list[Unit]:
        """The remaining units when the connection ends; a unit that lacks only its newline is complete."""
        units = self.feed(b"\n")
        if (rest := self.rest()) is not None:
            units.append(rest)
        return units

    def rest(self) -> Unit | None:
        """The rest of a stream that ends in the middle of a unit, which `next` never returns."""
        text = bytes(self._buffer)
        self._buffer.clear()
        self._restart()
        return Unit(from_bytes(text), "block", complete=False) if text.strip() else None

    def _next(self) -> Unit | None:
        if self._skipping and not self._skip_line():
            return None
        if self._start is None and not self._begin():
            return None
        end = self._end_of_block() if self._is_block else self._end_of_line()
        return None if end is None else self._cut(end)

    def _skip_line(self) -> bool:
        newline = self._buffer.find(b"\n")
        del self._buffer[: newline + 1 if newline >= 0 else len(self._buffer)]
        self._skipping = newline < 0
        return newline >= 0

    def _begin(self) -> bool:
        """Determine the kind of the next unit; False while it is not known yet."""
        if not self._drop_blank():
            return False
        buffer, first = self._buffer, self._scanned
        word = _FIRST_WORD.match(buffer, first)
        stop = word.end() if word else first + 1
        rest = buffer[first : first + 3]
        if stop >= len(buffer) or (rest in _BYTE_ORDER_MARK and len(rest) < 3):
            return False
        self._start = first
        self._is_block = word is not None and bytes(word[0]) in _OPENING
        self._depth = int(self._is_block)
        self._scanned = stop if self._is_block else first
        return True

    def _drop_blank(self) -> bool:
        """Drop blank lines and comments, but not the indentation of the next unit; False when nothing follows yet."""
        buffer = self._buffer
        if self._inside:
            if not self._leave():
                buffer.clear()
                self._scanned = 0
                return False
            del buffer[: self._scanned]
            self._scanned = 0
        blank = _BLANK.match(buffer, self._scanned)
        first = blank.end() if blank else self._scanned
        mark = buffer.rfind(_BYTE_ORDER_MARK, self._scanned, first)
        begin = max(buffer.rfind(b"\n", self._scanned, first) + 1, mark + 3 if mark >= 0 else 0)
        del buffer[:begin]
        self._scanned = first - begin
        if buffer.startswith(b"#", self._scanned):
            self._inside = b"#"
            buffer.clear()
            self._scanned = 0
        return self._scanned < len(buffer)

    def _end_of_line(self) -> int | None:
        newline = self._buffer.find(b"\n", self._scanned)
        self._scanned = len(self._buffer)
        return None if newline < 0 else newline

    def _end_of_block(self) -> int | None:
        buffer = self._buffer
        while self._scanned < len(buffer):
            if self._inside:
                if not self._leave():
                    return None
                continue
            dull = _DULL.match(buffer, self._scanned)
            if dull and dull.end() > self._scanned:
                self._scanned = dull.end()
                continue
            at = self._scanned
            if buffer[at] in b'"#':
                self._inside = bytes(buffer[at : at + 1])
                self._scanned += 1
                continue
            word = _WORD.match(buffer, at)
            end = word.end() if word else at
            if end == len(buffer):
                if end > at + _LONGEST_WORD:
                    self._scanned, self._inside = end, b"a"
                return None  # the word may be incomplete
            self._scanned = end
            self._depth += -1 if buffer[at:end] == b"end" else 1
            if self._depth == 0:
                return end
        return None

    def _leave(self) -> bool:
        """Step past the current string, comment or long word; False when its end has not arrived."""
        if self._inside == b"a":
            word = _WORD.match(self._buffer, self._scanned)
            end = word.end() if word else self._scanned
            over, self._scanned = end < len(self._buffer), end
        else:
            end = self._buffer.find(b'"' if self._inside == b'"' else b"\n", self._scanned)
            over, self._scanned = end >= 0, end + 1 if end >= 0 else len(self._buffer)
        if over:
            self._inside = b""
        return over

    def _cut(self, end: int) -> Unit:
        text = from_bytes(bytes(self._buffer[:end])).rstrip("\r")
        kind: Literal["block", "line"] = "block" if self._is_block else "line"
        del self._buffer[:end]
        self._restart()
        return Unit(text, kind)

    def _give_up(self) -> Unit:
        text = from_bytes(bytes(self._buffer[:200]))
        self._buffer.clear()
        self._restart()
        self._skipping = True
        return Unit(text, "error")
