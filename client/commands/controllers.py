"""``ur-client controllers``: what there is, and controllers that run until Ctrl-C."""

from typing import Annotated

import typer
from rich.table import Table

from client.commands.control import ControllersOption, MakeReady, Target, controllers_file, run, watch
from client.commands.options import PortOffset, RobotIP
from client.controllers import types
from client.controllers.controller import CONTROLLER_TYPES
from client.controllers.parameters import Reading, read_parameters
from client.errors import ControllerError
from urproto.commandline import AsJson, application, console, print_json

__all__ = ["controllers_app"]

controllers_app = application("Controllers as of ros2_control.", completion=False, no_args_is_help=True)


@controllers_app.command("types")
def types_command(as_json: AsJson = False) -> None:
    """List the types of controllers there are."""
    if as_json:
        known = {name: types.help_of(kind) for name, kind in sorted(CONTROLLER_TYPES.items())}
        print_json({"types": known, "refused": types.REFUSED})
        return
    table = Table("type", "what it does")
    for name in sorted(CONTROLLER_TYPES):
        table.add_row(name, types.help_of(CONTROLLER_TYPES[name]))
    for name, instead in types.REFUSED.items():
        table.add_row(name, f"not had here: {instead}")
    console().print(table)


@controllers_app.command("list")
def list_command(controllers: ControllersOption = None, as_json: AsJson = False) -> None:
    """List the controllers of a file, and say what in it is not understood: status 1 if any cannot be loaded."""
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
    names: Annotated[list[str], typer.Argument(help="Controllers of the file, to be activated together.")],
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
        found = types.find(name, kind)
        assert isinstance(parameters, dict)
        read = read_parameters(found.parameters_type, parameters, name, reading)
        found(name, read, 1.0).on_configure()
    except ControllerError as error:
        return [error.reason], False
    unknown = [f"{key} is not known: it is ignored" for key in reading.unknown]
    return [*unknown, *(f"{key} has no effect" for key in reading.without_effect)], True
