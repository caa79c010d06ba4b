"""The programs folder. A path named by a client or a file leads into this folder, or is not found.

Files are read here and nowhere else, because a robot reads them between two control periods: a file that is too large
is refused before any of it is read.
"""

from pathlib import Path, PurePosixPath
from typing import Final

from urproto.text import from_bytes
from urscript.polyscope.document import DocumentError

ROOTS: Final = ("/ursim/programs", "/programs", "/root/programs")  # its paths in clients and files
_PROGRAMS: Final = "programs"
MAX_FILE_BYTES: Final = 4 << 20
"""Largest file of the programs folder [bytes]. A guess: the largest public program has 0.3 MB, unpacked 3.3 MB."""


class FileTooLargeError(OSError):
    """A file of the programs folder exceeds the limit."""


def read_file(path: Path) -> bytes:
    """The content of a file of the programs folder. Raises OSError."""
    with path.open("rb") as file:
        content = b""
        size = path.stat().st_size
        if size <= MAX_FILE_BYTES:
            content = file.read(MAX_FILE_BYTES + 1)  # it may grow meanwhile
            size = len(content)
    if size > MAX_FILE_BYTES:
        raise FileTooLargeError(
            f"{path.name} has {size:,} bytes, and a file of the programs folder may have {MAX_FILE_BYTES:,}: "
            "split it, or remove what it does not need"
        )
    return content


def read_text(path: Path) -> str:
    """The content of a text file of the programs folder. Raises OSError."""
    return from_bytes(read_file(path)).removeprefix("\ufeff")


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
        """Text of a file; None when it does not exist. Raises DocumentError for one that cannot be read."""
        path = self.find(name)
        try:
            return None if path is None else read_text(path)
        except OSError as error:
            raise DocumentError(f"{name} cannot be read: {error.strerror or error}") from error


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
