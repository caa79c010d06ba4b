"""Program files the dashboard can load."""

from dataclasses import dataclass, field
from pathlib import Path

from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.trees.document import DocumentError
from emulator.programs.trees.folder import ProgramsFolder
from emulator.programs.trees.installation_file import InstallationFile, read_installation_steps
from emulator.programs.trees.program import ExternalControlCode, ProgramTree, TreeError, read_tree_steps, script_steps
from urproto.text import from_bytes
from urproto.versions import PolyscopeVersion
from urscript.compiler import compile_steps
from urscript.errors import CompileError
from urscript.files import inlined, is_inlined, split_steps
from urscript.parser import is_secondary
from urscript.work import Steps

__all__ = ["LoadedProgram", "ProgramLoadError", "load_steps"]


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
        return (yield from _script(path, _read(path)))
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


def _script(path: Path, text: str) -> Steps[LoadedProgram]:
    """The text as one program; `urscript.files` says how it is meant."""
    units = yield from split_steps(text)
    if (yield from is_inlined(units)):
        return LoadedProgram(path, inlined(path.stem, text))
    if len(units) < 2 or units[0].kind != "block":
        return LoadedProgram(path, text)
    if any(is_secondary(unit.text) for unit in units):
        raise ProgramLoadError(f"{path.name} holds {len(units)} programs: send them to a script port, one at a time")
    note = f"{path.name} holds {len(units)} programs: as one program they are functions that nothing calls"
    return LoadedProgram(path, inlined(path.stem, text), notes=[note])


def _read(path: Path) -> str:
    return from_bytes(path.read_bytes()).removeprefix("\ufeff")
