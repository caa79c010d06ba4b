"""``ur-client send``: a script to a robot."""

from pathlib import Path
from typing import Annotated

import typer

from client import primary
from client.commands.options import PortOffset, RobotIP
from client.errors import FileError
from client.scripts import is_secondary

__all__ = ["send_command"]


def send_command(
    file: Annotated[Path, typer.Argument(help="A URScript file.", exists=True, dir_okay=False)],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the program ends.")] = False,
) -> None:
    """Send a script and wait until it runs. Status 1 when it is no URScript, or when an error or a stop ends it.

    With --wait the robot's log has a line more, by which the end of the program is told from a stop; programs that use
    halt or return go without.
    """
    try:
        text = file.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(file, f"is no text: {error}") from error
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as robot:
        if is_secondary(text):
            if wait:
                raise typer.BadParameter("a controller does not report the end of a sec program: leave --wait out")
            robot.run(robot.core.send_secondary(text))
            typer.echo(f"sent {file}")
            return
        run = robot.run(robot.core.start(text, to_its_end=wait))
        typer.echo(f"{run.script.name} is running")
        if wait:
            robot.run(robot.core.finish(run), float("inf"))
            typer.echo(f"{run.script.name} has ended")
