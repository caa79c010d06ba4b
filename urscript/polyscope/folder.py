"""The programs folder. A path named by a client or a file leads into this folder, or is not found."""

from pathlib import Path, PurePosixPath
from typing import Final

from urproto.text import from_bytes

ROOTS: Final = ("/ursim/programs", "/programs", "/root/programs")  # its paths in clients and files
_PROGRAMS: Final = "programs"
_LARGEST: Final = 16 << 20  # bytes of a file named by a program


class ProgramsFolder:
    """A folder on this machine, or none. base: the folder of the program that names files."""

    def __init__(self, root: Path | None, base: Path | None = None) -> None:
        self.root = root.resolve() if root is not None else None
        self._base = base.resolve() if base is not None else self.root

    def find(self, name: str) -> Path | None:
        """The file for a path; None when it is not in the folder.

        Absolute paths are those of a controller, below one of its programs folders. Links that leave the folder are not
        followed.
        """
        requested = _relative(name)
        if self.root is None or self._base is None or requested is None or "\0" in name:
            return None
        bases = (self.root,) if PurePosixPath(name.strip()).is_absolute() else (self._base, self.root)
        return next((path for base in bases if (path := self._inside(base, requested))), None)

    def _inside(self, base: Path, requested: PurePosixPath) -> Path | None:
        assert self.root is not None
        try:
            path = base.joinpath(*requested.parts).resolve()
            return path if path.is_relative_to(self.root) and path.is_file() else None
        except (OSError, RuntimeError, ValueError):  # names too long, loops of links
            return None

    def place(self, name: str) -> Path | None:
        """The path in the folder for a file of this name, existing or not; None for a name that leaves the folder."""
        requested = _relative(name)
        if (
            self.root is None
            or requested is None
            or "\0" in name
            or any(part.startswith(".") for part in requested.parts)
        ):
            return None
        try:
            path = self.root.joinpath(*requested.parts)
            return path if path.resolve().is_relative_to(self.root) and path.name == path.resolve().name else None
        except (OSError, RuntimeError, ValueError):  # names too long, loops of links
            return None

    def installation(self, *names: str) -> Path | None:
        """The first of these installations that exists; names have no extension."""
        return next((path for name in names if name and (path := self.find(f"{name}.installation"))), None)

    def text(self, name: str) -> str | None:
        """Text of a file; None when it does not exist."""
        path = self.find(name)
        if path is None or path.stat().st_size > _LARGEST:
            return None
        return from_bytes(path.read_bytes()).removeprefix("\ufeff")


def _relative(name: str) -> PurePosixPath | None:
    requested = PurePosixPath(name.strip())
    for shown in ROOTS:
        if requested.is_relative_to(shown):
            return requested.relative_to(shown)
    if not requested.is_absolute():
        return requested if requested.parts else None
    # a path of a simulator: /home/someone/ursim-5.11/programs/x.urp
    parts = requested.parts
    return PurePosixPath(*parts[parts.index(_PROGRAMS) + 1 :]) if _PROGRAMS in parts else None
