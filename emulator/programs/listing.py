"""The program files of the programs folder."""

from collections.abc import Generator
from pathlib import Path
from typing import Final

__all__ = ["MOST_PROGRAMS", "program_files"]

MOST_PROGRAMS: Final = 2000  # guess: more are of no use to anybody who chooses one
_AT_ONCE: Final = 20  # entries looked at in one control period; each may ask the file system
_MOST_ENTRIES: Final = 50_000  # guess: then the folder is no programs folder
_SUFFIXES: Final = (".urp", ".script")


def program_files(root: Path) -> Generator[None, None, list[str]]:
    """Paths of all programs below the folder, relative to it and sorted, as ``load`` takes them; links are left out.

    Yields once a control period. A ``.script`` beside a ``.urp`` of its name is that program's, and not listed.
    """
    found = list[Path]()
    waiting, looked = [root], 0
    while waiting and len(found) < MOST_PROGRAMS and looked < _MOST_ENTRIES:
        for entry in _entries(waiting.pop(0)):
            looked += 1
            if looked % _AT_ONCE == 0:
                yield
            if entry.is_symlink():
                continue
            if entry.suffix in _SUFFIXES and entry.is_file():
                found.append(entry)
            elif not entry.name.startswith(".") and entry.is_dir():
                waiting.append(entry)
    trees = {path.with_suffix("") for path in found if path.suffix == ".urp"}
    shown = [path for path in found if path.suffix == ".urp" or path.with_suffix("") not in trees]
    return sorted(path.relative_to(root).as_posix() for path in shown[:MOST_PROGRAMS])


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:  # taken away meanwhile, or not ours to read
        return []
