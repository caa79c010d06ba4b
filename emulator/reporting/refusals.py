"""One line of the emulator's own log, at its default level, for each script that was refused.

Clients that send scripts get no answer: without this line, nobody at the terminal learns that a program was not
started, nor why. Repeats are throttled by robot time.
"""

import logging
from collections.abc import Callable
from typing import Final

from urproto.log_throttle import LogThrottle
from urproto.text import readable

_MAX_REASONS: Final = 20  # that are throttled separately; all others share one limit (guess)
_MOST_SHOWN: Final = 400  # characters of a reason, which may quote the script

_logger = logging.getLogger(__name__)


class RefusalLog:
    """Logs refused scripts, each reason immediately, then at most once a minute. clock_s: robot time [s]."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._throttles: dict[str, LogThrottle] = {}
        self._other = LogThrottle(clock_s)

    def report(self, origin: str, reason: str) -> None:
        """Log that a script was not started. origin: which one it was, and where it came from."""
        more = self._throttle(reason).due()
        if more is not None:
            _logger.warning("%s was not started: %s%s", _on_one_line(origin), _on_one_line(reason), more)

    def _throttle(self, reason: str) -> LogThrottle:
        if reason not in self._throttles and len(self._throttles) >= _MAX_REASONS:
            return self._other
        return self._throttles.setdefault(reason, LogThrottle(self._clock_s))


def _on_one_line(text: str) -> str:
    """Text of a client for a terminal: without line breaks, control characters and invalid bytes."""
    shown = "".join(letter if letter.isprintable() else " " for letter in readable(text))
    return shown if len(shown) <= _MOST_SHOWN else f"{shown[:_MOST_SHOWN]}..."
