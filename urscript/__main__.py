"""The command ``urscript``, and ``python -m urscript``."""

import gc
import sys
from argparse import ArgumentParser
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any, Final

from urproto.entry import run

_LASTING: Final = "lsp"
_WITHOUT_EMULATOR: Final = {  # which takes a second to load
    "check": "urscript.check.command",
    "format": "urscript.editor.format_command",
    "lsp": "urscript.editor.lsp_command",
}


def main() -> None:
    """Run the command line."""
    run(_command)


def _command() -> Callable[[], object]:
    place = _WITHOUT_EMULATOR.get(sys.argv[1] if len(sys.argv) > 1 else "")
    if place is None:
        from emulator.script_cli import main as command

        return command
    return partial(_run, sys.argv[1], import_module(place))


def _run(name: str, command: Any) -> object:
    if name != _LASTING:
        gc.disable()  # until the process ends: what a check creates has no cycles
    parser = ArgumentParser(prog=f"urscript {name}", description=f"{command.HELP[0].upper()}{command.HELP[1:]}.")
    command.add_arguments(parser)
    return command.run(parser.parse_args(sys.argv[2:]))


if __name__ == "__main__":
    main()
