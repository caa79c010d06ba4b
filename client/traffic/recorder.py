"""Byte streams of connections, with their times, into a pcapng file that Wireshark opens.

What is written is on disk a quarter of a second later, so a recording that is cut off by
anything but a full disk ends with a whole packet. When the disk is full the file is cut
back to its last whole packet, and what follows is not recorded.
"""

import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from client.decoding.capture_writer import head_of_capture, packet_block
from client.decoding.frames import ConnectionFrames
from client.decoding.packets import Endpoint
from client.errors import FileError

__all__ = ["FLUSH_S", "Recorded", "Recorder"]

FLUSH_S: Final = 0.25  # how often ``flush`` is to be called [s]
_KEPT_BYTES: Final = 1 << 18  # in memory, before they are written out of turn
_APPLICATION: Final = "ur-client proxy"


def wall_clock() -> Callable[[], int]:
    """Nanoseconds since 1970, that never go back."""
    begin = time.time_ns() - time.monotonic_ns()
    return lambda: begin + time.monotonic_ns()


class Recorder:
    """A file of recorded connections. Raises FileError when it cannot be made.

    comments: remarks that the file begins with. now_ns: the time of each packet. trouble: called once, with the
    reason, when the file cannot be written any more. failed: that reason, None while all is well.
    """

    def __init__(
        self,
        path: Path,
        comments: Iterable[str] = (),
        *,
        now_ns: Callable[[], int] | None = None,
        trouble: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.path = path
        self.failed: str | None = None
        self._trouble = trouble
        self._now_ns = now_ns or wall_clock()
        self._kept = bytearray()
        self._written = 0  # bytes, up to the end of a packet
        self._connections = 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise FileError(path, f"cannot be written: {error.strerror}") from error
        self._kept += head_of_capture(_APPLICATION, "proxy", comments)
        self.flush()

    def connection(self, client: Endpoint, server: Endpoint) -> "Recorded":
        """A connection has begun."""
        self._connections += 1
        return Recorded(self._packets, ConnectionFrames(client, server, self._connections))

    def flush(self) -> None:
        """Hand what is kept to the operating system."""
        kept, self._kept = self._kept, bytearray()
        size = len(kept)
        try:
            while kept:
                del kept[: os.write(self._file, kept)]
            self._written += size
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """The recording has ended."""
        if self._file >= 0:
            self.flush()
            os.close(self._file)
            self._file = -1

    def _packets(self, frames: Iterable[bytes]) -> None:
        if self.failed or self._file < 0:
            return
        now_ns = self._now_ns()
        for frame in frames:
            self._kept += packet_block(now_ns, frame)
        if len(self._kept) > _KEPT_BYTES:
            self.flush()

    def _fail(self, error: OSError) -> None:
        self.failed = f"{self.path} is not written any more, after {self._written} bytes: {error.strerror}"
        with suppress(OSError):  # a pipe cannot be cut
            os.ftruncate(self._file, self._written)
        self._trouble(self.failed)


class Recorded:
    """One connection of a recording; each call is a moment of it."""

    def __init__(self, write: Callable[[Iterable[bytes]], None], frames: ConnectionFrames) -> None:
        self._write = write
        self._frames = frames
        write(frames.open())

    def data(self, from_client: bool, data: bytes) -> None:
        """Bytes of one end."""
        self._write(self._frames.data(from_client, data))

    def end(self, from_client: bool) -> None:
        """This end sends nothing more."""
        self._write((self._frames.end(from_client),))

    def reset(self, from_client: bool) -> None:
        """This end broke the connection off."""
        self._write((self._frames.reset(from_client),))
