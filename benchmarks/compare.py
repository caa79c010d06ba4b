"""Compares two pages of `make benchmarks`: which figures are not what they were.

    git show HEAD:docs/reference/benchmarks.md > before.md
    make benchmarks && .venv/bin/python benchmarks/compare.py before.md

Rows belong together by what they say up to the last cell that is a word, such as a model. Exit status 1 when a figure
has become worse by more than the limit.
"""

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PAGE: Final = Path(__file__).resolve().parents[1] / "docs" / "reference" / "benchmarks.md"
_LIMIT: Final = 0.10
_FIGURE: Final = re.compile(r"\+?(-?[\d,]*\.?\d+) ?(us|ms|s|MiB|B|%|Hz|mm)?")
_SECONDS: Final = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_ROUNDING: Final = {"us": 0.3, "ms": 0.02, "s": 0.01, "%": 0.2, "MiB": 0.5}
"""Smaller differences mean nothing, whatever share of the figure they are."""
_MORE_IS_BETTER: Final = re.compile(r"/s\b|times real time|setpoints")

Place = tuple[str, str, str]
"""Title of the table, the words of the row, the column."""


@dataclass(frozen=True)
class Change:
    """ratio: new over old. worse: it is more of what there should be less of, or the other way round."""

    place: Place
    old: str
    new: str
    ratio: float
    worse: bool

    def __str__(self) -> str:
        table, row, column = self.place
        verdict = "worse " if self.worse else "better"
        return f"{verdict} x{self.ratio:.2f}  {table} | {row} | {column}: {self.old} -> {self.new}"


def figures(page: str) -> dict[Place, str]:
    """Every figure of a page's tables. A row that says the same words as one before it gets a number."""
    found: dict[Place, str] = {}
    seen: Counter[tuple[str, str]] = Counter()
    for table, columns, cells in _rows(page):
        head = max((index + 1 for index, cell in enumerate(cells) if cell[:1].isalpha()), default=0)
        row = ", ".join(cell for cell in cells[:head] if cell)
        seen[table, row] += 1
        if seen[table, row] > 1:
            row = f"{row} ({seen[table, row]})"
        for column, cell in zip(columns[head:], cells[head:], strict=True):
            if _FIGURE.fullmatch(cell):
                found[table, row, column] = cell
    return found


def changes(old_page: str, new_page: str, limit: float = _LIMIT) -> list[Change]:
    """Figures of both pages that differ by more than a share of the old one, the worst first."""
    old, new = figures(old_page), figures(new_page)
    found = []
    for place in old.keys() & new.keys():
        (before, rounding), (after, _) = _value(old[place]), _value(new[place])
        if not before or abs(after - before) <= rounding or abs(after / before - 1.0) <= limit:
            continue
        worse = (after > before) != bool(_MORE_IS_BETTER.search(place[2]))
        found.append(Change(place, old[place], new[place], after / before, worse))
    return sorted(found, key=lambda change: (not change.worse, -abs(change.ratio - 1.0), change.place))


def _rows(page: str) -> Iterator[tuple[str, list[str], list[str]]]:
    title, columns = "", list[str]()
    for line in page.splitlines():
        if line.startswith("## "):
            title, columns = line[3:], []
        elif line.startswith("|"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if not columns:
                columns = cells
            elif len(cells) == len(columns) and set(line) - set("|- "):
                yield title, columns, cells


def _value(figure: str) -> tuple[float, float]:
    """The number, of times in seconds, and what counts as rounding."""
    match = _FIGURE.fullmatch(figure)
    assert match is not None
    unit = match[2] or ""
    factor = _SECONDS.get(unit, 1.0)
    return factor * float(match[1].replace(",", "")), factor * _ROUNDING.get(unit, 0.0)


def main() -> int:
    """Print what has changed."""
    parser = argparse.ArgumentParser(description="Compare two pages of make benchmarks.")
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path, nargs="?", default=PAGE)
    parser.add_argument("--limit", type=float, default=_LIMIT, help="share of a figure that counts (default 0.1)")
    options = parser.parse_args()
    found = changes(options.old.read_text(), options.new.read_text(), options.limit)
    for change in found:
        sys.stdout.write(f"{change}\n")
    worse = sum(change.worse for change in found)
    sys.stdout.write(f"{worse} figures are worse by more than {options.limit:.0%}, {len(found) - worse} are better.\n")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
