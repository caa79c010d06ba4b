"""``ur-client controllers``: what there is, and controllers that run until Ctrl-C."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from client.commands.control import ControllersOption, MakeReady, Target, controllers_file, run, watch
from client.commands.options import PortOffset, RobotIP
from client.controllers import types
from client.controllers.controller import CONTROLLER_TYPES
from client.controllers.parameters import Reading, read_parameters
from client.errors import ControllerError

__all__ = ["controllers_app"]

controllers_app = typer.Typer(help="Controllers as of ros2_control.", no_args_is_help=True, rich_markup_mode=None)
_WIDTH = 120


@controllers_app.command("types")
def types_command() -> None:
    """List the types of controllers there are."""
    table = Table("type", "what it does")
    for name in sorted(CONTROLLER_TYPES):
        table.add_row(name, types.help_of(CONTROLLER_TYPES[name]))
    for name, instead in types.REFUSED.items():
        table.add_row(name, f"not had here: {instead}")
    Console(width=_WIDTH).print(table)


@controllers_app.command("list")
def list_command(controllers: ControllersOption = None) -> None:
    """List the controllers of a file, and say what in it is not understood: status 1 if any cannot be loaded."""
    file = controllers_file(controllers)
    table = Table("controller", "type", "notes", title=file.name)
    broken = False
    for name, kind in file.types.items():
        notes, fine = _notes(name, kind, file.parameters_of(name))
        broken = broken or not fine
        table.add_row(name, kind, "\n".join(notes))
    Console(width=_WIDTH).print(table)
    if broken:
        raise typer.Exit(1)


@controllers_app.command("interfaces")
def interfaces_command(
    robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0, make_ready: MakeReady = False
) -> None:
    """List the interfaces of a robot with their present values."""

    async def work() -> None:
        async with Target(robot_ip, port_offset, make_ready=make_ready).open() as loop:
            hardware = loop.manager.hardware
            table = Table("interface", "kind", "value")
            for info in loop.manager.list_interfaces():
                value = (hardware.commands if info.kind == "command" else hardware.states)[info.name]
                table.add_row(info.name, info.kind, "" if value != value else f"{value:g}")
        Console(width=_WIDTH).print(table)

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
