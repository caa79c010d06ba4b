"""What a command of ``urscript`` is, so that other packages can add theirs.

A package that can do something with scripts names a `Command` in its metadata:

    [project.entry-points."urscript.commands"]
    run = "emulator.run_command:COMMAND"
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass

from urproto.robots import RobotModel, choose_version, default_model, load_model
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

GROUP = "urscript.commands"
"""The group of entry points; the name of an entry point is that of its command."""

SUCCESS, TROUBLE, USAGE_ERROR = 0, 1, 2
"""Exit statuses: all is well, something is wrong with the script, or with how the command was called."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command. ``arguments`` declares its arguments, ``run`` carries it out and returns the exit status."""

    name: str
    help: str
    arguments: Callable[[ArgumentParser], None]
    run: Callable[[Namespace], int]


def add_controller_options(parser: ArgumentParser) -> None:
    """``--model`` and ``--polyscope``, the same for every command and with the emulator's defaults."""
    usual = DEFAULT_VERSION[Series.CB3]
    parser.add_argument(
        "--model", help="the arm, for example ur3 or ur5e (default ur3, ur3e for an e-Series PolyScope version)"
    )
    parser.add_argument(
        "--polyscope", help=f"PolyScope version (default: the usual one of the arm's series, {usual} of ur3)"
    )


def chosen_controller(options: Namespace) -> tuple[RobotModel, PolyscopeVersion]:
    """The arm and the version that these options ask for. Raises ValueError."""
    model = load_model((options.model or default_model(options.polyscope)).lower())
    return model, choose_version(options.polyscope, model)
