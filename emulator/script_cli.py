"""The command ``urscript``: check scripts, list built-ins, run files of programs on an emulated arm.

Running loads the whole emulator, so each command imports what it needs.
"""

import math
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as distribution_version
from pathlib import Path
from typing import Final, NoReturn

from emulator.options import help_of
from emulator.robot.kinds import ArmKind
from emulator.services.sockets import ScriptNetwork
from urproto.entry import SUCCESS, USAGE_ERROR
from urproto.robots import RobotModel, choose_version, default_model, load_model
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.check import command as check

_DISTRIBUTION: Final = "ur-emulator"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status is 0, 1 for a script with errors, or 2 for wrong usage."""
    options = make_parser().parse_args(arguments)
    status: int = options.run(options)
    return status


def make_parser() -> ArgumentParser:
    """The parser of the whole command line."""
    parser = ArgumentParser(prog="urscript", description="Check and run URScript programs.")
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


def _add_controller_options(parser: ArgumentParser) -> None:
    """Add ``--model`` and ``--polyscope``, the same for every command and with the emulator's defaults."""
    parser.add_argument("--model", help=help_of("model"))
    parser.add_argument("--polyscope", help=help_of("polyscope"))


def _chosen_controller(options: Namespace) -> tuple[RobotModel, PolyscopeVersion]:
    """The arm model and the PolyScope version that the options select. Raises ValueError."""
    model = load_model((options.model or default_model(options.polyscope)).lower())
    return model, choose_version(options.polyscope, model)


def _version() -> str:
    try:
        return distribution_version(_DISTRIBUTION)
    except PackageNotFoundError:  # a source tree that is not installed
        return "unknown"


def _usage_error(message: str) -> int:
    sys.stderr.write(f"urscript: {message}\n")
    return USAGE_ERROR


# functions


def _functions(options: Namespace) -> int:
    try:
        _, version = _chosen_controller(options)
    except ValueError as error:
        return _usage_error(str(error))
    available = libraries()
    chapter = ""
    for builtin in sorted(available.available(version).values(), key=lambda b: (b.chapter, b.name)):
        if builtin.chapter != chapter:
            chapter = builtin.chapter
            sys.stdout.write(f"\n{chapter}\n")
        note = f" ({builtin.note})" if builtin.note else ""
        sys.stdout.write(f"  {builtin.signature:<60} {builtin.status}{note}\n")
    return SUCCESS


# run


def _run_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="file of URScript programs; - for standard input")
    _add_controller_options(parser)
    parser.add_argument(
        "--speed",
        type=_speed,
        metavar="max|N",
        help="N times real time; max (the default): as fast as possible, or real time while a script socket is open",
    )
    parser.add_argument("--timeout", type=_positive, metavar="SECONDS", help="stop after this much robot time")
    parser.add_argument(
        "--script-network",
        choices=list(ScriptNetwork),
        default=ScriptNetwork.ANY,
        help=help_of("script_network"),
    )
    parser.add_argument("--world", type=Path, metavar="WORLD", help=help_of("world"))
    parser.add_argument(
        "--arm",
        metavar="ideal|dynamic|FILE",
        default=ArmKind.IDEAL,
        help=help_of("arm"),
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of a dynamic arm's measurement noise, and of faults without a seed",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND,NAME=VALUE,...",
        help=help_of("fault"),
    )
    parser.add_argument(
        "--speed-slider", type=_fraction, default=1.0, metavar="0..1", help="position of the speed slider (default 1)"
    )
    parser.add_argument("--joints", nargs=6, metavar="Q", help="six joint angles at the start [rad]")
    parser.add_argument(
        "--input",
        action="append",
        default=[],
        metavar="NAME=VALUE[@S]",
        help="set an input at the start, or at robot time S: digital0 to 7, configurable0 to 7, tool0 and 1 (0 or 1), "
        "analog0 and 1, tool-analog0 and 1 (V or A); repeatable",
    )
    parser.add_argument(
        "--register",
        action="append",
        default=[],
        metavar="NAME=VALUE[@S]",
        help="set an input register in the same way: bool0 to 127, int0 to 47, float0 to 47; repeatable",
    )
    parser.add_argument(
        "--answer",
        action="append",
        default=[],
        metavar="TEXT",
        help="answer to a question of the program, as an operator would type it; repeatable, in order",
    )
    parser.add_argument(
        "--peers",
        type=Path,
        metavar="FILE",
        help="YAML file with the answers of peers on sockets and XML-RPC (emulator.script_peers)",
    )
    parser.add_argument("--trace", action="store_true", help="show every statement before it is executed")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _fraction(text: str) -> float:
    value = _positive(text)
    if value > 1.0:
        raise ArgumentTypeError(f"{text!r} is more than 1")
    return value


def _speed(text: str) -> float | None:
    return None if text == "max" else _positive(text)


def _run(options: Namespace) -> int:
    from emulator import script_run  # here, because it loads the whole emulator: every urscript command imports us

    return script_run.run(options)


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def parsed(words: Sequence[str]) -> Namespace:
    """The options in the words that follow ``urscript run``. Raises ValueError."""
    parser = _Parser(add_help=False, allow_abbrev=False)
    _run_arguments(parser)
    return parser.parse_args(words)


_COMMANDS: Final[dict[str, tuple[str, Callable[[ArgumentParser], None], Callable[[Namespace], int]]]] = {
    "check": (check.HELP, check.add_arguments, check.run),
    "functions": ("list the built-in functions of a PolyScope version", _add_controller_options, _functions),
    "run": ("run a file of URScript programs on an emulated arm, in virtual time", _run_arguments, _run),
}
"""Each command: its help, what adds its arguments, and what runs it and returns the exit status."""
