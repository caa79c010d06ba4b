"""Line and branch coverage of the files under test.

A line is covered if a statement on it was executed. A branch is where an ``if`` or ``while`` continues: the first
statement of a block or, if there is none for the case, whatever follows.
"""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

from emulator.builtins.host import ProgramHost
from urscript.compiler import FILE_NAME
from urscript.parser import normalize, parse
from urscript.runtime import ScriptThread
from urscript.scripttest.program import TestProgram
from urscript.syntax import Constant, FunctionDef, If, Statement, While, all_statements
from urscript.work import run_to_end

Position: TypeAlias = tuple[int, int]
"""Line and column."""

_ELSEWHERE: Final = (0, 0)


class StepCounter:
    """The step hook of a run: counts statements, and the ways from one to the next in the same call of a function."""

    def __init__(self) -> None:
        self.hits: Counter[Position] = Counter()
        self.ways: Counter[tuple[Position, Position]] = Counter()
        self._last: dict[int, Position] = {}  # by the identity of the frame of the call

    def __call__(self, _host: ProgramHost, line: int, column: int, _thread: ScriptThread) -> bool:
        frame = sys._getframe(1)
        while frame.f_code.co_filename != FILE_NAME and frame.f_back is not None:
            frame = frame.f_back
        place = (line, column)
        self.hits[place] += 1
        if (before := self._last.get(id(frame))) is not None:
            self.ways[before, place] += 1  # if the call is another one, its predecessor ended after `before`
        self._last[id(frame)] = place
        return False

    def end(self) -> None:
        """Add the ends of the calls."""
        self.ways.update((place, _ELSEWHERE) for place in self._last.values())
        self._last.clear()


@dataclass
class FileCoverage:
    """Counts for one file. lines: by line. branches: for the line and column of each decision, by alternative."""

    lines: dict[int, int] = field(default_factory=dict)
    branches: dict[Position, list[int]] = field(default_factory=dict)

    def add(self, other: "FileCoverage") -> None:
        for line, count in other.lines.items():
            self.lines[line] = self.lines.get(line, 0) + count
        for place, counts in other.branches.items():
            known = self.branches.get(place, [0] * len(counts))
            self.branches[place] = [a + b for a, b in zip(known, counts, strict=True)]

    @property
    def missed_lines(self) -> list[int]:
        return sorted(line for line, count in self.lines.items() if not count)

    @property
    def all_branches(self) -> list[int]:
        return [count for counts in self.branches.values() for count in counts]


Coverage: TypeAlias = dict[Path, FileCoverage]
"""The coverage of each file."""


def coverage_of(program: TestProgram, tested: Iterable[Path], steps: StepCounter) -> Coverage:
    """The coverage of the files under test by a run of a program."""
    steps.end()
    found: Coverage = {path: FileCoverage() for path in tested}
    for statement in _statements(program):
        place = program.place(statement.line, statement.column)
        if place is None or place.path not in found:
            continue
        file = found[place.path]
        file.lines[place.line] = max(file.lines.get(place.line, 0), steps.hits[statement.line, statement.column])
        if isinstance(statement, If | While) and (counts := _alternatives(statement, steps.ways)):
            file.branches[place.line, place.column] = counts
    return found


def _statements(program: TestProgram) -> Iterator[Statement]:
    tree = run_to_end(parse(normalize(program.text), []))
    for body in (tree.body, *(function.body for function in tree.functions.values())):
        yield from all_statements(body)


def _alternatives(statement: If | While, ways: Mapping[tuple[Position, Position], int]) -> list[int]:
    """How often the statement continued with each block, and how often with none; empty if it has no choice."""
    here = (statement.line, statement.column)
    if isinstance(statement, While):
        blocks, otherwise = [statement.body], not isinstance(statement.condition, Constant)
    else:
        blocks, otherwise = [body for _, body in statement.branches], not statement.otherwise
        blocks += [statement.otherwise] if statement.otherwise else []
    starts = [_start(block) for block in blocks]
    if None in starts:
        return []
    counts = [ways.get((here, start), 0) for start in starts if start]
    if otherwise:
        counts.append(sum(count for (begin, end), count in ways.items() if begin == here and end not in starts))
    return counts if len(counts) > 1 else []


def _start(block: list[Statement]) -> Position | None:
    return next(((one.line, one.column) for one in block if not isinstance(one, FunctionDef)), None)


# reports


def merged(runs: Iterable[Coverage]) -> Coverage:
    """The coverage of all runs together."""
    total: Coverage = {}
    for run in runs:
        for path, file in run.items():
            total.setdefault(path, FileCoverage()).add(file)
    return dict(sorted(total.items()))


def coverage_table(coverage: Coverage) -> str:
    """A table with a row per file: lines and branches that were covered, and the lines that were not."""
    rows = [("file", "lines", "branches", "missing lines")]
    for path, file in coverage.items():
        branches = file.all_branches
        lines = len(file.lines)
        rows.append(
            (
                str(path),
                _share(lines - len(file.missed_lines), lines),
                _share(sum(count > 0 for count in branches), len(branches)),
                ", ".join(_ranges(file.missed_lines)),
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _share(covered: int, total: int) -> str:
    return f"{covered}/{total} ({covered / total:.0%})" if total else "-"


def _ranges(lines: list[int]) -> Iterator[str]:
    """The lines, with neighbours together: 3-5, 9."""
    for first in (line for line in lines if line - 1 not in lines):
        last = first
        while last + 1 in lines:
            last += 1
        yield str(first) if first == last else f"{first}-{last}"


def lcov(coverage: Coverage) -> str:
    """The coverage as an lcov trace file."""
    lines: list[str] = []
    for path, file in coverage.items():
        lines += ["TN:", f"SF:{path.absolute()}"]
        for block, ((line, _), counts) in enumerate(sorted(file.branches.items())):
            reached = file.lines.get(line, 0)
            lines += [f"BRDA:{line},{block},{n},{count if reached else '-'}" for n, count in enumerate(counts)]
        branches = file.all_branches
        lines += [f"BRF:{len(branches)}", f"BRH:{sum(count > 0 for count in branches)}"]
        lines += [f"DA:{line},{count}" for line, count in sorted(file.lines.items())]
        lines += [f"LF:{len(file.lines)}", f"LH:{len(file.lines) - len(file.missed_lines)}", "end_of_record"]
    return "\n".join([*lines, ""])
