"""How every command starts: Ctrl-C ends it without a traceback, even while its modules are being imported.

This module imports almost nothing, because an interrupt during its own import could not be caught.
"""

import os
import sys
from collections.abc import Callable

SUCCESS, TROUBLE, USAGE_ERROR = 0, 1, 2
"""Exit statuses of ``urscript``: success, an error in the script, or wrong usage of the command."""

INTERRUPTED = 130
"""Exit status of a program ended by Ctrl-C, as in shells."""

NOBODY_READS = 141
"""Exit status of a program whose output goes to a pipe that was closed, as in shells: ``urscript run x | head -1``."""


def usage_error(program: str, problem: object) -> int:
    """Report wrong usage in a line on standard error, and return the exit status for it."""
    print(f"{program}: {problem}", file=sys.stderr)
    return USAGE_ERROR


def run(load: Callable[[], Callable[[], object]]) -> None:
    """Import a command (``load`` does, and returns its function), run it and exit with what it returns."""
    try:
        from urproto.text import show_any_text

        show_any_text(sys.stdout, sys.stderr)
        status = load()()
        sys.stdout.flush()
        sys.exit(status if isinstance(status, int) else None)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is left of the output
        sys.exit(NOBODY_READS)
