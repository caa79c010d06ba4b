"""Throttled logging, for log lines that clients could otherwise trigger endlessly."""

from collections.abc import Callable
from typing import Final

EVERY_S: Final = 60.0


class LogThrottle:
    """Logs a line immediately, and then at most once a minute with the number of omitted lines.

    clock: monotonic seconds, like `time.monotonic`. period_s: the interval instead of a minute.
    """

    def __init__(self, clock: Callable[[], float], period_s: float = EVERY_S) -> None:
        self._clock = clock
        self._period_s = period_s
        self._next_s = -period_s
        self._omitted = 0

    def due(self) -> str | None:
        """The suffix for the line, "" for none; None if the line must be omitted this time."""
        now_s = self._clock()
        if now_s < self._next_s:
            self._omitted += 1
            return None
        omitted, self._omitted = self._omitted, 0
        self._next_s = now_s + self._period_s
        return f" ({omitted} more since the last such line)" if omitted else ""
