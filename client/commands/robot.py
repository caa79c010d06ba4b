"""``ur-client dashboard``, ``state``, ``send``, ``watch``, ``calibration`` and ``tool-comm``."""

import asyncio
import json
import signal
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.live import Live
from rich.table import Table

from client import dashboard, primary, rtde
from client.calibration import calibration_of, is_nominal, write_calibration
from client.commands.following import Interrupts, PortOffset, RobotIP, Sink, connect, follow
from client.dashboard_commands import WORDS, checked_command
from client.decoding import formatting
from client.errors import ClientError, FileError
from client.rtde import unknown_fields
from client.scripts import is_secondary
from client.tool_communication import PORT, ToolCommunication
from urproto.commandline import AsJson, completing, console, plain_json, print_json
from urproto.errors import RobotRefused
from urproto.modes import MODE_OUTPUTS, mode_name
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.text import from_bytes
from urproto.versions import PolyscopeVersion

_REFUSED = 1  # exit status
_DRAWN_HZ = 10.0  # redraws of the table: faster ones cannot be read
_STOP = "ur-client dashboard stop"
_STATE = (
    "timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction",
    "actual_q", "actual_qd", "actual_TCP_pose",
)  # fmt: skip


def tool_comm_command(
    device: Annotated[Path, typer.Option(help="Path of the serial device to create.")] = Path("/tmp/ttyUR"),
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Provide the serial line at the robot's tool (e-Series) as a device on this machine, until Ctrl-C."""
    asyncio.run(_serve(ToolCommunication(robot_ip, PORT + port_offset, device, typer.echo)))


async def _serve(line: ToolCommunication) -> None:
    loop = asyncio.get_running_loop()
    async with line:
        running = loop.create_task(line.run())
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, running.cancel)
        typer.echo(f"{line.device} is the tool of {line.host}:{line.port}. Ctrl-C ends it.")
        await asyncio.wait([running])
    if not running.cancelled():
        running.result()


def calibration_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    output: Annotated[Path, typer.Option("--output", "-o", help="The YAML file to write.")] = Path(
        "my_robot_calibration.yaml"
    ),
) -> None:
    """Save the robot's calibration in the format of ur_description."""
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as client:
        calibration = calibration_of(client.run(client.core.kinematics_info()))
        nominal = is_nominal(calibration, client.run(client.core.configuration_data()))
    write_calibration(output, calibration)
    typer.echo(f"{output}: {calibration.hash}" + (", nominal: this arm has no deviations" if nominal else ""))


def send_command(
    file: Annotated[Path, typer.Argument(help="A URScript file.", exists=True, dir_okay=False)],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the program ends.")] = False,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Send nothing if urscript check refuses it.")
    ] = True,
) -> None:
    """Send a script and wait until it runs. Exit status 1 if it is not URScript, or if an error or a stop ends it.

    The script is checked first, for the robot's version. --no-check leaves that to the robot, which may know functions
    of its URCaps. With --wait, the program writes one more line to the robot's log, which distinguishes its regular
    end from a stop. Programs that use halt or return do not get that line.
    """
    text = from_bytes(file.read_bytes())
    if "\0" in text:
        raise FileError(file, "is not text")
    if wait and is_secondary(text):
        raise typer.BadParameter("a controller does not report the end of a secondary program: leave out --wait")
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as client:
        if check:
            _check(file, text, client.run(client.core.polyscope_version()))
        if is_secondary(text):
            client.run(client.core.send_secondary(text))
            typer.echo(f"sent {file}")
            return
        run = client.run(client.core.start(text, require_end=wait))
        typer.echo(f"{run.script.name} is running")
        if wait:
            try:
                client.run(client.core.finish(run), float("inf"))
            except KeyboardInterrupt:
                where = f"--robot-ip {robot_ip}" + (f" --port-offset {port_offset}" if port_offset else "")
                typer.echo(f"\n{run.script.name} continues on the robot; to stop it: {_STOP} {where}", err=True)
                raise
            typer.echo(f"{run.script.name} has ended")


def _check(file: Path, text: str, version: PolyscopeVersion) -> None:
    """Print the warnings about a script. Raises ClientError with its first error."""
    from client.programs import script_problems  # imports the program trees, which other commands do not need

    for problem in script_problems(text, version):
        place = f"{file}:{problem.line}:{problem.column}: {'warning: ' if problem.warning else ''}{problem.message}"
        if not problem.warning:
            raise ClientError(f"{place}: nothing was sent; --no-check sends it unchecked")
        typer.echo(place, err=True)


def dashboard_command(
    line: Annotated[
        str,
        typer.Argument(help='A dashboard command, for example "power on".', autocompletion=completing(lambda: WORDS)),
    ],
    as_json: AsJson = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Send one dashboard command and print the answer. Exit status 1 if it is unknown, refused or fails."""
    with dashboard.BlockingDashboardClient(robot_ip, dashboard.PORT + port_offset) as client:
        try:
            answer, done = client.request(checked_command(line)), True
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


def watch_command(
    fields: Annotated[
        list[str],
        typer.Argument(
            help="RTDE outputs, for example actual_q robot_mode.", autocompletion=completing(lambda: OUTPUT_FIELDS)
        ),
    ],
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    rate: Annotated[float, typer.Option(help="States per second to request from the robot.")] = 10.0,
    plain: Annotated[bool, typer.Option("--plain", help="Print lines instead of a table, even on a terminal.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print every state as a line of JSON.")] = False,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Also write every state to this file.")] = None,
) -> None:
    """Show RTDE outputs of a robot as they change, until Ctrl-C."""
    if problem := unknown_fields(fields):
        raise typer.BadParameter(problem)
    names = list(dict.fromkeys(fields))
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        client = connect(opened, interrupts, robot_ip, port_offset, names, rate)
        sinks = [_csv_sink(csv_file, names, opened)] if csv_file else []
        lines = _json_lines if as_json else _lines
        in_table = sys.stdout.isatty() and not (plain or as_json)
        sinks.append(_live_table(client, opened) if in_table else lines)
        follow(client, sinks, interrupts)


def _lines(state: Mapping[str, Any]) -> None:
    print(formatting.pairs(state.items()), flush=True)


def _json_lines(state: Mapping[str, Any]) -> None:
    print(json.dumps(plain_json(state)), flush=True)


def _live_table(client: rtde.BlockingRTDEClient, opened: ExitStack) -> Sink:
    live = opened.enter_context(Live(console=console(), auto_refresh=False))
    each = max(1, round(client.core.rate_hz / _DRAWN_HZ))
    count = 0

    def draw(state: Mapping[str, Any]) -> None:
        nonlocal count
        count += 1
        if count % each == 0:
            live.update(state_table(state, f"{client.host}, PolyScope {client.core.version}"), refresh=True)

    return draw


def state_table(state: Mapping[str, Any], title: str) -> Table:
    """A row for each variable, a column for each element of the longest vector."""
    rows = {name: value if isinstance(value, tuple) else (value,) for name, value in state.items()}
    width = max(map(len, rows.values()), default=1)
    table = Table("variable", title=title)
    for index in range(width):
        table.add_column(str(index) if width > 1 else "value", justify="right")
    table.add_column("unit")
    for name, values in rows.items():
        cells = [_format_cell(name, value) for value in values] + [""] * (width - len(values))
        table.add_row(name, *cells, OUTPUT_FIELDS[name].unit)
    return table


def _format_cell(name: str, value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else formatting.value(value, name)


def _csv_sink(path: Path, names: list[str], opened: ExitStack) -> Sink:
    from client.recording.tables import CsvWriter  # imports numpy, which a table on the screen does not need

    try:
        writer = CsvWriter(path, names)
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror}") from error
    opened.callback(writer.close)
    return writer.write


def state_command(as_json: AsJson = False, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Print the robot's current state: modes, joints and TCP pose."""
    with rtde.BlockingRTDEClient(robot_ip, _STATE, port=rtde.PORT + port_offset) as client:
        state = client.receive()
        version = client.core.version
    if as_json:
        modes = {name: mode_name(MODE_OUTPUTS[name], state[name]) for name in MODE_OUTPUTS}
        print_json({"robot_ip": robot_ip, "polyscope": str(version), **state, **modes})
        return
    rows = [(name, _readable(name, value), OUTPUT_FIELDS[name].unit) for name, value in state.items()]
    title = f"{robot_ip}, PolyScope {version}"
    if not sys.stdout.isatty():
        typer.echo("\n".join([title, *(f"{name}: {text} {unit}".rstrip() for name, text, unit in rows)]))
        return
    table = Table("variable", "value", "unit", title=title)
    for row in rows:
        table.add_row(*row)
    console().print(table)


def _readable(name: str, value: Any) -> str:
    if name in MODE_OUTPUTS:
        return mode_name(MODE_OUTPUTS[name], value)
    numbers = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{number:.4f}" for number in numbers)
