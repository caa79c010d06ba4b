"""A file that grows while a robot works."""

from pathlib import Path
from typing import Any, Final

from client.errors import RecordingError

FLUSH_S: Final = 0.5
"""Longest delay until a recorded state is in the file [s]: a recorder that is killed loses no more than this."""


class OutputFile:
    """A file written without a buffer: its contents survive when this process is killed.

    failed: a write has failed; the file ends there. Raises OSError if the file cannot be opened, and RecordingError
    once it can no longer be written: the disk is full, a limit is reached, or the drive is gone.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failed = False
        self._file = path.open("wb", buffering=0)

    def write(self, data: Any) -> int:
        """Write all of the bytes; return their number."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.failed = True
            self._file.close()
            raise RecordingError(f"{self.path} can no longer be written: {error.strerror or error}") from error
        return len(data)

    def tell(self) -> int:
        """Position of the next byte."""
        return self._file.tell()

    def close(self) -> None:
        """Close the file; closing it twice is allowed."""
        try:
            self._file.close()
        except OSError as error:  # a network drive may report a failed write only now
            self.failed = True
            raise RecordingError(f"{self.path} may be incomplete: {error.strerror or error}") from error
