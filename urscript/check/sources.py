"""The programs to check, and where their lines are: in script files, templates, program trees, Python and C++."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

from urproto.text import from_bytes, to_bytes
from urproto.versions import PolyscopeVersion
from urscript.check.embedded import READERS, Embedded
from urscript.check.project import Project
from urscript.errors import ScriptError
from urscript.files import ScriptFile
from urscript.scripttest.suite import is_test_file, whole_program
from urscript.work import run_to_end

MAX_BYTES: Final = 4 << 20
"""Largest file that is checked, as large as a controller's programs may be here."""
SCRIPTS: Final = (".script", ".urscript")
_TREE: Final = ".urp"
_SCRIPT_NODE: Final = re.compile(rb"<file[^<>]{0,99}>(?:[^<>]{0,999}/)?([^<>/]{1,255})</file>")

Place: TypeAlias = tuple[int, int, str]
"""Line and column of the file that a user edits, and the text of that line."""

_HOLE: Final = r"(?:\{\{[^{}\n]*\}\}|\{[^{}\n]*\})"
_PLACEHOLDER: Final = re.compile(
    rf'"[^"\n{{}}]*"|#[^\n]*|(?P<line>(?m:^[ \t]*{_HOLE}[ \t]*(?:#[^\n]*)?$))|\w{{0,50}}{_HOLE}(?:\w|{_HOLE})*'
)
_LAST_ARGUMENT: Final = re.compile(r"(=[^=(),\n]*)(,[ \t]*\{\{?[^{}\n]*\}\}?)(?=[ \t]*\))")
"""A placeholder after an argument by name: it stands for further ones."""
_IN_NUMBER: Final = re.compile(r"[0-9]\.$")
_NO_LETTER: Final = re.compile(r"[^A-Za-z0-9_]")
_POSE: Final = "p"  # p[{x}] is a pose once it is filled in, but reads like an element of a variable


@dataclass(slots=True)
class Source:
    """One text of programs. name: of its file; place: maps a line and column of the text; lines: of the file.

    broken_nodes: nodes of a program tree from which PolyScope makes no script, each with its line and a message.
    stale: nodes whose script next to the tree is from another state of the program, likewise.
    variables: further ones that exist. in_tests: whether it is a file of tests, with the program that it tests.
    """

    name: str
    script: ScriptFile
    place: Callable[[int, int], Place | None]
    lines: list[str]
    placeholders: Iterable[str] = ()
    open: bool = False
    embedded: bool = False
    broken_nodes: Sequence[tuple[int, str]] = ()
    stale: Sequence[tuple[int, str]] = ()
    variables: Collection[str] = ()
    in_tests: bool = False


class SourceError(Exception):
    """A file cannot be checked: its name and the reason."""


def files_in(folder: Path) -> Iterator[Path]:
    """The programs of a folder: scripts and program trees.

    A script file that a tree there has in a Script node is a part of that program, and not checked alone.
    """
    files = sorted(file for file in folder.rglob("*") if file.suffix in (*SCRIPTS, _TREE))
    saved = {file.with_suffix(SCRIPTS[0]) for file in files if file.suffix == _TREE}
    parts = {name for file in files if file.suffix == _TREE for name in _script_nodes(file)}
    for file in files:
        if file.suffix == _TREE or file in saved or file.name not in parts:
            yield file


def has_saved_script(path: Path) -> bool:
    """Whether a file is a program tree with the script that PolyScope saved with it."""
    return path.suffix == _TREE and path.with_suffix(SCRIPTS[0]).is_file()


def _script_nodes(tree: Path) -> set[str]:
    """The names of the files in the Script nodes of a program tree; empty if it cannot be read."""
    from urscript.polyscope.document import DocumentError, unpacked

    try:
        with tree.open("rb") as file:
            return {from_bytes(name) for name in _SCRIPT_NODE.findall(unpacked(content(str(tree), file)))}
    except (OSError, DocumentError, SourceError):
        return set()


def sources_in(name: str, data: bytes | None, project: Project, version: PolyscopeVersion) -> list[Source]:
    """The sources in a file. data: its content; None if it is still to be read. Raises SourceError and ProjectError."""
    path = Path(name)
    if path.suffix == _TREE and data is None:
        return [_tree_source(name, path, version)]
    try:
        if data is None:
            with path.open("rb") as file:
                data = content(name, file)
        if path.suffix in READERS:
            text = from_bytes(data)
            return [_embedded_source(name, found, text.split("\n")) for found in READERS[path.suffix](text)]
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise SourceError(f"{name}: {getattr(error, 'strerror', None) or error}") from None
    return [_test_source(name, path, data) or _script_source(name, path, data, project)]


@lru_cache(maxsize=4)
def script_file(name: str, data: bytes) -> ScriptFile:
    """The programs of a text, which each version of a project and each request of an editor looks at."""
    return ScriptFile(name, data)


def content(name: str, file: BinaryIO) -> bytes:
    """The content of a file. Raises SourceError if it is too large."""
    data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise SourceError(f"{name}: has more than {MAX_BYTES:,} bytes: split it")
    return data


def _script_source(name: str, path: Path, data: bytes, project: Project) -> Source:
    placeholders = set[str]()
    shown = from_bytes(data).replace("\r\n", "\n").removeprefix("\ufeff")
    if project.matches(project.templates, path):
        text, placeholders = filled(shown)
        data = to_bytes(text)
    lines = shown.split("\n")
    before = project.preamble_text.count(b"\n")
    script = script_file(name, project.preamble_text + data)

    def place(line: int, column: int) -> Place | None:
        return _on(lines, line - before, column) if line > before else None

    return Source(name, script, place, lines, placeholders, project.matches(project.open, path))


def _test_source(name: str, path: Path, data: bytes) -> Source | None:
    """A file of tests with the program that it tests; None for another file, or if that program is not complete."""
    if not is_test_file(path) or not path.is_file():
        return None
    try:
        whole = whole_program(path)
    except (ScriptError, ValueError, OSError):  # ``urscript test`` reports it
        return None
    lines = from_bytes(data).split("\n")

    def place(line: int, column: int) -> Place | None:
        found = whole.place(line, column)
        if found is None:  # where the whole ends without what the file lacks
            return _on(lines, len(lines), 1)
        return _on(lines, found.line, found.column) if found.path == path else None

    script = ScriptFile(path.stem, to_bytes(whole.text))
    return Source(name, script, place, lines, variables=whole.variables, in_tests=True)


def _on(lines: list[str], line: int, column: int) -> Place:
    return line, column, lines[line - 1] if line <= len(lines) else ""


def _embedded_source(name: str, found: Embedded, lines: list[str]) -> Source:
    text, placeholders = filled(found.text) if "{" in found.text else (found.text, set[str]())

    def place(line: int, column: int) -> Place:
        host_line, start = found.starts[min(line, len(found.starts)) - 1]
        return _on(lines, host_line, start + column - 1)

    return Source(name, ScriptFile("program", to_bytes(text)), place, lines, placeholders, embedded=True)


def _tree_source(name: str, path: Path, version: PolyscopeVersion) -> Source:
    """The script of a program tree; a place is the line of the node that wrote it. Raises SourceError."""
    from urscript.polyscope.document import DocumentError, Element  # here, because scripts need none of it
    from urscript.polyscope.folder import ProgramsFolder, read_text
    from urscript.polyscope.installation_file import InstallationFile, load_installation_file
    from urscript.polyscope.program import write_steps
    from urscript.polyscope.stale import stale_nodes
    from urscript.polyscope.tree import read_tree_steps
    from urscript.polyscope.writer import ExternalControlCode

    folder, none = ProgramsFolder(path.absolute().parent), ExternalControlCode("", "")
    try:
        tree = run_to_end(read_tree_steps(path, folder))
        beside = folder.installation(*tree.installation_names)
        installation = load_installation_file(beside) if beside else InstallationFile()
        wrong: list[tuple[Element, str]] = []
        steps = write_steps(tree, installation, version=version, external_control=none, problems=wrong)
        writer = run_to_end(steps)
        saved = path.with_suffix(SCRIPTS[0])
        found = stale_nodes(tree, installation, read_text(saved)) if saved.is_file() and not wrong else []
    except (OSError, DocumentError, ValueError) as error:
        raise SourceError(f"{name}: {getattr(error, 'strerror', None) or error}") from None
    written = writer.lines()
    rows = [(text, writer.number(node) if node is not None else 0) for text, node in written for _ in text.split("\n")]

    def place(line: int, column: int) -> Place:
        text, number = rows[min(line, len(rows)) - 1]
        return max(number, 1), column, text

    broken = [(max(writer.number(node), 1), message) for node, message in wrong]
    stale = [(max(each.number, 1), each.message) for each in found]
    return Source(name, ScriptFile(path.stem, to_bytes(writer.text())), place, [], broken_nodes=broken, stale=stale)


def filled(text: str) -> tuple[str, set[str]]:
    """A text without its placeholders, ``{x}`` and ``{{x}}``, and the names that stand for them.

    Names have the same length, so that places stay true. A placeholder alone on its line may be any statements.
    """
    names = {_POSE}

    def fill(match: re.Match[str]) -> str:
        found = match[0]
        if found[0] in '"#':
            return found
        if match["line"]:
            return " " * len(found)
        if found[0].isdigit() or _IN_NUMBER.search(text, max(match.start() - 2, 0), match.start()):
            return "0" * len(found)
        name = _NO_LETTER.sub("_", found)
        names.add(name)
        return name

    without = _LAST_ARGUMENT.sub(lambda match: match[1] + " " * len(match[2]), text)
    return _PLACEHOLDER.sub(fill, without), names
