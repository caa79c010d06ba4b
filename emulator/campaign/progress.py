"""Progress of a campaign: a line that is updated in a terminal, or occasional lines in a file."""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final, TextIO

from emulator.campaign.work import Result, Status

_TERMINAL_S: Final = 0.5  # between two lines
_FILE_S: Final = 10.0
_WINDOW_S: Final = 60.0  # over which the rate is averaged: the number of machines may change


@dataclass
class Progress:
    """Shows the progress. total: number of runs; done: runs that had a result before."""

    total: int
    done: int
    out: TextIO
    _failed: int = 0
    _marks: deque[tuple[float, int, float]] = field(default_factory=deque)  # time, runs, robot time
    _robot_s: float = 0.0
    _printed_s: float = 0.0

    def __post_init__(self) -> None:
        self._marks.append((time.monotonic(), self.done, 0.0))
        self._printed_s = self._marks[0][0]

    def update(self, results: list[Result]) -> None:
        """Add new results, if any, and update the line when it is due."""
        self.done += len(results)
        self._failed += sum(result.status is not Status.PASSED for result in results)
        self._robot_s += sum(result.robot_s or 0.0 for result in results)
        now = time.monotonic()
        if now - self._printed_s >= (_TERMINAL_S if self.out.isatty() else _FILE_S):
            self._printed_s = now
            self._print_line(now)

    def finish(self) -> None:
        if self.out.isatty():
            self.out.write("\r\x1b[K")
            self.out.flush()

    def _print_line(self, now: float) -> None:
        self._marks.append((now, self.done, self._robot_s))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW_S:
            self._marks.popleft()
        began, done, robot_s = self._marks[0]
        text = f"{self.done:,} of {self.total:,} runs, {self._failed:,} failed"
        if self.done > done:
            left_s = (self.total - self.done) * (now - began) / (self.done - done)
            text += f", {duration(left_s)} left"
        if self._robot_s > robot_s:
            text += f", {(self._robot_s - robot_s) / (now - began):,.0f} robot seconds per second"
        self.out.write(f"\r\x1b[K{text}" if self.out.isatty() else f"{text}\n")
        self.out.flush()


def duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    if minutes < 90:
        return f"{minutes:.0f} min"
    return f"{minutes / 60:.1f} h" if minutes < 48 * 60 else f"{minutes / 1440:.1f} days"
