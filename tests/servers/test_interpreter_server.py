"""Port 30020: the server alone, and a client of a whole emulator over TCP."""

import asyncio
import re
from collections.abc import AsyncIterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from server_rig import E_SERIES, FakeController, MemoryClient

from emulator.app import Emulator, make_servers
from emulator.commands.requests import InterpreterLine
from emulator.config import EmulatorConfig
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.readiness import NotReady, check_ready
from emulator.servers.hooks import Direction
from emulator.servers.requests import InterpreterServer
from tests.budget import examples
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.interpreter import MAX_LINE
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

HOST = "127.0.0.1"
NO_PROGRAM = "discard: Program is in an invalid state: "


@pytest.fixture
def controller() -> FakeController:
    return FakeController(E_SERIES)


@pytest.fixture
def server(controller: FakeController) -> InterpreterServer:
    return InterpreterServer(controller)


def lines(controller: FakeController) -> list[InterpreterLine]:
    assert all(isinstance(command, InterpreterLine) for command in controller.commands)
    return controller.commands  # type: ignore[return-value]


@pytest.mark.parametrize("chunk", [1, 1000])
def test_lines_of_a_client_arrive_together(server: InterpreterServer, controller: FakeController, chunk: int) -> None:
    client = MemoryClient(server)
    client.feed(b"x = 1\r\n\nabort\nhalf", chunk)
    controller.tick()
    assert [line.text for line in lines(controller)] == ["x = 1", "", "abort"]
    assert client.take() == b""


def test_answers_go_to_the_requesting_client(server: InterpreterServer, controller: FakeController) -> None:
    first, second = MemoryClient(server), MemoryClient(server)
    first.feed(b"a\nb\n")
    second.feed(b"\xffc\n")
    controller.tick()
    for line in reversed(lines(controller)):
        line.answer(f"ack: 0: {line.text}")
    assert first.take() == b"ack: 0: b\nack: 0: a\n"
    assert second.take() == b"ack: 0: \xffc\n", "a statement is returned unchanged"


def test_answers_for_a_disconnected_client(server: InterpreterServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"a\n")
    client.vanish()
    controller.tick()
    lines(controller)[0].answer("ack: 1: a")


def test_a_half_closed_client_gets_its_answers(server: InterpreterServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"a\nb\nc")
    client.end()
    controller.tick()
    assert [line.text for line in lines(controller)] == ["a", "b"], "a statement needs a line end"
    lines(controller)[0].answer("ack: 1: a")
    assert client.connected
    lines(controller)[1].answer("ack: 2: b")
    assert client.take() == b"ack: 1: a\nack: 2: b\n"
    assert not client.connected


def test_a_line_that_is_too_long_is_discarded_and_the_connection_stays(
    server: InterpreterServer, controller: FakeController
) -> None:
    client = MemoryClient(server)
    client.feed(b"y" * (MAX_LINE + 1) + b"\nx = 1\n")
    controller.tick()
    assert [line.text for line in lines(controller)] == ["x = 1"]
    assert client.take() == b"discard: Statement is too long: " + b"y" * 60 + b"\n"
    assert client.connected


def test_a_flood_is_read_no_faster_than_it_is_executed(server: InterpreterServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"x\n" * 1000)
    assert not client.transport.is_reading()
    controller.tick()
    assert 0 < len(controller.commands) < 200
    controller.tick(20)
    assert len(controller.commands) == 1000
    assert client.transport.is_reading()


def test_hooks_see_lines(server: InterpreterServer, controller: FakeController) -> None:
    server.hooks.on_message.append(
        lambda connection, direction, line: None if "secret" in line else f"{direction.value} {line}"
    )
    client = MemoryClient(server)
    client.feed(b"secret\na\n")
    controller.tick()
    assert [line.text for line in lines(controller)] == ["received a"]
    lines(controller)[0].answer("ack")
    assert client.take() == f"{Direction.SENT.value} ack\n".encode()


@each_row(
    ("model", "version", "there"), [("ur3", "3.14", 0), ("ur3", "3.15", 1), ("ur5e", "5.9", 0), ("ur5e", "5.10", 1)]
)
def test_versions(model: str, version: str, there: bool) -> None:
    config = ControllerConfig(model=load_model(model), version=PolyscopeVersion.parse(version))
    names = [server.name for server in make_servers(Controller(config))]
    assert ("interpreter" in names) is bool(there)
    assert set(EmulatorConfig(controller=config, control=False).wanted_ports) == set(names)


# a whole emulator


class Client:
    """Reads answers byte by byte with the same pattern as the vendor's helper."""

    REPLY = re.compile(r"(\w+):\W+(\d+)?")

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def connect(cls, emulator: Emulator) -> "Client":
        return cls(*await asyncio.open_connection(HOST, emulator.ports["interpreter"]))

    async def answer(self) -> str:
        async with timeout(10):
            return (await self.reader.readline()).decode().rstrip("\n")

    async def request(self, line: str) -> str:
        self.writer.write(f"{line}\n".encode())
        return await self.answer()

    async def number(self, line: str) -> int:
        match = self.REPLY.match(await self.request(line))
        assert match is not None
        assert match[1] in ("ack", "state"), match.string
        return int(match[2])


@pytest.fixture(params=["ur3", "ur5e"])
async def emulator(request: pytest.FixtureRequest) -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model(request.param), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, speed=5.0)) as emulator:
        yield emulator


async def begin(emulator: Emulator, script: bytes = b"interpreter_mode()\n") -> asyncio.StreamWriter:
    """Send a script and wait until it is in interpreter mode."""
    _, writer = await asyncio.open_connection(HOST, emulator.ports["secondary"])
    writer.write(script)
    async with timeout(10):
        while not emulator.controller.programs.interpreter.active:
            await asyncio.sleep(0)
    return writer


async def test_a_session(emulator: Emulator) -> None:
    client = await Client.connect(emulator)
    assert await client.request("x = 1") == NO_PROGRAM + "x = 1"
    script = await begin(emulator)
    goal = "[0.4, -1.57, 0.3, -1.57, 0, 0]"
    assert await client.request(f"movej({goal}, a=3, v=1)") == f"ack: 1: movej({goal}, a=3, v=1)"
    assert await client.number("movej([2.0, -1.57, 0, -1.57, 0, 0])") == 2
    assert await client.request("set_digital_out(") == "discard: Syntax error: set_digital_out("
    last = await client.number("set_digital_out(2, True)")
    async with timeout(20):
        while await client.number("statelastexecuted") < 2:
            await asyncio.sleep(0)
        while emulator.controller.snapshot.target_q[0] < 0.5:
            await asyncio.sleep(0)
        assert await client.number("stateunexecuted") == 1
        await client.number("abort")
        while await client.number("statelastexecuted") < last:
            await asyncio.sleep(0)
        while not emulator.controller.snapshot.actual_digital_output_bits:
            await asyncio.sleep(0)
    assert 0.5 <= emulator.controller.snapshot.actual_q[0] < 1.9
    assert await client.number("clear_interpreter()") == last + 1
    assert await client.number("end_interpreter()") == last + 2
    async with timeout(10):
        while not (await client.request("statelastexecuted")).startswith(NO_PROGRAM):
            await asyncio.sleep(0)
    client.writer.close()
    script.close()


async def test_several_clients_share_one_queue(emulator: Emulator) -> None:
    clients = [await Client.connect(emulator) for _ in range(4)]
    script = await begin(emulator, b"def p():\n  global n = 0\n  interpreter_mode()\nend\n")
    for client in clients:
        client.writer.write(b"n = n + 1\n" * 50)
    answers = [[await client.answer() for _ in range(50)] for client in clients]
    assert sorted(int(answer.split(": ")[1]) for each in answers for answer in each) == list(range(1, 201))
    for each in answers:
        ids = [int(answer.split(": ")[1]) for answer in each]
        assert ids == sorted(ids)
    async with timeout(10):
        while emulator.controller.programs.variables["n"] != 200:
            await asyncio.sleep(0)
    for client in clients:
        client.writer.close()
    script.close()


async def test_a_client_that_sends_and_disconnects(emulator: Emulator) -> None:
    script = await begin(emulator, b"def p():\n  global n = 0\n  interpreter_mode()\n  sleep(100)\nend\n")
    client = await Client.connect(emulator)
    client.writer.write(b"n = 1\nn = n * 5\nend_interpreter()\n")
    client.writer.close()
    async with timeout(10):
        while emulator.controller.programs.interpreter.active:
            await asyncio.sleep(0)
    assert emulator.controller.programs.variables["n"] == 5
    script.close()


async def test_readiness_sends_a_real_request(emulator: Emulator) -> None:
    await check_ready(HOST, {"interpreter": emulator.ports["interpreter"]})

    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"Connected: something else\n")
        writer.close()

    other = await asyncio.start_server(greet, HOST, 0)
    port = other.sockets[0].getsockname()[1]
    with pytest.raises(NotReady, match=rf"interpreter port {port}.*not an answer of interpreter mode"):
        await check_ready(HOST, {"interpreter": port})
    other.close()


# garbage


class Running:
    """A controller in interpreter mode, which is restarted after it ended."""

    def __init__(self) -> None:
        self.controller = Controller(ControllerConfig(model=load_model("ur5e"), running=True))
        (self.server,) = (server for server in make_servers(self.controller) if server.name == "interpreter")

    def begin(self) -> None:
        programs = self.controller.programs
        if not programs.interpreter.active:
            programs.submit("def p():\n  while True:\n    interpreter_mode()\n  end\nend\n")
        for _ in range(50):
            self.controller.tick()
        assert programs.interpreter.active


@pytest.fixture(scope="module")
def running() -> Running:
    return Running()


@settings(max_examples=examples(20), deadline=None)
@given(
    data=st.binary(max_size=200) | st.text('abx=()1 "\n\r#:', max_size=200).map(str.encode), chunk=st.integers(1, 50)
)
def test_any_bytes(running: Running, data: bytes, chunk: int) -> None:
    """One answer for each line, the other client is served, and the server keeps running."""
    running.begin()
    other, client = MemoryClient(running.server), MemoryClient(running.server)
    client.feed(data, chunk)
    for _ in range(20):
        running.controller.tick()
    assert client.take().count(b"\n") == data.count(b"\n")
    running.begin()
    other.feed(b"sync()\n")
    running.controller.tick()
    assert re.fullmatch(rb"ack: \d+: sync\(\)\n|discard: Too many.*\n", other.take())
    other.feed(b"clear_interpreter()\n")
    running.controller.tick()
    other.vanish()
    client.vanish()
