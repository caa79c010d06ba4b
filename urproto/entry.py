"""Where every command of the project begins: Ctrl-C ends it without a traceback, while it still loads modules too.

It loads next to nothing itself, since an interrupt before it could not be caught.
"""

import sys
from importlib import import_module

INTERRUPTED = 130
"""Exit status of a program that Ctrl-C ended, as shells have it."""


def run(module: str) -> None:
    """Load a module and end with what its ``main`` returns."""
    try:
        from urproto.text import show_anything

        show_anything(sys.stdout, sys.stderr)
        sys.exit(import_module(module).main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def ur_client() -> None:
    """The command ``ur-client``."""
    run("client.cli")


def ur_emulator() -> None:
    """The command ``ur-emulator``."""
    run("emulator.cli")


def urscript() -> None:
    """The command ``urscript``."""
    run("urscript.cli")
