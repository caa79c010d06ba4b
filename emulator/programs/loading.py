"""Program files the dashboard can load."""

from dataclasses import dataclass
from pathlib import Path

from emulator.programs.trees.document import DocumentError
from emulator.programs.trees.program import ProgramTree, TreeError, read_tree

__all__ = ["LoadedProgram", "ProgramLoadError", "load_program"]


class ProgramLoadError(ValueError):
    """The file cannot be run."""


@dataclass(frozen=True, slots=True)
class LoadedProgram:
    """A program file. ``script`` is its URScript, empty when the file has none that can be run.

    ``tree``: the program tree of a ``.urp``.
    """

    path: Path
    script: str
    tree: ProgramTree | None = None

    @property
    def name(self) -> str:
        """File name without its extension."""
        return self.path.stem


def load_program(path: Path) -> LoadedProgram:
    """Read a ``.script`` file, or the ``.script`` that PolyScope saves beside each ``.urp``.

    A ``.urp`` alone can be loaded but not played: its program tree is not translated.
    Raises ProgramLoadError for another kind of file and OSError when it cannot be read.
    """
    if path.suffix == ".script":
        return LoadedProgram(path, _read(path))
    if path.suffix == ".urp":
        script = path.with_suffix(".script")
        return LoadedProgram(path, _read(script) if script.is_file() else "", _tree(path))
    raise ProgramLoadError(f"{path.name} is no program: programs are .urp or .script files")


def _tree(path: Path) -> ProgramTree | None:
    try:
        return read_tree(path)
    except (DocumentError, TreeError):
        return None


def _read(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "surrogateescape").removeprefix("\ufeff")
