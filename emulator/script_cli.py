"""The command ``urscript``: check scripts, list built-ins, run and test files of programs on an emulated arm.

Running loads the whole emulator, so each command imports what it needs.
"""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as distribution_version
from pathlib import Path
from typing import Final

from emulator.script_options import add_controller_options, add_run_options
from urproto.entry import SUCCESS, usage_error
from urproto.robots import RobotModel, choose_version, default_model, load_model
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.check import command as check
from urscript.editor import format_command, lsp_command

_DISTRIBUTION: Final = "ur-emulator"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status is 0, 1 for a script with errors, or 2 for wrong usage."""
    options = make_parser().parse_args(arguments)
    status: int = options.run(options)
    return status


def make_parser() -> ArgumentParser:
    parser = ArgumentParser(prog="urscript", description="Check, run and test URScript programs.")
    parser.add_argument("--version", action="version", version=f"urscript {_version()}")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (text, add_arguments, run) in _COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(run=run)
        add_arguments(command)
    return parser


def libraries() -> LibrarySet:
    """The built-ins that scripts can call."""
    from emulator.builtins import LIBRARIES

    return LibrarySet(LIBRARIES)


def _chosen_controller(options: Namespace) -> tuple[RobotModel, PolyscopeVersion]:
    """The arm model and the PolyScope version that the options select. Raises ValueError."""
    model = load_model((options.model or default_model(options.polyscope)).lower())
    return model, choose_version(options.polyscope, model)


def _version() -> str:
    try:
        return distribution_version(_DISTRIBUTION)
    except PackageNotFoundError:  # a source tree that is not installed
        return "unknown"


# functions


def _functions(options: Namespace) -> int:
    try:
        _, version = _chosen_controller(options)
    except ValueError as error:
        return usage_error("urscript", error)
    available = libraries()
    chapter = ""
    for builtin in sorted(available.available(version).values(), key=lambda b: (b.chapter, b.name)):
        if builtin.chapter != chapter:
            chapter = builtin.chapter
            print(f"\n{chapter}")
        note = f" ({builtin.note})" if builtin.note else ""
        print(f"  {builtin.signature:<60} {builtin.status}{note}")
    return SUCCESS


# run


def _run_arguments(parser: ArgumentParser) -> None:
    add_run_options(parser)
    parser.add_argument(
        "--page", type=Path, metavar="FILE.html", help="write a page for browsers: the arm in 3D, a timeline and curves"
    )


def _run(options: Namespace) -> int:
    from emulator import script_run  # here, because it loads the whole emulator: every urscript command imports us

    return script_run.run(options)


# test


def _test_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("paths", nargs="*", type=Path, default=[Path()], metavar="PATH", help="test files and folders")
    add_controller_options(parser)
    parser.add_argument("-k", dest="keyword", default="", metavar="TEXT", help="only tests whose name contains it")
    parser.add_argument(
        "-n",
        dest="processes",
        type=_processes,
        default=1,
        metavar="N|auto",
        help="number of processes (default 1)",
    )
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the results as JUnit XML")
    parser.add_argument("--coverage", action="store_true", help="show which lines and branches were executed")
    parser.add_argument("--lcov", type=Path, metavar="FILE", help="write that as an lcov trace file, too")
    parser.add_argument(
        "--profile",
        type=Path,
        metavar="FILE",
        help="write robot time by line for speedscope.app, and show the most",
    )


def _processes(text: str) -> int:
    """A number of processes; 0 is one per processor."""
    if text == "auto":
        return 0
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is neither a number of processes nor auto")
    return int(text)


def _test(options: Namespace) -> int:
    from emulator.scripttest import command  # see `_run`

    return command.run(options)


# debug


def _no_arguments(parser: ArgumentParser) -> None:
    """What an editor sends is all."""


def _dap(options: Namespace) -> int:
    from emulator.debugger import adapter  # see `_run`

    return adapter.run()


_COMMANDS: Final[dict[str, tuple[str, Callable[[ArgumentParser], None], Callable[[Namespace], int]]]] = {
    "check": (check.HELP, check.add_arguments, check.run),
    "dap": (
        "debug a program, for editors: the Debug Adapter Protocol on standard input and output",
        _no_arguments,
        _dap,
    ),
    "format": (format_command.HELP, format_command.add_arguments, format_command.run),
    "functions": ("list the built-in functions of a PolyScope version", add_controller_options, _functions),
    "lsp": (lsp_command.HELP, lsp_command.add_arguments, lsp_command.run),
    "run": ("run a file of URScript programs on an emulated arm, in virtual time", _run_arguments, _run),
    "test": ("run tests that are written in URScript, in virtual time", _test_arguments, _test),
}
"""Each command: its help, what adds its arguments, and what runs it and returns the exit status."""
