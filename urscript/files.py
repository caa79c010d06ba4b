"""Script files: the programs they contain, and where in the file each one begins.

A file has one of two forms, which `is_inlined` tells apart by its contents: programs one after the other, as a client
sends them to a script port, or the text of a Script node, which PolyScope puts into the body of a program. All code
that reads script files uses this module, so that a file is interpreted the same everywhere.
"""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from urproto.compat import Self
from urproto.text import from_bytes, to_bytes, words
from urproto.versions import PolyscopeVersion
from urscript.blocks import Blocks
from urscript.builtins import LibrarySet
from urscript.compiler import NOTHING, Inspect, Known, find_problems
from urscript.errors import CompileError, ScriptError, ScriptWarning
from urscript.parser import is_secondary, normalize
from urscript.splitter import ScriptSplitter, Unit
from urscript.work import Steps, run_to_end

_ENDED_BEFORE: Final = "the program ended before this"
_OTHER_LINE: Final = re.compile(r"(\b(?:on|of) line |(?:;|error:) line )(\d+)\b")
_CLOSING: Final = ("end", "else", "elif")
_SIGNATURE: Final = re.compile(r"\s*(def|thread)\s+(\w+)\s*\(\s*([^)]?)")
_WORD: Final = re.compile(r'"[^"]*"|#[^\n]*|([A-Za-z_]\w*)\s*([=(]?)(?!=)')
_NO_WORD: Final = re.compile(r"\W", re.ASCII)
_MOST_TRIES: Final = 5  # surplus ends of a file that are explained: each means to read the text twice
_PIECE_CHARACTERS: Final = 4096
_PIECE_COST: Final = 200  # measured: 50 microseconds for 1000 characters
_WORDS: Final = 64  # between two yields
_WORD_COST: Final = 1  # measured: 0.5 microseconds


def split_steps(text: str) -> Steps[list[Unit]]:
    """The units into which a script port would split a text."""
    splitter = ScriptSplitter()
    units: list[Unit] = []
    for start in range(0, len(text), _PIECE_CHARACTERS):
        units += splitter.feed(to_bytes(text[start : start + _PIECE_CHARACTERS]))
        yield _PIECE_COST
    return units + splitter.flush()


def is_inlined(units: Sequence[Unit]) -> Steps[bool]:
    """Whether the units of a text belong to one Script node rather than being separate programs.

    They do when a def has parameters, which a program does not have, or when one unit uses a name that another defines,
    which separate programs cannot do. A text that begins with a statement is a single program anyway.
    """
    if not units or units[0].kind != "block":
        return False
    signatures = [_SIGNATURE.match(unit.text) if unit.kind == "block" else None for unit in units]
    if any(found and found[1] == "def" and found[3] for found in signatures):
        return True
    names = [found[2] if found else "" for found in signatures]
    defined = set(filter(None, names))
    assigned: set[str] = set()  # by units that are lines; variables of a function are local to it
    for unit, found, name in zip(units, signatures, names, strict=True):
        for number, word in enumerate(_WORD.finditer(unit.text, found.end() if found else 0)):
            if number % _WORDS == 0:
                yield _WORDS * _WORD_COST
            called = word[1] in defined and word[2] == "("
            if called or (not name and word[1] in assigned):
                return True
        if unit.kind == "line":
            assigned |= {word[1] for word in _WORD.finditer(unit.text) if word[2] == "="}
    return False


def inlined(name: str, text: str) -> str:
    """The text of a Script node as a program; its lines keep their numbers. name: for example that of the file."""
    word = _NO_WORD.sub("_", name) or "program"
    return f"def {'_' if word[0].isdigit() else ''}{word}(): {text}\nend\n"


@dataclass(frozen=True, slots=True)
class FileUnit:
    """One program of a file.

    text: as sent to a controller. lines_before: number of lines in the file before line 1 of the program.
    columns_before: by how many characters its line 1 is longer than the line in the file.
    """

    text: str
    lines_before: int
    block: bool  # a def, sec, thread, if or while; otherwise a line
    columns_before: int = 0

    @property
    def secondary(self) -> bool:
        """True for a ``sec`` program, which runs alongside others."""
        return is_secondary(self.text)

    @property
    def indentation(self) -> int:
        """Number of characters before its first word."""
        return len(self.text) - len(self.text.lstrip())

    @property
    def _stray_end(self) -> bool:
        return not self.block and _is_stray(self.text)


def _is_stray(line: str) -> bool:
    return words(line)[0].rstrip(":") in _CLOSING


class _Part(NamedTuple):
    """A program with its problems. position: its offset in the text."""

    unit: FileUnit
    position: int
    problems: list[ScriptError]


class ScriptFile:
    """The text of a file and the programs it contains. ``name`` appears in error messages."""

    def __init__(self, name: str, data: bytes) -> None:
        self.name = name
        self.text = from_bytes(data).replace("\r\n", "\n").removeprefix("\ufeff")
        self._units = run_to_end(split_steps(self.text))
        self.inlined = run_to_end(is_inlined(self._units))
        self.units = self._programs()

    @classmethod
    def read(cls, name: str) -> Self:
        """Read the file of this name, or standard input for ``-``. Raises OSError."""
        if name == "-":
            return cls("<stdin>", sys.stdin.buffer.read())
        return cls(name, Path(name).read_bytes())

    def _programs(self) -> list[FileUnit]:
        if self.inlined:
            text = inlined(Path(self.name).stem, self.text)
            return [FileUnit(text, 0, block=True, columns_before=text.index(self.text))]
        if not self._units or self._units[0].kind != "block":
            return [self._program(self.text, 0, block=False)] if normalize(self.text) else []
        return [self._program(unit.text.rstrip("\n"), at, block=unit.kind == "block") for unit, at in self._places()]

    def _places(self) -> list[tuple[Unit, int]]:
        """The units, and where in the text each begins."""
        places = []
        position = 0
        for unit in self._units:
            text = unit.text.rstrip("\n")  # the splitter may have added one
            position = self.text.index(text, position)
            places.append((unit, position))
            position += len(text)
        return places

    def _program(self, text: str, position: int, *, block: bool) -> FileUnit:
        code = normalize(text)
        start = position + len(text) - len(code)
        return FileUnit(code, self.text.count("\n", 0, start), block)

    def problems(
        self,
        libraries: LibrarySet,
        version: PolyscopeVersion,
        known: Known = NOTHING,
        inspect: Inspect = lambda *_: (),
        blocks: Blocks | None = None,
    ) -> list[ScriptError]:
        """The problems of all programs, with lines counted from the beginning of the file.

        blocks: those of earlier states of the file.

        After a surplus ``end``, the rest of a program looks like separate commands whose variables are not defined. In
        that case, only the ``end`` is reported.
        """

        def find(text: str, *, statements: bool = False) -> list[ScriptError]:
            return find_problems(text, libraries, version, known, inspect, statements=statements, blocks=blocks)

        if self.inlined:
            return self._problems_inlined(find)
        parts: list[_Part] = []
        tries = 0
        places = self._places() if len(self.units) > 1 else [(None, 0)]
        for unit, (_, position) in zip(self.units, places, strict=False):
            parts.append(_Part(unit, position, [self.located(problem, unit) for problem in find(unit.text)]))
            if unit._stray_end and (tries := tries + 1) <= _MOST_TRIES:
                if whole := self._as_one(parts, len(self.text), find):
                    return [problem for part in whole for problem in part.problems]
                end = position + len(unit.text)
                parts = self._as_one(parts, end, find) or _without_unknown_names(parts)
        return [problem for part in parts for problem in part.problems]

    def _as_one(self, parts: list[_Part], end: int, find: Callable[..., list[ScriptError]]) -> list[_Part]:
        """Parts, of which the last one is a surplus ``end``, if all up to an offset was meant to be one block.

        It is one that ended too early: the last one that is indented like the ``end``. Empty when the text does not
        support that.
        """
        blocks = [at for at, part in enumerate(parts) if part.unit.block]
        if not blocks:
            return []
        indentation = parts[-1].unit.indentation
        first = [at for at in blocks if parts[at].unit.indentation == indentation or at == blocks[0]][-1]
        block = parts[first]
        problems = find(self.text[block.position : end])
        if any(_ENDED_BEFORE in problem.message for problem in problems):
            return []
        return [*parts[:first], block._replace(problems=[self.located(problem, block.unit) for problem in problems])]

    def _problems_inlined(self, find: Callable[..., list[ScriptError]]) -> list[ScriptError]:
        whole = self._program(self.text, 0, block=False)
        found = find(whole.text, statements=True)
        problems = [self.located(problem, whole) for problem in found]
        outside: range = range(0)  # lines after the last block
        for unit, position in self._places():
            line = self.text.count("\n", 0, position) + 1
            if unit.kind == "block":
                outside = range(line + unit.text.count("\n") + 1, sys.maxsize)
            elif _is_stray(unit.text):
                problems = [p for p in problems if not (_is_unknown_name(p) and p.line in outside and p.line < line)]
        return problems

    def located(self, error: ScriptError, unit: FileUnit) -> ScriptError:
        """Convert the position of an error in one of the programs to a position in the file."""
        line, column = error.line + unit.lines_before, error.column
        message = _OTHER_LINE.sub(lambda found: f"{found[1]}{int(found[2]) + unit.lines_before}", error.message)
        if error.line == 1:
            column = max(1, column - unit.columns_before)
        if isinstance(error, CompileError):
            return CompileError(message, line, column, self.text, error.wire)
        if isinstance(error, ScriptWarning):
            return ScriptWarning(message, line, column, self.text, error.kind)
        return ScriptError(message, line, column, self.text)


def _without_unknown_names(parts: list[_Part]) -> list[_Part]:
    """Parts without the unknown names after the last block, which may have ended too early."""
    after = max((at for at, part in enumerate(parts) if part.unit.block), default=-1) + 1
    certain = ([problem for problem in part.problems if not _is_unknown_name(problem)] for part in parts[after:])
    return [*parts[:after], *(part._replace(problems=left) for part, left in zip(parts[after:], certain, strict=True))]


def _is_unknown_name(problem: ScriptError) -> bool:
    return isinstance(problem, CompileError) and problem.unknown_name
