"""``python -m emulator``, and the command ``ur-emulator``."""

import os
import sys

__all__ = ["main"]


def main() -> None:
    """Run an emulator; with ``fleet`` as the first word many; with ``ctl`` a verb of one, loading next to nothing."""
    if sys.argv[1:2] == ["ctl"]:
        from emulator import ctl

        ctl.main(sys.argv[2:])
    elif sys.argv[1:2] == ["fleet"]:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read on import; a process with threads must not fork
        from emulator.fleet import command

        command.main(sys.argv[2:])
    else:
        from emulator import cli

        cli.main()


if __name__ == "__main__":
    main()
