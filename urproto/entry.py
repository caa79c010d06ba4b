"""Entry points of all commands: Ctrl-C ends them without a traceback, even while modules are being imported.

This module imports almost nothing, because an interrupt during its own import could not be caught.
"""

import os
import sys
from importlib import import_module

INTERRUPTED = 130
"""Exit status of a program ended by Ctrl-C, as in shells."""

NOBODY_READS = 141
"""Exit status of a program whose output goes to a pipe that was closed, as in shells: ``urscript run x | head -1``."""


def run(module: str) -> None:
    """Import a module, run its ``main`` and exit with its return value."""
    try:
        from urproto.text import show_any_text

        show_any_text(sys.stdout, sys.stderr)
        status = import_module(module).main()
        sys.stdout.flush()
        sys.exit(status)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is left of the output
        sys.exit(NOBODY_READS)


def ur_client() -> None:
    """The command ``ur-client``."""
    run("client.cli")


def ur_emulator() -> None:
    """The command ``ur-emulator``."""
    run("emulator.cli")


def urscript() -> None:
    """The command ``urscript``."""
    run("urscript.cli")
