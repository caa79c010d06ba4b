"""The ``urscript`` command: check scripts, list built-ins. Other packages add commands; the emulator adds ``run``."""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, entry_points
from importlib.metadata import version as distribution_version

from urproto.versions import PolyscopeVersion
from urscript.builtins import Library, LibrarySet
from urscript.commands import (
    GROUP,
    SUCCESS,
    TROUBLE,
    USAGE_ERROR,
    Command,
    add_controller_options,
    chosen_controller,
)
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.library import LIBRARIES

LIBRARY_GROUP = "urscript.libraries"
"""Entry points that name a list of `Library`; the emulator's holds the robot's built-ins."""

_DISTRIBUTION = "ur-emulator"

_ELSEWHERE = {"run": "run needs the emulator, which is not installed here: install ur-emulator as its README says"}
"""Commands of other packages, and the error when the package is not installed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status is 0, 1 for a script with errors, or 2 for wrong usage."""
    available = {command.name: command for command in commands()}
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given and given[0] in _ELSEWHERE and given[0] not in available:
        return _usage_error(_ELSEWHERE[given[0]])
    options = make_parser(available.values()).parse_args(given)
    return available[options.command].run(options)


def commands() -> Iterator[Command]:
    """The commands of this package, followed by those of other installed packages."""
    yield Command("check", "check script files and report all errors and warnings", _check_arguments, _check)
    yield Command("functions", "list the built-in functions of a PolyScope version", add_controller_options, _functions)
    for entry in entry_points(group=GROUP):
        command: Command = entry.load()
        yield command


def make_parser(available: Iterable[Command]) -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = argparse.ArgumentParser(prog="urscript", description="Check and run URScript programs.")
    parser.add_argument("--version", action="version", version=f"urscript {_version()}")
    subparsers = parser.add_subparsers(dest="command", required=True)
    for command in available:
        command.arguments(subparsers.add_parser(command.name, help=command.help, description=command.help))
    return parser


def _version() -> str:
    try:
        return distribution_version(_DISTRIBUTION)
    except PackageNotFoundError:  # a source tree that is not installed
        return "unknown"


def _libraries() -> list[Library]:
    for entry in entry_points(group=LIBRARY_GROUP):
        libraries: list[Library] = entry.load()
        return libraries
    return LIBRARIES


def _usage_error(message: str) -> int:
    sys.stderr.write(f"urscript: {message}\n")
    return USAGE_ERROR


# check


def _check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="script file; - reads standard input")
    add_controller_options(parser)


def _check(options: argparse.Namespace) -> int:
    try:
        _, version = chosen_controller(options)
    except ValueError as error:
        return _usage_error(str(error))
    libraries = LibrarySet(_libraries())
    return max([_check_file(name, libraries, version) for name in options.files])


def _check_file(name: str, libraries: LibrarySet, version: PolyscopeVersion) -> int:
    try:
        file = ScriptFile.read(name)
    except OSError as error:
        return _usage_error(f"{name}: {error.strerror}")
    problems = file.problems(libraries, version)
    for problem in problems:
        sys.stdout.write(problem.render(file.name) + "\n")
    errors = sum(isinstance(problem, CompileError) for problem in problems)
    if errors:
        return TROUBLE
    warnings = f"no errors, {len(problems)} warning{'s' if len(problems) > 1 else ''}"
    found = warnings if problems else "no problems found"
    sys.stdout.write(f"{file.name}: {found} for PolyScope {version}\n")
    return SUCCESS


# functions


def _functions(options: argparse.Namespace) -> int:
    try:
        _, version = chosen_controller(options)
    except ValueError as error:
        return _usage_error(str(error))
    libraries = LibrarySet(_libraries())
    chapter = ""
    for builtin in sorted(libraries.available(version).values(), key=lambda b: (b.chapter, b.name)):
        if builtin.chapter != chapter:
            chapter = builtin.chapter
            sys.stdout.write(f"\n{chapter}\n")
        note = f" ({builtin.note})" if builtin.note else ""
        sys.stdout.write(f"  {builtin.signature:<60} {builtin.status}{note}\n")
    return SUCCESS
