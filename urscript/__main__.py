"""The command ``urscript``, and ``python -m urscript``."""

import gc
import sys
from argparse import ArgumentParser
from collections.abc import Callable

from urproto.entry import run


def main() -> None:
    """Run the command line."""
    run(_command)


def _command() -> Callable[[], object]:
    if sys.argv[1:2] == ["check"]:  # needs no emulator, which takes a second to load
        gc.disable()  # until the process ends: what a check creates has no cycles
        return _check
    from emulator.script_cli import main as command

    return command


def _check() -> int:
    from urscript.check import command

    parser = ArgumentParser(prog="urscript check", description=f"{command.HELP[0].upper()}{command.HELP[1:]}.")
    command.add_arguments(parser)
    return command.run(parser.parse_args(sys.argv[2:]))


if __name__ == "__main__":
    main()
