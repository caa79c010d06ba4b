"""``ur-client dashboard``: one command of the dashboard server."""

from typing import Annotated

import typer

from client import dashboard
from client.commands.options import PortOffset, RobotIP
from client.operations import WORDS, judged
from urproto.commandline import AsJson, completing, print_json
from urproto.errors import RobotRefused

__all__ = ["dashboard_command"]

_REFUSED = 1


def dashboard_command(
    line: Annotated[
        str,
        typer.Argument(help='A dashboard command, for example "power on".', autocompletion=completing(lambda: WORDS)),
    ],
    as_json: AsJson = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Send one dashboard command and print the answer. Status 1 when the robot does not know it, refuses or fails."""
    with dashboard.BlockingDashboardClient(robot_ip, dashboard.PORT + port_offset) as robot:
        try:
            answer, done = robot.ask(judged(line)), True
        except RobotRefused as refusal:
            if not as_json:
                raise
            answer, done = refusal.answer, False
    if not as_json:
        typer.echo(answer)
        return
    print_json({"command": line, "answer": answer, "done": done})
    if not done:
        raise typer.Exit(_REFUSED)
