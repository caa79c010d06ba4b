"""The definition of a target, and code shared by targets.

A target returns for any input, or raises an exception that its reader documents, which is caught here. Anything else is
a finding, and so is an exception that is only logged. A stream is read twice, as a whole and in pieces of a length
given by the input's first byte; both have to give the same result.
"""

import logging
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol

from urproto.errors import ProtocolError
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

__all__ = ["REPOSITORY", "TARGETS", "VERSIONS", "Finding", "Target", "file", "folder", "in_any_split", "target"]

REPOSITORY: Final = Path(__file__).parents[3]
VERSIONS: Final = (PolyscopeVersion(3, 15, 8, 106339), DEFAULT_VERSION[Series.E], PolyscopeVersion(5, 4, 0, 0))


class Finding(AssertionError):  # noqa: N818 - what a fuzzer calls it
    """A reader violated its documented behaviour."""


@dataclass(frozen=True)
class Target:
    """One reader. seeds: valid inputs to begin with."""

    name: str
    read: Callable[[bytes], object]
    seeds: Callable[[], Iterable[bytes]]

    def __call__(self, data: bytes) -> None:
        """Read. Raises undocumented exceptions of the reader, and Finding for those it only logged."""
        with _nothing_logged():
            self.read(data)


TARGETS: dict[str, Target] = {}


def target(*seeds: bytes | Callable[[], Iterable[bytes]]) -> Callable[[Callable[[bytes], object]], None]:
    """Register a reader under the name of its function."""

    def all_seeds() -> Iterator[bytes]:
        for seed in seeds:
            yield from seed() if callable(seed) else (seed,)

    def register(read: Callable[[bytes], object]) -> None:
        TARGETS[read.__name__] = Target(read.__name__, read, all_seeds)

    return register


class _Complaints(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


@contextmanager
def _nothing_logged() -> Iterator[None]:
    """Exceptions that a port or the guard of the control period has caught and logged count as well."""
    complaints = _Complaints()
    logging.getLogger().addHandler(complaints)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(complaints)
    for record in complaints.records:
        if record.exc_info is not None and record.exc_info[1] is not None:
            raise record.exc_info[1]
        raise Finding(record.getMessage())


class _Stream(Protocol):
    def feed(self, data: bytes) -> list[Any]: ...


def _fed(stream: _Stream, pieces: Iterable[bytes]) -> tuple[list[Any], str]:
    """The messages, and the error that ended them."""
    found: list[Any] = []
    try:
        for piece in pieces:
            found += stream.feed(piece)
        found += stream.feed(b"")  # an error after messages is raised by the next call
    except ProtocolError as error:
        return found, str(error)
    return found, ""


def in_any_split(make: Callable[[], _Stream], data: bytes) -> list[Any]:
    """The messages of a stream. Raises Finding if they depend on the split."""
    size, data = 1 + data[0] if data else 1, data[1:]
    whole = _fed(make(), [data])
    pieces = _fed(make(), (data[start : start + size] for start in range(0, len(data), size)))
    if repr(whole) != repr(pieces):  # repr, since nan is not equal to itself
        raise Finding(f"whole: {whole!r}; in pieces of {size} bytes: {pieces!r}")
    return whole[0]


@cache
def folder() -> Path:
    """A folder of this process, in memory if possible."""
    shm = Path("/dev/shm")
    _KEPT.append(tempfile.TemporaryDirectory(prefix="fuzz-", dir=shm if shm.is_dir() else None))
    return Path(_KEPT[-1].name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []  # removed when the process ends


def file(name: str, data: bytes) -> Path:
    """A file with this content, for a reader of files."""
    path = folder() / name
    path.write_bytes(data)
    return path
