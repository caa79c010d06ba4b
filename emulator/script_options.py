"""The options of ``urscript run``, which other programs that run scripts share: campaigns and ``urscript test``."""

import math
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from emulator.options import help_of
from emulator.robot.kinds import ArmKind
from emulator.services.sockets import ScriptNetwork


def add_controller_options(parser: ArgumentParser) -> None:
    """Add ``--model`` and ``--polyscope``, the same for every command and with the emulator's defaults."""
    parser.add_argument("--model", help=help_of("model"))
    parser.add_argument("--polyscope", help=help_of("polyscope"))


def add_run_options(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="file of URScript programs; - for standard input")
    add_controller_options(parser)
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
    parser.add_argument("--gripper", metavar="MODEL", help=help_of("gripper"))
    parser.add_argument("--gripper-object", type=_positive, metavar="MM", help=help_of("gripper_object"))
    parser.add_argument("--arm", metavar="ideal|dynamic|FILE", default=ArmKind.IDEAL, help=help_of("arm"))
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of a dynamic arm's measurement noise, and of faults without a seed",
    )
    parser.add_argument("--fault", action="append", default=[], metavar="KIND,NAME=VALUE,...", help=help_of("fault"))
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
        help="YAML file with the devices that the script talks to (docs/peers.md)",
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


def parsed(words: Sequence[str]) -> Namespace:
    """The options in the words that follow ``urscript run``. Raises ValueError."""
    parser = _Parser(add_help=False, allow_abbrev=False)
    add_run_options(parser)
    return parser.parse_args(words)


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ValueError(message)
