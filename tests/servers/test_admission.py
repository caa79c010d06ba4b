"""Limits on the number of clients of a port, and rejection of others."""

import asyncio
import errno
import os
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, suppress

import pytest
from server_rig import FakeController

from emulator.config import ConfigError, check_client_limits
from emulator.servers import admission
from emulator.servers.admission import ClientLimits, Reason
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer
from urproto.compat_asyncio import timeout
from urproto.log_throttle import EVERY_S
from urproto.realtime import RealtimeDecoder
from urtesting.process import EmulatorProcess

HOST = "127.0.0.1"
ELSEWHERE = "127.0.0.2"
WAIT_S = 10


class Greeting(Connection):
    def opened(self) -> None:
        self.send(b"hello")


class Port(PortServer):
    def connect(self) -> Connection:
        return Greeting(self)


@pytest.fixture
async def server() -> AsyncIterator[PortServer]:
    server = Port("test", FakeController())
    server.limits = ClientLimits(port=3, address=2)
    await server.start(HOST, 0)
    yield server
    await server.stop()


@pytest.fixture
def clients() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


async def let_in(server: PortServer, clients: ExitStack, source: str = HOST) -> socket.socket | None:
    """A new client, None if it is turned away."""
    client = clients.enter_context(socket.socket())
    client.bind((source, 0))
    client.setblocking(False)
    loop = asyncio.get_running_loop()
    async with timeout(WAIT_S):
        await loop.sock_connect(client, (HOST, server.port))
        with suppress(ConnectionResetError):
            return client if await loop.sock_recv(client, 10) == b"hello" else None
    return None


async def until(condition: Callable[[], bool]) -> None:
    async with timeout(WAIT_S):
        while not condition():
            await asyncio.sleep(0)


needs_addresses = pytest.mark.skipif(sys.platform != "linux", reason="only one loopback address")


@needs_addresses
async def test_one_address_cannot_occupy_every_connection(
    server: PortServer, clients: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    first = await let_in(server, clients)
    assert first
    assert await let_in(server, clients)
    for _ in range(4):
        assert await let_in(server, clients) is None
    assert await let_in(server, clients, ELSEWHERE)
    assert await let_in(server, clients, ELSEWHERE) is None
    assert server.turned_away.counts == {"address full": 4, "port full": 1}
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 2
    assert "--most-clients-per-address" in warnings[0]
    assert "--most-clients allows" in warnings[1]
    first.close()
    await until(lambda: len(server.connections) == 2)
    assert await let_in(server, clients), "there is room again"


async def test_the_log_reports_the_number_of_rejections_a_minute_later(
    server: PortServer, clients: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    server.limits = ClientLimits(0, 0)
    for _ in range(3):
        await let_in(server, clients)
    server.turned_away._lines[Reason.PORT_FULL]._next_s -= EVERY_S
    await let_in(server, clients)
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 2
    assert warnings[1].endswith("(2 more since the last such line)")


def no_descriptors(*_: object) -> None:
    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))


async def test_the_reserve_turns_clients_away_when_descriptors_run_out(
    server: PortServer, clients: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    acceptor = server._listening
    assert acceptor is not None
    listening = acceptor._listening

    class Exhausted:
        """Accepts only with the reserve descriptor."""

        def accept(self) -> tuple[socket.socket, object]:
            if admission._descriptors._reserve is not None:
                no_descriptors()
            return listening.accept()

        def __getattr__(self, name: str) -> object:
            return getattr(listening, name)

    acceptor._listening = Exhausted()  # type: ignore[assignment]
    for _ in range(3):
        assert await let_in(server, clients) is None
    assert server.turned_away.counts == {"no descriptors": 3}
    acceptor._listening = listening
    assert await let_in(server, clients)
    assert len([record for record in caplog.records if record.levelname == "WARNING"]) <= 1


async def test_the_event_loop_does_not_spin_when_no_client_can_be_accepted(
    server: PortServer, clients: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    acceptor = server._listening
    assert acceptor is not None
    listening = acceptor._listening
    attempts = 0

    class Broken:
        def accept(self) -> None:
            nonlocal attempts
            attempts += 1
            raise OSError(errno.ENFILE, os.strerror(errno.ENFILE))

        def __getattr__(self, name: str) -> object:
            return getattr(listening, name)

    monkeypatch.setattr(admission, "_PAUSE_S", 0.05)
    acceptor._listening = Broken()  # type: ignore[assignment]
    waiting = asyncio.create_task(let_in(server, clients))
    await until(lambda: attempts > 0)
    for _ in range(100):
        await asyncio.sleep(0)
    assert attempts <= 4, "itself and in the place of the reserve, once or twice"
    acceptor._listening = listening
    assert await waiting, "a waiting client is accepted after the pause"


async def test_a_port_is_closed_during_a_pause(server: PortServer, monkeypatch: pytest.MonkeyPatch) -> None:
    acceptor = server._listening
    assert acceptor is not None
    acceptor._failed(OSError(errno.ENETDOWN, "down"))
    server.close_port()
    server.open_port()
    await until(lambda: server.listening)


def test_limits_are_checked() -> None:
    assert check_client_limits(256, None) == ClientLimits()
    assert check_client_limits(1, None) == ClientLimits(1, 1)
    assert check_client_limits(5, 5) == ClientLimits(5, 5)
    for port, address in ((0, None), (-1, 1), (5, 6), (5, 0)):
        with pytest.raises(ConfigError, match="client"):
            check_client_limits(port, address)


# a separate emulator, with more clients than descriptors

IDLE = 1100
WATCHED_S = 2.0
PORTS = (
    "dashboard",
    "primary",
    "secondary",
    "realtime",
    "rtde",
    "modbus",
    "control",
    "interpreter",
    "secondary read-only",
)
SLOWEST = 0.7  # of real time, under load; without admission control it was 0.1


@pytest.fixture
def robot(tmp_path) -> Iterator[EmulatorProcess]:
    (tmp_path / "wait.script").write_text("def wait():\n  sleep(3600)\nend\n")
    with EmulatorProcess(["--model", "ur3", "--running", "--programs", str(tmp_path)]) as robot:
        yield robot


def open_idle(robot: EmulatorProcess, count: int, clients: ExitStack) -> None:
    ports = robot.ports
    for number in range(count):
        clients.enter_context(socket.create_connection((robot.host, ports[PORTS[number % len(PORTS)]]), WAIT_S))


def eventually(condition: Callable[[], bool]) -> None:
    """Wait until it holds."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def refused(robot: EmulatorProcess) -> int:
    """Number of clients turned away for lack of descriptors."""
    return sum(counts["no descriptors"] for counts in robot.turned_away().values())


def pace(robot: EmulatorProcess) -> float:
    """Robot time that passes in a second."""
    begin_s, began = robot.time()["time_s"], time.monotonic()
    time.sleep(WATCHED_S)
    return (robot.time()["time_s"] - begin_s) / (time.monotonic() - began)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of another process can only be set on Linux")
def test_idle_and_excess_clients_do_not_affect_others(robot: EmulatorProcess, clients: ExitStack) -> None:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < 2 * IDLE:
        if hard != resource.RLIM_INFINITY and hard < 2 * IDLE:
            pytest.skip(f"a process may have {hard} files and connections here: too few for this many clients")
        resource.setrlimit(resource.RLIMIT_NOFILE, (2 * IDLE, hard))
        clients.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
    process = robot._process
    assert process is not None
    healthy = clients.enter_context(socket.create_connection((robot.host, robot.ports["realtime"]), WAIT_S))
    resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (2 * IDLE, hard))
    with ExitStack() as idle:
        open_idle(robot, IDLE, idle)
        robot.run_until("timestamp > 0")
        eventually(lambda: sum(map(len, robot.connections().values())) >= IDLE)
        assert robot.turned_away() == {}
        assert pace(robot) > SLOWEST
        # more than the limit: only the reserve is left
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (IDLE, hard))
        open_idle(robot, 300, idle)
        assert pace(robot) > SLOWEST
        eventually(lambda: refused(robot) == 300)
        # some are left, for the robot
        present = len(os.listdir(f"/proc/{process.pid}/fd"))
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (present + 20, hard))
        open_idle(robot, 20, idle)
        assert robot.dashboard("load wait.script").startswith("Loading program")
        eventually(lambda: refused(robot) == 320)
        assert robot.output.count("turned away") == 1, "a line a minute"
        assert len(robot.output) < 10_000
    eventually(lambda: not robot.connections()["dashboard"])
    with socket.create_connection((robot.host, robot.ports["dashboard"]), WAIT_S) as again:
        assert again.recv(100).startswith(b"Connected")
    assert len(RealtimeDecoder().feed(read_all(healthy))) > 100


def read_all(client: socket.socket) -> bytes:
    """All data that has arrived."""
    client.setblocking(False)
    data = b""
    with suppress(BlockingIOError):
        while piece := client.recv(1 << 20):
            data += piece
    return data
