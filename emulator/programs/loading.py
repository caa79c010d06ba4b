"""Loading and playing of program files, and the folder that they are in."""

import shutil
import tempfile
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from emulator.builtins.host import ProgramServices
from emulator.machine import Machine
from emulator.programs.compiling import CompiledTexts, Submission
from emulator.services.urcap import ProgramRequest
from urproto.versions import PolyscopeVersion
from urscript.compiler import CompiledProgram
from urscript.errors import CompileError
from urscript.files import inlined, is_inlined, split_steps
from urscript.parser import is_secondary
from urscript.polyscope.document import DocumentError
from urscript.polyscope.folder import ProgramsFolder, read_file, read_text
from urscript.polyscope.installation_file import InstallationFile, read_installation_steps
from urscript.polyscope.program import OutlineNode, script_steps
from urscript.polyscope.tree import ProgramTree, TreeError, read_tree_steps
from urscript.polyscope.urpx import SUFFIX as URPX
from urscript.polyscope.urpx import URPX_BYTES_PER_WORK, Urpx, UrpxError, read_urpx
from urscript.polyscope.writer import ExternalControlCode
from urscript.work import Steps

MAX_PROGRAMS: Final = 2000  # guess: a longer list is of no use for choosing a program
_AT_ONCE: Final = 20  # entries checked per control period; each may access the file system
_MAX_ENTRIES: Final = 50_000  # guess: a folder with more is not a programs folder
_SUFFIXES: Final = (".urp", URPX, ".script")
DEFAULT_URPX: Final = Path(__file__).with_name("polyscope_x") / "default.urpx"
"""The program that a robot with PolyScope X loads when it is switched on: one without nodes."""

DRIVER_PROGRAMS: Final = Path(__file__).with_name("urcap")
"""Programs folder for robots without one: its ``external_control.urp`` is an External Control node in a loop."""


def program_files(root: Path) -> Generator[None, None, list[str]]:
    """Paths of all programs in the folder, relative to it and sorted, as ``load`` accepts them; links are left out.

    Yields once a control period. A ``.script`` next to a ``.urp`` of the same name belongs to it and is not listed.
    """
    found = list[Path]()
    waiting, looked = [root], 0
    while waiting and len(found) < MAX_PROGRAMS and looked < _MAX_ENTRIES:
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
    return sorted(path.relative_to(root).as_posix() for path in shown[:MAX_PROGRAMS])


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:  # removed in the meantime, or not readable
        return []


@dataclass(frozen=True, slots=True)
class _PendingPlay:
    """A program that waits for the code of a driver."""

    submission: Submission
    tree: ProgramTree
    request: ProgramRequest
    start_at: int


class Player:
    """Prepares the program that ``play`` starts. ``loaded``: the chosen program. texts: what the robot has compiled."""

    def __init__(self, machine: Machine, services: ProgramServices, texts: CompiledTexts) -> None:
        self.loaded: LoadedProgram | None = None
        self._played: Submission | None = None
        self._machine, self._services, self._texts = machine, services, texts
        self._pending: _PendingPlay | None = None

    @property
    def waiting(self) -> Submission | None:
        """The submission that waits for its driver."""
        return None if self._pending is None else self._pending.submission

    def load_steps(self, path: Path, *, by_default: bool = False) -> Steps[None]:
        """Load a program, in pieces for a control loop. by_default: unless another one has been loaded by then.

        The installation that a program tree was saved with is loaded too, if it is in the programs
        folder. Raises ProgramLoadError or OSError; the program loaded before then remains.
        """
        machine = self._machine
        loaded = yield from load_steps(
            path, machine.config.programs_dir, machine.installation.file, machine.version, self._texts
        )
        if by_default and self.loaded is not None:
            return
        for note in loaded.notes:
            machine.messages.note(note)
        if loaded.installation is not None:
            machine.apply_installation(*loaded.installation)
        self.loaded, self._played = loaded, None

    def made(self, program: CompiledProgram) -> bool:
        """Whether this program is the loaded one as last played."""
        return self._played is not None and self._played.program is program

    def submission(self, *, stepped: bool, start_at: int = 0) -> Submission | None:
        """The submission to compile, or ``waiting`` if a driver has to be asked first; None without a loaded program.

        start_at: number of the node of the program tree at which to start, 0 for the whole program.
        """
        if self.loaded is None:
            return None
        tree = self.loaded.tree
        origin = f"the loaded program {self.loaded.name}"
        submission = Submission(self.loaded.script, self._machine.version, stepped, of_file=True, origin=origin)
        self._played = submission
        if tree is None:
            return submission
        if tree.needs_external_control:
            self._request_driver_program(tree, submission, start_at)
        else:
            file, version = self._machine.installation.file, self._machine.version
            submission.translation = script_steps(tree, file, version=version, start_at=start_at)
        return submission

    def step(self) -> Submission | None:
        """Advance one control period; returns the submission whose driver has answered."""
        pending = self._pending
        code = None if pending is None else pending.request.step()
        if pending is None or code is None:
            return None
        self._pending = None
        file, version = self._machine.installation.file, self._machine.version
        pending.submission.translation = script_steps(
            pending.tree, file, version=version, external_control=code, start_at=pending.start_at
        )
        return pending.submission

    def drop(self) -> bool:
        """Stop waiting for a driver; returns False if none was asked."""
        pending, self._pending = self._pending, None
        if pending is None:
            return False
        pending.request.close()
        pending.submission.accepted = False
        return True

    def _request_driver_program(self, tree: ProgramTree, submission: Submission, start_at: int) -> None:
        machine = self._machine
        address = machine.external_control.complete
        machine.messages.note(f"External Control requests its program from {address[0]}:{address[1]}")
        request = ProgramRequest(self._services.socket_backend, address, machine.period_s)
        self._pending = _PendingPlay(submission, tree, request, start_at)


class ProgramLoadError(ValueError):
    """The program file cannot be loaded or run."""


@dataclass(frozen=True, slots=True)
class LoadedProgram:
    """A program file.

    ``tree``: the program tree of a ``.urp``, translated when it is played; without one, ``script`` is played.
    ``installation``: the installation it was saved with, None if that is not in the folder.
    ``notes``: remarks for the user. ``title``: its name if that differs from the file's, as in PolyScope X.
    ``outline``: its nodes, if it has nodes but no tree.
    """

    path: Path
    script: str
    tree: ProgramTree | None = None
    installation: tuple[Path, InstallationFile] | None = None
    notes: list[str] = field(default_factory=list)
    title: str = ""
    outline: Sequence[OutlineNode] = ()

    @property
    def name(self) -> str:
        """Displayed name: the file name without its extension, unless the file specifies another."""
        return self.title or self.path.stem


def load_steps(
    path: Path, root: Path | None, present: InstallationFile, version: PolyscopeVersion, texts: CompiledTexts
) -> Steps[LoadedProgram]:
    """Read a ``.script``, ``.urp`` or ``.urpx`` file, in pieces for a control loop.

    root: the programs folder. present: the installation in use. texts: what the robot has compiled. A program tree
    that cannot be run, or whose translation does not compile, is replaced by the script that PolyScope saves next to
    each ``.urp``, and PolyScope X in each ``.urpx``, if that was saved with the program in its present form and
    compiles; otherwise, ProgramLoadError gives the reason. Also raises OSError.
    """
    if path.suffix == ".script":
        return (yield from _script(path, read_text(path)))
    wanted = URPX if version.is_polyscope_x else ".urp"
    if path.suffix != wanted:
        raise ProgramLoadError(f"{path.name} is not a program: use a {wanted} or .script file")
    if wanted == URPX:
        return (yield from _urpx(path, present, version, texts))
    folder = ProgramsFolder(root or path.parent, path.parent)
    try:
        tree = yield from read_tree_steps(path, folder)
    except (DocumentError, TreeError) as error:
        return (yield from _saved_script(path, None, error, version, texts))
    try:
        return (yield from _tree(path, tree, present, version, texts))
    except (DocumentError, TreeError, CompileError) as error:
        return (yield from _saved_script(path, tree, error, version, texts))


def _saved_script(
    path: Path, tree: ProgramTree | None, error: Exception, version: PolyscopeVersion, texts: CompiledTexts
) -> Steps[LoadedProgram]:
    """Load the script next to a program tree that cannot be run."""
    saved = path.with_suffix(".script")
    reason = f"{path.name} cannot be run: {error}"
    if not saved.is_file():
        raise ProgramLoadError(reason) from error
    if tree is not None and tree.needs_external_control:  # a saved script has the code of an earlier driver
        raise ProgramLoadError(reason) from error
    if tree is not None and tree.changed_since_saved:
        raise ProgramLoadError(
            f"{reason}. {saved.name} is not played instead, because it was saved with another version of the program: "
            f"{tree.changed_since_saved}"
        ) from error
    script = read_text(saved)
    try:
        yield from texts.compile(script, version)
    except CompileError as complaint:
        raise ProgramLoadError(f"{reason}. {saved.name} cannot be played instead: {complaint}") from error
    return LoadedProgram(path, script, notes=[f"{saved.name} is played instead of {path.name}: {error}"])


def _tree(
    path: Path, tree: ProgramTree, present: InstallationFile, version: PolyscopeVersion, texts: CompiledTexts
) -> Steps[LoadedProgram]:
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
    yield from texts.compile(script, version)
    return LoadedProgram(path, "", tree, installation, notes)


def _urpx(
    path: Path, present: InstallationFile, version: PolyscopeVersion, texts: CompiledTexts
) -> Steps[LoadedProgram]:
    try:
        data = read_file(path)
        yield len(data) // URPX_BYTES_PER_WORK
        program = read_urpx(data)
    except UrpxError as error:
        raise ProgramLoadError(f"{path.name}: {error}") from error
    try:
        tree = program.tree()
        yield from texts.compile((yield from script_steps(tree, present, version=version)), version)
    except (UrpxError, DocumentError, TreeError, CompileError) as error:
        return (yield from _saved_urpx(path, program, error, version, texts))
    return LoadedProgram(path, "", tree, title=program.name)


def _saved_urpx(
    path: Path, program: Urpx, error: Exception, version: PolyscopeVersion, texts: CompiledTexts
) -> Steps[LoadedProgram]:
    """Load the URScript in a program of PolyScope X whose nodes cannot be run."""
    reason = f"{path.name} cannot be run: {error}"
    if program.changed_since_saved:
        raise ProgramLoadError(f"{reason}. Nothing is played instead: {program.changed_since_saved}") from error
    script = program.saved_program()
    try:
        yield from texts.compile(script, version)
    except CompileError as complaint:
        raise ProgramLoadError(f"{reason}. The URScript in it cannot be played instead: {complaint}") from error
    notes = [f"the URScript in {path.name} is played instead of its nodes: {error}"]
    return LoadedProgram(path, script, notes=notes, title=program.name, outline=program.outline())


def _script(path: Path, text: str) -> Steps[LoadedProgram]:
    """Load a text as one program; see `urscript.files`."""
    units = yield from split_steps(text)
    if (yield from is_inlined(units)):
        return LoadedProgram(path, inlined(path.stem, text))
    if len(units) < 2 or units[0].kind != "block":
        return LoadedProgram(path, text)
    if any(is_secondary(unit.text) for unit in units):
        raise ProgramLoadError(f"{path.name} contains {len(units)} programs: send them to a script port, one at a time")
    note = f"{path.name} contains {len(units)} programs: as one program, they are functions that are never called"
    return LoadedProgram(path, inlined(path.stem, text), notes=[note])


def ensure_programs_folder(machine: Machine) -> Path:
    """Return the programs folder. If none was given, create a temporary one, which the system may clear."""
    folder = machine.config.programs_dir
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="ur-emulator-programs-"))
        shutil.copytree(DRIVER_PROGRAMS, folder, dirs_exist_ok=True)  # these are available without a folder, too
        machine.config = replace(machine.config, programs_dir=folder)
        machine.messages.note(f"there is no programs folder: files are saved to {folder}, see --programs")
    return folder
