"""Throttled logging: for lines that strangers could have a log repeat without end."""

from collections.abc import Callable
from typing import Final

EVERY_S: Final = 60.0


class LogThrottle:
    """A line is logged at once, then once a minute at most, with how often it was left out.

    clock: seconds that only go on, as `time.monotonic`. every_s: another time than a minute.
    """

    def __init__(self, clock: Callable[[], float], every_s: float = EVERY_S) -> None:
        self._clock = clock
        self._every_s = every_s
        self._next_s = -every_s
        self._left_out = 0

    def due(self) -> str | None:
        """What to append to the line, "" for nothing; None when it is left out this time."""
        now_s = self._clock()
        if now_s < self._next_s:
            self._left_out += 1
            return None
        left_out, self._left_out = self._left_out, 0
        self._next_s = now_s + self._every_s
        return f" ({left_out} more since the last such line)" if left_out else ""
