"""``ur-client watch``: some variables of a robot, as they change."""

import json
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.live import Live
from rich.table import Table

from client import rtde
from client.commands.following import Interrupts, Sink, follow
from client.commands.options import PortOffset, RobotIP
from client.connection import DEFAULT_TIMEOUT_S
from client.decoding import show
from client.recipes import unknown_fields
from urproto.commandline import completing, console, plain_json
from urproto.rtde.fields import OUTPUT_FIELDS

__all__ = ["state_table", "watch_command"]

_DRAWN_HZ = 10.0  # how often a table is drawn: nobody reads faster


def watch_command(
    fields: Annotated[
        list[str],
        typer.Argument(
            help="RTDE outputs, for example actual_q robot_mode.", autocompletion=completing(lambda: OUTPUT_FIELDS)
        ),
    ],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    rate: Annotated[float, typer.Option("--rate", help="How often a second the robot sends them.")] = 10.0,
    plain: Annotated[bool, typer.Option("--plain", help="Print lines, as without a terminal.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print a line of JSON for every state.")] = False,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write every state to this file too.")] = None,
) -> None:
    """Show values of a robot as they change, until Ctrl-C."""
    if problem := unknown_fields(fields):
        raise typer.BadParameter(problem)
    names = list(dict.fromkeys(fields))
    timeout_s = DEFAULT_TIMEOUT_S + 2 / rate if rate > 0 else DEFAULT_TIMEOUT_S
    port = rtde.PORT + port_offset
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        client = rtde.BlockingRTDEClient(robot_ip, names, frequency_hz=rate, port=port, timeout_s=timeout_s)
        robot = interrupts.wait(lambda: opened.enter_context(client))
        sinks = [_csv_sink(csv_file, names, opened)] if csv_file else []
        lines = _json_lines if as_json else _lines
        in_table = sys.stdout.isatty() and not (plain or as_json)
        sinks.append(_live_table(robot, opened) if in_table else lines)
        follow(robot, sinks, interrupts)


def _lines(state: Mapping[str, Any]) -> None:
    sys.stdout.write(f"{show.pairs(state.items())}\n")
    sys.stdout.flush()


def _json_lines(state: Mapping[str, Any]) -> None:
    sys.stdout.write(f"{json.dumps(plain_json(state))}\n")
    sys.stdout.flush()


def _live_table(robot: rtde.BlockingRTDEClient, opened: ExitStack) -> Sink:
    live = opened.enter_context(Live(console=console(), auto_refresh=False))
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
    from client.recording.tables import CsvWriter  # numpy: a table on the screen does without

    try:
        writer = CsvWriter(path, names)
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror}") from error
    opened.callback(writer.close)
    return writer.write
