"""The first record of a journal: from which options, files and state the controller of the run is made again."""

import platform
from base64 import b64encode
from collections.abc import Iterable
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, Final

from emulator.journal.file import FORMAT
from emulator.machine import ControllerConfig
from emulator.robot.kinds import ArmKind

_MAX_FILES: Final = 4 * 1024 * 1024  # bytes in the first record, which is written while the robot starts; guess
_MAX_ENTRIES: Final = 2000  # of the programs folder that are looked at; guess: a millisecond or two
_PROGRAM_FILES: Final = (".urp", ".urpx", ".script", ".installation", ".variables")
_PATHS: Final = ("arm", "calibration", "initial_positions", "programs", "safety", "world")  # options that may be files
_WORDS: Final = (*ArmKind, "factory")  # values of these options that name no files


def product_version() -> str:
    return version("ur-emulator")


def header_of(config: ControllerConfig) -> dict[str, Any]:
    """The first record's content: from which options and files the controller is made again."""
    files = _Files()
    return {
        "format": FORMAT,
        "product": product_version(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "model": config.model.name,
        "wall_clock_s": config.wall_clock_s,
        "options": {name: files.option(name, value) for name, value in (config.options or {}).items()},
        "files": files.contents,
        "left_out": files.left_out,
        "problem": files.problem if config.options is not None else "it was not made from options",
    }


class _Files:
    """The files that options name.

    contents: of each option, relative path -> base64. left_out: files for which there was no room. problem: an option
    that a journal cannot contain.
    """

    def __init__(self) -> None:
        self.contents: dict[str, dict[str, str]] = {}
        self.left_out: list[str] = []
        self.problem = ""
        self._room = _MAX_FILES

    def option(self, name: str, value: Any) -> Any:
        """The value for the journal: of a file or folder, its name below the option's own folder."""
        if name in _PATHS and isinstance(value, Path | str) and str(value) not in _WORDS:
            path = Path(value)
            if path.is_dir():
                self._add(name, path, program_files(path))
                return {"folder": name}
            if path.is_file():
                beside = islice(path.parent.rglob("*"), _MAX_ENTRIES) if name == "world" else ()
                self._add(name, path.parent, (path, *beside))
                return {"folder": name, "file": path.name}
        if isinstance(value, tuple):
            return list(value)
        if not isinstance(value, bool | int | float | str | list | dict | None):
            self.problem = f"the journal cannot contain the option {name}, an object: give a file"
            return None
        return value

    def _add(self, option: str, folder: Path, files: Iterable[Path]) -> None:
        contents = self.contents.setdefault(option, {})
        for file in filter(Path.is_file, files):
            name, size = file.relative_to(folder).as_posix(), file.stat().st_size
            if size > self._room:
                self.left_out.append(name)
            elif name not in contents:
                self._room -= size
                contents[name] = b64encode(file.read_bytes()).decode()


def program_files(folder: Path) -> list[Path]:
    """The files of a programs folder that a controller may read; of a very large folder, some of them."""
    return [file for file in islice(folder.rglob("*"), _MAX_ENTRIES) if file.suffix in _PROGRAM_FILES]
