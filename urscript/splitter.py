"""Cutting the byte stream of a script port into programs.

A unit is either a block (``def``, ``sec``, ``thread``, ``if`` or ``while`` with everything up to
its ``end``) or a line. Text comes in any pieces; a unit is complete when the byte after it has
arrived, so a line or a closing ``end`` without a newline waits. Blank lines and lines that hold
only a comment are dropped.

Inside a block only words, strings, comments and nesting are looked at: whether it is a program is
for the parser to say. A line outside blocks ends at its newline whatever it holds, so junk never
swallows the next command.

Every byte is looked at a bounded number of times, however the text is cut: what is blank or comment is dropped as it
comes, and everything else is gone on with where the last look ended.
"""

import re
from dataclasses import dataclass
from typing import Literal

from urproto.text import from_bytes

MAX_UNIT_BYTES = 4_000_000
"""Longest unit [bytes]. A guess: several times the longest program seen in the wild."""

_BLANK = re.compile(rb"(?:[ \t\r\n\f\v]+|\xef\xbb\xbf|#[^\n]*\n)*")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_FIRST_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_]{0,6}")  # as far as it takes to know that it opens no block
_WORD = re.compile(rb"[A-Za-z0-9_]+")
_DULL = re.compile(  # all but strings, comments, the words that nest, and a word that may go on
    rb'(?:[^A-Za-z_"#]+|(?!(?:def|sec|thread|if|while|end)(?![A-Za-z0-9_]))[A-Za-z_][A-Za-z0-9_]*(?![A-Za-z0-9_]|\Z))'
    rb"{0,500}"  # of which it remembers each
)
_OPENING = frozenset([b"def", b"sec", b"thread", b"if", b"while"])
_LONGEST_WORD = max(map(len, _OPENING))  # of those that matter


@dataclass(frozen=True, slots=True)
class Unit:
    """One program or command, as text.

    `complete` is False for what `flush` found unfinished. A unit of kind ``error`` holds in `text`
    the beginning of something too long; the rest of it is lost up to the next newline.
    """

    text: str
    kind: Literal["block", "line", "error"]
    complete: bool = True


class ScriptSplitter:
    """One per connection."""

    def __init__(self, max_unit_bytes: int = MAX_UNIT_BYTES) -> None:
        self._max = max_unit_bytes
        self._buffer = bytearray()
        self._skipping = False  # the rest of a line that was too long
        self._restart()

    def _restart(self) -> None:
        """At the start of the buffer a new unit may begin."""
        self._scanned = 0
        self._start: int | None = None  # where the unit begins, once its kind is known
        self._is_block = False
        self._depth = 0  # open blocks
        self._inside = b""  # '"' in a string, '#' in a comment, 'a' in a word that is too long to matter

    @property
    def pending(self) -> bool:
        """True while the beginning of a unit waits for the rest of it."""
        return bool(bytes(self._buffer).strip())

    def feed(self, data: bytes) -> list[Unit]:
        """The units that these bytes complete. Never raises."""
        self.add(data)
        return [*iter(self.next, None)]

    def add(self, data: bytes) -> None:
        """Take bytes, for `next` to look at."""
        self._buffer += data

    def next(self) -> Unit | None:
        """The next unit that is complete; None until more bytes come. Never raises."""
        unit = self._next()
        return self._give_up() if unit is None and len(self._buffer) > self._max else unit

    def flush(self) -> list[Unit]:
        """What is left when the connection ends: units that only miss a newline are complete."""
        units = self.feed(b"\n")
        if (rest := self.rest()) is not None:
            units.append(rest)
        return units

    def rest(self) -> Unit | None:
        """What `next` never will complete: the end of a stream that ends in the middle of a unit."""
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
        """Find out what begins; False while that is not known yet."""
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
        """Drop blank lines and comments, but not the indentation of what begins; False when nothing follows yet."""
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
                return None  # the word may go on
            self._scanned = end
            self._depth += -1 if buffer[at:end] == b"end" else 1
            if self._depth == 0:
                return end
        return None

    def _leave(self) -> bool:
        """Step past the string, comment or long word; False when its end has not arrived."""
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
