"""``ur-client controllers``, ``goal``, ``publish-goals`` and ``forward``: a running manager, and what it is asked."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from math import radians
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer
from rich.table import Table

from client.commands.control import (
    Arm,
    ControllersOption,
    Headless,
    MakeReady,
    RecordOption,
    SpeedSlider,
    Target,
    announce,
    controllers_file,
    follow,
    rest,
    run,
    say_result,
    until,
)
from client.commands.following import PortOffset, RobotIP
from client.commands.record import Overwrite, check_free
from client.controllers import JOINT_NAMES, JointTrajectory, JointTrajectoryPoint, configuration
from client.controllers.controller import in_short
from client.controllers.goal_files import GOAL_TIME_S, GoalFile, NamedGoal, read_goals
from client.controllers.parameters import Reading, read_parameters
from client.controllers.running import ManagerOptions, RunningManager, reached
from client.controllers.serving import ManagerServer, claim
from client.controllers.session import BEST_EFFORT, STRICT, available_types
from client.driver.config import ROBOT_PORTS
from client.driver.scheduling import real_time
from client.errors import ControllerError, MotionError, NoManagerError
from urproto.commandline import AsJson, application, console, print_json, with_options_of
from urproto.yamltext import NotYaml, load_yaml

_CONTROLLER = "scaled_joint_trajectory_controller"
_THERE_RAD: Final = 0.005  # guess: the lag of an arm that has all but arrived
_STANDS_S: Final = 2.0  # guess: longer than an arm takes to begin
_LOOK_S: Final = 0.05


class ForwardKind(Enum):
    """What a forward controller commands."""

    POSITION = "position"
    VELOCITY = "velocity"


class SetState(Enum):
    """Of a controller that is loaded, as `ros2 control load_controller --set-state` has it."""

    INACTIVE = "inactive"
    ACTIVE = "active"


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
    async with target.open() as arm:
        await target.activate(arm, name)
        result = await follow(arm, name, trajectory, "goal")
    say_result("goal", result)


async def publish(target: Target, goals: GoalFile, time_s: float, rounds: int) -> None:
    """Send all goals of a file, as often as ``rounds`` says; 0 is without end. Raises ControllerError."""
    async with target.open() as arm:
        goals.check_start((await arm.ask("robot_state"))["positions"])
        await target.activate(arm, goals.controller)
        done = 0
        while rounds == 0 or done < rounds:
            for number, goal in enumerate(goals.goals):
                last = number == len(goals.goals) - 1 and done == rounds - 1
                title = f"{goal.name} ({number + 1}/{len(goals.goals)})"
                await _one(arm, goals, goal, title, time_s, last)
            done += 1


async def _one(arm: Arm, goals: GoalFile, goal: NamedGoal, title: str, time_s: float, last: bool) -> None:
    began_s = (await arm.ask("robot_state"))["time_s"]
    if goals.commands:
        typer.echo(f"{goal.name}: {_listed(goal.point.positions)}")
        await arm.ask("forward_command", controller=goals.controller, values=goal.point.positions, hold=True)
    else:
        point = replace(goal.point, time_from_start_s=time_s)
        trajectory = JointTrajectory(goals.joints or JOINT_NAMES, (point,))
        say_result(goal.name, await follow(arm, goals.controller, trajectory, title))
    if goals.commands or not last:
        await until(arm, began_s + goals.wait_s)


forward_app = application(completion=False)


@forward_app.command(context_settings={"ignore_unknown_options": True})  # which negative numbers would be
@with_options_of(_target, last=True)
def forward_command(
    robot: Mapping[str, Any],
    kind: Annotated[ForwardKind, typer.Argument(help="What to command.")],
    values: Annotated[list[float], typer.Argument(help="One for each joint, base to wrist 3 [rad, rad/s].")],
    time: Annotated[
        float, typer.Option(help="How long the way to positions takes at full speed, or speeds last [s].")
    ] = 4.0,
    at_once: Annotated[
        bool, typer.Option("--at-once", help="Command positions as they are, as a publisher would: the arm jerks.")
    ] = False,
    degrees: Annotated[bool, typer.Option("--degrees", help="The values are in degrees.")] = False,
    controller: Annotated[str | None, typer.Option(help="Forward controller to use.")] = None,
) -> None:
    """Command positions or speeds through a forward controller; Ctrl-C brings the arm to rest."""
    _check_time(time)
    given = tuple(map(radians, values)) if degrees else tuple(values)
    run(forward(_target(**robot), controller or f"forward_{kind.value}_controller", kind, given, time, at_once))


async def forward(
    target: Target, name: str, kind: ForwardKind, values: Sequence[float], time_s: float, at_once: bool
) -> None:
    """Positions until the arm is there, or speeds for so long. Raises ControllerError."""
    position = kind is ForwardKind.POSITION
    async with target.open() as arm:
        await target.activate(arm, name)
        begin_s = (await arm.ask("robot_state"))["time_s"]
        ramp_s = time_s if position and not at_once else 0.0
        await arm.ask("forward_command", controller=name, values=values, time_s=ramp_s, hold=True)
        try:
            if position:
                await _arrival(arm, values)
            else:
                await until(arm, begin_s + time_s)
        finally:
            if not position:
                await arm.ask("forward_command", controller=name, values=[0.0] * len(values))
            await rest(arm)
        reached = (await arm.ask("robot_state"))["positions"]
    typer.echo(f"{name}: the arm is at {', '.join(f'{q:.3f}' for q in reached.values())} rad")


async def _arrival(arm: Arm, values: Sequence[float]) -> None:
    """Wait until the joints are there. Raises MotionError when they stand elsewhere."""
    stood_s: float | None = None
    while True:
        state = await arm.ask("robot_state")
        away = max(abs(q - value) for q, value in zip(state["positions"].values(), values, strict=True))
        if away < _THERE_RAD:
            return
        waits = state["safety_mode"] not in ("NORMAL", "REDUCED") or not state["at_rest"]
        stood_s = None if waits else stood_s or state["time_s"]
        if stood_s is not None and state["time_s"] > stood_s + _STANDS_S:
            raise MotionError("forward position", f"the arm stands {away:.3f} rad away: look at the robot's log")
        await until(arm, state["time_s"] + _LOOK_S)


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


controllers_app = application(
    "ros2_control's controllers: a manager that runs, and what other shells ask of it.",
    completion=False,
    no_args_is_help=True,
)

_Names: TypeAlias = Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of controllers.")]
_Name: TypeAlias = Annotated[str, typer.Argument(help="Name of a controller.")]


@controllers_app.command("serve")
def serve_command(
    controllers: ControllersOption = None,
    controller: Annotated[
        str, typer.Option(help="The controller that is active at first, once the arm can be moved; empty for none.")
    ] = _CONTROLLER,
    headless: Headless = True,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Run a controller manager that other shells and the pendant talk to, until Ctrl-C."""
    ports = {name: port + port_offset for name, port in ROBOT_PORTS.items()}
    file = controllers_file(controllers)
    run(
        serve(
            ManagerOptions(
                robot_ip,
                {"robot_ports": ports},
                file,
                controller=controller,
                headless=headless,
                make_ready=make_ready,
            )
        )
    )


async def serve(options: ManagerOptions) -> None:
    """Until it is cancelled."""
    with claim(options.robot_ip, options.rtde_port) as place:
        async with reached(options) as robot:
            running = RunningManager(robot, headless=options.headless)
            running.load_all()
            for note in running.manager.notes:
                typer.echo(f"note: {note}", err=True)
            with real_time(robot.driver.config.realtime):
                async with running.at_work(options), ManagerServer(running, place):
                    await announce(running, options)
                    await asyncio.Event().wait()


def _ask(robot_ip: str, port_offset: int, do: str, **arguments: Any) -> Any:
    """One request to the running manager. Raises NoManagerError, ControllerError."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset).manager() as manager:
            return await manager.ask(do, **arguments)

    return asyncio.run(work())


def _each(robot_ip: str, port_offset: int, do: str, names: Sequence[str], done: str) -> None:
    """The same request for one controller after the other."""
    for name in names:
        _ask(robot_ip, port_offset, do, name=name)
        typer.echo(f"Successfully {done} {name}")


@controllers_app.command("types")
def types_command(robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0, as_json: AsJson = False) -> None:
    """List the available controller types: of the running manager, or those of this program."""
    try:
        found = _ask(robot_ip, port_offset, "list_controller_types")
    except NoManagerError:
        found = available_types()
    if as_json:
        print_json(found)
        return
    table = Table("type", "what it does")
    for name, what in found["types"].items():
        table.add_row(name, what)
    console().print(table)


@controllers_app.command("list")
def list_command(
    controllers: Annotated[
        Path | None, typer.Option("--controllers", help="Check this controllers file, without any manager.")
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="With the interfaces they need.")] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """List the controllers of the running manager; or those of a file, with exit status 1 if any cannot be loaded."""
    if controllers is not None:
        _list_file(controllers, as_json)
        return
    found = _ask(robot_ip, port_offset, "list_controllers")
    if as_json:
        print_json(found)
        return
    if not found:
        typer.echo("No controllers are currently loaded!")
        return
    table = Table("controller", "type", "state", "claimed interfaces", *(("needs",) if verbose else ()))
    for one in found:
        needs = (*one["required_command_interfaces"], *one["required_state_interfaces"])
        row = (one["name"], one["type"], one["state"], in_short(one["claimed_interfaces"]))
        table.add_row(*row, *(("\n".join(needs),) if verbose else ()))
    console().print(table)


def _list_file(path: Path, as_json: bool) -> None:
    """Raises typer.Exit."""
    file = controllers_file(path)
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


@controllers_app.command("load")
def load_command(
    names: _Names,
    controllers: Annotated[
        Path | None,
        typer.Option("--controllers", help="The file that describes them, if it is not that of the manager."),
    ] = None,
    set_state: Annotated[
        SetState | None, typer.Option("--set-state", help="Configure them too, or configure and activate them.")
    ] = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Load controllers into the running manager."""
    file = controllers_file(controllers) if controllers is not None else None
    for name in names:
        given = {} if file is None else {"type": file.type_of(name), "parameters": file.parameters_of(name)}
        for note in _ask(robot_ip, port_offset, "load_controller", name=name, **given)["notes"]:
            typer.echo(f"note: {note}", err=True)
        if set_state is not None:
            _ask(robot_ip, port_offset, "configure_controller", name=name)
        if set_state is SetState.ACTIVE:
            _ask(robot_ip, port_offset, "switch_controller", activate=[name])
        into = f" into state {set_state.value}" if set_state else ""
        typer.echo(f"Successfully loaded controller {name}{into}")


@controllers_app.command("configure")
def configure_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Configure loaded controllers: from unconfigured, or from inactive once more, to inactive."""
    _each(robot_ip, port_offset, "configure_controller", names, "configured")


@controllers_app.command("cleanup")
def cleanup_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Take inactive controllers back to unconfigured."""
    _each(robot_ip, port_offset, "cleanup_controller", names, "cleaned up")


@controllers_app.command("unload")
def unload_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Forget controllers that are not active."""
    _each(robot_ip, port_offset, "unload_controller", names, "unloaded")


@controllers_app.command("activate")
def activate_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Activate inactive controllers together, or none of them."""
    _ask(robot_ip, port_offset, "switch_controller", activate=names)
    typer.echo(f"Successfully activated {', '.join(names)}")


@controllers_app.command("deactivate")
def deactivate_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Deactivate active controllers together, or none of them."""
    _ask(robot_ip, port_offset, "switch_controller", deactivate=names)
    typer.echo(f"Successfully deactivated {', '.join(names)}")


@controllers_app.command("switch")
def switch_command(
    activate: Annotated[
        list[str] | None, typer.Option("--activate", help="Names, with commas between them or one an option.")
    ] = None,
    deactivate: Annotated[list[str] | None, typer.Option("--deactivate", help="Names, in the same way.")] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="All of it or nothing; else those in another state are left out.")
    ] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Deactivate some controllers and activate others, in one control cycle."""
    start, stop = _split(activate), _split(deactivate)
    if not start and not stop:
        raise typer.BadParameter("say what to --activate or --deactivate")
    strictness = STRICT if strict else BEST_EFFORT
    done = _ask(robot_ip, port_offset, "switch_controller", activate=start, deactivate=stop, strictness=strictness)
    wanted = {**dict.fromkeys(start, "activated"), **dict.fromkeys(set(stop) - set(start), "deactivated")}
    for name, word in wanted.items():
        if name not in done[word]:
            typer.echo(f"note: {name} was not {word}: it is not in a state for it", err=True)
    typer.echo("Successfully switched controllers")


def _split(names: Sequence[str] | None) -> list[str]:
    return [name for words in names or () for name in words.replace(",", " ").split()]


@controllers_app.command("parameters")
def parameters_command(
    name: _Name, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0, as_json: AsJson = False
) -> None:
    """List the parameters of a loaded controller."""
    found = _ask(robot_ip, port_offset, "list_parameters", name=name)
    if as_json:
        print_json({key: one["value"] for key, one in found.items()})
        return
    table = Table("parameter", "value", "")
    for key, one in found.items():
        table.add_row(key, json.dumps(one["value"]), "read-only" if one["read_only"] else "")
    console().print(table)


@controllers_app.command("set-parameters")
def set_parameters_command(
    name: _Name,
    assignments: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="constraints.goal_time=0.5")],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Set parameters of a loaded controller, all of them or none; they take effect at once."""
    values = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise typer.BadParameter(f"{assignment!r} is not NAME=VALUE")
        try:
            values[key] = load_yaml(text)
        except NotYaml as error:
            raise typer.BadParameter(f"{text!r} is not a value: {error}") from None
    _ask(robot_ip, port_offset, "set_parameters", name=name, parameters=values)
    typer.echo(f"Successfully set {', '.join(values)} of {name}")


@controllers_app.command("hardware")
def hardware_command(
    set_state: Annotated[
        str | None, typer.Option("--set-state", help="Take the arm to active, inactive or unconfigured first.")
    ] = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """List the running manager's hardware components: the arm."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset).manager() as manager:
            components = await manager.ask("list_hardware_components")
            if set_state is None:
                return components
            name = components[0]["name"]
            await manager.ask("set_hardware_component_state", name=name, state=set_state)
            return await manager.ask("list_hardware_components")

    found = asyncio.run(work())
    if as_json:
        print_json(found)
        return
    table = Table("component", "type", "plugin", "state")
    for one in found:
        table.add_row(one["name"], one["type"], one["plugin_name"], one["state"])
    console().print(table)


@controllers_app.command("interfaces")
def interfaces_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    make_ready: MakeReady = False,
    as_json: AsJson = False,
) -> None:
    """List the interfaces of a robot with their present values, and who claims them."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset, make_ready=make_ready).open() as arm:
            return await arm.ask("list_hardware_interfaces")

    found: list[Any] = asyncio.run(work())
    if as_json:
        print_json(found)
        return
    table = Table("interface", "kind", "value", "claimed by")
    for one in found:
        value = one["value"]
        shown = "" if value is None or value != value else f"{value:g}"
        table.add_row(one["name"], one["kind"], shown, one["claimed_by"])
    console().print(table)


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
