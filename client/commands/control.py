"""What the commands around controllers share: the robot, the control loop, the way to a goal."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer

from client.commands.following import MotionProgress
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
from client.driver.scheduling import real_time
from client.errors import ControllerError
from urproto.compat_asyncio import timeout
from urproto.modes import SafetyMode

_DRAWN_S: Final = 0.1
_INTERRUPTED: Final = 130  # exit status of a program that Ctrl-C ended
_RELEASE: Final = {
    SafetyMode.PROTECTIVE_STOP: "After 5 s, here or on the pendant: ur-client dashboard "
    "'unlock protective stop', then ur-client dashboard play.",
    SafetyMode.SAFEGUARD_STOP: "Close the safeguard, reset it, then: ur-client dashboard play.",
}
_ELSEWHERE: Final = "It is released on the pendant."

ControllersOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--controllers", help="A ros2_control controllers file (default: the usual controllers)."),
]
MakeReady: TypeAlias = Annotated[
    bool, typer.Option("--make-ready", help="Power the arm on and release its brakes first, if necessary.")
]


RecordOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--record", help="Record robot and controller into this file: .mcap (or .csv, .npz: the robot alone)."
    ),
]
SpeedSlider: TypeAlias = Annotated[
    float | None,
    typer.Option("--speed-slider", min=0.01, max=1.0, help="Set the robot's speed slider first; it stays set."),
]


@dataclass(frozen=True, slots=True)
class Target:
    """Which robot, and with what. speed_slider: 0.01 to 1, None leaves it where it is."""

    robot_ip: str
    port_offset: int
    controllers: Path | None = None
    make_ready: bool = False
    record: Path | None = None
    speed_slider: float | None = None
    prefix: str = ""

    @asynccontextmanager
    async def open(self) -> AsyncIterator[ControlledRobot]:
        """Its control loop; the arm is at rest and its program ended afterwards."""
        ports = {name: port + self.port_offset for name, port in ROBOT_PORTS.items()}
        file = controllers_file(self.controllers, self.prefix)
        robot = ControlledRobot(
            self.robot_ip,
            file,
            prefix=self.prefix,
            make_ready=self.make_ready,
            record=self.record,
            robot_ports=ports,
        )
        with real_time(robot.driver.config.realtime):  # this process does nothing else
            async with robot as loop:
                if self.record is not None:
                    typer.echo(f"recording into {self.record}", err=True)
                if self.speed_slider is not None:
                    await loop.robot.set_speed_slider(self.speed_slider)
                yield loop


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
        with MotionProgress(title) as progress:
            waiting = False
            while not handle.done:
                waiting = _say_waiting(loop, progress, waiting)
                progress.update(controller.progress, _note(loop))
                with suppress(TimeoutError):
                    async with timeout(_DRAWN_S):
                        await loop.result(handle)
            progress.update(1.0 if handle.result.error_code == 0 else controller.progress)
    except asyncio.CancelledError:
        loop.manager.deactivate(name)
        await loop.rest()
        raise
    await loop.rest()  # within tolerance it may still be on the way
    return await loop.result(handle)


def _say_waiting(loop: ControlLoop, progress: MotionProgress, before: bool) -> bool:
    """Whether a stop holds the arm; what to do about it is told when it begins."""
    mode = loop.driver.robot.safety_mode
    waiting = mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED)
    if waiting and not before:
        progress.say(
            f"the arm waits: its safety mode is {mode.name}. Find the cause. {_RELEASE.get(mode, _ELSEWHERE)} "
            "The goal goes on then; Ctrl-C gives up."
        )
    return waiting


def _note(loop: ControlLoop) -> str:
    """Why the motion is slower than planned."""
    if (mode := loop.driver.robot.safety_mode) not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return mode.name.replace("_", " ").lower()
    slider = loop.driver.state["target_speed_fraction"]
    return f"slider {100.0 * slider:.0f} %" if slider < 1.0 else ""


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
