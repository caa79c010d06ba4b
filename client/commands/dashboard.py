"""``ur-client dashboard``: one command of the dashboard server."""

from typing import Annotated

import typer

from client import dashboard
from client.commands.options import PortOffset, RobotIP

__all__ = ["dashboard_command"]


def dashboard_command(
    line: Annotated[str, typer.Argument(help='A dashboard command, for example "power on".')],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Send one dashboard command and print the answer."""
    with dashboard.BlockingDashboardClient(robot_ip, dashboard.PORT + port_offset) as robot:
        typer.echo(robot.ask(dashboard.command(line)))
