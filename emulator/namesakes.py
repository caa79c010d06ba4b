"""Packages of other people that have the names of ours: whoever finds them first gets something else than meant."""

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import packages_distributions
from importlib.metadata import version as distribution_version
from pathlib import Path
from typing import Final

import emulator

_DISTRIBUTION: Final = "ur-emulator"
_PACKAGES: Final = ("client", "emulator", "urproto", "urscript")
_ROOT: Final = Path(emulator.__file__).absolute().parents[1]
_HERE_CURE: Final = (
    "rename it, or work elsewhere. The commands (ur-emulator, ur-client, ...) and the pytest plugin do not look "
    "there; python -P does not either"
)
_PATH_CURE: Final = "take that folder off PYTHONPATH, or rename the package in it"
_SITE_CURE: Final = "remove it, or install ur-emulator into a virtual environment of its own (python -m venv)"


@dataclass(frozen=True)
class Namesake:
    """Something with the name of one of our packages, what it does to us, and what to do."""

    package: str
    problem: str
    cure: str


def installation() -> str:
    """Which version this is, where, and for which Python."""
    return f"ur-emulator {distribution_version(_DISTRIBUTION)} in {_ROOT}, Python {sys.version.split()[0]}"


def find_namesakes() -> list[Namesake]:
    """All of them: in the current folder, on PYTHONPATH, in site-packages, and among installed distributions."""
    search = list(dict.fromkeys([os.getcwd(), *(str(Path(place).absolute()) for place in sys.path if place)]))
    found = [namesake for package in _PACKAGES for namesake in _shadows(package, search)]
    return found + list(_shared_distributions())


def _shadows(package: str, search: list[str]) -> Iterator[Namesake]:
    """Those that are found before ours. A folder that is no package is, if ours is not on the path at all."""
    before: list[tuple[str, ModuleSpec]] = []
    for place in search:
        spec = PathFinder.find_spec(package, [place])
        if spec is None:
            continue
        if spec.origin is not None and _is_ours(spec.origin):
            before = [(folder, other) for folder, other in before if other.origin is not None]
            break
        before.append((place, spec))
    for place, spec in before:
        where = spec.origin or str(Path(place, package))
        yield Namesake(package, f"{where} is found before ours by python {_finder(place)}", _cure(place))


def _finder(place: str) -> str:
    return f"started in {place}" if place == os.getcwd() else "everywhere"


def _cure(place: str) -> str:
    if place == os.getcwd():
        return _HERE_CURE
    named = (str(Path(entry).absolute()) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry)
    return _PATH_CURE if place in named else _SITE_CURE


def _is_ours(origin: str) -> bool:
    return Path(origin).resolve().is_relative_to(_ROOT.resolve())


def _shared_distributions() -> Iterator[Namesake]:
    """Distributions that put files where ours are: whichever was installed last has overwritten the other's."""
    owners = packages_distributions()
    for package in _PACKAGES:
        for other in sorted({name for name in owners.get(package, []) if name != _DISTRIBUTION}):
            yield Namesake(
                package,
                f"the distribution {other} installs a package of this name too: one has overwritten the other",
                f"pip uninstall {other} and pip install --force-reinstall {_DISTRIBUTION}, or a virtual environment "
                "for each",
            )
