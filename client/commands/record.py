"""``ur-client record``, ``stream`` and ``convert``: a robot's states into files and onto screens."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer

from client import rtde
from client.commands.describe import model_of_robot
from client.commands.following import Interrupts, Sink, follow
from client.commands.options import PortOffset, RobotIP
from client.connection import DEFAULT_TIMEOUT_S
from client.errors import ClientError, RecordingError
from client.recording import live
from client.recording.files import Recorder, Writer, convert, field_names, read, told
from client.recording.live import (
    FOXGLOVE_PORT,
    PLOTJUGGLER_PORT,
    PLOTJUGGLER_WEBSOCKET_PORT,
    FoxgloveServer,
    address_of,
)
from client.recording.recording import Recording
from client.recording.stamps import Stamps
from urproto.errors import ProtocolError, RobotRefused
from urproto.robots.description import urdf as urdf_of

__all__ = ["Overwrite", "check_free", "convert_command", "read_telling", "record_command", "stream_command"]

_STREAM_HZ: Final = 50.0  # more than a screen shows

Fields: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--fields", help="RTDE outputs, with commas or repeated; default stands for the usual ones."),
]
Duration: TypeAlias = Annotated[
    float | None, typer.Option("--duration", min=0.0, help="How long, by the robot's clock [s]; else until Ctrl-C.")
]
Overwrite: TypeAlias = Annotated[bool, typer.Option("--overwrite", help="Replace the file if it is there.")]


def record_command(
    file: Annotated[Path, typer.Argument(help="Where to: .mcap (ROS 2, PlotJuggler, Foxglove), .csv or .npz.")],
    fields: Fields = None,
    frequency: Annotated[
        float | None, typer.Option("--frequency", help="How often a second; the robot's full rate without it.")
    ] = None,
    duration: Duration = None,
    overwrite: Overwrite = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Record what a robot does, until Ctrl-C."""
    names = _chosen(fields)
    check_free(file, overwrite)
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        robot = _connect(opened, interrupts, robot_ip, port_offset, names, frequency)
        info = {"robot": robot_ip, "polyscope": str(robot.core.version), "rate_hz": f"{robot.core.rate_hz:g}"}
        recorder = opened.enter_context(Recorder(file, names, info))
        typer.echo(f"recording {_what(robot, names)} into {file}. Ctrl-C ends it.", err=True)
        follow(robot, [recorder.write], interrupts, duration)
    typer.echo(f"{file}: {recorder.count} states")
    if recorder.left_out:
        typer.echo(f"note: {recorder.left_out} states of the robot had no time (timestamp) and were left out", err=True)


def stream_command(
    plotjuggler: Annotated[
        str | None,
        typer.Option(
            "--plotjuggler",
            help=f"Its UDP server, udp://127.0.0.1:{PLOTJUGGLER_PORT}, or its WebSocket server, "
            f"ws://127.0.0.1:{PLOTJUGGLER_WEBSOCKET_PORT}; protocol json.",
        ),
    ] = None,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Let Foxglove connect (see --listen).")] = False,
    listen: Annotated[
        str, typer.Option("--listen", help="Where Foxglove connects to.")
    ] = f"ws://127.0.0.1:{FOXGLOVE_PORT}",
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf", help="For Foxglove's 3D panel; without it the robot is asked.", exists=True, dir_okay=False
        ),
    ] = None,
    fields: Fields = None,
    frequency: Annotated[float, typer.Option("--frequency", help="How often a second.")] = _STREAM_HZ,
    duration: Duration = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Show what a robot does in PlotJuggler or Foxglove while it does it, until Ctrl-C."""
    if not plotjuggler and not foxglove:
        raise typer.BadParameter("say where to: --plotjuggler udp://127.0.0.1:9870, --foxglove, or both")
    names = _chosen(fields)
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        robot = _connect(opened, interrupts, robot_ip, port_offset, names, frequency)
        writers: list[Writer] = []
        if plotjuggler:
            writers.append(live.plotjuggler(plotjuggler))
        if foxglove:
            description = _text(urdf) if urdf else _described(robot_ip, port_offset)
            server = FoxgloveServer(names, *address_of(listen, "ws", FOXGLOVE_PORT), description)
            writers.append(server)
            typer.echo(f"Foxglove: open a connection to {listen.rpartition(':')[0]}:{server.port}", err=True)
        for writer in writers:
            opened.callback(writer.close)
        typer.echo(f"streaming {_what(robot, names)}. Ctrl-C ends it.", err=True)
        follow(robot, _stamped(writers), interrupts, duration)


def convert_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    target: Annotated[Path, typer.Argument(help="Where to, in the format of its suffix.")],
    overwrite: Overwrite = False,
) -> None:
    """Write a recording in another format."""
    check_free(target, overwrite)
    recording = convert(file, target)
    _tell(file, recording)
    typer.echo(f"{target}: {len(recording)} states of {len(recording.values)} variables")
    if recording.controllers:
        typer.echo(f"without what controllers told ({', '.join(recording.controllers)}): it stays in {file}", err=True)


def read_telling(path: Path) -> Recording:
    """A recording; it is told when it is damaged or has no proper end."""
    recording = read(path)
    _tell(path, recording)
    return recording


def _tell(path: Path, recording: Recording) -> None:
    if what := told(recording.info):
        typer.echo(f"note: {path}: {'; '.join(what)}; the {len(recording)} states that are left count", err=True)


def check_free(path: Path, overwrite: bool) -> None:
    """Refuse to write over a file unless that was asked for."""
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} is there already: choose another name, or --overwrite")


def _chosen(fields: Sequence[str] | None) -> tuple[str, ...]:
    parts = [name.strip() for part in fields or ["default"] for name in part.split(",")]
    return field_names(name for name in parts if name)


def _connect(
    opened: ExitStack,
    interrupts: Interrupts,
    robot_ip: str,
    port_offset: int,
    names: Sequence[str],
    frequency_hz: float | None,
) -> rtde.BlockingRTDEClient:
    timeout_s = DEFAULT_TIMEOUT_S + (2.0 / frequency_hz if frequency_hz and frequency_hz > 0.0 else 0.0)
    robot = rtde.BlockingRTDEClient(
        robot_ip, names, frequency_hz=frequency_hz, port=rtde.PORT + port_offset, timeout_s=timeout_s
    )
    connected: rtde.BlockingRTDEClient = interrupts.wait(lambda: opened.enter_context(robot))
    return connected


def _what(robot: rtde.BlockingRTDEClient, names: Sequence[str]) -> str:
    rate = f"{robot.core.rate_hz:g} times a second"
    return f"{len(names)} variables of {robot.host} (PolyScope {robot.core.version}) {rate}"


def _stamped(writers: Sequence[Writer]) -> list[Sink]:
    stamps = Stamps()

    def write(values: Any) -> None:
        if (time_ns := stamps.of(values["timestamp"])) is not None:
            for writer in writers:
                writer.write(values, time_ns)

    return [write]


def _described(robot_ip: str, port_offset: int) -> str | None:
    """The robot's URDF; None, and it is told why, where it cannot be had: everything else works without."""
    try:
        return urdf_of(model_of_robot(robot_ip, port_offset))
    except (ClientError, ProtocolError, RobotRefused) as error:
        typer.echo(f"no arm in Foxglove's 3D panel: {error}", err=True)
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path} is no text: {error}") from error
