"""The messages of a control period, for the primary interface and the log."""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from urproto.errorcodes import error_text
from urproto.log_throttle import LogThrottle
from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    ErrorCodeMessage,
    KeyMessage,
    RobotMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)
from urproto.primary.program_state import VariableMessage
from urproto.text import readable

_MAX_REASONS: Final = 20  # that are throttled separately; all others share one limit (guess)
_MOST_SHOWN: Final = 400  # characters of a reason, which may quote the script
_HISTORY_LINES: Final = 10_000  # guess; bounds memory

_logger = logging.getLogger(__name__)


class RefusalLog:
    """One line of the emulator's own log, at its default level, for each script that was refused.

    Clients that send scripts get no answer: without this line, nobody at the terminal learns that a program was not
    started, nor why. Each reason is logged immediately, then at most once a minute. clock_s: robot time [s].
    """

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


class MessageLog:
    """Collects messages during a control period and stamps them with the controller's time.

    ``time_us`` returns the controller's uptime. ``history`` is the text log that the
    dashboard's ``saveLog`` writes. ``on_note`` is called with lines that go to this log only.
    """

    def __init__(self, time_us: Callable[[], int]) -> None:
        self._time_us = time_us
        self._pending: list[RobotMessage | VariableMessage] = []
        self.on_note: Callable[[str], None] | None = None
        self.history: deque[str] = deque(maxlen=_HISTORY_LINES)
        self._refusals = RefusalLog(lambda: time_us() / 1e6)

    def emit(self, message: RobotMessage | VariableMessage) -> None:
        """Send a message with this period's snapshot; a missing timestamp is filled in."""
        if not message.timestamp_us:
            message = replace(message, timestamp_us=self._time_us())
        self._pending.append(message)
        self._log(_describe(message))

    def note(self, text: str) -> None:
        """Write a line to the text log only."""
        if self.on_note is not None:
            self.on_note(text)
        self._log(text)

    def refused(self, origin: str, reason: str) -> None:
        """Log for whoever started the emulator that a script was not started; see `RefusalLog`."""
        self._refusals.report(origin, reason)

    def trace(self, text: str, *values: object) -> None:
        """Log why something happened, with robot time, for ``--log-level debug`` only.

        text: a `logging` format for the values, which are formatted only if that level is active.
        """
        if _logger.isEnabledFor(logging.DEBUG):
            _logger.debug("%.3f s: " + text, self._time_us() / 1e6, *values)

    def _log(self, text: str) -> None:
        self.trace("%s", text)
        self.history.append(f"{self._time_us() / 1e6:.3f} {text}")

    def text(self, text: str) -> None:
        """Send the message of ``textmsg()``."""
        self.emit(TextMessage(text=text))

    def variable(self, name: str, text: str) -> None:
        """Send the message of ``varmsg()``."""
        self.emit(VariableMessage(title=name, text=text))

    def key(self, title: str, text: str) -> None:
        """Send a key message: a fixed title and a text, such as PROGRAM_XXX_STARTED and the program's name."""
        self.emit(KeyMessage(title=title, text=text))

    def safety_mode(self, mode: SafetyMode) -> None:
        self.emit(SafetyModeMessage(safety_mode=mode))

    def error(self, code: int, argument: int = 0, level: ReportLevel = ReportLevel.WARNING, text: str = "") -> None:
        """Add an entry C<code>A<argument> to the error log; the text is that of the table unless given."""
        self.emit(ErrorCodeMessage(code=code, argument=argument, level=level, text=text or error_text(code, argument)))

    def compile_error(self, line: int, column: int, text: str) -> None:
        """Report a script that does not compile; line and column count from 1. The message has no timestamp."""
        self.emit(RuntimeExceptionMessage(timestamp_us=NO_TIMESTAMP_US, line=line, column=column, text=text))

    def runtime_exception(self, line: int, column: int, text: str) -> None:
        """Report a runtime exception of a script; line and column count from 1."""
        self.emit(RuntimeExceptionMessage(line=line, column=column, text=text))

    def take(self) -> tuple[RobotMessage | VariableMessage, ...]:
        """The messages since the last call, in order."""
        if not self._pending:
            return ()
        taken = tuple(self._pending)
        self._pending.clear()
        return taken


def _describe(message: RobotMessage | VariableMessage) -> str:
    if isinstance(message, VariableMessage):
        return f"{message.title} = {message.text}"
    if isinstance(message, ErrorCodeMessage):
        return f"{message.label} {message.text}"
    if isinstance(message, SafetyModeMessage):
        return f"safety mode {SafetyMode(message.safety_mode).name}"
    if isinstance(message, KeyMessage):
        return f"{message.title} {message.text}"
    if isinstance(message, RuntimeExceptionMessage):
        return f"runtime exception at {message.line}:{message.column}: {message.text}"
    return getattr(message, "text", type(message).__name__)
