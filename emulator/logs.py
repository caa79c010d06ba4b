"""What a running emulator prints. Nothing of it can hold the control loop up.

A terminal that was stopped with Ctrl-S, a pipe that nobody reads and a disk that is busy let whoever writes wait,
for seconds or for ever. So a thread writes, and the loop only hands over.
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
from urproto.text import show_anything

_MOST_WAITING: Final = 10_000  # texts: some megabytes (guess)
_MOST_REMEMBERED: Final = 20  # kinds of failures that are told in full, and saved (guess)
_GOODBYE_S: Final = 2.0  # how long the end waits for what is still to be written (guess)


class LogLevel(StrEnum):
    """How much is logged, on standard error."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class BackgroundStream(io.TextIOBase):
    """A stream of `sys`, by name. Within `in_background` a thread writes; what finds too much waiting is left out."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._waiting: SimpleQueue[str | None] | None = None
        self._lost = 0

    def write(self, text: str) -> int:
        """Write, or hand over."""
        waiting = self._waiting
        if waiting is None:
            self._target.write(text)
            self._target.flush()
        elif waiting.qsize() >= _MOST_WAITING:
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
        """Let a thread write meanwhile. At the end what still waits is written, if that does not take long."""
        show_anything(self._target)
        self._waiting = waiting = SimpleQueue[str | None]()
        writer = threading.Thread(target=self._write_all, args=(waiting,), name=f"{self._name} writer", daemon=True)
        writer.start()
        try:
            yield
        finally:
            self._waiting = None
            waiting.put(None)
            writer.join(_GOODBYE_S)

    @property
    def _target(self) -> TextIO:
        target: TextIO = getattr(sys, self._name)
        return target

    def _write_all(self, waiting: "SimpleQueue[str | None]") -> None:
        while (text := waiting.get()) is not None:
            lost, self._lost = self._lost, 0
            if lost:
                text += f"({lost} texts more were left out: nobody took them)\n"
            try:
                self._target.write(text)
                self._target.flush()
            except OSError:  # whoever read it is gone
                _discard(waiting)
                return


def _discard(waiting: "SimpleQueue[str | None]") -> None:
    while waiting.get() is not None:
        pass


OUTPUT: Final = BackgroundStream("stdout")
ERROR: Final = BackgroundStream("stderr")


def log_to_stderr(level: LogLevel) -> None:
    """Log of this process, from this level on: in columns on a terminal, else a line a record."""
    handler: logging.Handler
    if ERROR.isatty():
        from rich.logging import RichHandler  # neither a look at the options nor `urscript run` waits for these

        from urproto.commandline import console

        handler = RichHandler(console=console(cast(TextIO, ERROR)), show_path=False, rich_tracebacks=False)
        form = "%(message)s"
    else:
        handler = logging.StreamHandler(ERROR)
        form = "%(asctime)s %(levelname)-8s %(message)s"
    logging.basicConfig(level=level.value.upper(), format=form, datefmt="%X", handlers=[handler])


class Novelty:
    """Which failures were told already."""

    def __init__(self) -> None:
        self._reported: set[str] = set()

    def of(self, error: BaseException, who: object = "") -> bool:
        """True the first time that this kind of error comes from this place."""
        key = f"{who} {type(error).__name__} {place_of(error)}"
        if key in self._reported or len(self._reported) >= _MOST_REMEMBERED:
            return False
        self._reported.add(key)
        return True


def place_of(error: BaseException) -> str:
    """File and line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    return f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown place"
