"""Imports the project's own packages into a process that may have others of the same names.

A user's ``emulator`` or ``client`` folder stays what ``import emulator`` finds; ours then lives beside it, without
a name in ``sys.modules``.
"""

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from urproto.testing.launch import PACKAGES, ROOT, OwnPackages

_nameless: dict[str, ModuleType] = {}  # our modules whose names others have


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
