"""``ur-client proxy``, ``decode``, ``compare``, ``smoothness`` and ``replay-traffic``: record and examine a robot's
connections."""

import asyncio
import json
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import asdict
from enum import Enum
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from client.commands.following import PortOffset, RobotIP
from client.decoding.codecs import CODECS, Side
from client.decoding.session import Choice, DecodingSession, InputForm
from client.traffic.peers_file import PeersRecorder
from client.traffic.ports import choose_ports, query_identity
from client.traffic.proxy import Proxy, Route, driver_routes, peer_routes, robot_routes
from client.traffic.recording import TrafficRecorder, TrafficRecording
from client.traffic.replay import ReplayRobot
from urproto.commandline import AsJson, console, print_json

if TYPE_CHECKING:
    from client.traffic.smoothness import Smoothness

_CHUNK = 65536  # bytes
_UNREADABLE = 1  # exit status when something could not be decoded

CodecName = Enum("CodecName", {name: name for name in CODECS}, type=str)  # type: ignore[misc] # an Enum, so that the help text lists the names

_DIFFERENT = 1
_UNRECORDED = 1  # exit status when the recording ended before the proxy


def decode_command(
    file: Annotated[str, typer.Argument(help="Captured bytes, hexadecimal text or a pcap file; - for standard input.")],
    codec: Annotated[
        CodecName | None,
        typer.Option("--as", help="Protocol of the bytes (default: guessed from port and content)."),
    ] = None,
    side: Annotated[
        Side | None,
        typer.Option("--from", help="Sender of the bytes, if they are from one direction (a driver is a client)."),
    ] = None,
    port: Annotated[
        list[int] | None,
        typer.Option(help="Port of the bytes; in a pcap file, the port to show. Repeatable."),
    ] = None,
    port_offset: Annotated[int, typer.Option(help="Port offset of the emulator.")] = 0,
    form: Annotated[InputForm, typer.Option("--input", help="Format of the file.")] = InputForm.AUTO,
    as_json: Annotated[bool, typer.Option("--json", help="Print every message as a line of JSON.")] = False,
) -> None:
    """Print captured traffic of any controller port, one line per message. Exit status 1 for unreadable data (!)."""
    chosen = CODECS[codec.value] if codec else None
    as_json_line = (lambda line: json.dumps(asdict(line))) if as_json else None
    session = DecodingSession(Choice(chosen, side, tuple(port or ()), port_offset, form), as_json_line)
    with ExitStack() as opened:
        source = _stdin() if file == "-" else _open(file, opened)
        try:
            _decode_all(source, session)
        except KeyboardInterrupt:  # how an endless stream usually ends
            _print_lines(session.end())
    if session.problems:
        raise typer.Exit(_UNREADABLE)


def _stdin() -> BufferedIOBase:
    stdin = sys.stdin.buffer
    assert isinstance(stdin, BufferedIOBase)
    return stdin


def _open(file: str, opened: ExitStack) -> BufferedReader:
    try:
        return opened.enter_context(Path(file).open("rb"))
    except OSError as error:
        raise typer.BadParameter(f"cannot read {file}: {error.strerror}") from error


def _decode_all(source: BufferedIOBase, session: DecodingSession) -> None:
    while data := source.read1(_CHUNK):
        _print_lines(session.feed(data))
    _print_lines(session.end())


def _print_lines(lines: Iterable[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))  # in one write: Ctrl-C between lines would lose the rest
    sys.stdout.flush()


def compare_command(
    first: Annotated[Path, typer.Argument(help="A recording (pcapng, pcap), or a table of `watch --csv`.")],
    second: Annotated[Path, typer.Argument(help="The one to compare it with.")],
    tolerance: Annotated[
        list[str] | None,
        typer.Option(help="Tolerance of a unit or field, such as rad=0.01 or actual_q=0.01. Repeatable."),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(help="Added to the robot time of the first recording [s] (default: found by alignment)."),
    ] = None,
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """Report whether two recordings agree, and where they diverge. Exit status 1 if they differ."""
    from client.traffic.compare import compare_sources, read_source  # numpy: the other commands start without it
    from client.traffic.report import as_object, report

    comparison = compare_sources(
        read_source(first, port_offset), read_source(second, port_offset), tolerance or (), offset
    )
    if as_json:
        print_json(as_object(comparison))
    else:
        typer.echo(report(comparison), nl=False)
    if not comparison.same:
        raise typer.Exit(_DIFFERENT)


def smoothness_command(
    file: Annotated[Path, typer.Argument(help="A recording: a pcapng file of `ur-client proxy`, or any pcap file.")],
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """Report why a streamed motion is rough: program, network, controller or arm. Exit status 1 if something is."""
    from client.traffic.smoothness import examine  # numpy: the other commands start without it

    smoothness = examine(TrafficRecording.read(file, port_offset))
    if as_json:
        print_json(asdict(smoothness))
    else:
        for remark in smoothness.remarks:
            typer.echo(f"note: {remark}", err=True)
        _print_smoothness(smoothness)
    if smoothness.findings:
        raise typer.Exit(_DIFFERENT)


def _print_smoothness(smoothness: "Smoothness") -> None:
    for stream in smoothness.streams:
        timing, lag = stream.timing, "" if stream.lag_s is None else f", target {1e3 * stream.lag_s:.0f} ms behind"
        usual, most, longest = timing.interval_ms
        typer.echo(f"{stream.source}: {timing.count} setpoints in {timing.duration_s:.1f} s")
        typer.echo(f"{timing.rate_hz:.1f} per second, {timing.distinct_hz:.1f} of them new{lag}")
        typer.echo(f"interval: median {usual:.1f} ms, 99 % below {most:.1f} ms, longest {longest:.1f} ms")
        if stream.forms:
            table = Table("", "speed rad/s", "roughness mrad", "largest mrad", "joint", box=None, pad_edge=False)
            for form in stream.forms:
                numbers = f"{form.speed_rad_s:.2f}", f"{form.rms_mrad:.2f}", f"{form.largest_mrad:.1f}"
                table.add_row(form.name, *numbers, form.joint)
            console().print(table)
    for finding in smoothness.findings:
        typer.echo(f"- {finding.cause.value}: {finding.text}.\n  {finding.advice[0].upper()}{finding.advice[1:]}.")
    if not smoothness.findings:
        typer.echo("Nothing that makes the motion rough.")


def replay_traffic_command(
    file: Annotated[Path, typer.Argument(help="A recording: a pcapng file of `ur-client proxy`, or any pcap file.")],
    listen: Annotated[str, typer.Option(help="Address to listen on for clients.")] = "127.0.0.1",
    speed: Annotated[float, typer.Option(help="Recorded seconds per second.")] = 1.0,
    loop: Annotated[
        bool, typer.Option("--loop", help="Start over at the end of the recording instead of closing the connections.")
    ] = False,
    recorded_offset: Annotated[int, typer.Option(help="Port offset of the robot when it was recorded.")] = 0,
    port_offset: PortOffset = 0,
) -> None:
    """Act as the robot of a recording, until Ctrl-C: send its states at their times and its answers to requests."""
    recording = TrafficRecording.read(file, recorded_offset)
    for problem in recording.problems:
        typer.echo(f"! {problem}", err=True)
    try:
        asyncio.run(_play(recording, listen, speed, loop, port_offset))
    except OSError as error:
        raise typer.BadParameter(str(error)) from error


async def _play(recording: TrafficRecording, listen: str, speed: float, loop: bool, port_offset: int) -> None:
    robot = ReplayRobot(recording, listen, speed=speed, loop=loop, port_offset=port_offset, report=typer.echo)
    async with robot:
        for name, port in robot.ports.items():
            typer.echo(f"{name}: {listen}:{port}")
        typer.echo(f"Replaying {recording.path}. Ctrl-C ends it.")
        await until_interrupted()


def proxy_command(
    robot_ip: RobotIP = "127.0.0.1",
    listen: Annotated[str, typer.Option(help="Address to listen on for clients.")] = "127.0.0.1",
    file: Annotated[
        Path | None,
        typer.Option(
            "--record",
            help="pcapng file to write everything to; Wireshark can open it. With --peer: a .yaml file for urscript's "
            "--peers.",
        ),
    ] = None,
    ports: Annotated[
        list[str] | None,
        typer.Option(help="Name or number of a port to relay (default: all of a robot's). Repeatable."),
    ] = None,
    driver: Annotated[
        str | None,
        typer.Option(help="Address of a driver: also relay the robot's connections to its ports 50001-50004."),
    ] = None,
    peers: Annotated[
        list[str] | None,
        typer.Option(
            "--peer",
            help="HOST:PORT of a device that a robot's program connects to: relay it, and of the robot only --ports. "
            "Repeatable.",
        ),
    ] = None,
    port_offset: PortOffset = 0,
    listen_offset: Annotated[
        int, typer.Option(help="Offset added to each port the proxy listens on, as for an emulator.")
    ] = 0,
) -> None:
    """Relay every connection to a robot unchanged and record it, until Ctrl-C."""
    chosen = choose_ports(ports or ()).items() if ports or not peers else ()
    routes = robot_routes(robot_ip, listen, chosen, port_offset=port_offset, listen_offset=listen_offset)
    if driver is not None:
        routes += driver_routes(driver, listen)
    routes += peer_routes(map(_peer, peers or ()), listen, listen_offset=listen_offset)
    _refuse_loop(routes)
    recorder: TrafficRecorder | PeersRecorder | None = None
    if file is not None and file.suffix == ".yaml":
        if not peers or chosen or driver:
            raise typer.BadParameter("a .yaml file records peers only: give --peer, without --ports and --driver")
        recorder = PeersRecorder(file, _warn)
    elif file is not None:
        recorder = _recorder(file, robot_ip, port_offset)
    try:
        asyncio.run(_relay(routes, recorder))
    except OSError as error:
        raise typer.BadParameter(str(error)) from error
    finally:
        if recorder is not None:
            recorder.close()
    if recorder is not None and recorder.failed:
        raise typer.Exit(_UNRECORDED)


def _peer(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise typer.BadParameter(f"{text!r} is not of the form HOST:PORT")
    return host.strip("[]"), int(port)


def _refuse_loop(routes: list[Route]) -> None:
    for route in routes:
        if (route.listen, route.listen_port) == (route.host, route.target):
            raise typer.BadParameter(
                f"the proxy cannot listen on {route.host}:{route.target}, which is the robot's own {route.name}: "
                "give another --listen (127.0.0.2, for example) or a --listen-offset"
            )


def _recorder(file: Path, robot_ip: str, port_offset: int) -> TrafficRecorder:
    comments = asyncio.run(query_identity(robot_ip, port_offset))
    return TrafficRecorder(file, comments, problem=_warn)


async def _relay(routes: list[Route], recorder: TrafficRecorder | PeersRecorder | None) -> None:
    async with Proxy(routes, recorder, typer.echo) as proxy:
        for name, port in proxy.ports.items():
            route = proxy.routes[name]
            typer.echo(f"{name}: {route.listen}:{port} -> {route.host}:{route.target}")
        recording = f"Recording to {recorder.path} ({recorder.place.name} until it ends). " if recorder else ""
        typer.echo(f"{recording}Ctrl-C ends it.")
        await until_interrupted()


async def until_interrupted() -> None:
    """Return at Ctrl-C or SIGTERM."""
    ended = asyncio.Event()
    stop: Callable[[], None] = ended.set
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(NotImplementedError):  # Windows: there Ctrl-C cancels this task
            loop.add_signal_handler(number, stop)
    await ended.wait()


def _warn(text: str) -> None:
    typer.echo(f"! {text}; the connections are still relayed", err=True)
