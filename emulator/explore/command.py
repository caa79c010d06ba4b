"""``ur-emulator explore``: search for the schedule that breaks a program."""

import math
import time
from pathlib import Path
from typing import Annotated, Final

import typer

from emulator.config import ConfigError
from emulator.explore.answer import junit, story, write_found
from emulator.explore.choices import PlanError
from emulator.explore.plan import Plan, read_plan
from emulator.explore.search import Found, Runner, explored
from emulator.logs import LogLevel, log_to_stderr
from emulator.options import errors_in_one_line
from emulator.realtime import usable_cores
from urproto.commandline import application
from urproto.durable import write_file

_FOUND: Final = 1

app = application(completion=False)


@app.command()
def _explore(
    file: Annotated[Path, typer.Argument(help="YAML file of the exploration (docs/explore.md).")],
    *,
    runs: Annotated[int, typer.Option(min=1, help="Runs to make at most.")] = 500,
    minutes: Annotated[float | None, typer.Option(min=0.0, help="Time to search for at most.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search: the same one finds the same.")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes (default: one per core); the results are the same.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for what is found (default: FILE without its suffix, plus -found).")
    ] = None,
    junit_file: Annotated[Path | None, typer.Option("--junit", help="Write the properties as test cases here.")] = None,
) -> None:
    """Search for the schedule of faults, inputs, operators and delays that breaks a program."""
    log_to_stderr(LogLevel.ERROR)
    with errors_in_one_line():
        try:
            plan = read_plan(file)
            with Runner(plan, workers or usable_cores()) as runner:
                until = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
                found, search = explored(
                    plan,
                    runner,
                    seed,
                    lambda: runner.runs >= runs or time.monotonic() >= until,
                    lambda text: typer.echo(text, err=True),
                )
        except PlanError as error:
            raise ConfigError(f"{file}: {error}") from error
        for one in found.values():
            _tell(file, plan, one, out or file.with_name(f"{file.stem}-found"))
        if junit_file is not None:
            write_file(junit_file, junit(plan, found, runner.runs))
    for name in [one.name for one in plan.properties if one.name not in found]:
        typer.echo(f"{name}: not broken")
    for name, count in search.refused.items():
        typer.echo(f"note: the robot refused {name!r} {count} times", err=True)
    typer.echo(f"{runner.runs} runs, {len(search.features)} different things seen, seed {seed}")
    if found:
        raise typer.Exit(_FOUND)


def _tell(file: Path, plan: Plan, found: Found, folder: Path) -> None:
    typer.echo(f"{found.property}: broken")
    for line in story(plan, found.trail):
        typer.echo(f"  {line}")
    journal = write_found(file, plan, found, folder)
    typer.echo(f"  see it again: ur-emulator replay {journal}")
    typer.echo(f"  keep it: {journal.with_name(f'test_{journal.stem}.py')}")
