"""Follow a robot's states until Ctrl-C; options and progress bar shared by the commands."""

import signal
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from types import FrameType
from typing import Annotated, Any, Final, TypeAlias

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn

from client import rtde
from client.connection import DEFAULT_TIMEOUT_S
from client.errors import ClientError
from urproto.compat import Self

ROBOT_IP_VARIABLE: Final = "UR_ROBOT_IP"  # saves typing --robot-ip in a shell used for one robot

RobotIP: TypeAlias = Annotated[str, typer.Option("--robot-ip", envvar=ROBOT_IP_VARIABLE, help="Address of the robot.")]
PortOffset: TypeAlias = Annotated[
    int, typer.Option("--port-offset", help="Offset added to each port, as given to the emulator.")
]

INTERRUPTED: Final = 130
"""Exit status of a program that Ctrl-C ended."""

_LINE_S: Final = 5.0  # between two lines, to keep the log of a long motion short
_RECONNECT_S: Final = 5.0  # time limit of one attempt
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class ProgressBar:
    """Progress bar of one motion: a context manager to `update` now and then.

    Writes to standard error: a bar on a terminal, otherwise a line every few seconds.
    """

    def __init__(self, title: str, console: Console | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._title = title
        self._console = console or Console(stderr=True, highlight=False)
        self._now_s = now_s
        self._began_s = self._printed_s = now_s()
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

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, share: float, note: str = "") -> None:
        """Show the progress. share: 0 to 1. note: a few words to show next to it."""
        now_s = self._now_s()
        text = f"{now_s - self._began_s:.0f} s, {note}" if note else f"{now_s - self._began_s:.0f} s"
        self._bar.update(self._task, completed=share, note=text)
        if not self._console.is_terminal and now_s - self._printed_s >= _LINE_S:
            self._printed_s = now_s
            self.print_line(f"{self._title}: {100.0 * share:.0f} % after {text}")

    def print_line(self, text: str) -> None:
        self._console.print(text, markup=False, soft_wrap=not self._console.is_terminal)


Sink = Callable[[Mapping[str, Any]], object]


class Interrupts:
    """Turn Ctrl-C and SIGTERM into KeyboardInterrupt inside `wait` only, so that no write is ever interrupted.

    Enter it before opening the files it protects: then closing them is not interrupted either.
    """

    def __init__(self) -> None:
        self._waiting = False
        self._interrupted = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # only the main thread receives signals
            self._before = {number: signal.signal(number, self._handle) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def wait(self, function: Callable[[], Any]) -> Any:
        """Call a function that may be interrupted, and return its result. Raises KeyboardInterrupt."""
        self._waiting = True
        try:
            if self._interrupted:
                raise KeyboardInterrupt
            return function()
        finally:
            self._waiting = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._interrupted = True
        if self._waiting:
            self._waiting = False  # already here: a second signal may arrive before `wait` resets it
            raise KeyboardInterrupt


def connect(
    opened: ExitStack,
    interrupts: Interrupts,
    robot_ip: str,
    port_offset: int,
    names: Sequence[str],
    frequency_hz: float | None,
) -> rtde.BlockingRTDEClient:
    """Request variables of a robot; the connection ends with ``opened``. Raises URError, KeyboardInterrupt."""
    timeout_s = DEFAULT_TIMEOUT_S + (2.0 / frequency_hz if frequency_hz and frequency_hz > 0.0 else 0.0)
    client = rtde.BlockingRTDEClient(
        robot_ip, names, frequency_hz=frequency_hz, port=rtde.PORT + port_offset, timeout_s=timeout_s
    )
    connected: rtde.BlockingRTDEClient = interrupts.wait(lambda: opened.enter_context(client))
    return connected


def follow(
    client: rtde.BlockingRTDEClient,
    sinks: Iterable[Sink],
    interrupts: Interrupts,
    duration_s: float | None = None,
) -> None:
    """Pass every state to the sinks, until Ctrl-C or until duration_s has passed by the robot's clock.

    A lost connection is reported and reopened. duration_s needs ``timestamp`` among the variables.
    """
    sinks = tuple(sinks)
    clock = _Clock(duration_s)
    try:
        while not clock.finished:
            try:
                state = interrupts.wait(client.receive)
            except ClientError as error:
                typer.echo(f"{error} (reconnecting; Ctrl-C ends it)", err=True)
                interrupts.wait(lambda: _reconnect(client))
                continue
            clock.update(state)
            for sink in sinks:
                sink(state)
    except KeyboardInterrupt:  # the usual way to end
        return


class _Clock:
    """Elapsed time by the robot's clock. That clock starts again at zero when the robot reboots."""

    def __init__(self, duration_s: float | None) -> None:
        self._duration_s = duration_s
        self._elapsed_s = 0.0
        self._last_s: float | None = None

    @property
    def finished(self) -> bool:
        return self._duration_s is not None and self._elapsed_s >= self._duration_s - 1e-6

    def update(self, state: Mapping[str, Any]) -> None:
        if self._duration_s is None:
            return
        now_s = state["timestamp"]
        if self._last_s is not None:
            self._elapsed_s += max(0.0, now_s - self._last_s)
        self._last_s = now_s


def _reconnect(client: rtde.BlockingRTDEClient) -> None:
    while True:
        try:
            client.reconnect(_RECONNECT_S)
        except ClientError:
            continue
        typer.echo("reconnected", err=True)
        return
