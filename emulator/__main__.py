"""``python -m emulator``, and the command ``ur-emulator``."""

import sys

__all__ = ["main"]


def main() -> None:
    """Run an emulator, or with ``ctl`` as the first word a verb of one that runs, which loads next to nothing."""
    if sys.argv[1:2] == ["ctl"]:
        from emulator import ctl

        ctl.main(sys.argv[2:])
    else:
        from emulator import cli

        cli.main()


if __name__ == "__main__":
    main()
