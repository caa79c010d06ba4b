"""Removes from an environment what a robot never loads; for the build of the image only.

Pinocchio's wheels bring the headers, build files and tools of half a dozen C++ libraries: four fifths of all bytes.
Run by the environment's own interpreter. What this process has mapped after loading the emulator stays.
"""

import sys
import sysconfig
from pathlib import Path

from emulator.controller import Controller, ControllerConfig
from urproto.robots import load_model

__all__: list[str] = []


def main() -> None:
    """Load, look, remove."""
    Controller(ControllerConfig(model=load_model("ur5e"), running=True)).tick()
    maps = Path("/proc/self/maps").read_text().splitlines()
    loaded = {Path(line.split(maxsplit=5)[5]) for line in maps if line.count("/") and ".so" in line}
    prefix = Path(sysconfig.get_path("purelib"), "cmeel.prefix")
    before = _size(prefix)
    for path in sorted(prefix.rglob("*"), reverse=True):  # what is in a folder before the folder
        if path.is_dir() and not path.is_symlink():
            if not any(path.iterdir()):
                path.rmdir()
        elif path.suffix != ".py" and path.resolve() not in loaded:
            path.unlink()
    sys.stdout.write(f"{prefix}: {before} MB, now {_size(prefix)} MB\n")


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*")) // 1_000_000


if __name__ == "__main__":
    main()
