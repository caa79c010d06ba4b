"""Program files the dashboard can load."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.trees.document import DocumentError
from emulator.programs.trees.folder import ProgramsFolder
from emulator.programs.trees.installation_file import InstallationFile, read_installation_steps
from emulator.programs.trees.program import ExternalControlCode, ProgramTree, TreeError, read_tree_steps, script_steps
from urproto.versions import PolyscopeVersion
from urscript.compiler import compile_steps
from urscript.errors import CompileError
from urscript.splitter import ScriptSplitter
from urscript.values import to_bytes
from urscript.work import Steps

__all__ = ["LoadedProgram", "ProgramLoadError", "load_steps"]

_PIECE_CHARACTERS: Final = 4096
_PIECE_COST: Final = 200  # measured: 50 microseconds for 1000 characters
_NO_WORD: Final = re.compile(r"\W", re.ASCII)


class ProgramLoadError(ValueError):
    """The file cannot be run."""


@dataclass(frozen=True, slots=True)
class LoadedProgram:
    """A program file.

    ``tree``: the program tree of a ``.urp``, translated when it is played; without one ``script`` is played.
    ``installation``: the installation it was saved with, None when that is not in the folder.
    ``notes``: what the user should know.
    """

    path: Path
    script: str
    tree: ProgramTree | None = None
    installation: tuple[Path, InstallationFile] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """File name without its extension."""
        return self.path.stem


def load_steps(
    path: Path, root: Path | None, present: InstallationFile, version: PolyscopeVersion
) -> Steps[LoadedProgram]:
    """Read a ``.script`` or ``.urp`` file, in pieces for a control loop.

    root: the programs folder. present: the installation in use. A program tree that cannot be
    run, or whose translation does not compile, is replaced by the ``.script`` that PolyScope saves
    beside each ``.urp`` if that was saved with the program as it is now and compiles; else
    ProgramLoadError says what is to blame. Also raises OSError.
    """
    if path.suffix == ".script":
        return LoadedProgram(path, (yield from _whole(path.stem, _read(path))))
    if path.suffix != ".urp":
        raise ProgramLoadError(f"{path.name} is no program: programs are .urp or .script files")
    folder = ProgramsFolder(root or path.parent, path.parent)
    try:
        tree = yield from read_tree_steps(path, folder)
    except (DocumentError, TreeError) as error:
        return (yield from _twin(path, None, error, version))
    try:
        return (yield from _tree(path, tree, present, version))
    except (DocumentError, TreeError, CompileError) as error:
        return (yield from _twin(path, tree, error, version))


def _twin(path: Path, tree: ProgramTree | None, error: Exception, version: PolyscopeVersion) -> Steps[LoadedProgram]:
    """The script beside a program tree, which cannot be run for a reason."""
    twin = path.with_suffix(".script")
    reason = f"{path.name} cannot be run: {error}"
    if not twin.is_file():
        raise ProgramLoadError(reason) from error
    if tree is not None and tree.needs_external_control:  # a saved script has the code of an earlier driver
        raise ProgramLoadError(reason) from error
    if tree is not None and tree.changed_since_twin:
        raise ProgramLoadError(
            f"{reason}. {twin.name} is not played instead, since it was not saved with the program as it is now: "
            f"{tree.changed_since_twin}"
        ) from error
    script = _read(twin)
    try:
        yield from compile_steps(script, LIBRARY_SET, version)
    except CompileError as twins:
        raise ProgramLoadError(f"{reason}. {twin.name} cannot be played instead: {twins}") from error
    return LoadedProgram(path, script, notes=[f"{twin.name} is played instead of {path.name}: {error}"])


def _tree(path: Path, tree: ProgramTree, present: InstallationFile, version: PolyscopeVersion) -> Steps[LoadedProgram]:
    found = tree.folder.installation(*tree.installation_names)
    installation, notes = None, []
    if found is None:
        notes.append(f"{path.name}: its installation {tree.installation_names[0]} is not in the programs folder")
    else:
        installation = found, (yield from read_installation_steps(found))
    script = yield from script_steps(
        tree,
        installation[1] if installation else present,
        version=version,
        external_control=ExternalControlCode("", ""),
    )
    yield from compile_steps(script, LIBRARY_SET, version)
    return LoadedProgram(path, "", tree, installation, notes)


def _whole(name: str, text: str) -> Steps[str]:
    """The text as one program.

    A file made for a Script node defines functions and then calls them: it is played as inside such
    a node. Sent to a script port, each of its functions would be a program.
    """
    splitter = ScriptSplitter()
    units = []
    for start in range(0, len(text), _PIECE_CHARACTERS):
        units += splitter.feed(to_bytes(text[start : start + _PIECE_CHARACTERS]))
        yield _PIECE_COST
    units += splitter.flush()
    if len(units) < 2 or units[0].kind != "block":
        return text
    return f"def {_NO_WORD.sub('_', f'_{name}' if name[:1].isdigit() else name)}(): {text}\nend\n"


def _read(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "surrogateescape").removeprefix("\ufeff")
