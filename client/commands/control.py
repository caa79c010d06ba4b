"""What the commands around controllers share: the robot, the control loop, the way to a goal."""

import asyncio
import sys
from collections.abc import Coroutine
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from client.controllers import (
    ControlledRobot,
    ControllersFile,
    ControlLoop,
    ErrorCode,
    JointTrajectory,
    Result,
    read_controllers,
    usual_controllers,
)
from client.driver.config import ROBOT_PORTS
from client.errors import ControllerError
from urproto.modes import SafetyMode

__all__ = ["ControllersOption", "MakeReady", "Target", "controllers_file", "follow", "run", "say_result", "watch"]

_DRAWN_S: Final = 0.1
_LONG_S: Final = 1.0  # a bar for less would only flicker
_INTERRUPTED: Final = 130  # exit status of a program that Ctrl-C ended

ControllersOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--controllers", help="A controllers file as of ros2_control; the usual controllers without it."),
]
MakeReady: TypeAlias = Annotated[
    bool, typer.Option("--make-ready", help="Power the arm on and release its brakes first, if need be.")
]


@dataclass(frozen=True, slots=True)
class Target:
    """Which robot, and with what."""

    robot_ip: str
    port_offset: int
    controllers: Path | None = None
    make_ready: bool = False
    prefix: str = ""

    def open(self) -> ControlledRobot:
        """Its control loop, to be entered; the arm is at rest and its program ended afterwards."""
        ports = {name: port + self.port_offset for name, port in ROBOT_PORTS.items()}
        file = controllers_file(self.controllers, self.prefix)
        return ControlledRobot(self.robot_ip, file, prefix=self.prefix, make_ready=self.make_ready, robot_ports=ports)


def controllers_file(path: Path | None, prefix: str = "") -> ControllersFile:
    """The file that was named, and its oddities told; or the usual controllers."""
    if path is None:
        return usual_controllers(prefix)
    try:
        file = read_controllers(path, prefix)
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"cannot read {path}: {error}") from error
    for note in file.notes:
        typer.echo(f"note: {note}", err=True)
    return file


def run(work: Coroutine[Any, Any, None]) -> None:
    """Do it; Ctrl-C ends it in order, with the arm at rest."""
    try:
        asyncio.run(work)
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(_INTERRUPTED) from None


async def follow(loop: ControlledRobot, name: str, trajectory: JointTrajectory, title: str) -> Result:
    """Send a goal and show how it goes. When the task is cancelled, the arm is brought to rest first."""
    loop.check_reach(trajectory)
    controller = loop.manager.controller(name)
    handle = controller.send_goal(trajectory)
    try:
        with _bar(title, trajectory) as bar:
            waiting = False
            while not handle.done:
                waiting = _say_waiting(loop, waiting)
                bar.update(bar.task_ids[0], completed=controller.progress)
                with suppress(TimeoutError):
                    await asyncio.wait_for(loop.result(handle), _DRAWN_S)
            bar.update(bar.task_ids[0], completed=1.0 if handle.result.error_code == 0 else controller.progress)
    except asyncio.CancelledError:
        loop.manager.deactivate(name)
        await loop.rest()
        raise
    await loop.rest()  # within tolerance it may still be on the way
    return await loop.result(handle)


def _say_waiting(loop: ControlLoop, before: bool) -> bool:
    """Whether a stop holds the arm; it is told when it begins."""
    mode = loop.driver.robot.safety_mode
    waiting = mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED)
    if waiting and not before:
        typer.echo(
            f"the arm waits: its safety mode is {mode.name}. Find the cause; when it is unlocked and its program "
            "goes on, so does the goal. Ctrl-C gives up.",
            err=True,
        )
    return waiting


async def watch(loop: ControlLoop) -> None:
    """Tell which controllers there are, whenever that changes. Raises ControllerError when none is left."""
    before: list[str] = []
    while True:
        lines = [f"{info.name} [{info.type}] {info.state}" for info in loop.manager.list_controllers()]
        if lines != before:
            typer.echo("\n".join(lines))
            before = lines
        if not loop.manager.active():
            raise ControllerError("controllers", "none is active any more: the lines above and the log say why")
        await loop.cycles()


def say_result(title: str, result: Result) -> None:
    """One line; exit status 1 for a goal that was not reached."""
    typer.echo(f"{title}: {result.error_code.name}: {result.error_string}")
    if result.error_code is not ErrorCode.SUCCESSFUL:
        raise typer.Exit(1)


def _bar(title: str, trajectory: JointTrajectory) -> Progress:
    visible = sys.stderr.isatty() and trajectory.points[-1].time_from_start_s >= _LONG_S
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    progress = Progress(*columns, disable=not visible)
    progress.add_task(title, total=1.0)
    return progress
