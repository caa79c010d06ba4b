"""A robot's states, one after the other, until somebody has seen enough."""

import signal
import threading
from collections.abc import Callable, Iterable, Mapping
from types import FrameType, TracebackType
from typing import Any, Final, Self

import typer

from client import rtde
from client.errors import ClientError

__all__ = ["Interrupts", "Sink", "follow"]

_RECONNECT_S: Final = 5.0  # how long one attempt to come back takes
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)

Sink = Callable[[Mapping[str, Any]], object]


class Interrupts:
    """Ctrl-C and SIGTERM are a KeyboardInterrupt while one waits, and never while something is being written.

    Enter it before the files it is to protect: closing them is not interrupted either.
    """

    def __init__(self) -> None:
        self._waiting = False
        self._came = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # no other gets signals
            self._before = {number: signal.signal(number, self._take) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def wait(self, what: Callable[[], Any]) -> Any:
        """Do something that may be interrupted. Raises KeyboardInterrupt."""
        self._waiting = True
        try:
            if self._came:
                raise KeyboardInterrupt
            return what()
        finally:
            self._waiting = False

    def _take(self, number: int, frame: FrameType | None) -> None:
        self._came = True
        if self._waiting:
            self._waiting = False  # here and not only where it is caught: a second one may come before that
            raise KeyboardInterrupt


def follow(
    robot: rtde.BlockingRTDEClient,
    sinks: Iterable[Sink],
    interrupts: Interrupts,
    duration_s: float | None = None,
) -> None:
    """Hand every state to the sinks, until Ctrl-C or for so long by the robot's clock.

    A lost connection is told and opened again. duration_s needs ``timestamp`` among the variables.
    """
    sinks = tuple(sinks)
    clock = _Clock(duration_s)
    try:
        while not clock.over:
            try:
                state = interrupts.wait(robot.receive)
            except ClientError as error:
                typer.echo(f"{error} (tried until it works; Ctrl-C ends)", err=True)
                interrupts.wait(lambda: _come_back(robot))
                continue
            clock.see(state)
            for sink in sinks:
                sink(state)
    except KeyboardInterrupt:  # the usual way to end
        return


class _Clock:
    """How long it has been by the robot's clock, which begins anew when the robot does."""

    def __init__(self, duration_s: float | None) -> None:
        self._duration_s = duration_s
        self._elapsed_s = 0.0
        self._last_s: float | None = None

    @property
    def over(self) -> bool:
        return self._duration_s is not None and self._elapsed_s >= self._duration_s - 1e-6

    def see(self, state: Mapping[str, Any]) -> None:
        if self._duration_s is None:
            return
        now_s = state["timestamp"]
        if self._last_s is not None:
            self._elapsed_s += max(0.0, now_s - self._last_s)
        self._last_s = now_s


def _come_back(robot: rtde.BlockingRTDEClient) -> None:
    while True:
        try:
            robot.reconnect(_RECONNECT_S)
        except ClientError:
            continue
        typer.echo("connected again", err=True)
        return
