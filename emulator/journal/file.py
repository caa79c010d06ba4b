"""The format of journals: a first line, then frames of records.

A frame is a header (length and CRC-32 of its content, big-endian uint32 each) and JSON lines, compressed with zlib. A
record is an array: the number of control periods that were over when it happened, its kind, and what belongs to it. The
first record is ``[0, "run", {...}]``. A frame is written once a second, so a process that is killed loses the rest.
"""

import io
import json
import struct
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from errno import ENOSPC
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

FORMAT: Final = 2
"""Of the records. Raise it when they change: journals of another format are refused."""
MAGIC: Final = b"ur-emulator journal 1\n"
_HEADER: Final = struct.Struct("!II")
_MAX_FRAME: Final = 2**28  # bytes, of which none that was written has as many
_LEVEL: Final = 1  # of compression: a quarter of the time of the usual level, a tenth more bytes
MOST_IN_MEMORY: Final = 32 * 1024 * 1024
"""Bytes of a journal that is kept in memory; guess: forty minutes of a stream of setpoints."""
_TOO_LONG: Final = (
    "it is too long for the memory; an emulator's begins anew once no program runs, and --journal FILE has no limit"
)
Record = list[Any]

DAMAGE: Final = (TypeError, LookupError, AttributeError)
"""Errors of records that no recorder has written."""


class JournalError(ValueError):
    """A file that is not a journal, or a damaged one."""


class Sink(Protocol):
    """Takes the bytes of a journal."""

    def write(self, data: bytes, /) -> object: ...

    def flush(self) -> object: ...


class MemorySink:
    """Keeps a journal in memory, as long as it is not too long.

    Later parts have beginnings of their own, which are left out where the part before is there.
    """

    def __init__(self, limit: int = MOST_IN_MEMORY) -> None:
        self._parts: list[list[bytes]] = [[]]
        self._limit = limit
        self._size = 0

    def write(self, data: bytes) -> None:
        """Raises OSError once there is no more room; what was kept is given up then."""
        if not self._parts:
            return
        self._parts[-1].append(data)
        self._size += len(data)
        if self._size > self._limit:
            self._parts.clear()
            self._size = 0
            raise OSError(ENOSPC, _TOO_LONG)

    def flush(self) -> None: ...

    @property
    def content(self) -> bytes:
        """The journal so far; empty if it was too long."""
        first, *others = self._parts or [[]]
        return b"".join((*first, *(data for part in others for data in part[1:])))


class JournalWriter:
    """Writes records to a sink; `flush` completes a frame.

    background: compress and write in a thread, which a control loop must not do itself.
    """

    def __init__(self, sink: Sink, *, background: bool = False) -> None:
        self._sink = sink
        self._worker = ThreadPoolExecutor(1, "journal") if background else None
        self._lines: list[str] = []
        self._problem: Exception | None = None
        self._put(MAGIC)

    def add(self, record: Record) -> None:
        self._lines.append(line_of(record))

    def flush(self) -> None:
        """Write the frame. Raises OSError, in the background that of an earlier frame."""
        lines, self._lines = self._lines, []
        if lines:
            self.afterwards(lambda: self._put(frame_of(lines)))
        if self._problem is not None:
            raise self._problem

    def afterwards(self, work: Callable[[], object]) -> None:
        """Do something once all that was flushed is written. Raises OSError if that is now."""
        if self._worker is None:
            work()
        else:
            self._worker.submit(self._attempt, work)

    def recover(self) -> None:
        """Write again, after an error."""
        self._problem = None

    def drain(self) -> None:
        """Write the frame, and wait for it. Raises OSError."""
        self.flush()
        if self._worker is not None:
            self._worker.submit(int).result()

    def close(self) -> None:
        """Write the last frame, and wait for it. Raises OSError."""
        self.flush()
        if self._worker is not None:
            self._worker.shutdown()
            self._worker = None

    def _attempt(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self._problem = error

    def _put(self, data: bytes) -> None:
        self._sink.write(data)
        self._sink.flush()


def line_of(record: Record) -> str:
    return json.dumps(record, separators=(",", ":"))


def frame_of(lines: list[str]) -> bytes:
    content = zlib.compress("\n".join(lines).encode(), _LEVEL)
    return _HEADER.pack(len(content), zlib.crc32(content)) + content


def read_journal(source: Path | bytes) -> Iterator[Record]:
    """The records of a journal, without those of a frame that is incomplete at its end.

    Raises JournalError for another file and for a damaged one, after the records before the damage; OSError.
    """
    with io.BytesIO(source) if isinstance(source, bytes) else open(source, "rb") as stream:
        name = "the journal" if isinstance(source, bytes) else str(source)
        if stream.read(len(MAGIC)) != MAGIC:
            raise JournalError(f"{name} is not a journal of this version of ur-emulator")
        try:
            yield from _records(stream)
        except (zlib.error, ValueError) as error:
            raise JournalError(f"{name} is damaged after {stream.tell()} bytes: {error}") from error


def _records(stream: BinaryIO) -> Iterator[Record]:
    while len(header := stream.read(_HEADER.size)) == _HEADER.size:
        length, checksum = _HEADER.unpack(header)
        if length > _MAX_FRAME:
            raise ValueError(f"a frame of {length} bytes")
        content = stream.read(length)
        if len(content) < length:
            return
        if zlib.crc32(content) != checksum:
            raise ValueError("the checksum of a frame is wrong")
        for line in zlib.decompress(content).decode().splitlines():
            record = json.loads(line)
            if not isinstance(record, list) or list(map(type, record[:2])) != [int, str]:
                raise ValueError(f"{line[:100]} is not a record")
            yield record
