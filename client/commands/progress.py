"""How far a motion is: a bar in a terminal, a line now and then elsewhere."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn

__all__ = ["MotionProgress"]

_LINE_S: Final = 5.0  # between two lines: a log of a long motion stays short


class MotionProgress:
    """Of one motion; use it with ``with``, and `update` it now and then. Standard output stays free."""

    def __init__(self, title: str, console: Console | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._title = title
        self._console = console or Console(stderr=True, highlight=False)
        self._now_s = now_s
        self._began_s = self._said_s = now_s()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task(escape(title), total=1.0, note="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, share: float, note: str = "") -> None:
        """share: 0 to 1. note: what else there is to say about it, in a few words."""
        now_s = self._now_s()
        text = f"{now_s - self._began_s:.0f} s, {note}" if note else f"{now_s - self._began_s:.0f} s"
        self._bar.update(self._task, completed=share, note=text)
        if not self._console.is_terminal and now_s - self._said_s >= _LINE_S:
            self._said_s = now_s
            self.say(f"{self._title}: {100.0 * share:.0f} % after {text}")

    def say(self, text: str) -> None:
        """A line of its own, above the bar."""
        self._console.print(text, markup=False, soft_wrap=not self._console.is_terminal)
