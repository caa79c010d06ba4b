"""``ur-client controllers``: what there is, and controllers that run until Ctrl-C."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from client.commands.control import (
    ControllersOption,
    MakeReady,
    RecordOption,
    SpeedSlider,
    Target,
    controllers_file,
    follow,
    run,
    say_result,
    watch,
)
from client.commands.following import PortOffset, RobotIP
from client.commands.record import Overwrite, check_free
from client.controllers import (
    JOINT_NAMES,
    ControlledRobot,
    ControlLoop,
    JointTrajectory,
    JointTrajectoryPoint,
    configuration,
)
from client.controllers.controller import CONTROLLER_TYPES
from client.controllers.goal_files import GOAL_TIME_S, GoalFile, NamedGoal, read_goals
from client.controllers.parameters import Reading, read_parameters
from client.errors import ControllerError
from urproto.commandline import AsJson, application, console, print_json, with_options_of

_CONTROLLER = "scaled_joint_trajectory_controller"


def _target(
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    record: RecordOption = None,
    overwrite: Overwrite = False,
    speed_slider: SpeedSlider = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> Target:
    if record is not None:
        check_free(record, overwrite)
    return Target(robot_ip, port_offset, controllers, make_ready, record, speed_slider)


@with_options_of(_target, last=True)
def goal_command(
    robot: Mapping[str, Any],
    positions: Annotated[str, typer.Option(help='Joint angles, base to wrist 3: "0,-1.57,0,-1.57,0,0" [rad].')],
    time: Annotated[float, typer.Option(help="How long the motion takes at full speed [s].")] = 6.0,
    degrees: Annotated[bool, typer.Option("--degrees", help="The angles are in degrees.")] = False,
    controller: Annotated[str, typer.Option(help="Trajectory controller to use.")] = _CONTROLLER,
) -> None:
    """Move the arm to joint angles and stop there; Ctrl-C brings it to rest."""
    q = tuple(radians(angle) for angle in _angles(positions)) if degrees else _angles(positions)
    _check_time(time)
    target = _target(**robot)
    point = JointTrajectoryPoint(q, (0.0,) * len(q), time_from_start_s=time)
    run(go(target, controller, JointTrajectory(JOINT_NAMES, (point,))))


@with_options_of(_target, last=True)
def publish_goals_command(
    robot: Mapping[str, Any],
    file: Annotated[Path, typer.Argument(help="Goals as publisher_joint_trajectory_controller reads them.")],
    node: Annotated[str | None, typer.Option(help="Section of the file, if it has several.")] = None,
    time: Annotated[float, typer.Option(help="How long each motion takes at full speed [s].")] = GOAL_TIME_S,
    rounds: Annotated[int, typer.Option(min=0, help="How many times to send all goals; 0 repeats until Ctrl-C.")] = 1,
    controller: Annotated[str | None, typer.Option(help="Controller to use instead of the file's.")] = None,
) -> None:
    """Send the goals of a file, each once the previous one is reached; Ctrl-C brings the arm to rest."""
    _check_time(time)
    try:
        goals = read_goals(file, node)
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"cannot read {file}: {error}") from error
    for note in goals.notes:
        typer.echo(f"note: {note}", err=True)
    if controller is not None:
        goals = replace(goals, controller=controller)
    target = _target(**robot)
    run(publish(target, goals, time, rounds))


def _check_time(time_s: float) -> None:
    if not time_s > 0.0:
        raise typer.BadParameter(f"--time has to be above 0 s, not {time_s}")


def _angles(text: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(part) for part in text.replace(",", " ").replace("[", " ").replace("]", " ").split())
    except ValueError:
        raise typer.BadParameter(f"--positions takes numbers with commas between them, not {text!r}") from None
    if len(angles) != len(JOINT_NAMES):
        raise typer.BadParameter(f"--positions takes {len(JOINT_NAMES)} joint angles, not {len(angles)}")
    return angles


async def go(target: Target, name: str, trajectory: JointTrajectory) -> None:
    """Let one controller of the target follow one trajectory."""
    async with target.open() as loop:
        loop.manager.activate(name)
        result = await follow(loop, name, trajectory, "goal")
    say_result("goal", result)


async def publish(target: Target, goals: GoalFile, time_s: float, rounds: int) -> None:
    """Send all goals of a file, as often as ``rounds`` says; 0 is without end. Raises ControllerError."""
    async with target.open() as loop:
        goals.check_start(_standing(loop))
        loop.manager.activate(goals.controller)
        done = 0
        while rounds == 0 or done < rounds:
            for number, goal in enumerate(goals.goals):
                last = number == len(goals.goals) - 1 and done == rounds - 1
                title = f"{goal.name} ({number + 1}/{len(goals.goals)})"
                await _one(loop, goals, goal, title, time_s, last)
            done += 1


async def _one(loop: ControlledRobot, goals: GoalFile, goal: NamedGoal, title: str, time_s: float, last: bool) -> None:
    began_s = loop.manager.time_s
    if goals.commands:
        typer.echo(f"{goal.name}: {_listed(goal.point.positions)}")
        loop.manager.controller(goals.controller).command(goal.point.positions)
    else:
        point = replace(goal.point, time_from_start_s=time_s)
        trajectory = JointTrajectory(goals.joints or JOINT_NAMES, (point,))
        say_result(goal.name, await follow(loop, goals.controller, trajectory, title))
    while (goals.commands or not last) and loop.manager.time_s < began_s + goals.wait_s:
        await loop.cycles()


def _standing(loop: ControlLoop) -> Mapping[str, float]:
    states = loop.manager.hardware.states
    return {joint: states[f"{joint}/position"] for joint in JOINT_NAMES}


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


controllers_app = application("ros2_control's controllers.", completion=False, no_args_is_help=True)


@controllers_app.command("types")
def types_command(as_json: AsJson = False) -> None:
    """List the available controller types."""
    if as_json:
        known = {name: configuration.help_of(kind) for name, kind in sorted(CONTROLLER_TYPES.items())}
        print_json({"types": known, "refused": configuration.REFUSED})
        return
    table = Table("type", "what it does")
    for name in sorted(CONTROLLER_TYPES):
        table.add_row(name, configuration.help_of(CONTROLLER_TYPES[name]))
    for name, instead in configuration.REFUSED.items():
        table.add_row(name, f"not available here: {instead}")
    console().print(table)


@controllers_app.command("list")
def list_command(controllers: ControllersOption = None, as_json: AsJson = False) -> None:
    """List the controllers of a file and what in it is not understood; exit status 1 if any cannot be loaded."""
    file = controllers_file(controllers)
    table = Table("controller", "type", "notes", title=file.name)
    rows = [(name, kind, *_notes(name, kind, file.parameters_of(name))) for name, kind in file.types.items()]
    if as_json:
        print_json([{"name": name, "type": kind, "notes": notes, "fine": fine} for name, kind, notes, fine in rows])
    else:
        for name, kind, notes, _ in rows:
            table.add_row(name, kind, "\n".join(notes))
        console().print(table)
    if not all(fine for *_, fine in rows):
        raise typer.Exit(1)


@controllers_app.command("interfaces")
def interfaces_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    make_ready: MakeReady = False,
    as_json: AsJson = False,
) -> None:
    """List the interfaces of a robot with their present values."""

    async def work() -> None:
        async with Target(robot_ip, port_offset, make_ready=make_ready).open() as loop:
            hardware = loop.manager.hardware
            infos = loop.manager.list_interfaces()
            values = [(hardware.commands if one.kind == "command" else hardware.states)[one.name] for one in infos]
        rows = list(zip(infos, values, strict=True))
        if as_json:
            print_json([{"name": info.name, "kind": info.kind, "value": value} for info, value in rows])
            return
        table = Table("interface", "kind", "value")
        for info, value in rows:
            table.add_row(info.name, info.kind, "" if value != value else f"{value:g}")
        console().print(table)

    run(work())


@controllers_app.command("load")
def load_command(
    names: Annotated[list[str], typer.Argument(help="Controllers of the file to activate together.")],
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Load, configure and activate controllers, and run them until Ctrl-C or until none is left."""

    async def work() -> None:
        async with Target(robot_ip, port_offset, controllers, make_ready).open() as loop:
            loop.manager.activate(*names)
            for note in loop.manager.notes:
                typer.echo(f"note: {note}", err=True)
            await watch(loop)

    run(work())


def _notes(name: str, kind: str, parameters: object) -> tuple[list[str], bool]:
    reading = Reading()
    try:
        found = configuration.find(name, kind)
        assert isinstance(parameters, dict)
        read = read_parameters(found.parameters_type, parameters, name, reading)
        found(name, read, 1.0).on_configure()
    except ControllerError as error:
        return [error.reason], False
    unknown = [f"{key} is not known: it is ignored" for key in reading.unknown]
    return [*unknown, *(f"{key} has no effect" for key in reading.without_effect)], True
