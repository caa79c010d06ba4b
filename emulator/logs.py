"""Output and log of a running emulator, which never block the control loop.

Writing to a terminal that was stopped with Ctrl-S, to a pipe that nobody reads or to a busy disk can block for seconds
or for ever. So a thread writes, and the control loop only puts text in its queue.
"""

import io
import logging
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Final, TextIO, cast

from urproto.compat import StrEnum
from urproto.text import show_any_text

_MAX_WAITING: Final = 10_000  # texts: some megabytes (guess)
_MAX_REMEMBERED: Final = 20  # kinds of failures that are reported in full, and saved (guess)
_FLUSH_S: Final = 2.0  # time limit for writing the rest of the queue at the end (guess)


class LogLevel(StrEnum):
    """How much is logged, on standard error."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class BackgroundStream(io.TextIOBase):
    """A stream of `sys`, by name. Within `in_background` a thread writes to it; text beyond a full queue is dropped."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._waiting: SimpleQueue[str | None] | None = None
        self._lost = 0

    def write(self, text: str) -> int:
        """Write, or queue for the thread."""
        waiting = self._waiting
        if waiting is None:
            self._target.write(text)
            self._target.flush()
        elif waiting.qsize() >= _MAX_WAITING:
            self._lost += 1
        else:
            waiting.put(text)
        return len(text)

    def isatty(self) -> bool:
        return self._target.isatty()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._target.encoding

    @contextmanager
    def in_background(self) -> Iterator[None]:
        """Let a thread write inside the context. At the end the rest of the queue is written, for up to 2 s."""
        show_any_text(self._target)
        self._waiting = waiting = SimpleQueue[str | None]()
        writer = threading.Thread(target=self._write_all, args=(waiting,), name=f"{self._name} writer", daemon=True)
        writer.start()
        try:
            yield
        finally:
            self._waiting = None
            waiting.put(None)
            writer.join(_FLUSH_S)

    @property
    def _target(self) -> TextIO:
        target: TextIO = getattr(sys, self._name)
        return target

    def _write_all(self, waiting: "SimpleQueue[str | None]") -> None:
        while (text := waiting.get()) is not None:
            lost, self._lost = self._lost, 0
            if lost:
                text += f"({lost} more texts were dropped: the output was blocked)\n"
            try:
                self._target.write(text)
                self._target.flush()
            except OSError:  # the reader is gone
                _discard(waiting)
                return


def _discard(waiting: "SimpleQueue[str | None]") -> None:
    while waiting.get() is not None:
        pass


OUTPUT: Final = BackgroundStream("stdout")
ERROR: Final = BackgroundStream("stderr")


def log_to_stderr(level: LogLevel) -> None:
    """Log this process from this level on: in columns on a terminal, otherwise one line per record."""
    handler: logging.Handler
    if ERROR.isatty():
        from rich.logging import RichHandler  # imported here: --help and `urscript run` do not need them

        from urproto.commandline import console

        handler = RichHandler(console=console(cast(TextIO, ERROR)), show_path=False, rich_tracebacks=False)
        form = "%(message)s"
    else:
        handler = logging.StreamHandler(ERROR)
        form = "%(asctime)s %(levelname)-8s %(message)s"
    logging.basicConfig(level=level.value.upper(), format=form, datefmt="%X", handlers=[handler])


class ReportedErrors:
    """The kinds of errors that have been reported, so that each is reported once."""

    def __init__(self) -> None:
        self._keys: set[str] = set()

    def is_new(self, error: BaseException, who: object = "") -> bool:
        """Whether this type of error is raised at this place for the first time; who: tells sources apart."""
        key = f"{who} {type(error).__name__} {place_of(error)}"
        if key in self._keys or len(self._keys) >= _MAX_REMEMBERED:
            return False
        self._keys.add(key)
        return True


def place_of(error: BaseException) -> str:
    """File and line that raised the error."""
    frames = traceback.extract_tb(error.__traceback__)
    return f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown place"
