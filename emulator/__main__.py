"""The command ``ur-emulator``, and ``python -m emulator``."""

from collections.abc import Callable

from urproto.entry import run


def main() -> None:
    run(_command)


def _command() -> Callable[[], object]:
    from emulator.cli import main as command

    return command


if __name__ == "__main__":
    main()
