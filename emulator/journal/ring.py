"""The last part of a run in memory. It begins anew where the robot is at rest, so that what is older can be dropped.

A running program cannot be described, and a robot at rest not to the last detail. So a new beginning is a proposal:
another process executes the seconds that follow it, and only if they are the same does it count.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from emulator.journal.file import MAGIC, MOST_IN_MEMORY, MemorySink, frame_of, line_of
from urproto.compat import module_command
from urproto.durable import write_file

SEGMENT_S: Final = 600.0
"""Robot time of a part; two are kept, and what was recorded since."""
_PROVEN: Final = 10  # frames, of a second each, that are executed again
_LAZY: Final = 19  # of the priorities of processes


class Ring(MemorySink):
    """Keeps the last two parts of a journal, each of at least ``segment_s`` [s], and what follows them.

    A part is longer while no new beginning can be proven. What does not fit into ``limit`` bytes is given up, until
    there is a new beginning.
    """

    def __init__(self, segment_s: float = SEGMENT_S, limit: int = MOST_IN_MEMORY) -> None:
        super().__init__(limit)
        self._segment_s = self._due_s = segment_s
        self._proposed = False  # the last part's beginning is not proven yet
        self._proof: _Proof | None = None

    def due(self, time_s: float) -> bool:
        """Whether the journal should begin anew at this time."""
        return not self._proposed and (time_s >= self._due_s or not self._parts)

    def proposal(self, header: dict[str, Any], time_s: float) -> Callable[[], None]:
        """A new beginning at this time; returns what makes it, once everything before it is written."""
        self._due_s = time_s + self._segment_s
        return lambda: self._propose(header)

    def _propose(self, header: dict[str, Any]) -> None:
        head = MAGIC + frame_of([line_of([0, "run", header])])
        self._parts.append([head])
        self._size += len(head)
        self._proposed = True

    def write(self, data: bytes) -> None:
        try:
            super().write(data)
        except OSError:
            self.close()
            raise
        if self._proof is not None:
            self._judge(self._proof.same)
        elif self._proposed and len(self._parts[-1]) > _PROVEN:
            with suppress(OSError):  # no room for a process: in the next second
                self._proof = _Proof(b"".join(self._parts[-1]))

    def _judge(self, same: bool | None) -> None:
        if same is None:
            return
        self.close()
        if same:
            del self._parts[:-2]
            self._size = sum(len(data) for part in self._parts for data in part)
        elif len(self._parts) > 1:
            self._parts[-2] += self._parts.pop()[1:]

    def close(self) -> None:
        """End the proof that is under way."""
        self._proposed = False
        if self._proof is not None:
            self._proof.close()
            self._proof = None


class _Proof:
    """Another process, which executes a journal again. Raises OSError."""

    def __init__(self, journal: bytes) -> None:
        self._folder = TemporaryDirectory(prefix="ur-emulator-", ignore_cleanup_errors=True)
        file = Path(self._folder.name, "run.journal")
        write_file(file, journal)
        nowhere = subprocess.DEVNULL
        words = [*module_command("emulator"), "replay", str(file)]
        self._process = subprocess.Popen(words, stdin=nowhere, stdout=nowhere, stderr=nowhere)
        if sys.platform != "win32":
            os.setpriority(os.PRIO_PROCESS, self._process.pid, _LAZY)

    @property
    def same(self) -> bool | None:
        """Whether the run was the same; None until that is known."""
        status = self._process.poll()
        return None if status is None else status == 0

    def close(self) -> None:
        """End the process, and remove its file."""
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()
