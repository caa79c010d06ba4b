"""Runs an emulator for a test: the one this file belongs to, and no longer than the test's own process lives.

It is started as a file, ``python -P launch.py [options of ur-emulator]``, since ``-m emulator`` would take whatever
is called ``emulator`` in the folder or on the PYTHONPATH of the test.
"""

import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Final

ROOT: Final = Path(__file__).absolute().parents[2]  # the folder that holds the four packages
PACKAGES: Final = ("client", "emulator", "urproto", "urscript")
_GOODBYE_S: Final = 5.0  # guess: how long a clean end may take


class OwnPackages:
    """A finder that knows the project's packages only, where they are installed."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """As importlib wants it."""
        return PathFinder.find_spec(name, [str(ROOT)]) if name in PACKAGES else None


def pin() -> None:
    """Let the packages of this process be those of the project, whatever else has their names."""
    sys.meta_path.insert(0, OwnPackages)


def check() -> None:
    """``ur-emulator-check``, which has to work where other packages have our names."""
    pin()
    importlib.import_module("urproto.entry").run("emulator.check")


def _end_with_parent() -> None:
    """Standard input is a pipe that nobody writes to: it ends when the process that started this one is gone."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GOODBYE_S)
    os._exit(1)


def _main() -> None:
    pin()
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    importlib.import_module("emulator.__main__").main()


if __name__ == "__main__":
    _main()
