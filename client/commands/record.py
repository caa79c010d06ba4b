"""``ur-client record``, ``stream``, ``convert``, ``plot``, ``replay`` and ``describe``: recordings and live data."""

import asyncio
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer

from client import rtde
from client.calibration import read_calibration
from client.cameras import Shot
from client.commands.cameras import DEFAULT_HZ, CameraNames, CameraOptions, CameraPort, CameraRate, follow_cameras
from client.commands.following import INTERRUPTED, Interrupts, PortOffset, ProgressBar, RobotIP, Sink, connect, follow
from client.commands.scene_drawing import DrawnServer, model_of_robot, scene_drawing
from client.controllers.remote import check_no_manager
from client.driver.config import robot_ports
from client.errors import ClientError, FileError, RecordingError
from client.recording import live
from client.recording.files import Recorder, Writer, convert, field_names, read, remarks
from client.recording.live import (
    FOXGLOVE_PORT,
    PLOTJUGGLER_PORT,
    PLOTJUGGLER_WEBSOCKET_PORT,
    FoxgloveServer,
    address_of,
)
from client.recording.motion import JointPath, joint_path
from client.recording.plots import deviations, draw
from client.recording.recording import Recording
from client.recording.timestamps import Stamps
from client.robot import Robot
from urproto.addresses import is_loopback
from urproto.commandline import with_options_of
from urproto.durable import write_file
from urproto.errors import RobotRefused, URError
from urproto.ports import CAMERA_PORT
from urproto.robots import UnknownModelError, load_model
from urproto.robots.description import MissingMeshesError
from urproto.robots.description import urdf as urdf_of

if TYPE_CHECKING:
    from client.planning.markers import SceneDrawing

_APPROACH_RAD_S: Final = 0.3  # guess: slow enough to reach the emergency stop in time
_APPROACH_RAD_S2: Final = 0.5
_POLL_S: Final = 0.1
_STREAM_HZ: Final = 50.0  # smooth enough for any screen


def describe_command(
    model: Annotated[str | None, typer.Argument(help="The arm, for example ur3 or ur5e.")] = None,
    robot_ip: Annotated[
        str | None, typer.Option(help="Read the model and the calibration from this robot instead.")
    ] = None,
    port_offset: PortOffset = 0,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.")] = Path("robot.urdf"),
    calibration: Annotated[Path | None, typer.Option(help="Calibration file of the arm.")] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(help="Folder of meshes, such as ur_description's meshes/ur5e (default: simple shapes)."),
    ] = None,
    prefix: Annotated[str, typer.Option(help="Prefix for the name of every link and joint.")] = "",
) -> None:
    """Write the URDF of an arm: joints, limits, inertias, geometry and, if available, its calibration."""
    if (model is None) == (robot_ip is None):
        raise typer.BadParameter("give either a model or --robot-ip")
    try:
        arm = load_model(model.lower()) if model else model_of_robot(robot_ip or "", port_offset)
        if calibration is not None:
            measured = read_calibration(calibration)
            measured.check_model(arm)
            arm = replace(arm, calibration=measured.dh)
        text = urdf_of(arm, meshes=meshes, prefix=prefix)
    except (UnknownModelError, MissingMeshesError) as error:
        raise typer.BadParameter(str(error)) from error
    with FileError.accessing(output):
        write_file(output, text)
    typer.echo(f"{output}: {arm.title}, " + ("nominal" if arm.calibration is None else "calibrated"))


def plot_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Plot to write: .png, .svg, .pdf or .html.")
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title of the plot (default: the file's name).")] = None,
    controller: Annotated[
        str | None,
        typer.Option(help='Controller whose desired motion to draw; "robot": the robot\'s target.'),
    ] = None,
    limit: Annotated[
        float | None, typer.Option(min=0.0, help="Draw a line at this deviation from the path [rad].")
    ] = None,
    overwrite: "Overwrite" = False,
) -> None:
    """Plot a recording: desired and actual positions and speeds, their differences, and the speed scaling."""
    output = file.with_suffix(".png") if output is None else output
    check_free(output, overwrite)
    recording = read_with_remarks(file)
    draw(recording, output, file.name if title is None else title, controller=controller, limit_rad=limit)
    typer.echo(f"{output}: {len(recording)} states, {recording.time_s[-1]:.2f} s")
    tracking = recording.tracking(controller)
    if tracking.compared:
        worst = max(deviations(recording, controller=controller), key=lambda deviation: deviation.largest)
        typer.echo(f"desired by: {tracking.source}")
        typer.echo(f"largest position error: {worst.largest:.5f} rad ({worst.joint}, rms {worst.rms:.5f} rad)")
        typer.echo(f"largest deviation from the path: {tracking.largest_path_deviation:.5f} rad")


def replay_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    speed: Annotated[float, typer.Option(help="Multiple of the recorded speed.")] = 1.0,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real arm without asking for confirmation.")] = False,
    make_ready: Annotated[
        bool, typer.Option("--make-ready", help="Power the arm on and release its brakes first, if necessary.")
    ] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Move the arm slowly to the start of a recorded path, then along it as recorded; Ctrl-C brings it to rest."""
    if not 0.0 < speed <= 10.0:
        raise typer.BadParameter(f"--speed must be above 0 and at most 10, not {speed:g}")
    path = joint_path(read_with_remarks(file), speed)
    ports = robot_ports(port_offset)
    with exclusive_motion(robot_ip, ports), Robot(robot_ip, robot_ports=ports) as robot:
        check_and_confirm(robot_ip, robot, path, yes=yes)
        if make_ready:
            robot.make_ready()
        robot.move_j(path.start_rad, speed_rad_s=_APPROACH_RAD_S, acceleration_rad_s2=_APPROACH_RAD_S2)
        move_along(robot, path, "replay")
    typer.echo(f"{file}: replayed {path.duration_s:.2f} s")


@contextmanager
def exclusive_motion(robot_ip: str, ports: Mapping[str, int]) -> Iterator[None]:
    """Guard a block that moves a robot.

    Refuses to start while a controller manager is running for the robot. Ctrl-C prints "stopped" and exits with
    status 130.
    """
    asyncio.run(check_no_manager(robot_ip, ports["rtde"]))
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(INTERRUPTED) from None


def check_and_confirm(robot_ip: str, robot: Robot, path: JointPath, *, yes: bool) -> None:
    """Check the path against the limits of the robot; ask for confirmation unless it is on this machine.

    Raises URError, or typer.Exit if the answer is no.
    """
    arm = robot.inner.driver.link.configuration
    if arm is None:
        raise RobotRefused("replay", "it does not report its limits", "check that its primary port (30001) answers")
    path.check(arm)
    if not yes and not is_loopback(robot_ip):  # a real robot never is
        _confirm(robot_ip, robot, path)


def _confirm(address: str, robot: Robot, path: JointPath) -> None:
    distance_rad = max(abs(a - b) for a, b in zip(robot.q, path.start_rad, strict=True))
    question = (
        f"The arm at {address} will move by up to {distance_rad:.2f} rad to the start of the path, and then along it "
        f"for {path.duration_s:.1f} s. Obstacles are not checked. Is the path clear?"
    )
    if not sys.stdin.isatty():
        raise ClientError(f"{question} There is no terminal to answer from: pass --yes if it is")
    if not typer.confirm(question):
        raise typer.Exit(1)


def move_along(robot: Robot, path: JointPath, what: str) -> None:
    """Move the arm from the start of the path, where it is now, to its end, and show the progress.

    what: title of the progress bar.
    """
    robot.sequence(path.points(), wait=False)
    with ProgressBar(what) as progress:
        done_s, last_s = 0.0, robot.state.timestamp_s
        while robot.moving:
            try:
                robot.wait_done(_POLL_S)
            except TimeoutError:
                now_s = robot.state.timestamp_s
                done_s += (now_s - last_s) * robot.state.speed_fraction
                last_s = now_s
                progress.update(min(1.0, done_s / path.duration_s))
        progress.update(1.0)
    robot.wait_done()  # raises if the motion failed between two polls


Overwrite: TypeAlias = Annotated[bool, typer.Option("--overwrite", help="Overwrite the file if it exists.")]


@dataclass(frozen=True)
class _Source:
    """What to record or stream of a robot, as options of a command."""

    fields: Annotated[
        list[str] | None,
        typer.Option(help="RTDE outputs, comma-separated or repeated; the word default adds the usual ones."),
    ] = None
    duration: Annotated[
        float | None,
        typer.Option(min=0.0, help="Duration by the robot's clock [s] (default: until Ctrl-C)."),
    ] = None
    scene: Annotated[
        Path | None,
        typer.Option(help="World file whose objects to draw around the arm (extra plan).", dir_okay=False),
    ] = None
    plan: Annotated[
        Path | None,
        typer.Option(help="Output of `ur-client plan --json` whose path to draw (extra plan).", dir_okay=False),
    ] = None
    camera: CameraNames = None
    depth: Annotated[bool, typer.Option("--depth", help="Also include depth images of those cameras.")] = False
    camera_rate: CameraRate = DEFAULT_HZ
    camera_port: CameraPort = None
    robot_ip: RobotIP = "127.0.0.1"
    port_offset: PortOffset = 0

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The RTDE variables. Raises RecordingError for an unknown one."""
        parts = [name.strip() for part in self.fields or ["default"] for name in part.split(",")]
        return field_names(name for name in parts if name)

    @cached_property
    def cameras(self) -> CameraOptions:
        """The cameras. Raises BadParameter."""
        port = self.camera_port or CAMERA_PORT + self.port_offset
        return CameraOptions(self.robot_ip, port, self.camera or (), self.camera_rate, self.depth)

    def drawing(self) -> "SceneDrawing | None":
        return scene_drawing(self.scene, self.plan, self.names, self.robot_ip, self.port_offset)

    def connect(
        self, opened: ExitStack, interrupts: Interrupts, frequency_hz: float | None
    ) -> tuple[rtde.BlockingRTDEClient, str]:
        """The connection, and a description of it."""
        client = connect(opened, interrupts, self.robot_ip, self.port_offset, self.names, frequency_hz)
        source = f"{client.host} (PolyScope {client.core.version})"
        return client, f"{len(self.names)} variables of {source} at {client.core.rate_hz:g} Hz"


@with_options_of(_Source, last=True)
def record_command(
    source_options: Mapping[str, Any],
    file: Annotated[Path, typer.Argument(help="File to write: .mcap (ROS 2, PlotJuggler, Foxglove), .csv or .npz.")],
    frequency: Annotated[float | None, typer.Option(help="States per second (default: the robot's full rate).")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Record a robot's states, until Ctrl-C."""
    source = _Source(**source_options)
    if source.cameras.names and file.suffix.lower() != ".mcap":
        raise RecordingError(f"{file}: only .mcap files can contain camera images")
    check_free(file, overwrite)
    if (source.scene or source.plan) and file.suffix.lower() != ".mcap":
        raise typer.BadParameter(f"--scene and --plan need an .mcap file: {file} cannot contain drawings")
    drawing = source.drawing()
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        client, what = source.connect(opened, interrupts, frequency)
        shots = follow_cameras(opened, source.cameras)
        info = {"robot": client.host, "polyscope": str(client.core.version), "rate_hz": f"{client.core.rate_hz:g}"}
        recorder = opened.enter_context(Recorder(file, source.names, info))
        typer.echo(f"recording {what} to {file} ({recorder.place.name} until it ends). Ctrl-C ends it.", err=True)
        pictures = 0

        def write(state: Mapping[str, Any]) -> None:
            nonlocal pictures
            recorder.write(state)
            for shot in shots():
                recorder.write_shot(shot)
                pictures += 1

        sinks: list[Sink] = [write]
        if drawing is not None:
            sinks.append(drawing.onto(recorder))
        follow(client, sinks, interrupts, source.duration)
    typer.echo(f"{file}: {recorder.count} states" + (f", {pictures} images" if source.cameras.names else ""))
    if recorder.left_out:
        typer.echo(f"note: {recorder.left_out} states without a timestamp were left out", err=True)


@with_options_of(_Source, last=True)
def stream_command(
    source_options: Mapping[str, Any],
    plotjuggler: Annotated[
        str | None,
        typer.Option(
            help=f"PlotJuggler's UDP server (udp://127.0.0.1:{PLOTJUGGLER_PORT}) or WebSocket server "
            f"(ws://127.0.0.1:{PLOTJUGGLER_WEBSOCKET_PORT}); choose the protocol json there.",
        ),
    ] = None,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Serve Foxglove (see --listen).")] = False,
    listen: Annotated[str, typer.Option(help="Address to listen on for Foxglove.")] = f"ws://127.0.0.1:{FOXGLOVE_PORT}",
    urdf: Annotated[
        Path | None,
        typer.Option(
            help="URDF for Foxglove's 3D panel (default: generated for the robot's model).",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    frequency: Annotated[float, typer.Option(help="States per second.")] = _STREAM_HZ,
) -> None:
    """Stream a robot's live data to PlotJuggler or Foxglove, until Ctrl-C."""
    if not plotjuggler and not foxglove:
        raise typer.BadParameter("nowhere to stream to: give --plotjuggler udp://127.0.0.1:9870, --foxglove, or both")
    source = _Source(**source_options)
    if (source.scene or source.plan) and not foxglove:
        raise typer.BadParameter("--scene and --plan need --foxglove: PlotJuggler shows curves only")
    if source.cameras.names and not foxglove:
        raise typer.BadParameter("--camera needs --foxglove: PlotJuggler shows no images")
    drawing = source.drawing()
    with ExitStack() as opened:
        interrupts = opened.enter_context(Interrupts())
        client, what = source.connect(opened, interrupts, frequency)
        shots = follow_cameras(opened, source.cameras)
        writers: list[Writer] = []
        server: FoxgloveServer | None = None
        if plotjuggler:
            writers.append(live.plotjuggler(plotjuggler))
        if foxglove:
            description = _text(urdf) if urdf else _described(source.robot_ip, source.port_offset)
            server = FoxgloveServer(source.names, *address_of(listen, "ws", FOXGLOVE_PORT), description)
            writers.append(server if drawing is None else DrawnServer(server, drawing))
            typer.echo(f"Foxglove: open a connection to {listen.rpartition(':')[0]}:{server.port}", err=True)
        for writer in writers:
            opened.callback(writer.close)
        typer.echo(f"streaming {what}. Ctrl-C ends it.", err=True)
        follow(client, [_timestamped_sink(writers, server, shots)], interrupts, source.duration)


def convert_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    target: Annotated[Path, typer.Argument(help="File to write; its suffix chooses the format.")],
    overwrite: Overwrite = False,
) -> None:
    """Convert a recording to another format."""
    check_free(target, overwrite)
    recording = convert(file, target)
    _print_remarks(file, recording)
    typer.echo(f"{target}: {len(recording)} states of {len(recording.values)} variables")
    if recording.controllers:
        names = ", ".join(recording.controllers)
        typer.echo(f"note: the states of controllers ({names}) were not converted: they are only in {file}", err=True)


def read_with_remarks(path: Path, columns: Sequence[str] | None = None) -> Recording:
    """Read a recording; print a note if it is damaged or incomplete. columns: as in `read`."""
    recording = read(path, columns)
    _print_remarks(path, recording)
    return recording


def _print_remarks(path: Path, recording: Recording) -> None:
    if found := remarks(recording.info):
        typer.echo(f"note: {path}: {'; '.join(found)}; using the remaining {len(recording)} states", err=True)


def check_free(path: Path, overwrite: bool) -> None:
    """Raise RecordingError if the file exists and may not be overwritten."""
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists: choose another name, or pass --overwrite")


def _timestamped_sink(
    writers: Sequence[Writer], picture_server: FoxgloveServer | None, shots: Callable[[], list[Shot]]
) -> Sink:
    """A sink that passes each state to all writers, and images to the Foxglove server, with this machine's time."""
    stamps = Stamps()

    def write(values: Any) -> None:
        if (time_ns := stamps.of(values["timestamp"])) is not None:
            for writer in writers:
                writer.write(values, time_ns)
        for shot in shots():
            if picture_server is not None and (taken_ns := stamps.at(shot.time_s)) is not None:
                picture_server.write_shot(shot, taken_ns)

    return write


def _described(robot_ip: str, port_offset: int) -> str | None:
    """The robot's URDF; None, after printing the reason, if not available: streaming works without it."""
    try:
        return urdf_of(model_of_robot(robot_ip, port_offset))
    except URError as error:
        typer.echo(f"no arm in Foxglove's 3D panel: {error}", err=True)
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path} is not text: {error}") from error
