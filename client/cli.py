"""``ur-client``: the everyday things, from a terminal, against any robot or emulator."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from client import dashboard, primary, rtde
from client.commands.calibration import calibration_command
from client.commands.compare import compare_command
from client.commands.controllers import controllers_app
from client.commands.decode import decode_command
from client.commands.describe import describe_command
from client.commands.doctor import doctor_command
from client.commands.goal import goal_command, publish_goals_command
from client.commands.options import PortOffset, RobotIP
from client.commands.plot import plot_command
from client.commands.proxy import proxy_command
from client.commands.record import convert_command, record_command, stream_command
from client.commands.replay import replay_command
from client.commands.replay_traffic import replay_traffic_command
from client.commands.ros2_bridge import ros2_bridge_command
from client.commands.tool_comm import tool_comm_command
from client.commands.watch import watch_command
from client.errors import ClientError
from urproto.errors import ProtocolError, RobotRefused
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots import CalibrationError
from urproto.rtde.fields import OUTPUT_FIELDS

__all__ = ["app", "main"]

app = typer.Typer(help=__doc__, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)

_STATE = (
    "timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction",
    "actual_q", "actual_qd", "actual_TCP_pose",
)  # fmt: skip
_NAMES = {"robot_mode": RobotMode, "safety_mode": SafetyMode, "runtime_state": RuntimeState}
_MAIN_PROGRAM = "def "  # only such programs report that they started


@app.command("dashboard")
def dashboard_command(
    line: Annotated[str, typer.Argument(help='A dashboard command, for example "power on".')],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Send one dashboard command and print the answer."""
    with dashboard.BlockingDashboardClient(robot_ip, dashboard.PORT + port_offset) as robot:
        typer.echo(robot.ask(dashboard.command(line)))


@app.command("state")
def state_command(robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Print what the robot is doing right now."""
    with rtde.BlockingRTDEClient(robot_ip, _STATE, port=rtde.PORT + port_offset) as robot:
        state = robot.receive()
        version = robot.core.version
    table = Table("variable", "value", "unit", title=f"{robot_ip}, PolyScope {version}")
    for name, value in state.items():
        table.add_row(name, _readable(name, value), OUTPUT_FIELDS[name].unit)
    Console(width=100).print(table)


@app.command("send")
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


app.command("decode")(decode_command)
app.command("watch")(watch_command)
app.command("goal")(goal_command)
app.command("publish-goals")(publish_goals_command)
app.add_typer(controllers_app, name="controllers")
app.command("record")(record_command)
app.command("stream")(stream_command)
app.command("convert")(convert_command)
app.command("plot")(plot_command)
app.command("replay")(replay_command)
app.command("calibration")(calibration_command)
app.command("describe")(describe_command)
app.command("doctor")(doctor_command)
app.command("tool-comm")(tool_comm_command)
app.command("proxy")(proxy_command)
app.command("ros2-bridge")(ros2_bridge_command)
app.command("replay-traffic")(replay_traffic_command)
app.command("compare")(compare_command)


def _readable(name: str, value: Any) -> str:
    if name in _NAMES:
        return _NAMES[name](value).name
    numbers = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{number:.4f}" for number in numbers)


def main() -> None:
    """Entry point of ``ur-client``: errors are one line, exit status 1."""
    try:
        app()
    except (ClientError, CalibrationError, ProtocolError, RobotRefused, UnicodeDecodeError) as error:
        typer.echo(f"ur-client: {error}", err=True)
        sys.exit(1)
