"""The connections of scripts, over real loopback sockets."""

import asyncio
import errno
import os
import socket
import struct
import sys
from collections.abc import AsyncIterator, Callable

import pytest

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.servers import script_sockets
from emulator.servers.script_sockets import NetworkSockets
from emulator.services.sockets import ScriptNetwork, ScriptSocket
from tests.rows import each_row
from urproto.addresses import BackdoorMark, is_backdoor
from urproto.compat_asyncio import timeout
from urproto.robots import load_model
from urproto.testing.process import EmulatorProcess

HOST = "127.0.0.1"


class Peer:
    """The server that a script connects to."""

    def __init__(self) -> None:
        self.connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
        self.port = 0
        self.writers: list[asyncio.StreamWriter] = []

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        await self.connections.put((reader, writer))


@pytest.fixture
async def peer() -> AsyncIterator[Peer]:
    peer = Peer()
    server = await asyncio.start_server(peer.accept, HOST, 0)
    peer.port = server.sockets[0].getsockname()[1]
    yield peer
    server.close()
    await asyncio.sleep(0.01)  # connections still being accepted
    for writer in peer.writers:
        writer.transport.abort()
    await asyncio.sleep(0)


@pytest.fixture
async def sockets() -> AsyncIterator[NetworkSockets]:
    sockets = NetworkSockets()
    yield sockets
    await sockets.close()


async def until(condition: Callable[[], bool]) -> None:
    async with timeout(5):
        while not condition():
            await asyncio.sleep(0)


async def opened(sockets: NetworkSockets, peer: Peer) -> ScriptSocket:
    socket = sockets.open(HOST, peer.port)
    assert socket.state == "connecting"
    assert not socket.send(b"too early")
    await until(lambda: socket.state == "open")
    return socket


async def test_data_flows_both_ways(sockets: NetworkSockets, peer: Peer) -> None:
    socket = await opened(sockets, peer)
    reader, writer = await peer.connections.get()
    assert socket.send(b"hello\n")
    assert await reader.readline() == b"hello\n"
    writer.write(b"answer")
    await until(lambda: bytes(socket.inbox) == b"answer")
    writer.close()
    await until(lambda: socket.state == "closed")
    assert bytes(socket.inbox) == b"answer", "received data stays readable"
    assert not socket.send(b"more")


async def test_the_peer_sees_a_close(sockets: NetworkSockets, peer: Peer) -> None:
    socket = await opened(sockets, peer)
    reader, _ = await peer.connections.get()
    socket.send(b"last words")
    socket.close()
    socket.close()
    assert socket.state == "closed"
    assert await reader.read() == b"last words"


@pytest.mark.parametrize("port", [1, 0, -1, 70_000])
async def test_invalid_addresses_end_in_state_closed(sockets: NetworkSockets, port: int) -> None:
    socket = sockets.open(HOST, port)
    await until(lambda: socket.state == "closed")


async def test_closing_while_connecting(sockets: NetworkSockets, peer: Peer) -> None:
    socket = sockets.open(HOST, peer.port)
    socket.close()
    assert socket.state == "closed"
    other = sockets.open(HOST, peer.port)
    await asyncio.sleep(0)
    other.close()
    await sockets.close()
    assert other.state == "closed"


async def test_a_peer_that_is_far_ahead_must_wait(
    sockets: NetworkSockets, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script_sockets, "_MAX_UNREAD", 1000)
    socket = await opened(sockets, peer)
    _, writer = await peer.connections.get()
    sent = bytes(range(256)) * 8000
    writer.write(sent)
    await until(lambda: len(socket.inbox) >= 1000)
    await asyncio.sleep(0.05)
    assert len(socket.inbox) < len(sent)
    got = bytearray()

    def read() -> bool:
        if socket.state == "open":
            got.extend(socket.inbox)
            socket.inbox.clear()
        return len(got) == len(sent)

    await until(read)
    assert got == sent


# restrictions on the connections of scripts


def resolve_names(monkeypatch: pytest.MonkeyPatch, **names: list[str]) -> None:
    """Let names resolve to these addresses."""

    async def getaddrinfo(name: str, port: int, **_: object) -> list[tuple[object, ...]]:
        if name not in names:
            raise socket.gaierror(socket.EAI_NONAME, "unknown name")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in names[name]]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)


@pytest.mark.parametrize("network", list(ScriptNetwork))
@pytest.mark.parametrize("address", [HOST, "here", "both"])
async def test_loopback_addresses(
    network: ScriptNetwork, address: str, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolve_names(monkeypatch, here=[HOST], both=["192.0.2.1", HOST] if network is ScriptNetwork.LOOPBACK else [HOST])
    notes: list[str] = []
    sockets = NetworkSockets(network, notes.append)
    opened = sockets.open(address, peer.port)
    await until(lambda: opened.state != "connecting")
    assert opened.state == ("closed" if network is ScriptNetwork.NONE else "open")
    assert len(notes) == (network is ScriptNetwork.NONE)
    await sockets.close()


@each_row("address", ["127.8.9.10", "::1", "::ffff:127.0.0.1"])
async def test_every_spelling_of_loopback_is_recognised(address: str) -> None:
    assert len(await NetworkSockets(ScriptNetwork.LOOPBACK)._permitted(address, 80)) == 1


@pytest.mark.parametrize("network", [ScriptNetwork.LOOPBACK, ScriptNetwork.NONE])
@pytest.mark.parametrize(
    "address", ["192.0.2.1", "0.0.0.0", "::", "2001:db8::1", "::ffff:192.0.2.1", "128.0.0.1", "elsewhere"]
)
async def test_other_addresses_are_refused_with_the_reason_in_the_log(
    network: ScriptNetwork, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolve_names(monkeypatch, elsewhere=["192.0.2.7"])
    notes: list[str] = []
    sockets = NetworkSockets(network, notes.append)
    opened = sockets.open(address, 50001)
    await until(lambda: opened.state == "closed")
    (note,) = notes
    assert note.startswith(f"a script may not connect to {address}:50001")
    assert note.endswith(f"the script network is {network}")
    assert ("192.0.2.7" in note) == (address == "elsewhere" and network is ScriptNetwork.LOOPBACK)
    await sockets.close()


async def test_unresolvable_names_end_in_state_closed(sockets: NetworkSockets, monkeypatch: pytest.MonkeyPatch) -> None:
    resolve_names(monkeypatch)
    opened = sockets.open("nowhere", 80)
    await until(lambda: opened.state == "closed")


async def test_all_addresses_of_a_name_are_tried(
    sockets: NetworkSockets, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolve_names(monkeypatch, twice=["127.0.0.9", HOST])
    opened = sockets.open("twice", peer.port)
    await until(lambda: opened.state == "open")


@pytest.mark.parametrize("network", [ScriptNetwork.ANY, ScriptNetwork.NONE])
async def test_an_emulator_applies_the_network_restriction_to_its_scripts(network: ScriptNetwork, peer: Peer) -> None:
    controller = ControllerConfig(model=load_model("ur5e"), running=True)
    config = EmulatorConfig(controller=controller, ephemeral_ports=True, script_network=network)
    async with Emulator(config) as emulator:
        script = f'def prog():\n textmsg("opened ", socket_open("{HOST}", {peer.port}))\nend\n'
        emulator.controller.programs.submit(script)
        log = emulator.controller.messages.history
        await until(lambda: any("opened " in line for line in log))
        refused = network is ScriptNetwork.NONE
        assert any(line.endswith(f"opened {not refused}") for line in log)
        assert any("the script network is none" in line for line in log) == refused


# big and slow


async def test_a_peer_that_does_not_read_stops_the_script_from_sending(sockets: NetworkSockets, peer: Peer) -> None:
    socket = await opened(sockets, peer)
    reader, _ = await peer.connections.get()
    line = b"x" * 1023
    sent = 0
    while socket.send(line):
        sent += len(line)
        assert sent < 64 * 1024 * 1024
    assert sent > 1024 * 1024
    assert socket.state == "open"
    got = 0
    while got < sent:
        got += len(await reader.read(65536))
    assert got == sent
    assert socket.send(line)


async def test_the_reason_a_connection_closed(sockets: NetworkSockets, peer: Peer) -> None:
    orderly = await opened(sockets, peer)
    _, writer = await peer.connections.get()
    writer.close()
    await until(lambda: orderly.state == "closed")
    assert orderly.failure == ""

    broken = await opened(sockets, peer)
    _, writer = await peer.connections.get()
    end = writer.get_extra_info("socket")
    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()
    await until(lambda: broken.state == "closed")
    assert broken.failure == os.strerror(errno.ECONNRESET)

    with socket.socket() as bound:
        bound.bind((HOST, 0))
        refused = sockets.open(HOST, bound.getsockname()[1])
        await until(lambda: refused.state == "closed")
    assert refused.failure == os.strerror(errno.ECONNREFUSED)


async def test_an_unresolvable_name_is_a_failure_with_a_reason(sockets: NetworkSockets) -> None:
    nowhere = sockets.open("host.invalid", 50002)
    async with timeout(20):
        while nowhere.state != "closed":
            await asyncio.sleep(0.005)
    assert nowhere.failure
    assert "Unknown error" not in nowhere.failure


# the control API


async def reaches(sockets: NetworkSockets, address: str, port: int) -> bool:
    opened = sockets.open(address, port)
    await until(lambda: opened.state != "connecting")
    return opened.state == "open"


@pytest.fixture
async def control() -> AsyncIterator[int]:
    """The port of a control API on 127.0.0.1, of another robot in this process."""
    controller = ControllerConfig(model=load_model("ur3"))
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        yield emulator.ports["control"]


@pytest.mark.parametrize("address", [HOST, "localhost", "0.0.0.0", "::ffff:127.0.0.1", "2130706433", "127.1", "name"])
async def test_the_control_api_is_refused_for_any_spelling_of_its_address(
    address: str, control: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if address == "name":
        resolve_names(monkeypatch, name=[HOST])
    notes: list[str] = []
    sockets = NetworkSockets(note=notes.append)
    assert not await reaches(sockets, address, control)
    (note,) = notes
    assert note.startswith(f"a script may not connect to {address}:{control}")
    assert "control API" in note
    assert "--script-network any-and-control" in note
    await sockets.close()


async def test_a_name_with_other_addresses_too_uses_only_those(
    control: int, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolve_names(monkeypatch, both=["127.0.0.9", HOST])
    sockets = NetworkSockets()
    assert await sockets._permitted("both", control) == [("127.0.0.9", control)]
    assert await sockets._permitted("both", peer.port) == [("127.0.0.9", peer.port), (HOST, peer.port)]


@pytest.mark.parametrize("network", list(ScriptNetwork))
async def test_the_control_api_is_reachable_only_if_allowed(network: ScriptNetwork, control: int) -> None:
    sockets = NetworkSockets(network)
    assert await reaches(sockets, HOST, control) == (network is ScriptNetwork.ANY_AND_CONTROL)
    await sockets.close()


@pytest.mark.skipif(sys.platform != "linux", reason="control APIs of other processes are recognised on Linux only")
async def test_the_control_api_of_another_process_is_recognised() -> None:
    """As in a fleet, whose robots are in several processes, and with robots of other tests."""
    with EmulatorProcess(["--ephemeral-ports"]) as other:
        port = other.ports["control"]
        assert is_backdoor(other.host, port)
        assert not is_backdoor(other.host, other.ports["dashboard"])
        assert not await reaches(NetworkSockets(), other.host, port)
    assert not is_backdoor(other.host, port), "the mark is gone with its process"


async def test_a_pendant_is_refused_like_a_control_api() -> None:
    listening = await asyncio.start_server(lambda reader, writer: writer.close(), HOST, 0)
    port = listening.sockets[0].getsockname()[1]
    mark = BackdoorMark(HOST, port)  # like a pendant in its own process
    try:
        assert not await reaches(NetworkSockets(), HOST, port)
        assert await reaches(NetworkSockets(ScriptNetwork.ANY_AND_CONTROL), HOST, port)
    finally:
        mark.close()
    assert await reaches(NetworkSockets(), HOST, port)
    listening.close()


async def test_a_control_api_on_all_interfaces_is_recognised_by_each_address() -> None:
    port = 1  # not used by an emulator that runs at the same time
    mark = BackdoorMark("0.0.0.0", port)
    try:
        assert is_backdoor(HOST, port)
        assert is_backdoor("127.0.0.77", port)
        assert not is_backdoor("192.0.2.1", port), "of another machine"
        assert not is_backdoor("::1", port)
    finally:
        mark.close()
    assert not is_backdoor(HOST, port)


def turn_an_input_on(port: int) -> str:
    """A program that sends this request to a control API, byte by byte where URScript has no escapes."""
    head = ["POST /verbs/set_digital_input HTTP/1.1", f"Host: {HOST}", "Content-Type: application/json"]
    lines = [f'socket_send_string("{line}")\nendline()' for line in (*head, "Content-Length: 24", "")]
    body = "socket_send_byte(34)\n".join(
        f'socket_send_string("{part}")\n' for part in ["{", "index", ":0,", "level", ":true}"]
    )
    return "\n".join(
        [
            "def prog():",
            "def endline():\nsocket_send_byte(13)\nsocket_send_byte(10)\nend",
            f'opened = socket_open("{HOST}", {port})',
            *lines,
            f'{body}sleep(0.1)\ntextmsg("opened ", opened)\nend\n',
        ]
    )


@pytest.mark.parametrize("network", [ScriptNetwork.ANY, ScriptNetwork.ANY_AND_CONTROL])
async def test_a_program_uses_its_own_control_api_only_if_allowed(network: ScriptNetwork) -> None:
    controller = ControllerConfig(model=load_model("ur5e"), running=True)
    config = EmulatorConfig(controller=controller, ephemeral_ports=True, script_network=network)
    async with Emulator(config) as emulator:
        emulator.controller.programs.submit(turn_an_input_on(emulator.ports["control"]))
        log = emulator.controller.messages.history
        await until(lambda: any("opened " in line for line in log))
        allowed = network is ScriptNetwork.ANY_AND_CONTROL
        assert any(line.endswith(f"opened {allowed}") for line in log)
        assert bool(emulator.controller.snapshot.actual_digital_input_bits & 1) is allowed


async def test_a_remote_procedure_call_does_not_reach_the_control_api() -> None:
    controller = ControllerConfig(model=load_model("ur5e"), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        url = f"http://{HOST}:{emulator.ports['control']}/"
        emulator.controller.programs.submit(f'def prog():\n rpc_factory("xmlrpc", "{url}").ports()\nend\n')
        log = emulator.controller.messages.history
        await until(lambda: any("belongs to a control API" in line for line in log))


async def test_a_program_reaches_its_own_script_port_as_on_an_arm() -> None:
    controller = ControllerConfig(model=load_model("ur3"), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        emulator.controller.programs.submit(
            f'def prog():\n socket_open("{HOST}", 30002)\n socket_send_line("set_standard_digital_out(3, True)")\n'
            " sleep(0.2)\nend\n"
        )
        await until(lambda: bool(emulator.controller.snapshot.actual_digital_output_bits & 8))
