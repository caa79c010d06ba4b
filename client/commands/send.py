"""``ur-client send``: a script to a robot."""

from pathlib import Path
from typing import Annotated

import typer

from client import primary
from client.commands.options import PortOffset, RobotIP

__all__ = ["send_command"]

_MAIN_PROGRAM = "def "  # only such programs report that they started


def send_command(
    file: Annotated[Path, typer.Argument(help="A URScript file.", exists=True, dir_okay=False)],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the program ends.")] = False,
) -> None:
    """Send a script; a program is waited for until it runs."""
    text = file.read_text("utf-8")
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as robot:
        if not text.lstrip().startswith(_MAIN_PROGRAM):
            robot.run(robot.core.send_script(text))
            typer.echo(f"sent {file}")
            return
        typer.echo(f"{robot.run(robot.core.run_script(text))} is running")
        if wait:
            name = robot.run(robot.core.wait_until_stopped(), float("inf"))
            typer.echo(f"{name} has ended")
