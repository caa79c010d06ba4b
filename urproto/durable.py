"""Files that are written completely or not at all, even if the disk is full, the process is killed, or power fails.

A new file gets another name in the same folder. Its contents are flushed to the disk before it is renamed, and the
folder afterwards, so that the name refers to the old contents or to the new ones at any time.
"""

import errno
import io
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO, Final

_NEW: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)  # Windows would translate line ends
_YIELD_S: Final = 0.0003  # per control period; without it, many pass in virtual time until the disk is done
_SHOWN: Final = 40  # characters of a file's name that its temporary name repeats: names have a limit


class NewFile(io.RawIOBase):
    """A file that gets its name when it is complete. Every write reaches the operating system.

    path: where its contents are: under a temporary name until `publish`. A device or a pipe keeps its name, since it
    cannot be replaced. replaces: there is an earlier file of that name. unfinished: the temporary name is one that
    users recognise, ``run.unfinished.mcap``, because the file is of use to them even if it is never completed. Raises
    OSError, like all methods that do not say otherwise.
    """

    def __init__(self, target: Path, *, unfinished: bool = False) -> None:
        super().__init__()
        self._target = Path(os.path.realpath(target))  # a link stays one
        self._mode = _mode(self._target)
        self._size = 0
        self.replaces = self._mode is not None and stat.S_ISREG(self._mode)
        if self.replaces and not os.access(self._target, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self._target))
        if self.replaces or self._mode is None:
            self.path = self._create(_unfinished_names if unfinished else _temporary_names)
        else:
            self.path, self._descriptor = self._target, os.open(self._target, os.O_WRONLY)

    def _create(self, names: Callable[[Path], Iterator[str]]) -> Path:
        for name in names(self._target):
            path = self._target.with_name(name)
            with suppress(FileExistsError):
                self._descriptor = os.open(path, _NEW, 0o666)
                return path
        raise AssertionError("there is always another name")

    def write(self, data: Any) -> int:
        """Write all of the bytes; return their number."""
        left = memoryview(data).cast("B")
        size = len(left)
        while left:
            left = left[os.write(self._descriptor, left) :]
        self._size += size
        return size

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        """Number of bytes written."""
        return self._size

    def truncate(self, size: int | None = None) -> int:
        """Remove everything after this number of bytes, which a failed write may have left."""
        size = self._size if size is None else size
        os.ftruncate(self._descriptor, size)
        return size

    def publish(self) -> None:
        """Give the complete file its name, and return when the disk has it."""
        if self.path == self._target:
            self.close()
            return
        if self._mode is not None:
            os.chmod(self.path, stat.S_IMODE(self._mode))
        os.fsync(self._descriptor)
        self.close()
        os.replace(self.path, self._target)
        self.path = self._target
        _sync_folder(self._target.parent)

    def discard(self) -> None:
        """Delete the file, unless it has its name already. Raises nothing."""
        self.abandon()
        if self.path != self._target:
            with suppress(OSError):
                os.unlink(self.path)

    def abandon(self) -> None:
        """Like `close`, for a file that could not be written. Raises nothing."""
        with suppress(OSError):
            self.close()

    def close(self) -> None:
        """Close the file under the name that it has."""
        descriptor, self._descriptor = self._descriptor, -1
        super().close()
        if descriptor >= 0:
            os.close(descriptor)


def _mode(path: Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None


def _temporary_names(target: Path) -> Iterator[str]:
    while True:
        yield f".{target.name[:_SHOWN]}.{secrets.token_hex(4)}.new"


def _unfinished_names(target: Path) -> Iterator[str]:
    yield f"{target.stem}.unfinished{target.suffix}"
    number = 2
    while True:
        yield f"{target.stem}.unfinished-{number}{target.suffix}"
        number += 1


@contextmanager
def replacing(path: Path) -> Iterator[NewFile]:
    """A file to write to. It replaces the one at the path at the end of the block, and is deleted after an error.

    Raises OSError.
    """
    file = NewFile(path)
    try:
        yield file
        file.publish()
    except BaseException:
        file.discard()
        raise


def write_file(path: Path, content: bytes | str) -> None:
    """Write a file, text as UTF-8. Raises OSError."""
    with replacing(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def writing(path: Path, content: bytes | str) -> Generator[None, None, None]:
    """Like `write_file`, for a control loop that a slow disk must not stop: yields until the file is written."""
    errors: list[BaseException] = []

    def work() -> None:
        try:
            write_file(path, content)
        except BaseException as error:
            errors.append(error)

    thread = Thread(target=work, name="file writer")
    thread.start()
    while thread.is_alive():
        thread.join(_YIELD_S)
        yield
    if errors:
        raise errors[0]


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to fill. It gets its name at the end of the block, and is deleted after an error. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = path.with_name(next(_temporary_names(path)))
    folder.mkdir()
    try:
        yield folder
        for root, _, files in os.walk(folder):
            for name in files:
                _sync(Path(root, name), os.O_RDWR)
            _sync_folder(Path(root))
        os.rename(folder, path)
        _sync_folder(path.parent)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _sync_folder(path: Path) -> None:
    if sys.platform == "win32":  # which has no such operation
        return
    try:
        _sync(path, os.O_RDONLY)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF):  # some network drives cannot do it either
            raise


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def growing(path: Path) -> BinaryIO:
    """Open a file for what is recorded as it happens: what was written survives the process. Raises OSError."""
    return open(path, "wb", buffering=0)
