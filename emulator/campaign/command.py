"""``ur-emulator campaign``: many runs of programs or tests in virtual time, and their progress."""

import sys
import time
from collections import deque
from contextlib import closing
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from shlex import join
from shutil import rmtree
from typing import Annotated, Final, TextIO

import typer

from emulator.campaign.conduct import Conductor, first_failures, simplest
from emulator.campaign.journal import FAILED_RUNS, Journal, write_parquet
from emulator.campaign.plan import Plan, Run, read_plan
from emulator.campaign.report import Summary, write_report
from emulator.campaign.work import Result, Status, installed_version
from emulator.campaign.workers import LocalWorkers, RayWorkers, Workers
from emulator.config import ConfigError
from emulator.options import errors_in_one_line
from emulator.realtime import usable_cores
from urproto.commandline import application
from urproto.extras import how_to_install

_FAILED: Final = 1
_INTERRUPTED: Final = 130  # as in shells
_PREVIEW: Final = 10  # commands that --dry-run shows

app = application(completion=False)
_TERMINAL_S: Final = 0.5  # between two lines
_FILE_S: Final = 10.0
_WINDOW_S: Final = 60.0  # over which the rate is averaged: the number of machines may change


@app.command()
def _campaign(
    file: Annotated[Path, typer.Argument(help="YAML file of the campaign (docs/campaigns.md).")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="Folder for results (default: FILE without its suffix, plus -results).")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes on this machine (default: one per core).")
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on a Ray cluster instead: its address, auto, or local (a new one)."),
    ] = None,
    minimise: Annotated[
        int, typer.Option(min=0, help="Number of kinds of failures for which a failed run is simplified.")
    ] = 10,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard existing results.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the number of runs and the first commands, and run nothing.")
    ] = False,
) -> None:
    """Run programs or tests many times in virtual time, with every combination of options."""
    with errors_in_one_line():
        if find_spec("pyarrow") is None:
            raise ConfigError(f"campaigns need Parquet: {how_to_install('campaign')}")
        if ray is not None and workers is not None:
            raise ConfigError("a Ray cluster uses one process per core: leave out --workers")
        plan = read_plan(file)
        if dry_run:
            _preview(plan)
            return
        folder = out or file.with_name(f"{file.stem}-results")
        if fresh:
            (folder / "journal.jsonl").unlink(missing_ok=True)
            rmtree(folder / FAILED_RUNS, ignore_errors=True)
        with Journal(folder, plan, installed_version()) as journal:
            simpler = _carry_out(plan, journal, ray, workers, minimise)
            write_parquet(journal, plan, folder / "results.parquet")
            summary = write_report(folder / "report.html", plan, journal, simpler)
        _conclude(summary, folder)


def _carry_out(plan: Plan, journal: Journal, ray: str | None, workers: int | None, minimise: int) -> dict[int, Run]:
    """Carry out every run that has no result; return simplified versions of failed runs, by number."""
    done = len(plan) - journal.left
    if done:
        typer.echo(f"{done:,} of {len(plan):,} runs are already done.")
    progress = Progress(len(plan), done, sys.stderr)
    version = installed_version()
    with closing(_workers(plan, ray, workers)) as chosen:
        try:
            Conductor(plan, chosen, journal, version, progress.update).run()
            progress.finish()
            return simplest(plan, chosen, version, first_failures(journal, minimise))
        except KeyboardInterrupt:
            progress.finish()
            left = f"{journal.left:,} runs are left: repeat the command to continue" if journal.left else "all are done"
            typer.echo(f"Interrupted. {left}.", err=True)
            raise typer.Exit(_INTERRUPTED) from None


def _workers(plan: Plan, ray: str | None, workers: int | None) -> Workers:
    if ray is not None:
        return RayWorkers(ray, plan.folder)
    return LocalWorkers(plan.folder, workers or usable_cores())


def _preview(plan: Plan) -> None:
    typer.echo(f"{len(plan):,} runs, in {plan.folder}:")
    for number in range(min(_PREVIEW, len(plan))):
        typer.echo(join(plan.command(plan.run(number))))
    if len(plan) > _PREVIEW:
        typer.echo("...")


def _conclude(summary: Summary, folder: Path) -> None:
    counts = ", ".join(f"{count:,} {status}" for status, count in sorted(summary.by_status.items()))
    typer.echo(f"{counts}: {folder / 'report.html'}, {folder / 'results.parquet'}")
    if summary.passed < summary.runs:
        raise typer.Exit(_FAILED)


@dataclass
class Progress:
    """Shows the progress. total: number of runs; done: runs that had a result before."""

    total: int
    done: int
    out: TextIO
    _failed: int = 0
    _marks: deque[tuple[float, int, float]] = field(default_factory=deque)  # time, runs, robot time
    _robot_s: float = 0.0
    _printed_s: float = 0.0

    def __post_init__(self) -> None:
        self._marks.append((time.monotonic(), self.done, 0.0))
        self._printed_s = self._marks[0][0]

    def update(self, results: list[Result]) -> None:
        """Add new results, if any, and update the line when it is due."""
        self.done += len(results)
        self._failed += sum(result.status is not Status.PASSED for result in results)
        self._robot_s += sum(result.robot_s or 0.0 for result in results)
        now = time.monotonic()
        if now - self._printed_s >= (_TERMINAL_S if self.out.isatty() else _FILE_S):
            self._printed_s = now
            self._print_line(now)

    def finish(self) -> None:
        if self.out.isatty():
            self.out.write("\r\x1b[K")
            self.out.flush()

    def _print_line(self, now: float) -> None:
        self._marks.append((now, self.done, self._robot_s))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW_S:
            self._marks.popleft()
        began, done, robot_s = self._marks[0]
        text = f"{self.done:,} of {self.total:,} runs, {self._failed:,} failed"
        if self.done > done:
            left_s = (self.total - self.done) * (now - began) / (self.done - done)
            text += f", {duration(left_s)} left"
        if self._robot_s > robot_s:
            text += f", {(self._robot_s - robot_s) / (now - began):,.0f} robot seconds per second"
        self.out.write(f"\r\x1b[K{text}" if self.out.isatty() else f"{text}\n")
        self.out.flush()


def duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    if minutes < 90:
        return f"{minutes:.0f} min"
    return f"{minutes / 60:.1f} h" if minutes < 48 * 60 else f"{minutes / 1440:.1f} days"
