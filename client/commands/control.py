"""Shared by the commands that use controllers: options, the connection to a controller manager, goal execution."""

import asyncio
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Protocol, TypeAlias

import typer

from client.commands.following import INTERRUPTED, ProgressBar
from client.controllers import (
    ControllersFile,
    ErrorCode,
    JointTrajectory,
    Result,
    RobotControl,
    read_controllers,
    usual_controllers,
)
from client.controllers.configuration import trajectory_controller
from client.controllers.controller import LifecycleState
from client.controllers.remote import ANSWER_S, RemoteManager
from client.controllers.running import ManagerOptions, RunningManager
from client.controllers.session import Session
from client.driver.config import robot_ports
from client.driver.scheduling import real_time
from client.errors import ControllerError, NoManagerError
from client.recording import DEFAULT_FIELDS
from urproto.modes import SafetyMode

ACTIVE: Final = str(LifecycleState.ACTIVE)
UNCONFIGURED: Final = str(LifecycleState.UNCONFIGURED)
_POLL_S: Final = 0.05
_REST_S: Final = 3.0  # guess: a ramp to rest takes less than one second
_READY_S: Final = 120.0  # guess: an arm that boots and releases its brakes
_SLOW: Final = ("make_ready", "set_hardware_component_state", "begin_recording", "end_recording")
_FREE: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_RELEASE: Final = {
    SafetyMode.PROTECTIVE_STOP: "After 5 s, release it on the pendant, or run ur-client dashboard "
    "'unlock protective stop' and ur-client dashboard play.",
    SafetyMode.SAFEGUARD_STOP: "Close the safeguard, reset it, then run ur-client dashboard play.",
}
_ON_THE_PENDANT: Final = "Release it on the pendant."

ControllersOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--controllers", help="A ros2_control controllers file (default: the usual controllers)."),
]
InitialController: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--controller",
        help="Controller to activate once the arm can be moved; empty for none (default: the file's trajectory "
        "controller).",
    ),
]
Headless: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--headless/--no-headless",
        help="Send the control program to the robot, or wait for a program with External Control to be played there.",
    ),
]
MakeReady: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--make-ready",
        help="Power the arm on and release its brakes first, if necessary; with --no-headless, also play the loaded "
        "program, or wait for one.",
    ),
]


RecordOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--record", help="Record the robot and the controller to this .mcap file (.csv or .npz: the robot only)."
    ),
]
SpeedSlider: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--speed-slider",
        min=0.01,
        max=1.0,
        help="Set the robot's speed slider first (0.01 to 1). It keeps that value afterwards.",
    ),
]


Seen: TypeAlias = Callable[[Mapping[str, Any]], Awaitable[None]]


class ArmAccess(Protocol):
    """Access to the controller manager that moves the arm.

    owns_manager: whether this command runs the manager itself; otherwise it shares one that is already running.
    """

    owns_manager: bool

    async def request(self, do: str, /, **arguments: Any) -> Any:
        """See `client.controllers.session.Session`. Raises URError."""


class _OwnManager(Session):
    """With a controller manager that this command runs; it ends with the command."""

    owns_manager = True


class _Shared(RemoteManager):
    """With the controller manager that is already running for this robot."""

    owns_manager = False

    async def request(self, do: str, /, **arguments: Any) -> Any:
        return await super().request(do, timeout_s=_READY_S if do in _SLOW else ANSWER_S, **arguments)


@dataclass(frozen=True, slots=True)
class Target:
    """The robot to move, and the options to move it with. speed_slider: 0.01 to 1; None leaves it as it is."""

    robot_ip: str
    port_offset: int
    controllers: Path | None = None
    make_ready: bool = False
    record: Path | None = None
    speed_slider: float | None = None

    @property
    def ports(self) -> dict[str, int]:
        return robot_ports(self.port_offset)

    def manager(self) -> _Shared:
        """The manager running for this robot; entering it raises NoManagerError if there is none."""
        return _Shared(self.robot_ip, self.ports["rtde"])

    @asynccontextmanager
    async def open(self) -> AsyncIterator[ArmAccess]:
        """Connect to the running manager, or else run one.

        When a manager of this command ends, the arm is at rest and its program has ended.
        """
        async with AsyncExitStack() as opened:
            try:
                arm: ArmAccess = await opened.enter_async_context(self.manager())
            except NoManagerError:
                typer.echo(
                    f"no controller manager is running for {self.robot_ip}: starting one for this command", err=True
                )
                arm = await opened.enter_async_context(self._open_alone())
            else:
                typer.echo(f"using the controller manager that is running for {self.robot_ip}", err=True)
                if self.make_ready:
                    await arm.request("make_ready")
            if self.record is not None:
                await arm.request("begin_recording", path=str(self.record.absolute()))
                opened.push_async_callback(arm.request, "end_recording")
                typer.echo(f"recording to {self.record}", err=True)
            if self.speed_slider is not None:
                await arm.request("set_speed_slider", fraction=self.speed_slider)
            yield arm

    @asynccontextmanager
    async def _open_alone(self) -> AsyncIterator[ArmAccess]:
        control = RobotControl(
            self.robot_ip,
            controllers_file(self.controllers),
            make_ready=self.make_ready,
            outputs=DEFAULT_FIELDS if self.record else (),
            robot_ports=self.ports,
        )
        with real_time(control.driver.config.realtime):  # this process does nothing else
            async with control:
                session = _OwnManager(RunningManager(control))
                try:
                    yield session
                finally:
                    await session.close()

    async def trajectory_controller(self, arm: ArmAccess) -> str:
        """Name of the trajectory controller in the controllers file, or of the manager's. Raises ControllerError."""
        if arm.owns_manager or self.controllers is None:
            types = await arm.request("list_available")
        else:
            types = read_controllers(self.controllers).types
        if not (name := trajectory_controller(types)):
            raise ControllerError("controllers file", "it has no trajectory controller: name one with --controller")
        return name

    async def activate(self, arm: ArmAccess, name: str) -> None:
        """Load and configure a controller if necessary, and activate it in place of those that move the arm."""
        states = {one["name"]: one["state"] for one in await arm.request("list_controllers")}
        if name not in states:
            await arm.request("load_controller", name=name, **self._described(arm, name))
        elif self.controllers is not None and not arm.owns_manager:
            typer.echo(
                f"note: {name} is loaded already and keeps its parameters: --controllers has no effect on it", err=True
            )
        if states.get(name, UNCONFIGURED) == UNCONFIGURED:
            await arm.request("configure_controller", name=name)
        if states.get(name) != ACTIVE:
            others = await arm.request("moving_controllers")
            await arm.request("switch_controller", activate=[name], deactivate=others)
            if others:
                typer.echo(f"note: {name} replaces {', '.join(others)}", err=True)

    def _described(self, arm: ArmAccess, name: str) -> dict[str, Any]:
        """Type and parameters of a controller from the file, for a manager that did not read the same file."""
        if arm.owns_manager or self.controllers is None:
            return {}
        file = controllers_file(self.controllers)
        return {"type": file.type_of(name), "parameters": file.parameters_of(name)}


def controllers_file(path: Path | None, prefix: str = "") -> ControllersFile:
    """Read a controllers file and print its notes; without a path, return the usual controllers."""
    if path is None:
        return usual_controllers(prefix)
    try:
        file = read_controllers(path, prefix)
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"cannot read {path}: {error}") from error
    for note in file.notes:
        typer.echo(f"note: {note}", err=True)
    return file


def run(work: Coroutine[Any, Any, None], *, interrupted: int = INTERRUPTED) -> None:
    """Run a coroutine. Ctrl-C and SIGTERM end it in an orderly way, with the arm at rest. interrupted: exit status."""
    try:
        asyncio.run(_until_terminated(work))
    except (KeyboardInterrupt, asyncio.CancelledError):
        typer.echo("stopped", err=True)
        raise typer.Exit(interrupted) from None


async def _until_terminated(work: Coroutine[Any, Any, None]) -> None:
    """Let SIGTERM cancel the work, as asyncio does for Ctrl-C."""
    task = asyncio.current_task()
    assert task is not None
    with suppress(NotImplementedError, RuntimeError):  # on Windows, and outside the main thread
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    await work


async def announce(running: RunningManager, options: ManagerOptions) -> None:
    """Print that the manager is ready; with make_ready, first wait until the control program runs."""
    if text := running.waiting(options):
        typer.echo(text, err=True)
    typer.echo(await running.ready(options), err=True)


async def follow(
    arm: ArmAccess, name: str, trajectory: JointTrajectory, title: str, seen: Seen | None = None
) -> Result:
    """Send a goal and show its progress. If the task is cancelled, the arm is brought to rest first.

    seen: called from time to time with the robot's state, as `Session.robot_state` returns it.
    """
    number = await arm.request("send_goal", controller=name, trajectory=asdict(trajectory))
    try:
        with ProgressBar(title) as progress:
            waiting = False
            while "error_code" not in (goal := await arm.request("goal", goal=number)):
                state = await arm.request("robot_state")
                if seen is not None:
                    await seen(state)
                waiting = _print_stop(state, progress, waiting)
                progress.update(goal["progress"], _note(state))
                await asyncio.sleep(_POLL_S)
            progress.update(1.0 if goal["error_code"] == 0 else goal["progress"])
    except asyncio.CancelledError:
        if arm.owns_manager:
            await arm.request("switch_controller", deactivate=[name])
        else:
            await arm.request("cancel_goal", goal=number)
        await wait_until_at_rest(arm)
        raise
    await wait_until_at_rest(arm)  # the goal succeeds once within tolerance: the arm may still be moving
    return Result(ErrorCode(goal["error_code"]), goal["error_string"])


async def wait_until_at_rest(arm: ArmAccess) -> None:
    """Wait until the arm is at rest, at most a few seconds of robot time."""
    state = await arm.request("robot_state")
    end_s = state["time_s"] + _REST_S
    while not state["at_rest"] and state["time_s"] < end_s:
        await asyncio.sleep(_POLL_S)
        state = await arm.request("robot_state")


async def until(arm: ArmAccess, time_s: float) -> None:
    """Wait until a point in robot time."""
    while (await arm.request("robot_state"))["time_s"] < time_s:
        await asyncio.sleep(_POLL_S)


def _print_stop(state: Mapping[str, Any], progress: ProgressBar, before: bool) -> bool:
    """Whether a safety stop holds the arm. Prints what to do about it when the stop begins."""
    mode = SafetyMode[state["safety_mode"]]
    waiting = mode not in _FREE
    if waiting and not before:
        progress.print_line(
            f"the arm waits: its safety mode is {mode.name}. Find the cause. {_RELEASE.get(mode, _ON_THE_PENDANT)} "
            "The goal then continues; Ctrl-C aborts it."
        )
    return waiting


def _note(state: Mapping[str, Any]) -> str:
    """Why the motion is slower than planned; empty if it is not."""
    if (mode := SafetyMode[state["safety_mode"]]) not in _FREE:
        return mode.name.replace("_", " ").lower()
    slider = state["target_speed_fraction"]
    return f"slider {100.0 * slider:.0f} %" if slider < 1.0 else ""


def print_result(title: str, result: Result, *, err: bool = False) -> None:
    """Print the result as one line; exit with status 1 if the goal was not reached. err: print to standard error."""
    typer.echo(f"{title}: {result.error_code.name}: {result.error_string}", err=err)
    if result.error_code is not ErrorCode.SUCCESSFUL:
        raise typer.Exit(1)
