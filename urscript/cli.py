"""The ``urscript`` command: check scripts and list built-ins without a robot."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.builtins import Library, LibrarySet
from urscript.compiler import compile_script
from urscript.errors import CompileError, ScriptError
from urscript.library import LIBRARIES
from urscript.splitter import ScriptSplitter
from urscript.values import from_bytes

__all__ = ["main"]

GROUP = "urscript.libraries"
"""Entry points that name a list of `Library`; the emulator's holds the robot's built-ins."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status is 0, 1 for a script with errors, or 2 for wrong usage."""
    options = _parser().parse_args(arguments)
    try:
        version = PolyscopeVersion.parse(options.polyscope)
    except ValueError as error:
        return _usage_error(str(error))
    libraries = LibrarySet(_libraries())
    if options.command == "functions":
        return _functions(libraries, version)
    return max([_check(path, libraries, version) for path in options.files])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="urscript", description="Check URScript programs and list the built-ins.")
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="compile files and show what is wrong with them")
    check.add_argument("files", nargs="+", type=Path, metavar="FILE")
    functions = commands.add_parser("functions", help="list the built-ins of a version")
    for command in (check, functions):
        default = str(DEFAULT_VERSION[Series.E])
        command.add_argument("--polyscope", default=default, help=f"PolyScope version (default {default})")
    return parser


def _libraries() -> list[Library]:
    for entry in entry_points(group=GROUP):
        libraries: list[Library] = entry.load()
        return libraries
    return LIBRARIES


def _usage_error(message: str) -> int:
    sys.stderr.write(f"urscript: {message}\n")
    return 2


# check


def _check(path: Path, libraries: LibrarySet, version: PolyscopeVersion) -> int:
    try:
        data = path.read_bytes()
    except OSError as error:
        return _usage_error(f"{path}: {error.strerror}")
    problems = list(_problems(data, libraries, version))
    for problem in problems:
        sys.stdout.write(problem.render(str(path)) + "\n")
    if not problems:
        sys.stdout.write(f"{path}: no problems found for PolyScope {version}\n")
    return 1 if problems else 0


def _problems(data: bytes, libraries: LibrarySet, version: PolyscopeVersion) -> Iterator[ScriptError]:
    """What is wrong, with lines counted from the beginning of the file."""
    whole = from_bytes(data).replace("\r\n", "\n")
    for text, first_line in _units(whole):
        try:
            program = compile_script(text, libraries, version)
        except CompileError as error:
            yield ScriptError(error.message, error.line + first_line, error.column, whole)
            continue
        for warning in program.warnings:
            yield ScriptError(warning.message, warning.line + first_line, warning.column, whole)


def _units(text: str) -> Iterator[tuple[str, int]]:
    """The programs of a file with the number of lines before each.

    A file that begins with a statement is one program, as PolyScope includes it.
    """
    splitter = ScriptSplitter()
    units = [*splitter.feed(text.encode("utf-8", "surrogateescape")), *splitter.flush()]
    one = not units or units[0].kind != "block"
    position = 0
    for unit_text in [text] if one else [unit.text for unit in units]:
        position = text.index(unit_text, position)
        body = unit_text.lstrip()
        yield body, text.count("\n", 0, position + len(unit_text) - len(body))
        position += len(unit_text)


# functions


def _functions(libraries: LibrarySet, version: PolyscopeVersion) -> int:
    chapter = ""
    for builtin in sorted(libraries.available(version).values(), key=lambda b: (b.chapter, b.name)):
        if builtin.chapter != chapter:
            chapter = builtin.chapter
            sys.stdout.write(f"\n{chapter}\n")
        note = f" ({builtin.note})" if builtin.note else ""
        sys.stdout.write(f"  {builtin.signature:<60} {builtin.status}{note}\n")
    return 0
