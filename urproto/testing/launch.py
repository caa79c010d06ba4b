"""Start an emulator with this file: ``python launch.py [options of ur-emulator]``.

``-m emulator`` would run any ``emulator`` in the folder or on the PYTHONPATH of a test; this file imports the packages
next to its own. The emulator ends together with the test's process.
"""

import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).absolute().parents[2]  # the folder with the packages
_SHUTDOWN_S: Final = 5.0  # guess: how long a clean shutdown may take


def import_own_packages() -> None:
    """Import the project's packages, which Python then finds whatever else has their names."""
    sys.path.insert(0, str(ROOT))
    import emulator  # noqa: F401
    import urproto  # noqa: F401
    import urscript  # noqa: F401

    sys.path.remove(str(ROOT))


def check() -> None:
    """The command ``ur-emulator-check``, which must work even if other packages have our names."""
    import_own_packages()
    from emulator.check import main
    from urproto.entry import run

    run(lambda: main)


def _end_with_parent() -> None:
    """Exit when the parent process is gone: standard input is a pipe without data, which is closed then."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_SHUTDOWN_S)
    os._exit(1)


def _main() -> None:
    if not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the folder of this file, which must not be searched
    import_own_packages()
    from emulator.__main__ import main

    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    main()


if __name__ == "__main__":
    _main()
