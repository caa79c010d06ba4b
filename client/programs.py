"""PolyScope programs and installations as local files: create, open, check and save them.

The program trees and their editing are in `urscript.polyscope`.
"""

import json
import subprocess
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Final, Literal, NamedTuple

from client.errors import ClientError, FileError
from urproto.compat import module_command
from urproto.durable import write_file
from urproto.robots import RobotModel, choose_version, default_model, load_model
from urproto.text import from_bytes, readable, to_bytes
from urproto.versions import PolyscopeVersion
from urscript.polyscope.comparing import Change, differences
from urscript.polyscope.document import DocumentError, Element, link, packed, read_document, write_document
from urscript.polyscope.editing import Problem, ProgramEditor, Row
from urscript.polyscope.files import SCRIPT_SUFFIX
from urscript.polyscope.folder import ProgramsFolder, read_file
from urscript.polyscope.installation_file import InstallationFile, load_installation_file
from urscript.polyscope.installation_sections import SettingError
from urscript.polyscope.installation_settings import new_installation, set_driver_address
from urscript.polyscope.lines import Line, read_lines
from urscript.polyscope.merging import merge_files
from urscript.polyscope.saved_script import read_saved_script
from urscript.polyscope.stale import saved_in, stale_nodes
from urscript.polyscope.tree import TreeError, is_external_control, tag_of
from urscript.polyscope.urpx import UrpxError, counterpart
from urscript.work import gc_paused, run_to_end

_ALWAYS_USED: Final = ("mounting", "payloads")  # parts of an installation
_SYNTAX_ERROR: Final = "syntax error"
_CHECKED: Final = (0, 1)  # exit statuses of a script without and with errors
_CHECK_S: Final = 60.0  # guess: it usually takes one second


class ScriptProblem(NamedTuple):
    """A finding of the checker. Lines and columns count from 1. A warning does not keep a script from running."""

    line: int
    column: int
    warning: bool
    message: str


class CheckerError(ClientError):
    """The script checker could not run; the message contains its output."""


def checker_command(version: PolyscopeVersion) -> tuple[str, ...]:
    """Command that checks a script on standard input.

    The client does not import the language package: it runs the command, as an editor would.
    """
    return (*module_command("urscript"), "check", "--isolated", "--format=json", "--polyscope", str(version), "-")


def controller(model: str | None, polyscope: str | None) -> tuple[RobotModel, PolyscopeVersion]:
    """Resolve the arm model and the PolyScope version, with the emulator's defaults. Raises ClientError."""
    try:
        arm = load_model((model or default_model(polyscope)).lower())
        return arm, choose_version(polyscope, arm)
    except ValueError as error:
        raise ClientError(str(error)) from None


def open_program(path: Path, model: str | None = None, polyscope: str | None = None) -> ProgramEditor:
    """Open a program, with its installation from the same folder and the code of URCaps from its script file.

    Raises FileError if the file is not a program, and ClientError for an unknown arm or version.
    """
    try:
        return _program(path.read_bytes(), path, model, polyscope)
    except OSError as error:
        raise FileError(path, _reason(error)) from None


def _program(data: bytes, path: Path, model: str | None = None, polyscope: str | None = None) -> ProgramEditor:
    """Open a program from the contents of its file, at a path that need not exist; errors as `open_program`."""
    folder = ProgramsFolder(path.absolute().parent)
    try:
        root = read_document(data)
        version = saved_in(root)
        arm, version = controller(model, polyscope or (None if model else str(version)))
        installation = find_installation(root, folder)
        script = path.with_suffix(SCRIPT_SUFFIX)
        saved = run_to_end(read_saved_script(from_bytes(script.read_bytes()) if script.is_file() else ""))
        return ProgramEditor(root, path.stem, installation, version, arm, saved_script=saved, folder=folder)
    except (OSError, DocumentError, TreeError) as error:
        raise FileError(path, _reason(error)) from None


def open_lines(path: Path) -> Line:
    """The lines of any of PolyScope's files. Raises FileError."""
    try:
        return read_lines(read_file(path))
    except (OSError, DocumentError, TreeError, UrpxError) as error:
        raise FileError(path, _reason(error)) from None


def compare_files(before: Path, after: Path) -> list[Change]:
    """The changes between two files and, of two programs, between what they use of the installations next to them.

    Raises FileError for a file that cannot be read, and ClientError for files of different kinds.
    """
    with gc_paused():
        return _changes(before, after)


def _changes(before: Path, after: Path) -> list[Change]:
    old, new = open_lines(before), open_lines(after)
    if old.kind != new.kind:
        raise ClientError(f"{before} is of the kind {old.kind} and {after} of the kind {new.kind}: compare equal kinds")
    changes = differences(old, new)
    if old.kind == "program":
        first, second = _installation_lines(before, old), _installation_lines(after, new)
        if first is not None and second is not None:
            used = {value for _, line in chain(old.walk(), new.walk()) for value in line.content.values()}
            changes += [change for change in differences(first, second) if _concerns(change, used)]
    return changes


def merge_into(base: Path, ours: Path, theirs: Path, path: Path) -> list[str]:
    """Merge their changes since the base into our file, and return the conflicts. Raises FileError.

    A file that cannot be read or merged is one conflict, and ours stays as it is. path: of the file itself, next to
    which its installation is.
    """
    try:
        versions = [read_file(version) for version in (base, ours, theirs)]
        with gc_paused():
            merged = merge_files(*versions)
    except (OSError, DocumentError, TreeError, UrpxError) as error:
        return [f"it cannot be merged, and stays as it is in ours: {_reason(error)}"]
    try:
        write_file(ours, merged.data)
    except OSError as error:
        raise FileError(ours, _reason(error)) from None
    return merged.conflicts or _new_problems(versions[1:], merged.data, path)


def _new_problems(versions: Sequence[bytes], merged: bytes, path: Path) -> list[str]:
    """What keeps a merged program from running, if both of its versions can be run."""
    if merged in versions:
        return []
    try:
        editor = _program(merged, path)
        found = all_problems(editor)
        if not found or any(all_problems(_program(version, path)) for version in versions):
            return []
    except ClientError:  # not a program, or nothing to check it with
        return []
    titles = {row.id: f"{row.title}: " for row in editor.rows()}
    return [f"{titles.get(each.node, '')}only the merged program cannot be run: {each.message}" for each in found]


def _installation_lines(path: Path, program: Line) -> Line | None:
    """The lines of the installation that a program was saved with, if it is in the folder."""
    names = (program.content.get(name, "") for name in ("installationRelativePath", "installation"))
    found = ProgramsFolder(path.absolute().parent).installation(*names)
    return open_lines(found) if found is not None else None


def _concerns(change: Change, used: set[str]) -> bool:
    """Whether a change of an installation is one of something that programs with these values name, or all use."""
    return any(
        line is not None and line.parent is not None and (line.name in used or line.kind in _ALWAYS_USED)
        for line in (change.before, change.after)
    )


def find_installation(root: Element, folder: ProgramsFolder) -> InstallationFile:
    """The installation that a program was saved with, if it is in the folder; otherwise an empty one."""
    found = folder.installation(root.get("installationRelativePath"), root.get("installation"))
    if found is None:
        return InstallationFile(root.get("installation") or "default")
    try:
        return load_installation_file(found)
    except (OSError, DocumentError) as error:
        raise FileError(found, _reason(error)) from None


def set_driver(path: Path, host: str, port: int, version: PolyscopeVersion) -> bool:
    """Set the address of External Control's driver in an installation, and return whether the file is new.

    Raises FileError.
    """
    is_new = not path.exists()
    root = new_installation(version, path.stem) if is_new else open_installation(path)
    try:
        set_driver_address(root, host, port)
    except (DocumentError, SettingError) as error:
        raise FileError(path, str(error)) from None
    save_installation(root, path)
    return is_new


def open_installation(path: Path) -> Element:
    """Open an installation file and return its document. Raises FileError."""
    try:
        root = link(read_document(path.read_bytes()))
    except (OSError, DocumentError) as error:
        raise FileError(path, _reason(error)) from None
    if root.tag != "Installation":
        raise FileError(path, f"<{root.tag}> is not an installation")
    return root


def save_installation(root: Element, path: Path) -> None:
    """Write an installation file atomically. Raises FileError."""
    try:
        write_file(path, packed(write_document(root)))
    except (OSError, DocumentError) as error:
        raise FileError(path, _reason(error)) from None


def all_problems(editor: ProgramEditor) -> list[Problem]:
    """All problems that keep a program from running: those of its nodes or, if there are none, those of its script.

    Raises CheckerError if the script cannot be checked.
    """
    found = editor.problems()
    if found:
        return found
    written = editor.written()
    authors: list[Element | None] = []
    for line, author in written.lines():
        authors += [author] * (line.count("\n") + 1)
    errors = _script_errors(written.text(), editor.version)
    return [
        Problem(editor.node_of(author) if (author := authors[min(line, len(authors)) - 1]) else "", message)
        for line, message in errors
    ]


class Conversion(NamedTuple):
    """What becomes of a node in PolyScope X. how: node, script or nothing. note: which node, or why not."""

    row: Row
    how: Literal["node", "script", "nothing"]
    note: str


def conversions(editor: ProgramEditor) -> list[Conversion]:
    """What becomes of the nodes of a program in the version of PolyScope X that it was opened for.

    Raises CheckerError if its script cannot be checked.
    """
    problems = {problem.node: problem.message for problem in reversed(all_problems(editor))}
    found = []
    for row, line in zip(editor.rows(), editor.tree.lines, strict=True):
        element = line.element
        note = problems.get(row.id, "")
        if is_external_control(element):
            note = "it needs the URCapX of External Control, which has its own node"
        elif tag_of(element) == "Contributed":
            note = "URCaps of PolyScope 5 do not run on PolyScope X; install its URCapX, if there is one"
        if row.suppressed:
            found.append(Conversion(row, "nothing", "suppressed"))
        elif note:
            found.append(Conversion(row, "nothing", note))
        else:
            node = counterpart(element)
            found.append(Conversion(row, "node" if node else "script", node))
    return found


def stale_problems(editor: ProgramEditor, path: Path) -> list[Problem]:
    """Where the script next to a program was saved from another state of it, or of its installation."""
    script = path.with_suffix(SCRIPT_SUFFIX)
    if not script.is_file():
        return []
    nodes = {line.number: editor.node_of(line.element) for line in editor.tree.lines}
    found = stale_nodes(editor.tree, editor.installation, from_bytes(script.read_bytes()))
    return [Problem(nodes.get(each.number, ""), each.message) for each in found]


def report_of(path: Path, form: str, model: str | None, polyscope: str | None) -> tuple[int, str]:
    """What ``urscript check`` reports about a program in one of its formats, and its exit status.

    Raises CheckerError.
    """
    options = [*(["--model", model] if model else []), *(["--polyscope", polyscope] if polyscope else [])]
    command = [*module_command("urscript"), "check", f"--format={form}", "--strict", *options, str(path)]
    ran = _run(command)
    if ran.returncode not in _CHECKED:
        raise CheckerError(readable(from_bytes(ran.stderr)).strip() or str(ran.returncode))
    return ran.returncode, from_bytes(ran.stdout)


def _script_errors(text: str, version: PolyscopeVersion) -> list[tuple[int, str]]:
    """Line and message of each error.

    A syntax error at the first word of a line is attributed to the line before, which the parser takes to continue.
    """
    written, errors = text.split("\n"), []
    for problem in script_problems(text, version):
        if not problem.warning:
            begins = not written[problem.line - 1][: problem.column - 1].strip()
            errors.append((problem.line - (begins and problem.message.startswith(_SYNTAX_ERROR)), problem.message))
    return errors


def script_problems(text: str, version: PolyscopeVersion) -> list[ScriptProblem]:
    """What ``urscript check`` finds in a script, for a controller of this version. Raises CheckerError."""
    ran = _run(checker_command(version), to_bytes(text))
    return read_problems(ran.returncode, ran.stdout, ran.stderr)


def _run(command: Sequence[str], text: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(command, input=text, capture_output=True, timeout=_CHECK_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CheckerError(f"urscript check: {error}") from None


def read_problems(status: int | None, output: bytes, errors: bytes) -> list[ScriptProblem]:
    """The problems in what `checker_command` printed. Raises CheckerError if its exit status is another one."""
    if status not in _CHECKED:
        raise CheckerError(f"urscript check: {readable(from_bytes(errors)).strip() or status}")
    return sorted(
        ScriptProblem(found["line"], found["column"], found["severity"] == "warning", found["message"])
        for found in json.loads(output)
    )


def _reason(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
