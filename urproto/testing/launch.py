"""The project's own packages in a process that may have others of the same names, such as ``client`` and ``emulator``.

Tests run an emulator by this file, ``python launch.py [options of ur-emulator]``, since ``-m emulator`` would take
whatever is called ``emulator`` in the folder or on the PYTHONPATH of the test. It ends with the test's own process.

In the test's process ``load`` imports ours beside a user's: theirs stay what ``import emulator`` finds, ours are then
without a name in ``sys.modules``.
"""

import importlib
import importlib.util
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Final

ROOT: Final = Path(__file__).absolute().parents[2]  # the folder that holds the four packages
PACKAGES: Final = ("client", "emulator", "urproto", "urscript")
_GOODBYE_S: Final = 5.0  # guess: how long a clean end may take

_nameless: dict[str, ModuleType] = {}  # our modules whose names others have


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


def load(name: str) -> ModuleType:
    """A module of the project by its dotted name. It is the one that ``import`` gives, if that finds ours."""
    taken = [package for package in PACKAGES if package != "urproto" and not _finds_ours(package)]
    if not taken:
        return importlib.import_module(name)
    with _own_names(taken):
        return importlib.import_module(name)


def is_ours(origin: str | None, package: str) -> bool:
    """Whether a package's ``__init__.py`` is that of the project."""
    ours = ROOT / package / "__init__.py"
    return origin is not None and Path(origin).exists() and ours.samefile(origin)


def _finds_ours(package: str) -> bool:
    """Whether ``import`` gives ours, without importing it."""
    present = sys.modules.get(package)
    if present is not None:
        return is_ours(getattr(present, "__file__", None), package)
    spec = importlib.util.find_spec(package)
    return spec is not None and is_ours(spec.origin, package)


@contextmanager
def _own_names(taken: list[str]) -> Iterator[None]:
    """Give our packages their names while something of them is imported."""
    theirs = _taken_out(taken)
    sys.modules.update(_nameless)
    sys.meta_path.insert(0, OwnPackages)
    try:
        yield
    finally:
        sys.meta_path.remove(OwnPackages)
        _nameless.update(_taken_out(taken))
        sys.modules.update(theirs)


def _taken_out(packages: list[str]) -> dict[str, ModuleType]:
    names = [name for name in sys.modules if name.partition(".")[0] in packages]
    return {name: sys.modules.pop(name) for name in names}


def _end_with_parent() -> None:
    """Standard input is a pipe that nobody writes to: it ends when the process that started this one is gone."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GOODBYE_S)
    os._exit(1)


def _main() -> None:
    if not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the folder of this file, which nobody is to import from
    pin()
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    importlib.import_module("emulator.__main__").main()


if __name__ == "__main__":
    _main()
