"""``ur-client watch``: some variables of a robot, as they change."""

import csv
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from client import rtde
from client.commands.options import PortOffset, RobotIP
from client.connection import DEFAULT_TIMEOUT_S
from client.decoding import show
from client.errors import ClientError
from urproto.rtde.fields import OUTPUT_FIELDS

__all__ = ["state_table", "unknown_fields", "watch_command"]

_DRAWN_HZ = 10.0  # how often a table is drawn: nobody reads faster
_RECONNECT_S = 5.0  # how long one attempt to come back takes
_CLOSE_NAMES = 5

Sink = Callable[[Mapping[str, Any]], None]


def watch_command(
    fields: Annotated[list[str], typer.Argument(help="RTDE outputs, for example actual_q robot_mode.")],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    rate: Annotated[float, typer.Option("--rate", help="How often a second the robot sends them.")] = 10.0,
    plain: Annotated[bool, typer.Option("--plain", help="Print lines, as without a terminal.")] = False,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write every state to this file too.")] = None,
) -> None:
    """Show values of a robot as they change, until Ctrl-C."""
    if problem := unknown_fields(fields):
        raise typer.BadParameter(problem)
    names = list(dict.fromkeys(fields))
    timeout_s = DEFAULT_TIMEOUT_S + 2 / rate if rate > 0 else DEFAULT_TIMEOUT_S
    port = rtde.PORT + port_offset
    try:
        with ExitStack() as opened:
            robot = opened.enter_context(
                rtde.BlockingRTDEClient(robot_ip, names, frequency_hz=rate, port=port, timeout_s=timeout_s)
            )
            sinks = [_csv_sink(csv_file, names, opened)] if csv_file else []
            sinks.append(_lines if plain or not sys.stdout.isatty() else _live_table(robot, opened))
            _watch(robot, sinks)
    except KeyboardInterrupt:  # the way to end
        return


def unknown_fields(names: Iterable[str]) -> str | None:
    """What is wrong with the names, and what may have been meant; None when nothing is."""
    for name in names:
        if name not in OUTPUT_FIELDS:
            close = get_close_matches(name, OUTPUT_FIELDS, _CLOSE_NAMES, 0.5)
            hint = f"did you mean {', '.join(close)}?" if close else "docs/supported.md lists them"
            return f"no RTDE output is called {name!r}: {hint}"
    return None


def _watch(robot: rtde.BlockingRTDEClient, sinks: list[Sink]) -> None:
    while True:
        try:
            state = robot.receive()
        except ClientError as error:
            _come_back(robot, error)
            continue
        for sink in sinks:
            sink(state)


def _come_back(robot: rtde.BlockingRTDEClient, error: ClientError) -> None:
    typer.echo(f"{error} (tried until it works; Ctrl-C ends)", err=True)
    while True:
        try:
            robot.reconnect(_RECONNECT_S)
        except ClientError:
            continue
        typer.echo("connected again", err=True)
        return


def _lines(state: Mapping[str, Any]) -> None:
    sys.stdout.write(f"{show.pairs(state.items())}\n")
    sys.stdout.flush()


def _live_table(robot: rtde.BlockingRTDEClient, opened: ExitStack) -> Sink:
    live = opened.enter_context(Live(console=Console(), auto_refresh=False))
    each = max(1, round(robot.core.rate_hz / _DRAWN_HZ))
    count = 0

    def draw(state: Mapping[str, Any]) -> None:
        nonlocal count
        count += 1
        if count % each == 0:
            live.update(state_table(state, f"{robot.host}, PolyScope {robot.core.version}"), refresh=True)

    return draw


def state_table(state: Mapping[str, Any], title: str) -> Table:
    """A row for each variable, a column for each element of the longest vector."""
    rows = {name: value if isinstance(value, tuple) else (value,) for name, value in state.items()}
    width = max(map(len, rows.values()), default=1)
    table = Table("variable", title=title)
    for index in range(width):
        table.add_column(str(index) if width > 1 else "value", justify="right")
    table.add_column("unit")
    for name, values in rows.items():
        cells = [_cell(name, value) for value in values] + [""] * (width - len(values))
        table.add_row(name, *cells, OUTPUT_FIELDS[name].unit)
    return table


def _cell(name: str, value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else show.value(value, name)


def _csv_sink(path: Path, names: list[str], opened: ExitStack) -> Sink:
    try:
        file = opened.enter_context(path.open("w", newline="", encoding="utf-8", buffering=1))
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror}") from error
    writer = csv.writer(file)
    writer.writerow(column for name in names for column in _columns(name))

    def write(state: Mapping[str, Any]) -> None:
        values = (state[name] for name in names)
        writer.writerow([part for value in values for part in (value if isinstance(value, tuple) else (value,))])

    return write


def _columns(name: str) -> list[str]:
    count = OUTPUT_FIELDS[name].type.count
    return [f"{name}_{index}" for index in range(count)] if count > 1 else [name]
