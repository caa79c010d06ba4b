"""Files of scripts: which programs they hold, and where in the file each of them is."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.compiler import find_problems
from urscript.errors import CompileError, ScriptError
from urscript.parser import is_secondary, normalize
from urscript.splitter import ScriptSplitter
from urscript.values import from_bytes

__all__ = ["FileUnit", "ScriptFile"]

_CLOSING = ("end", "else", "elif")


@dataclass(frozen=True, slots=True)
class FileUnit:
    """One program of a file. ``lines_before``: how many lines of the file come before its line 1."""

    text: str
    lines_before: int
    block: bool  # a def, sec, thread, if or while; otherwise a line

    @property
    def secondary(self) -> bool:
        """True for a ``sec`` program, which runs beside others."""
        return is_secondary(self.text)

    @property
    def _stray_end(self) -> bool:
        return not self.block and self.text.split(None, 1)[0].rstrip(":") in _CLOSING


class ScriptFile:
    """The text of a file, cut into programs as a script port would.

    A file that begins with a statement is one program: PolyScope includes such files in the
    body of another. ``name`` is what error messages call it.
    """

    def __init__(self, name: str, data: bytes) -> None:
        self.name = name
        self.text = from_bytes(data).replace("\r\n", "\n").removeprefix("\ufeff")
        self.units = self._split()

    @classmethod
    def read(cls, name: str) -> Self:
        """The file of this name, or standard input for ``-``. Raises OSError."""
        if name == "-":
            return cls("<stdin>", sys.stdin.buffer.read())
        return cls(name, Path(name).read_bytes())

    def _split(self) -> list[FileUnit]:
        splitter = ScriptSplitter()
        units = [*splitter.feed(self.text.encode("utf-8", "surrogateescape")), *splitter.flush()]
        if not units or units[0].kind != "block":
            return [self._unit(self.text, 0, block=False)] if normalize(self.text) else []
        found: list[FileUnit] = []
        position = 0
        for unit in units:
            text = unit.text.rstrip("\n")  # one may come from the splitter
            position = self.text.index(text, position)
            found.append(self._unit(text, position, block=unit.kind == "block"))
            position += len(text)
        return found

    def _unit(self, text: str, position: int, *, block: bool) -> FileUnit:
        code = normalize(text)
        start = position + len(text) - len(code)
        return FileUnit(code, self.text.count("\n", 0, start), block)

    def problems(self, libraries: LibrarySet, version: PolyscopeVersion) -> list[ScriptError]:
        """What is wrong with each of the programs, with lines counted from the beginning of the file.

        After an ``end`` too many, the rest of a program looks like commands of their own, whose
        variables nobody knows: of that, only the ``end`` is reported.
        """
        found: list[ScriptError] = []
        outside: list[ScriptError] = []  # in lines behind the last block
        for unit in self.units:
            problems = [self.located(problem, unit) for problem in find_problems(unit.text, libraries, version)]
            if unit.block:
                found += outside
                outside = []
            elif unit._stray_end:
                outside = [p for p in outside if isinstance(p, CompileError) and not p.wire.startswith("compile_error")]
            outside += problems
        return found + outside

    def located(self, error: ScriptError, unit: FileUnit) -> ScriptError:
        """An error of one of the programs as an error of the file."""
        line = error.line + unit.lines_before
        if isinstance(error, CompileError):
            return CompileError(error.message, line, error.column, self.text, error.wire)
        return ScriptError(error.message, line, error.column, self.text)
