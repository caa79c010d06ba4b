"""The program of a test: the files under test, the mocks and the test file as nested functions, then calls of the test.

Every function of a program may be called everywhere in it, however deep it is nested. A file with functions is
therefore inserted as it is, and so is a file with a single program, which becomes a function; its variables become
those of the whole, so that its own functions and the tests can see them. Lines keep their text, except that a call of a
mocked function becomes a call of the mock.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from urproto.text import from_bytes, to_bytes
from urscript.errors import CompileError, ScriptError
from urscript.files import FileUnit, ScriptFile, split_steps
from urscript.parser import normalize, parse
from urscript.work import run_to_end

_NAME: Final = "urscript_test"
_DEFINED: Final = re.compile(r"\s*(def|thread)\s+(\w+)\s*\(\s*(\)?)")
_MOCK: Final = re.compile(r"^\s*(?:def|thread)\s+mock_(\w+)\s*\(", re.MULTILINE)
_SECONDARY: Final = re.compile(r"\s*sec\s")
_PREFIX: Final = "mock_"


@dataclass(frozen=True, slots=True)
class Place:
    """A position in a file."""

    path: Path
    line: int
    column: int = 1


@dataclass(frozen=True, slots=True)
class Definition:
    """A function that a file defines, and where its text begins and ends."""

    name: str
    line: int
    begin: int
    end: int


class Source:
    """A file to insert. Raises OSError; ScriptError if it is not a program or a collection of functions."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = from_bytes(path.read_bytes()).replace("\r\n", "\n").removeprefix("\ufeff")
        self.definitions: list[Definition] = []
        position, others = 0, False
        for unit in run_to_end(split_steps(self.text)):
            text = unit.text.rstrip("\n")
            position = self.text.index(text, position)
            line = self.text.count("\n", 0, position) + 1
            if found := _DEFINED.match(text):
                self.definitions.append(Definition(found[2], line, position, position + len(text)))
                others = others or found[1] == "thread" or not found[3]
            elif _SECONDARY.match(text):
                raise CompileError.syntax("a secondary program cannot be tested with others", line, 1, self.text)
            others = others or (found is None and bool(normalize(text)))
            position += len(text)
        self.is_program = len(self.definitions) == 1 and not others

    @property
    def mocks(self) -> list[str]:
        """The names of the functions that it mocks."""
        return _MOCK.findall(self.text)

    def variables(self) -> list[str]:
        """The variables of the program, which its functions share; none for a collection of functions."""
        if not self.is_program:
            return []
        return list(run_to_end(parse(normalize(self.text), [])).globals)

    def lines(self, mocks: Iterable[str]) -> list[tuple[str, tuple[int, ...]]]:
        """The lines with calls of mocks, and the columns at which the prefix of a mock was inserted."""
        inside = {one.name: range(one.begin, one.end) for one in self.definitions}
        names = "|".join(map(re.escape, mocks))
        others = r'"[^"]*"|#[^\n]*|\b(?:def|thread)\s+\w+'
        calls = re.compile(rf"{others}|(?<![\w.])({names})(?=\s*\()" if names else r"(?!)")
        inserted: dict[int, list[int]] = {}
        pieces, done = [], 0
        for found in calls.finditer(self.text):
            if found[1] is None or found.start() in inside.get(_PREFIX + found[1], ()):
                continue  # a text, a comment or a definition; or a mock that calls the real function
            pieces += [self.text[done : found.start()], _PREFIX]
            done = found.start()
            line = self.text.count("\n", 0, done)
            inserted.setdefault(line, []).append(done - self.text.rfind("\n", 0, done))
        text = "".join([*pieces, self.text[done:]])
        return [(line, tuple(inserted.get(number, ()))) for number, line in enumerate(text.split("\n"))]


class PlacedError(ScriptError):
    """An error at a position in one of the files of a test."""

    def __init__(self, message: str, place: Place, source: str) -> None:
        super().__init__(message, place.line, place.column, source)
        self.place = place

    def render(self, file: str = "") -> str:
        return super().render(str(self.place.path))


@dataclass(slots=True)
class _Lines:
    """Lines of a program, and for each its file, its line there, and the columns where something was inserted."""

    texts: list[str] = field(default_factory=list)
    origins: list[tuple[Source, int, tuple[int, ...]] | None] = field(default_factory=list)

    def add(self, *texts: str) -> None:
        self.texts += texts
        self.origins += [None] * len(texts)

    def insert(self, source: Source, mocks: Iterable[str]) -> None:
        for number, (text, inserted) in enumerate(source.lines(mocks), 1):
            self.texts.append(text)
            self.origins.append((source, number, inserted))


class TestProgram(ScriptFile):
    """The program of a test. tested: the files under test. calls: statements at its end.

    assigns: whether it begins with an assignment to each variable of the tested program, so that it exists. Raises
    CompileError for a file that cannot be inserted.
    """

    __test__ = False  # not a class of tests for pytest

    def __init__(
        self,
        tested: Sequence[Source],
        mocks: Sequence[Source],
        test: Source,
        calls: Iterable[str],
        *,
        assigns: bool = True,
    ) -> None:
        mocked = dict.fromkeys(name for source in (*mocks, test) for name in source.mocks)
        lines = _Lines()
        lines.add(f"def {_NAME}():")
        self.variables = dict.fromkeys(name for source in tested for name in source.variables())
        if self.variables and assigns:
            lines.add("if False:", *(f"{name} = 0" for name in self.variables), "end")
        for source in (*tested, *mocks, test):
            lines.insert(source, mocked)
        lines.add(*calls, "end")
        self._origins = lines.origins
        super().__init__(_NAME, to_bytes("\n".join(lines.texts) + "\n"))

    def place(self, line: int, column: int = 1) -> Place | None:
        """The place in a file of a position in the program; None for a line that is in no file."""
        origin = self._origins[line - 1] if 0 < line <= len(self._origins) else None
        if origin is None:
            return None
        source, number, inserted = origin
        shift = sum(len(_PREFIX) for place, at in enumerate(inserted) if at + place * len(_PREFIX) < column)
        return Place(source.path, number, max(1, column - shift))

    def located(self, error: ScriptError, unit: FileUnit) -> ScriptError:
        """Convert the position of an error to one in a file."""
        place = self.place(error.line + unit.lines_before, error.column)
        origin = self._origins[error.line - 1] if place else None
        return PlacedError(error.message, place, origin[0].text) if place and origin else super().located(error, unit)
