"""Plants bugs one at a time, and reports which of them are found by the tests of their subject.

    python tests/mutants/mutants.py                 all of mutants.toml
    python tests/mutants/mutants.py urscript motion those with one of the words in their package or tests

Each is planted in a copy of the repository, never in the repository itself. First, each test file runs once without a
bug, since a test that fails anyway finds nothing. The exit status is 1 if tests fail without a bug, if the place of a
mutant no longer exists (fix its `before`; an ordinary test reports it, too), if a mutant is found or missed contrary to
the list, or if too few of all mutants are found.

A mutant in mutants.toml:

    package   the folder or file that contains `before` exactly once
    before    a piece of code; line breaks and indentation do not matter
    after     its replacement
    tests     test files, or single tests by their pytest ids, that should find it
    missed    only for a mutant that no test finds: why this is acceptable
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from compileall import compile_dir
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode
from queue import SimpleQueue
from typing import TypeVar

from urproto.compat import load_toml

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.toml")
MIN_MUTANTS = 100
"""Minimum number of mutants."""
MIN_FOUND = 0.9
"""Minimum fraction of mutants that must be found."""
PATIENCE_S = 300.0

_T = TypeVar("_T")


@dataclass(frozen=True)
class Mutant:
    package: str
    before: str
    after: str
    tests: tuple[str, ...]
    missed: str = ""

    def __str__(self) -> str:
        return f"{self.package}: {' '.join(self.before.split())}  ->  {' '.join(self.after.split())}"


class GoneError(Exception):
    """The place of a mutant or its tests are missing or ambiguous."""


def read_list(path: Path) -> list[Mutant]:
    rows = load_toml(path.read_text())["mutant"]
    return [Mutant(**{**row, "tests": tuple(row["tests"])}) for row in rows]


def changed(mutant: Mutant, tree: Path) -> tuple[Path, str]:
    """The file that a mutant changes, and its text with the bug. Raises GoneError."""
    words = mutant.before.split()
    pattern = re.compile(r"\s+".join(map(re.escape, words)))
    folder = tree / mutant.package
    files = [folder] if folder.is_file() else sorted(folder.rglob("*.py"))
    likely = [(file, text) for file in files if all(word in (text := file.read_text()) for word in words)]
    places = [(file, text) for file, text in likely for _ in pattern.finditer(text)]
    if len(places) != 1:
        raise GoneError(f"{' '.join(mutant.before.split())!r} occurs {len(places)} times in {mutant.package}")
    ((file, text),) = places
    return file, pattern.sub(lambda _: mutant.after, text)


def passes(tree: Path, tests: Iterable[str]) -> bool:
    """Whether these tests of a copy pass. A hang is a failure."""
    # without --assert=plain, pytest would rewrite the asserts of the whole project in every run, as nothing is cached
    options = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "--assert=plain", "--timeout", "60")
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *tests],
            cwd=tree,
            env={**_environment(), "PYTHONPATH": str(tree), "CI": "1", "PYTHONDONTWRITEBYTECODE": "1"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    if done.returncode not in (0, 1, 2, 3):
        raise GoneError(f"{' '.join(tests)}: {done.stdout.decode(errors='replace')[-300:]}")
    return done.returncode == 0


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}


def copy_to(tree: Path) -> Path:
    """A compiled copy of the repository, checked by hashes, since a bug is planted and removed within a second."""
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    compile_dir(tree, quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return tree


class Bench:
    """Copies of the repository, each used by one job at a time."""

    def __init__(self, folder: Path, jobs: int) -> None:
        self._trees: SimpleQueue[Path] = SimpleQueue()
        first = copy_to(folder / "0")
        self._trees.put(first)
        for number in range(1, jobs):
            self._trees.put(shutil.copytree(first, folder / str(number)))

    def in_a_tree(self, work: Callable[[Path], _T]) -> _T:
        tree = self._trees.get()
        try:
            return work(tree)
        finally:
            self._trees.put(tree)

    def problem(self, test: str) -> str:
        """The problem of a test file without any bug; empty if it passes."""
        try:
            passed = self.in_a_tree(lambda tree: passes(tree, [test]))
        except GoneError as error:
            return str(error)
        return "" if passed else f"{test} fails without a bug, so it cannot find one: fix it first"

    def verdict(self, mutant: Mutant) -> str:
        """found, MISSED or GONE."""

        def judge(tree: Path) -> str:
            file, text = changed(mutant, tree)
            original = file.read_text()
            file.write_text(text)
            try:
                return "MISSED" if passes(tree, mutant.tests) else "found"
            finally:
                file.write_text(original)

        try:
            verdict_text = self.in_a_tree(judge)
        except GoneError as error:
            verdict_text = f"GONE ({error})"
        print(f"{verdict_text:7}{mutant}", flush=True)
        return verdict_text


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="only mutants with one of these words in their package or tests")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    parser.add_argument("--list", type=Path, default=LIST, help="another list of mutants")
    parser.add_argument("--trust", action="store_true", help="do not run the tests without a bug first")
    given = parser.parse_args()
    mutants = read_list(given.list)
    if given.words:
        mutants = [m for m in mutants if any(word in " ".join((m.package, *m.tests)) for word in given.words)]
    subjects = [] if given.trust else sorted({test for mutant in mutants for test in mutant.tests})
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        bench = Bench(Path(folder), given.jobs)
        problems = {test: text for test, text in zip(subjects, pool.map(bench.problem, subjects), strict=True) if text}
        print(*problems.values(), sep="\n", end="\n" if problems else "")
        if subjects:
            print(f"{len(subjects) - len(problems)} of {len(subjects)} test files pass without a bug", flush=True)
        provable = [mutant for mutant in mutants if not set(mutant.tests) & set(problems)]
        verdicts = dict(zip(provable, pool.map(bench.verdict, provable), strict=True))
    return _report(mutants, verdicts, whole=not given.words)


def _report(mutants: list[Mutant], verdicts: dict[Mutant, str], *, whole: bool) -> int:
    """Print the result against the minima; returns the exit status."""
    found = sum(verdict == "found" for verdict in verdicts.values())
    print(f"{found} of {len(mutants)} bugs are found, {found / max(len(mutants), 1):.0%}")
    surprises = [m for m, verdict in verdicts.items() if verdict != ("MISSED" if m.missed else "found")]
    problems = [f"not as listed: {mutant}" for mutant in surprises]
    if len(verdicts) < len(mutants):
        problems.append(f"{len(mutants) - len(verdicts)} were not planted, since their tests fail without a bug")
    if whole and len(mutants) < MIN_MUTANTS:
        problems.append(f"{len(mutants)} are too few: at least {MIN_MUTANTS} are required")
    if whole and found < MIN_FOUND * len(mutants):
        problems.append(f"too few are found: {MIN_FOUND:.0%} are required")
    print(*(problems or ["all as listed"]), sep="\n")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())
