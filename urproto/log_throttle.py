"""Throttled logging, for log lines that clients could otherwise trigger endlessly."""

from collections.abc import Callable
from typing import Final

EVERY_S: Final = 60.0


class LogThrottle:
    """Logs a line immediately, and then at most once a minute with the number of omitted lines.

    clock: monotonic seconds, like `time.monotonic`. every_s: the interval instead of a minute.
    """

    def __init__(self, clock: Callable[[], float], every_s: float = EVERY_S) -> None:
        self._clock = clock
        self._every_s = every_s
        self._next_s = -every_s
        self._left_out = 0

    def due(self) -> str | None:
        """The suffix for the line, "" for none; None if the line must be omitted this time."""
        now_s = self._clock()
        if now_s < self._next_s:
            self._left_out += 1
            return None
        left_out, self._left_out = self._left_out, 0
        self._next_s = now_s + self._every_s
        return f" ({left_out} more since the last such line)" if left_out else ""
