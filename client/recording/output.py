"""A file that grows while a robot works."""

from pathlib import Path
from typing import Any, Final

from client.errors import RecordingError
from urproto.durable import NewFile

FLUSH_S: Final = 0.5
"""Longest delay until a recorded state is in the file [s]: a recorder that is killed loses no more than this."""


class OutputFile:
    """A file written without a buffer: its contents survive when this process is killed.

    Until it is complete, it is called ``run.unfinished.mcap``, and an earlier ``run.mcap`` stays. keep: it contains
    something that is worth keeping if a write fails. failed: a write has failed; the file ends there. Raises OSError if
    the file cannot be opened, and RecordingError once it can no longer be written: the disk is full, a limit is
    reached, or the drive is gone.
    """

    def __init__(self, path: Path) -> None:
        self.failed = False
        self.keep = False
        self._file = NewFile(path, unfinished=True)

    @property
    def path(self) -> Path:
        """Where its contents are."""
        return self._file.path

    @property
    def replaces(self) -> bool:
        """Whether it is going to replace an earlier file."""
        return self._file.replaces

    def write(self, data: Any) -> int:
        """Write all of the bytes; return their number."""
        try:
            return self._file.write(data)
        except OSError as error:
            self.fail()
            raise RecordingError(f"{self.path} can no longer be written: {error.strerror or error}") from error

    def tell(self) -> int:
        """Position of the next byte."""
        return self._file.tell()

    def close(self, *, complete: bool) -> None:
        """Close the file; closing it twice is allowed. complete: give it its name, unless a write has failed."""
        if self._file.closed:
            return
        try:
            if complete:
                self._file.publish()
            else:
                self._file.close()
        except OSError as error:  # a network drive may report a failed write only now
            self.fail()
            raise RecordingError(f"{self.path} may be incomplete: {error.strerror or error}") from error

    def discard(self) -> None:
        """Delete the file."""
        self._file.discard()

    def fail(self) -> None:
        """Close the file where it is, or delete it unless it is worth keeping. Raises nothing."""
        self.failed = True
        if self.keep:
            self._file.abandon()
        else:
            self._file.discard()
