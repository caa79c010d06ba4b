"""``ur-emulator replay``: execute a recorded run again, compare it, and go on from any moment of it."""

import asyncio
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from emulator.control.conditions import parse_condition
from emulator.journal.file import MemorySink
from emulator.journal.replay import Replay
from emulator.logs import LogLevel, log_to_stderr
from emulator.options import CONTROLLER_OPTIONS, RobotOptions, errors_in_one_line, with_ports
from emulator.serve import serve
from emulator.snapshot import Snapshot
from urproto.commandline import application, fail, with_options_of
from urproto.text import number

_PROGRAM: Final = "ur-emulator replay"
_DIFFERS: Final = 1

app = application(completion=False)


@app.command()
@with_options_of(RobotOptions, without=(*CONTROLLER_OPTIONS, "fault", "journal"), last=True)
def _replay(
    robot: Mapping[str, Any],
    file: Annotated[Path, typer.Argument(help="The journal.")],
    *,
    until: Annotated[
        str,
        typer.Option(
            metavar="SECONDS|CONDITION",
            help="Stop at this uptime of the robot, or once a condition on its state is true, such as "
            '"safety_mode != NORMAL".',
        ),
    ] = "",
    go_on: Annotated[
        bool, typer.Option("--serve", help="Then open the ports: the robot goes on from there in real time.")
    ] = False,
    log_level: Annotated[LogLevel, typer.Option(help="Level of the log.")] = LogLevel.WARNING,
) -> None:
    """Execute a recorded run again, in virtual time, and check that it is the same, period by period."""
    log_to_stderr(log_level)
    try:
        condition = _condition(until)
        with Replay(file, again=MemorySink() if go_on else None) as replay:
            began_s = time.monotonic()
            replay.run(condition)
            _report(replay, time.monotonic() - began_s)
            if go_on:
                with errors_in_one_line():
                    asyncio.run(serve(with_ports(replay.config, **robot), None, None, replay=replay))
    except ValueError as error:
        fail(_PROGRAM, error)
    except OSError as error:
        fail(_PROGRAM, f"{file}: {error.strerror}")


def _condition(text: str) -> Callable[[Snapshot], bool] | None:
    """Raises ValueError for a text that is neither a time nor a condition."""
    if not text:
        return None
    try:
        time_s = number(text)
    except ValueError:
        return parse_condition(text)
    return lambda snapshot: snapshot.timestamp >= time_s


def _report(replay: Replay, took_s: float) -> None:
    controller, header = replay.controller, replay.header
    typer.echo(
        f"{controller.model.title}, PolyScope {controller.version}, recorded by ur-emulator {header['product']}: "
        f"{replay.periods} periods, {replay.periods * controller.period_s:.3f} s of robot time, in {took_s:.1f} s"
    )
    typer.echo(
        f"uptime {controller.time_s:.3f} s, {controller.snapshot.robot_mode.name}, "
        f"{controller.snapshot.safety_mode.name}, program {controller.snapshot.runtime_state.name}"
    )
    if replay.difference is None:
        typer.echo(f"the same in all {replay.checked} periods that were compared")
        return
    typer.echo(f"{replay.difference}\nlikely cause: {replay.advice}", err=True)
    raise typer.Exit(_DIFFERS)
