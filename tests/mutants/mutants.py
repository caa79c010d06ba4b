"""Plants bugs one at a time, and tells which of them the tests of their subject find.

    python tests/mutants/mutants.py                 all of mutants.toml
    python tests/mutants/mutants.py urscript motion those whose package or tests have one of the words in them

Each is planted in a copy of the repository, never in the repository. It ends with status 1 when a bug that is to be
found is not, when the place of one is gone (mend its `before`), or when tests fail without any bug.

A mutant in mutants.toml:

    package   the folder that `before` is looked for in; it stands there once
    before    a piece of code, whatever its line breaks and indentation
    after     what stands there instead
    tests     what should find it
    missed    only of one that nothing finds: why that may be so
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.toml")
WANTED = 0.9
PATIENCE_S = 300.0


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
    """The place of a mutant is not there, or not unique."""


def plant(mutant: Mutant, tree: Path) -> tuple[Path, str]:
    """Change the copy; the file that was changed, and what it was."""
    pattern = re.compile(r"\s+".join(map(re.escape, mutant.before.split())))
    folder = tree / mutant.package
    files = [folder] if folder.is_file() else sorted(folder.rglob("*.py"))
    found = [(file, len(pattern.findall(file.read_text()))) for file in files]
    places = [(file, count) for file, count in found if count]
    if sum(count for _, count in places) != 1:
        raise GoneError(f"stands {sum(count for _, count in places)} times in {mutant.package}")
    file, _ = places[0]
    text = file.read_text()
    file.write_text(pattern.sub(lambda _: mutant.after, text))
    return file, text


def passes(tree: Path, tests: tuple[str, ...]) -> bool:
    """Whether these tests of a copy pass. A hang is a failure."""
    options = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "--timeout", "60")
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
    return tree


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="only mutants with one of these words in their package or tests")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    parser.add_argument("--list", type=Path, default=LIST, help="another list of mutants")
    parser.add_argument("--trust", action="store_true", help="do not run the tests without a bug first")
    given = parser.parse_args()
    mutants = [
        Mutant(**{**row, "tests": tuple(row["tests"])}) for row in tomllib.loads(given.list.read_text())["mutant"]
    ]
    if given.words:
        mutants = [m for m in mutants if any(word in " ".join((m.package, *m.tests)) for word in given.words)]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(given.jobs):
            trees.put(copy_to(Path(folder) / str(number)))

        def sound(tests: tuple[str, ...]) -> str:
            tree = trees.get()
            try:
                return "" if passes(tree, tests) else f"fails without a bug: {' '.join(tests)}"
            except GoneError as error:
                return str(error)
            finally:
                trees.put(tree)

        def judge(mutant: Mutant) -> str:
            tree = trees.get()
            try:
                file, text = plant(mutant, tree)
                try:
                    verdict = "MISSED" if passes(tree, mutant.tests) else "found"
                finally:
                    file.write_text(text)
            except GoneError as error:
                verdict = f"GONE ({error})"
            finally:
                trees.put(tree)
            print(f"{verdict:7}{mutant}", flush=True)
            return verdict

        broken = [said for said in pool.map(sound, () if given.trust else sorted({m.tests for m in mutants})) if said]
        print(*broken, sep="\n", end="\n" if broken else "", flush=True)
        verdicts = list(pool.map(judge, mutants))
    found = verdicts.count("found")
    surprises = [
        mutant
        for mutant, verdict in zip(mutants, verdicts, strict=True)
        if verdict != ("MISSED" if mutant.missed else "found")
    ]
    print(f"{found} of {len(mutants)} found", *(f"not as listed: {mutant}" for mutant in surprises), sep="\n")
    return bool(broken or surprises or (not given.words and found < WANTED * len(mutants)))


if __name__ == "__main__":
    sys.exit(main())
