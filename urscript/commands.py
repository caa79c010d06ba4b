"""What a command of ``urscript`` is, so that other packages can add theirs.

A package that can do something with scripts names a `Command` in its metadata:

    [project.entry-points."urscript.commands"]
    run = "emulator.run_command:COMMAND"
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["GROUP", "SUCCESS", "TROUBLE", "USAGE_ERROR", "Command"]

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
