"""Import the project's packages even if others have the same names, such as ``client`` and ``emulator``.

Tests start an emulator with this file, ``python launch.py [options of ur-emulator]``, because ``-m emulator`` would run
any ``emulator`` in the folder or on the PYTHONPATH of the test. The emulator ends together with the test's process.

In the test's process, ``load`` imports our packages next to those of a user: ``import emulator`` still finds the user's
package, and ours are not in ``sys.modules``.
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

ROOT: Final = Path(__file__).absolute().parents[2]  # the folder with the four packages
PACKAGES: Final = ("client", "emulator", "urproto", "urscript")
_SHUTDOWN_S: Final = 5.0  # guess: how long a clean shutdown may take

_hidden_modules: dict[str, ModuleType] = {}  # our modules whose names are taken by others


class OwnPackages:
    """A finder for the project's packages only, where they are installed."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """The method of the importlib finder protocol."""
        return PathFinder.find_spec(name, [str(ROOT)]) if name in PACKAGES else None


def pin() -> None:
    """Make this process import the project's packages, even if others have the same names."""
    sys.meta_path.insert(0, OwnPackages)


def check() -> None:
    """The command ``ur-emulator-check``, which must work even if other packages have our names."""
    pin()
    importlib.import_module("urproto.entry").run("emulator.check")


def load(name: str) -> ModuleType:
    """A module of the project by its dotted name: the same as with ``import``, if that finds ours."""
    shadowed = [package for package in PACKAGES if package != "urproto" and not _finds_own_package(package)]
    if not shadowed:
        return importlib.import_module(name)
    with _own_names(shadowed):
        return importlib.import_module(name)


def is_own_package(origin: str | None, package: str) -> bool:
    """Whether a package's ``__init__.py`` is that of the project."""
    own_file = ROOT / package / "__init__.py"
    return origin is not None and Path(origin).exists() and own_file.samefile(origin)


def _finds_own_package(package: str) -> bool:
    """Whether ``import`` would find our package, without importing it."""
    present = sys.modules.get(package)
    if present is not None:
        return is_own_package(getattr(present, "__file__", None), package)
    spec = importlib.util.find_spec(package)
    return spec is not None and is_own_package(spec.origin, package)


@contextmanager
def _own_names(shadowed: list[str]) -> Iterator[None]:
    """Give our packages their names in ``sys.modules`` while one of their modules is imported."""
    others = _remove_modules(shadowed)
    sys.modules.update(_hidden_modules)
    sys.meta_path.insert(0, OwnPackages)
    try:
        yield
    finally:
        sys.meta_path.remove(OwnPackages)
        _hidden_modules.update(_remove_modules(shadowed))
        sys.modules.update(others)


def _remove_modules(packages: list[str]) -> dict[str, ModuleType]:
    names = [name for name in sys.modules if name.partition(".")[0] in packages]
    return {name: sys.modules.pop(name) for name in names}


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
    pin()
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    importlib.import_module("emulator.__main__").main()


if __name__ == "__main__":
    _main()
