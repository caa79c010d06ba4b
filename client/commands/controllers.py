"""``ur-client controllers``: run a controller manager, and manage its controllers from other shells."""

import asyncio
import json
from collections.abc import Iterable, Sequence
from enum import Enum
from math import isnan
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from rich.table import Table

from client.commands.control import (
    ControllersOption,
    Headless,
    InitialController,
    MakeReady,
    Target,
    announce,
    controllers_file,
    run,
)
from client.commands.following import PortOffset, RobotIP
from client.controllers import configuration
from client.controllers.controller import interface_summary
from client.controllers.parameters import Reading, read_parameters
from client.controllers.running import ManagerOptions, RunningManager, reached
from client.controllers.serving import ManagerServer, claim
from client.controllers.session import BEST_EFFORT, STRICT, available_types
from client.driver.config import robot_ports
from client.driver.scheduling import real_time
from client.errors import ControllerError, NoManagerError
from urproto.commandline import AsJson, application, console, print_json
from urproto.structures import InvalidYamlError, load_yaml


class SetState(Enum):
    """State to take a loaded controller to, as in `ros2 control load_controller --set-state`."""

    INACTIVE = "inactive"
    ACTIVE = "active"


controllers_app = application(
    "Run a ros2_control controller manager, and manage its controllers from other shells.",
    completion=False,
    no_args_is_help=True,
)

_Names: TypeAlias = Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of controllers.")]
_Name: TypeAlias = Annotated[str, typer.Argument(help="Name of a controller.")]


@controllers_app.command("serve")
def serve_command(
    controllers: ControllersOption = None,
    controller: InitialController = None,
    headless: Headless = True,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Run a controller manager for other shells and the pendant, until Ctrl-C."""
    ports = robot_ports(port_offset)
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
    with claim(options.robot_ip, options.rtde_port) as place:
        async with reached(options) as control:
            running = RunningManager(control, headless=options.headless)
            running.load_all()
            for note in running.manager.notes:
                typer.echo(f"note: {note}", err=True)
            with real_time(control.driver.config.realtime):
                async with running.at_work(options), ManagerServer(running, place):
                    await announce(running, options)
                    await asyncio.Event().wait()


def _request(robot_ip: str, port_offset: int, do: str, **arguments: Any) -> Any:
    """Send one request to the running manager. Raises NoManagerError, ControllerError."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset).manager() as manager:
            return await manager.request(do, **arguments)

    return asyncio.run(work())


def _request_for_each(robot_ip: str, port_offset: int, do: str, names: Sequence[str], done: str) -> None:
    for name in names:
        _request(robot_ip, port_offset, do, name=name)
        typer.echo(f"Successfully {done} {name}")


@controllers_app.command("types")
def types_command(robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0, as_json: AsJson = False) -> None:
    """List the controller types of the running manager or, without one, of this program."""
    try:
        found = _request(robot_ip, port_offset, "list_controller_types")
    except NoManagerError:
        found = available_types()
    _print(found, as_json, ("type", "what it does"), found["types"].items())


@controllers_app.command("list")
def list_command(
    controllers: Annotated[
        Path | None, typer.Option(help="List and check this controllers file; needs no manager.")
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Also list the interfaces they need.")] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """List the running manager's controllers, or those of a file. Exit status 1 if one in the file cannot be loaded."""
    if controllers is not None:
        _list_file(controllers, as_json)
        return
    found = _request(robot_ip, port_offset, "list_controllers")
    if not (found or as_json):
        typer.echo("No controllers are currently loaded!")
        return
    rows = [
        (
            *(one[column] for column in ("name", "type", "state")),
            interface_summary(one["claimed_interfaces"]),
            "\n".join((*one["required_command_interfaces"], *one["required_state_interfaces"])),
        )
        for one in found
    ]
    headings = ("controller", "type", "state", "claimed interfaces", "needs")
    columns = slice(None if verbose else -1)
    _print(found, as_json, headings[columns], (row[columns] for row in rows))


def _list_file(path: Path, as_json: bool) -> None:
    """Raises typer.Exit."""
    file = controllers_file(path)
    rows = [(name, kind, *_notes(name, kind, file.parameters_of(name))) for name, kind in file.types.items()]
    found = [{"name": name, "type": kind, "notes": notes, "fine": fine} for name, kind, notes, fine in rows]
    cells = ((name, kind, "\n".join(notes)) for name, kind, notes, _ in rows)
    _print(found, as_json, ("controller", "type", "notes"), cells, file.name)
    if not all(fine for *_, fine in rows):
        raise typer.Exit(1)


@controllers_app.command("load")
def load_command(
    names: _Names,
    controllers: Annotated[
        Path | None,
        typer.Option(help="File with their types and parameters, if it is not the manager's."),
    ] = None,
    set_state: Annotated[
        SetState | None,
        typer.Option(help="Also configure them (inactive), or configure and activate them (active)."),
    ] = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Load controllers into the running manager."""
    file = controllers_file(controllers) if controllers is not None else None
    for name in names:
        given = {} if file is None else {"type": file.type_of(name), "parameters": file.parameters_of(name)}
        for note in _request(robot_ip, port_offset, "load_controller", name=name, **given)["notes"]:
            typer.echo(f"note: {note}", err=True)
        if set_state is not None:
            _request(robot_ip, port_offset, "configure_controller", name=name)
        if set_state is SetState.ACTIVE:
            _request(robot_ip, port_offset, "switch_controller", activate=[name])
        into = f" into state {set_state.value}" if set_state else ""
        typer.echo(f"Successfully loaded controller {name}{into}")


@controllers_app.command("configure")
def configure_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Configure loaded controllers: from unconfigured to inactive, or inactive ones once more."""
    _request_for_each(robot_ip, port_offset, "configure_controller", names, "configured")


@controllers_app.command("cleanup")
def cleanup_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Take inactive controllers back to unconfigured."""
    _request_for_each(robot_ip, port_offset, "cleanup_controller", names, "cleaned up")


@controllers_app.command("unload")
def unload_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Unload controllers that are not active."""
    _request_for_each(robot_ip, port_offset, "unload_controller", names, "unloaded")


@controllers_app.command("activate")
def activate_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Activate inactive controllers: all of them in the same cycle, or none."""
    _request(robot_ip, port_offset, "switch_controller", activate=names)
    typer.echo(f"Successfully activated {', '.join(names)}")


@controllers_app.command("deactivate")
def deactivate_command(names: _Names, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Deactivate active controllers: all of them in the same cycle, or none."""
    _request(robot_ip, port_offset, "switch_controller", deactivate=names)
    typer.echo(f"Successfully deactivated {', '.join(names)}")


@controllers_app.command("switch")
def switch_command(
    activate: Annotated[
        list[str] | None, typer.Option(help="Names of controllers, comma-separated or repeated.")
    ] = None,
    deactivate: Annotated[list[str] | None, typer.Option(help="Names of controllers, likewise.")] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Switch all or none; without it, controllers in another state are skipped.")
    ] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Activate some controllers and deactivate others in the same control cycle."""
    start, stop = _split(activate), _split(deactivate)
    if not start and not stop:
        raise typer.BadParameter("nothing to switch: give --activate or --deactivate, or both")
    strictness = STRICT if strict else BEST_EFFORT
    done = _request(robot_ip, port_offset, "switch_controller", activate=start, deactivate=stop, strictness=strictness)
    requested = {**dict.fromkeys(start, "activated"), **dict.fromkeys(set(stop) - set(start), "deactivated")}
    for name, word in requested.items():
        if name not in done[word]:
            typer.echo(f"note: {name} was not {word}: its state does not allow it", err=True)
    typer.echo("Successfully switched controllers")


def _split(names: Sequence[str] | None) -> list[str]:
    return [name for words in names or () for name in words.replace(",", " ").split()]


@controllers_app.command("parameters")
def parameters_command(
    name: _Name, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0, as_json: AsJson = False
) -> None:
    """List the parameters of a loaded controller."""
    found = _request(robot_ip, port_offset, "list_parameters", name=name)
    values = {key: one["value"] for key, one in found.items()}
    rows = ((key, json.dumps(values[key]), "read-only" if one["read_only"] else "") for key, one in found.items())
    _print(values, as_json, ("parameter", "value", ""), rows)


@controllers_app.command("set-parameters")
def set_parameters_command(
    name: _Name,
    assignments: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME=VALUE...", help="Parameters and their new values, for example constraints.goal_time=0.5."
        ),
    ],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Set parameters of a loaded controller, all of them or none; they take effect immediately."""
    values = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise typer.BadParameter(f"{assignment!r} is not NAME=VALUE")
        try:
            values[key] = load_yaml(text)
        except InvalidYamlError as error:
            raise typer.BadParameter(f"{key}: {text!r} is not a YAML value: {error}") from None
    _request(robot_ip, port_offset, "set_parameters", name=name, parameters=values)
    typer.echo(f"Successfully set {', '.join(values)} of {name}")


@controllers_app.command("hardware")
def hardware_command(
    set_state: Annotated[
        str | None, typer.Option(help="First set the arm's state: active, inactive or unconfigured.")
    ] = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """List the running manager's hardware components, which is the arm alone."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset).manager() as manager:
            components = await manager.request("list_hardware_components")
            if set_state is None:
                return components
            name = components[0]["name"]
            await manager.request("set_hardware_component_state", name=name, state=set_state)
            return await manager.request("list_hardware_components")

    found = asyncio.run(work())
    rows = ([one[column] for column in ("name", "type", "plugin_name", "state")] for one in found)
    _print(found, as_json, ("component", "type", "plugin", "state"), rows)


@controllers_app.command("interfaces")
def interfaces_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    make_ready: MakeReady = False,
    as_json: AsJson = False,
) -> None:
    """List the interfaces of a robot, their current values and the controllers that claim them."""

    async def work() -> Any:
        async with Target(robot_ip, port_offset, make_ready=make_ready).open() as arm:
            return await arm.request("list_hardware_interfaces")

    found: list[Any] = asyncio.run(work())
    rows = ((one["name"], one["kind"], _format(one["value"]), one["claimed_by"]) for one in found)
    _print(found, as_json, ("interface", "kind", "value", "claimed by"), rows)


def _format(value: float | None) -> str:
    return "" if value is None or isnan(value) else f"{value:g}"


def _print(
    found: Any, as_json: bool, headings: Sequence[str], rows: Iterable[Iterable[str]], title: str | None = None
) -> None:
    if as_json:
        print_json(found)
        return
    table = Table(*headings, title=title)
    for row in rows:
        table.add_row(*row)
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
    unknown = [f"{key} is unknown and ignored" for key in reading.unknown]
    return [*unknown, *(f"{key} has no effect" for key in reading.without_effect)], True
