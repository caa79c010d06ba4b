"""A reader who has nothing but a clone and what a page told him to install: no privileges, and an empty home folder.

Packages that he was not told to install cannot be imported. They are hidden in the environment of the tests instead of
installing another one for each page, which would take minutes.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from importlib.metadata import distribution, distributions, packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pages import ROOT

__all__ = ["UNPRIVILEGED", "clone", "environment", "move_in", "told_to_install"]

# What an ordinary user may do on a machine that is prepared as `ur-client doctor` recommends: real-time priority and
# locked memory, as the pages run in real time next to other tests. The user is who runs the tests: others could not
# enter the folder of a Python that belongs to root.
UNPRIVILEGED = ("setpriv", "--bounding-set=-all,+sys_nice,+ipc_lock", "--inh-caps=-all", "--ambient-caps=-all", "--")
PROJECT = "ur-emulator"
USUAL = (f"{PROJECT}[pendant]", "pip")  # make emulator
SCRIPTS = Path(sys.executable).parent
CACHE = Path.home() / ".cache"
HIDE = """
from importlib.machinery import PathFinder

every_module, every_package = PathFinder.find_spec, PathFinder.find_distributions

@classmethod
def find_spec(cls, name, path=None, target=None):
    return None if name.partition(".")[0] in MODULES else every_module(name, path, target)

@classmethod
def find_distributions(cls, *context):  # those with plugins of pytest, for example
    return (found for found in every_package(*context) if found.metadata["Name"] not in NAMES)

PathFinder.find_spec, PathFinder.find_distributions = find_spec, find_distributions
"""  # imports little, as each Python that a page starts runs it


def clone(folder: Path) -> None:
    """A copy of what git tracks, as `git clone` makes it; where there is no git, of everything without a dot."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".*", "build", "__pycache__", "*.egg-info"))
        return
    for name in listed.stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)


def told_to_install(page: Path) -> tuple[str, ...]:
    """The requirements that a page names after `pip install`; those of `make emulator` if it installs no clone."""
    named = list[str]()
    for arguments in re.findall(r"pip install (?!\"\$)([^\n`#]+)", page.read_text()):
        named += [word.rstrip(".,;:") or "." for word in shlex.split(arguments) if not word.startswith("-")]
    ours = [PROJECT + word.lstrip("./") for word in named if word.startswith(".") and word != ".[test]"]
    return *(ours or USUAL), *(word for word in named if not word.startswith(".")), "pip"


def installed(requirements: tuple[str, ...]) -> set[str]:
    """Names of the distributions that pip installs for these."""
    found = set[str]()
    waiting = [(Requirement(text), frozenset[str]()) for text in requirements if text != f"{PROJECT}[...]"]
    seen = set[tuple[str, frozenset[str]]]()
    while waiting:
        requirement, extras_of_parent = waiting.pop()
        name, extras = canonicalize_name(requirement.name), frozenset(requirement.extras)
        applies = any(
            requirement.marker is None or requirement.marker.evaluate({"extra": extra})
            for extra in extras_of_parent or {""}
        )
        if not applies or (name, extras) in seen:
            continue
        seen.add((name, extras))
        found.add(name)
        waiting += [(Requirement(text), extras | {""}) for text in distribution(name).requires or ()]
    return found


@cache
def present() -> tuple[list[str], dict[str, set[str]]]:
    """Names of all distributions here, and of those that each module belongs to."""
    return [found.metadata["Name"] for found in distributions()], {
        module: set(owners) for module, owners in packages_distributions().items()
    }


def hidden(requirements: tuple[str, ...]) -> str:
    """Code that hides the packages that were not installed, and their modules, from the Python that starts with it."""
    there = installed(requirements)
    everything, owners = present()
    names = {name for name in everything if canonicalize_name(name) not in there}
    modules = {module for module in owners if owners[module] <= names}
    return f"NAMES = {names!r}\nMODULES = {modules!r}\n{HIDE}"


def move_in(home: Path, page: Path, cloned: Path) -> Path:
    """Give the reader of a page a copy of a clone in his home folder; the copy's folder."""
    folder = home / PROJECT
    shutil.copytree(cloned, folder, copy_function=os.link)
    (home / "packages").mkdir()
    (home / "packages" / "sitecustomize.py").write_text(hidden(told_to_install(page)))
    return folder


def environment(home: Path) -> dict[str, str]:
    return {
        "HOME": str(home),
        "LANG": "C.UTF-8",
        # what a machine has after the first time; it takes a minute: message packages, and a list of fonts
        "UR_CLIENT_ROS2_CACHE": os.environ.get("UR_CLIENT_ROS2_CACHE", f"{CACHE}/ur-client/ros2"),
        "MPLCONFIGDIR": f"{CACHE}/matplotlib",
        "PATH": f"{SCRIPTS}:/usr/local/bin:/usr/bin:/bin",
        "PYTHONPATH": f"{home / 'packages'}:{ROOT}",  # as an editable installation of another clone
    }
