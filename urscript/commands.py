"""Commands of ``urscript``, and how other packages add theirs.

A package adds a command by naming a `Command` in its metadata:

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
"""Exit statuses: success, an error in the script, or wrong usage of the command."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command. ``arguments`` declares its arguments; ``run`` executes it and returns the exit status."""

    name: str
    help: str
    arguments: Callable[[ArgumentParser], None]
    run: Callable[[Namespace], int]


def add_controller_options(parser: ArgumentParser) -> None:
    """Add ``--model`` and ``--polyscope``, the same for every command and with the emulator's defaults."""
    usual = DEFAULT_VERSION[Series.CB3]
    parser.add_argument(
        "--model", help="the arm, for example ur3 or ur5e (default ur3, ur3e for an e-Series PolyScope version)"
    )
    parser.add_argument("--polyscope", help=f"PolyScope version (default: that of the arm's series, {usual} for ur3)")


def chosen_controller(options: Namespace) -> tuple[RobotModel, PolyscopeVersion]:
    """The arm model and the PolyScope version that the options select. Raises ValueError."""
    model = load_model((options.model or default_model(options.polyscope)).lower())
    return model, choose_version(options.polyscope, model)
