"""A file that grows while a robot works."""

from pathlib import Path
from typing import Any, Final

from client.errors import RecordingError

FLUSH_S: Final = 0.5
"""What is recorded is in the file at most so much later [s], so that a recorder that is killed loses no more."""


class OutputFile:
    """Written without a buffer: what was written stays when this process is killed.

    path: where. failed: something could not be written; what is in the file ends there. Raises OSError when the file
    cannot be opened, and RecordingError when it cannot be written any more: a full disk, a limit, a drive that is gone.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failed = False
        self._file = path.open("wb", buffering=0)

    def write(self, data: Any) -> int:
        """Write bytes, all of them; how many they were."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.failed = True
            self._file.close()
            raise RecordingError(f"cannot write {self.path} any more: {error.strerror or error}") from error
        return len(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._file.tell()

    def close(self) -> None:
        """Write no more; closing twice does no harm."""
        try:
            self._file.close()
        except OSError as error:  # a network drive tells it only now
            self.failed = True
            raise RecordingError(f"{self.path} may lack its end: {error.strerror or error}") from error
