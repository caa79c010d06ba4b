"""The command ``ur-client``, and ``python -m client``."""

from collections.abc import Callable

from urproto.entry import run


def main() -> None:
    """Run the command line."""
    run(_command)


def _command() -> Callable[[], object]:
    from client.cli import main as command

    return command


if __name__ == "__main__":
    main()
