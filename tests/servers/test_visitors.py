"""Web pages at the ports of a robot: nothing that a browser sends is executed, for any split into segments."""

import struct
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from server_rig import E_SERIES, FakeController, MemoryClient

from emulator.app import make_servers
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.servers.admission import Reason
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer
from emulator.servers.web import Opening, visitor
from tests.budget import examples
from tests.rows import each_row
from urproto.robotiq import MODELS
from urproto.robots import load_model
from urproto.rtde.codec import InputData, SetupInputs

SCRIPT = b"def page():\n  set_standard_digital_out(0, True)\nend\n"
LINES = b"power on\nstop\npopup hello\n"
REQUESTS = {
    "a POST": b"POST / HTTP/1.1\r\nHost: 127.0.0.1:30002\r\nContent-Type: text/plain\r\n\r\n" + SCRIPT,
    "a long path": b"POST /" + b"x" * 5000 + b" HTTP/1.1\r\n\r\n" + SCRIPT,
    "a form": b"POST /a?b=c HTTP/1.1\r\nOrigin: http://evil.example\r\n\r\nx=\r\n" + LINES,
    "a GET": b"GET /robotmode HTTP/1.1\r\nHost: a\r\n\r\n" + LINES,
    "a preflight": b"OPTIONS * HTTP/1.1\r\nAccess-Control-Request-Method: PUT\r\n\r\n" + SCRIPT,
    "a PUT": b"PUT /x HTTP/1.1\n\n" + SCRIPT,
    "a proxy's": b"GET http://127.0.0.1:30002/ HTTP/1.1\r\n\r\n" + LINES,
    "a tunnel": b"CONNECT 127.0.0.1:30002 HTTP/1.1\r\n\r\n" + SCRIPT,
    "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + SCRIPT,
    "a WebSocket": b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\r\n" + SCRIPT,
}
TICKET = b"\npower on\n" + SCRIPT  # chosen by the page's server and returned by the browser
HELLO = b"\1" + (len(TICKET) + 36).to_bytes(3, "big") + b"\3\3" + bytes(34) + TICKET
TLS = b"\x16\3\1" + len(HELLO).to_bytes(2, "big") + HELLO
SENT = {**REQUESTS, "TLS": TLS}
TEXT_PORTS = ["dashboard", "primary", "secondary", "realtime", "interpreter", "gripper"]
PORTS = [*TEXT_PORTS, "primary read-only", "secondary read-only", "realtime read-only", "modbus", "rtde", "tool line"]


def make_ports() -> tuple[FakeController, dict[str, PortServer]]:
    """All ports of an arm, which records its commands."""
    config = ControllerConfig(model=load_model("ur5e"), gripper=MODELS["robotiq-2f-85"])
    fake = FakeController(E_SERIES)
    servers = {server.name: server for server in make_servers(Controller(config), tool_line=True)}
    for server in servers.values():
        server.controller = fake
    return fake, servers


@pytest.fixture(scope="module")
def ports() -> tuple[FakeController, dict[str, PortServer]]:
    return make_ports()


def test_all_ports_are_tested(ports: tuple[FakeController, dict[str, PortServer]]) -> None:
    assert set(ports[1]) == set(PORTS)


def splits(data: bytes) -> Iterator[list[bytes]]:
    """As a whole, in two pieces at every position of the first line, and byte by byte."""
    yield [data]
    for place in range(1, 40):
        yield [data[:place], data[place:]]
    yield [bytes([byte]) for byte in data]


def send(fake: FakeController, server: PortServer, pieces: list[bytes]) -> MemoryClient:
    """Each piece in a separate control period, as long as the connection is open, then the end."""
    client = MemoryClient(server)
    for piece in pieces:
        client.feed(piece)
        if not client.connected:
            break
        fake.tick()
    client.end()
    fake.tick(2)
    client.vanish()
    return client


@each_row("port", [port for port in PORTS if port != "tool line"])
@each_row("what", SENT)
def test_browser_requests_are_not_executed_in_any_split(
    ports: tuple[FakeController, dict[str, PortServer]], port: str, what: str
) -> None:
    fake, servers = ports
    server = servers[port]
    for number, pieces in enumerate(splits(SENT[what])):
        fake.commands.clear()
        client = send(fake, server, pieces)
        assert client.transport.aborted, (number, pieces[0])
        assert not fake.commands, (number, pieces[0])


@settings(max_examples=examples(66), deadline=None)
@given(data=st.sampled_from(sorted(SENT.values())), cuts=st.lists(st.integers(1, 200), max_size=8))
def test_browser_requests_are_not_executed_in_many_pieces(data: bytes, cuts: list[int]) -> None:
    opening = Opening(patient=True)
    for start, end in pairwise(sorted({0, *cuts, len(data)})):
        assert opening.feed(data[start:end]) == b""
        if isinstance(opening.verdict, Reason):
            return
    raise AssertionError("not known for what it is")


def test_the_tool_line_passes_possible_device_data_but_no_request_body(
    ports: tuple[FakeController, dict[str, PortServer]],
) -> None:
    fake, servers = ports
    server = servers["tool line"]
    for data in SENT.values():
        for pieces in splits(data):
            fake.commands.clear()
            client = send(fake, server, pieces)
            assert client.transport.aborted
            passed = b"".join(command.data for command in fake.commands)  # type: ignore[attr-defined]
            assert data.startswith(passed)
            assert len(passed) <= max(len(data.partition(b" HTTP")[0]) + 6 if data[0] != 0x16 else 8, 8)
            assert len(pieces) > 1 or not passed
    client = MemoryClient(server)
    fake.commands.clear()
    client.feed(b"P")
    fake.tick()
    assert [command.data for command in fake.commands] == [b"P"]  # type: ignore[attr-defined]
    client.feed(b"ING\n")
    fake.tick()
    assert [command.data for command in fake.commands] == [b"P", b"ING\n"]  # type: ignore[attr-defined]


def rtde_body() -> bytes:
    """``POS`` reads as a start package of 20559 bytes, and a page controls the data after it."""
    head = b"POST / HTTP/1.1\r\nHost: 127.0.0.1:30004\r\n\r\n"
    inputs = SetupInputs(("speed_slider_mask", "speed_slider_fraction")).encode(1)
    return head + b" " * (0x504F - len(head)) + inputs + InputData(1, struct.pack(">Id", 1, 0.0)).encode(1)


@pytest.mark.parametrize("judged", [True, False])
@pytest.mark.parametrize(
    ("port", "data"),
    [
        ("rtde", rtde_body()),
        ("secondary", REQUESTS["a POST"]),
        ("dashboard", REQUESTS["a form"]),
        ("dashboard", TLS),
        ("interpreter", REQUESTS["a POST"]),
        ("gripper", b"POST / HTTP/1.1\r\n\r\nSET ACT 1\n"),
    ],
)
def test_the_requests_would_be_executed_without_the_check(
    ports: tuple[FakeController, dict[str, PortServer]],
    port: str,
    data: bytes,
    judged: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Connection, "for_browsers", not judged)
    fake, servers = ports
    fake.tick(5)  # earlier data
    fake.commands.clear()
    client = MemoryClient(servers[port])
    client.feed(data)
    fake.tick(5)
    client.vanish()
    assert bool(fake.commands) is not judged


@each_row("port", TEXT_PORTS)
@each_row("chunk", [1, 4096])
@each_row(
    "data",
    [
        SCRIPT,
        LINES,
        b"P = 1\n",
        b"GET = POST / HEAD\n",
        b"GET /\n",
        b"POSE",
        b"A * B\n",
        b"load /programs/x.urp\n",
        b"popup /status HTTP/1.1 is not for robots\n",
        b"GET POS\nGET STA",
        b"SET ACT 1\n",
        b"\n\nGET / HTTP/1.1\n",
        b"\x16",
        b"\x16\x04text\n",
    ],
)
def test_robot_clients_are_accepted(
    ports: tuple[FakeController, dict[str, PortServer]], port: str, data: bytes, chunk: int
) -> None:
    _, servers = ports
    received = bytearray()
    client = MemoryClient(servers[port])
    client.connection.received = received.extend  # type: ignore[method-assign]
    client.feed(data, chunk)
    assert client.connected
    client.end()
    client.vanish()
    assert received == data


@given(address=st.integers(0, 0xFFFF), count=st.integers(1, 125), crc=st.binary(min_size=2, max_size=2))
@example(address=0x0100, count=1, crc=b"\x12\x34")
def test_modbus_rtu_of_unit_22_is_not_a_tls_handshake(address: int, count: int, crc: bytes) -> None:
    request = b"\x16\3" + struct.pack(">HH", address, count) + crc
    verdict = visitor(request)
    assert not isinstance(verdict, Reason)
    assert verdict is False or crc[0] == 0, "eight bytes, and the device waits for them"


@given(st.binary(max_size=40), st.integers(1, 5))
def test_the_classification_does_not_depend_on_the_split(data: bytes, chunk: int) -> None:
    verdict = visitor(data)
    opening = Opening(patient=True)
    passed = b""
    for start in range(0, len(data), chunk):
        passed += opening.feed(data[start : start + chunk])
        if opening.verdict is not True:
            break
    else:
        assert verdict is True
        assert passed + opening.rest() == data
        return
    assert opening.verdict == (verdict if verdict is not True else opening.verdict)


def test_browser_requests_are_counted_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    server = make_ports()[1]["dashboard"]
    for _ in range(5):
        MemoryClient(server).feed(REQUESTS["a POST"])
    MemoryClient(server).feed(TLS)
    MemoryClient(server).feed(b"robotmode\n")
    assert server.turned_away.counts == {"http": 5, "tls": 1}
    first, second = (record.getMessage() for record in caplog.records if record.levelname == "WARNING")
    assert "HTTP request" in first
    assert "close the web page" in first
    assert "TLS" in second
    later = make_ports()[1]["dashboard"]
    later.take_over(server)
    assert later.turned_away.counts == {"http": 5, "tls": 1}
