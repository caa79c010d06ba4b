"""The proxy between real sockets: it changes nothing between the two ends, and records everything."""

import asyncio
import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from client import BlockingDashboardClient, BlockingPrimaryClient, BlockingRTDEClient, dashboard
from client.cli import app
from client.errors import RobotUnreachableError
from client.traffic.ports import query_identity
from client.traffic.proxy import Proxy, Route, robot_routes
from client.traffic.recording import TrafficRecorder, TrafficRecording
from client.traffic.tracks import tracks_of
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.robots import load_model

HOST = "127.0.0.1"
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def proxied(
    serve: Serve, recorder: TrafficRecorder | None = None, *, mirrored: bool = False
) -> AsyncIterator[int]:
    """A server, and the port of a proxy in front of it; recorded as the tool line."""

    async with serving(serve) as target:
        route = Route("one", 54321, HOST, 0, HOST, target, mirrored)
        async with Proxy([route], recorder, lambda text: None) as proxy:
            yield proxy.ports["one"]


@asynccontextmanager
async def serving(serve: Serve, port: int = 0) -> AsyncIterator[int]:
    """A server's port; its connections are closed at the end."""
    handlers: set[asyncio.Task[None]] = set()

    async def served(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        handlers.add(asyncio.current_task())
        with contextlib.suppress(OSError):
            await serve(reader, writer)
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    server = await asyncio.start_server(served, HOST, port)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        await asyncio.wait_for(asyncio.gather(*handlers), 30)


async def echo_until_end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    data = await reader.read()
    writer.write(data[::-1])
    writer.write_eof()


async def test_bytes_and_half_closes_are_forwarded_both_ways(tmp_path):
    recorder = TrafficRecorder(tmp_path / "file")
    data = bytes(range(256)) * 4000
    async with proxied(echo_until_end, recorder) as port:
        reader, writer = await asyncio.open_connection(HOST, port)
        writer.write(data)
        writer.write_eof()
        assert await asyncio.wait_for(reader.read(), 20) == data[::-1]
        await ended(writer)
    recorder.close()
    (one,) = TrafficRecording.read(tmp_path / "file").conversations
    assert (one.sent(from_server=False), one.sent(from_server=True)) == (data, data[::-1])
    assert [piece.from_server for piece in one.pieces if not piece.data] == [False, True]


async def test_a_connection_reset_is_forwarded():
    async def break_off(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(1)
        connection = writer.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()

    async with proxied(break_off) as port:
        reader, writer = await asyncio.open_connection(HOST, port)
        writer.write(b"!")
        with pytest.raises(ConnectionResetError):
            await asyncio.wait_for(reader.read(), 20)
        await ended(writer)


async def test_a_client_that_does_not_read_blocks_only_its_own_connection():
    blocked = asyncio.Event()
    sent = 0

    async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal sent
        if await reader.readexactly(1) == b"a":
            writer.write(b"answer")
            return
        while True:
            writer.write(bytes(1 << 16))
            sent += 1 << 16
            try:
                async with timeout(1):
                    await writer.drain()
            except TimeoutError:
                blocked.set()
                return

    async with proxied(flood) as port:
        slow, slow_writer = await asyncio.open_connection(HOST, port, limit=1 << 10)
        slow_writer.write(b"b")
        await asyncio.wait_for(blocked.wait(), 60)  # so the proxy does not buffer without limit
        reader, writer = await asyncio.open_connection(HOST, port)
        writer.write(b"a")
        assert await asyncio.wait_for(reader.readexactly(6), 20) == b"answer"
        assert len(await asyncio.wait_for(slow.readexactly(sent), 60)) == sent  # nothing was lost
        await ended(writer, slow_writer)


async def test_a_port_without_a_robot_is_closed_and_reported_once():
    with socket.create_server((HOST, 0)) as placeholder:
        gone = placeholder.getsockname()[1]
    reports: list[str] = []
    async with serving(echo_until_end) as there:
        routes = [Route("there", 1, HOST, 0, HOST, there), Route("gone", 2, HOST, gone, HOST, gone)]
        async with Proxy(routes, None, reports.append) as proxy:
            assert list(proxy.ports) == ["there"]
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(HOST, gone)
    assert reports == [f"gone: {HOST}:{gone} does not accept connections (Connection refused); closed here as well"]
    with pytest.raises(RobotUnreachableError):
        async with Proxy([Route("gone", 2, HOST, 0, HOST, gone)], None, reports.append):
            pass


async def test_a_robot_that_disappears_while_the_proxy_runs():
    reports: list[str] = []
    async with contextlib.AsyncExitStack() as running:
        async with serving(echo_until_end) as target:
            route = Route("one", 29999, HOST, 0, HOST, target)
            proxy = await running.enter_async_context(Proxy([route], None, reports.append))
            port = proxy.ports["one"]
        reader, writer = await asyncio.open_connection(HOST, port)
        with contextlib.suppress(ConnectionResetError):
            assert await asyncio.wait_for(reader.read(), 20) == b""
        await ended(writer)
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(HOST, port)
        assert reports == [
            f"one: {HOST}:{target} does not accept connections (Connection refused); closed here as well"
        ]
        async with serving(echo_until_end, target), timeout(30):
            while "one" not in proxy.ports:
                await asyncio.sleep(0.05)
        assert proxy.ports["one"] == port
        assert reports[1:] == [f"one: {HOST}:{target} accepts connections now"]


async def ended(*writers: asyncio.StreamWriter) -> None:
    for writer in writers:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def test_a_session_with_an_emulator(tmp_path: Path):
    config = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3"), running=True), ephemeral_ports=True)
    async with Emulator(config) as emulator:
        routes = [
            Route(route.name, route.port, HOST, 0, HOST, emulator.ports[route.name])
            for route in robot_routes(HOST)
            if route.name in emulator.ports
        ]
        comments = await query_identity(HOST, emulator.ports["dashboard"] - dashboard.PORT)
        recorder = TrafficRecorder(tmp_path / "session.pcapng", comments)
        async with Proxy(routes, recorder, lambda text: None) as proxy:
            seen = await asyncio.to_thread(use, proxy.ports)
        recorder.close()
    recording = TrafficRecording.read(tmp_path / "session.pcapng")
    assert recording.comments == ["robot: UR3", "PolyScope: 3.15.8.106339"]
    assert {30001, 30004, 29999} <= set(recording.ports)
    (track,) = (track for track in tracks_of(recording) if track.source == "rtde")
    for state in seen:
        index = track.times_s.index(state["timestamp"])
        assert [track.columns[f"actual_q[{joint}]"][index] for joint in range(6)] == list(state["actual_q"])


def use(ports: dict[str, int]) -> list[dict]:
    """A typical user session; the states it received."""
    with (
        BlockingDashboardClient(HOST, ports["dashboard"]) as panel,
        BlockingRTDEClient(HOST, ["timestamp", "actual_q"], port=ports["rtde"]) as states,
        BlockingPrimaryClient(HOST, ports["primary"]) as primary,
    ):
        panel.request(dashboard.ROBOT_MODE)
        primary.run(primary.core.run_script("def prog():\n  movej([0.1, -1.5, 0, -1.5, 0, 0])\nend\n"))
        return [dict(states.receive()) for _ in range(100)]


# the command


@pytest.mark.skipif(sys.platform != "linux", reason="needs a second loopback address")
async def test_ctrl_c_ends_the_command_with_a_complete_recording(tmp_path):
    listen = f"127.80.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    async with serving(echo_until_end) as port:
        offset = str(port - 54321)
        options = ["--ports", "tool line", "--port-offset", offset, "--listen-offset", offset, "--listen", listen]
        call = ["proxy", "--robot-ip", HOST, *options, "--record", str(tmp_path / "file")]
        command = subprocess.Popen(
            [sys.executable, "-c", "from client.cli import main; main()", *call], stdout=subprocess.PIPE, text=True
        )
        try:
            lines = [await asyncio.to_thread(command.stdout.readline) for _ in range(2)]
            reader, writer = await asyncio.open_connection(listen, port)
            writer.write(b"abc")
            writer.write_eof()
            assert await asyncio.wait_for(reader.read(), 20) == b"cba"
            await ended(writer)
            command.send_signal(signal.SIGINT)
            await asyncio.to_thread(command.communicate, timeout=30)
        finally:
            command.kill()
            command.communicate()
    assert lines == [
        f"tool line: {listen}:{port} -> {HOST}:{port}\n",
        f"Recording to {tmp_path / 'file'} (file.unfinished until it ends). Ctrl-C ends it.\n",
    ]
    assert command.returncode == 0
    (one,) = TrafficRecording.read(tmp_path / "file").conversations
    assert (one.port, one.sent(from_server=True)) == (54321, b"cba")


@each_row(
    ("options", "message"),
    [
        (["--ports", "rtd"], "'rtd' is not a port of a robot: did you mean rtde?"),
        (["--port-offset", "40000"], "dashboard would be on port 69999"),
        (
            ["--robot-ip", HOST, "--listen", HOST],
            f"the proxy cannot listen on {HOST}:29999, which is the robot's own dashboard",
        ),
    ],
)
def test_invalid_arguments_are_reported(options, message):
    result = CliRunner().invoke(app, ["proxy", *options])
    text = " ".join(f"{result.stderr} {result.exception}".replace("│", " ").split())
    assert result.exit_code != 0
    assert message in text
