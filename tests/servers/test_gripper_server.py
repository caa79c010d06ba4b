"""The gripper's port, to external clients and to programs of the controller it is mounted on."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig, choose_gripper
from emulator.machine import ControllerConfig
from emulator.ports import PORTS
from emulator.readiness import check_ready
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.script_sockets import OwnPorts
from emulator.services.sockets import ScriptNetwork
from tests.ticking import StepClock
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.primary.messages import TextMessage
from urproto.robotiq import MODELS, Get, Status
from urproto.robots import load_model

HOST = "127.0.0.1"
MODEL = MODELS["robotiq-2f-85"]


def config(model: str = "ur3", **more: object) -> EmulatorConfig:
    controller = ControllerConfig(model=load_model(model), running=True, gripper=MODEL, gripper_object_mm=30.0)
    return EmulatorConfig(controller=controller, ephemeral_ports=True, **more)  # type: ignore[arg-type]


@pytest.fixture(params=["ur3", "ur5e"])
async def emulator(request: pytest.FixtureRequest) -> AsyncIterator[Emulator]:
    async with Emulator(config(request.param), StepClock()) as emulator:
        yield emulator


class Client:
    def __init__(self, emulator: Emulator, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.emulator = emulator
        self.reader = reader
        self.writer = writer

    async def request(self, request: bytes) -> bytes:
        """The answer, after any number of control periods."""
        self.writer.write(request)
        answer = asyncio.create_task(self.reader.read(1000))
        async with timeout(10):
            while not answer.done():
                await asyncio.sleep(0)
                self.emulator.controller.tick()
        return answer.result()


@pytest.fixture
async def client(emulator: Emulator) -> AsyncIterator[Client]:
    reader, writer = await asyncio.open_connection(HOST, emulator.ports["gripper"])
    yield Client(emulator, reader, writer)
    writer.close()
    await writer.wait_closed()


async def test_a_client_grips_something(emulator: Emulator, client: Client) -> None:
    gripper = emulator.controller.gripper
    assert gripper is not None
    assert await client.request(b"GET STA\n") == b"STA 0\n"
    assert await client.request(b"SET ACT 1\n") == b"ack"
    while await client.request(b"GET STA\n") != b"STA 3\n":
        pass
    assert await client.request(b"SET POS 255 SPE 255 FOR 10 GTO 1\n") == b"ack"
    assert await client.request(b"GET PRE\n") == b"PRE 255\n"
    while await client.request(b"GET OBJ\n") == b"OBJ 0\n":
        pass
    assert await client.request(b"GET OBJ\nGET POS\nGET FLT\n") == b"OBJ 2\nPOS 150\nFLT 00\n", "in one piece"
    assert gripper.position == pytest.approx(MODEL.count(30.0))


async def test_both_dialects_on_one_connection(client: Client) -> None:
    assert await client.request(b"GET PRE") == b"000"
    assert await client.request(b"GET PRE\n") == b"PRE 000\n"
    assert await client.request(b"rubbish\n") == b"nack"
    assert await client.request(b"GET DST") == b"4"


async def test_the_last_request_is_answered_before_the_connection_ends(emulator: Emulator, client: Client) -> None:
    client.writer.write(b"GET STA\nGET POS")
    client.writer.write_eof()
    answer = asyncio.create_task(client.reader.read(-1))
    async with timeout(10):
        while not answer.done():
            await asyncio.sleep(0)
            emulator.controller.tick()
    assert answer.result() == b"STA 0\n3"


async def test_a_flood_ends_only_its_own_connection(emulator: Emulator, client: Client) -> None:
    _, flooding = await asyncio.open_connection(HOST, emulator.ports["gripper"])
    flooding.write(b"x" * 100_000)
    server = emulator.servers["gripper"]
    async with timeout(10):
        while len(server.connections) != 1:
            await asyncio.sleep(0)
    assert await client.request(b"GET STA\n") == b"STA 0\n"
    flooding.transport.abort()


async def test_hooks_see_and_change_requests(emulator: Emulator, client: Client) -> None:
    seen = []

    def hook(connection: Connection, direction: Direction, message: object) -> object:
        seen.append((direction, message))
        return Get("STA") if message == Get("POS") else message

    emulator.servers["gripper"].hooks.on_message.append(hook)
    assert await client.request(b"GET POS\n") == b"STA 0\n"
    assert seen == [(Direction.RECEIVED, Get("POS")), (Direction.SENT, b"STA 0\n")]


PROGRAM = """
def grip():
  opened = socket_open("127.0.0.1", 63352, "gripper")
  textmsg("opened ", opened)
  socket_set_var("SID", 9, "gripper")
  textmsg("sid ", socket_read_byte_list(3, "gripper"))
  socket_set_var("ACT", 1, "gripper")
  ack = socket_read_byte_list(3, "gripper")
  state = [0, 0]
  while state[1] != 51:
    socket_send_string("GET STA", "gripper")
    state = socket_read_byte_list(1, "gripper")
  end
  socket_send_string("SET POS", "gripper")
  socket_send_byte(32, "gripper")
  socket_send_string(255, "gripper")
  socket_send_byte(32, "gripper")
  socket_send_string("GTO 1", "gripper")
  socket_send_byte(10, "gripper")
  ack = socket_read_byte_list(3, "gripper")
  while socket_get_var("OBJ", "gripper") == 0:
    sleep(0.01)
  end
  textmsg("held ", socket_get_var("OBJ", "gripper"))
  textmsg("at ", socket_get_var("POS", "gripper"))
end
"""


@pytest.mark.parametrize("network", [ScriptNetwork.ANY, ScriptNetwork.LOOPBACK])
async def test_a_program_reaches_the_gripper_of_its_own_controller(network: ScriptNetwork) -> None:
    """By the usual address and port, regardless of where the emulator listens."""
    async with Emulator(config(host="127.94.63.35", script_network=network), StepClock()) as emulator:
        controller = emulator.controller
        texts = []
        controller.subscribe(lambda snapshot: texts.extend(snapshot.messages))
        controller.programs.submit(PROGRAM)
        async with timeout(30):
            while controller.programs.busy:
                controller.tick()
                await asyncio.sleep(0)
        sent_texts = [message.text for message in texts if isinstance(message, TextMessage)]
        assert sent_texts == ["opened True", "sid [3,97,99,107]", "held 2", "at 150"]
        assert controller.programs.state is RuntimeState.STOPPED
        assert controller.gripper is not None
        assert controller.gripper.status is Status.ACTIVE


@pytest.mark.parametrize("address", ["127.0.0.1", "localhost"])
async def test_a_program_reaches_the_dashboard_of_its_own_controller(address: str) -> None:
    async with Emulator(config(host="127.94.63.36")) as emulator:  # in real time: names are looked up in a thread
        controller = emulator.controller
        texts = []
        controller.subscribe(lambda snapshot: texts.extend(snapshot.messages))
        controller.programs.submit(
            f'def ask():\n  socket_open("{address}", 29999)\n  socket_read_line()\n'
            '  socket_send_line("robotmode")\n  textmsg(socket_read_line())\nend\n'
        )
        ended = asyncio.Event()
        controller.subscribe(lambda snapshot: None if controller.programs.busy else ended.set())
        async with timeout(30):
            await ended.wait()
        assert [message.text for message in texts if isinstance(message, TextMessage)] == ["Robotmode: RUNNING"]


def test_connections_to_own_ports_are_redirected() -> None:
    own = OwnPorts()
    assert own.reach("127.0.0.1", 29999) == ("127.0.0.1", 29999), "not open yet"
    own.opened("0.0.0.0", {29999: 30099, 502: 4000})
    assert own.reach("127.0.0.1", 29999) == ("127.0.0.1", 30099)
    assert own.reach("::1", 502) == ("127.0.0.1", 4000)
    assert own.reach("127.0.0.1", 50002) == ("127.0.0.1", 50002), "a driver's"
    assert own.reach("127.0.0.2", 29999) == ("127.0.0.2", 29999), "another robot's"


async def test_signals_of_a_program_reach_its_own_modbus_server() -> None:
    async with Emulator(config(host="127.94.63.37"), StepClock()) as emulator:
        controller = emulator.controller
        controller.modbus_registers.general[2] = 4711
        controller.programs.submit(
            'def ask():\n  modbus_add_signal("127.0.0.1", 255, 130, 2, "own")\n'
            '  while modbus_get_signal_status("own") != 4711:\n    sync()\n  end\nend\n'
        )
        async with timeout(30):
            while controller.programs.busy:
                controller.tick()
                await asyncio.sleep(0)
        assert controller.programs.state is RuntimeState.STOPPED


async def test_the_gripper_port_opens_only_with_a_gripper(emulator: Emulator) -> None:
    assert "gripper" in emulator.ports
    without = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")))
    assert "gripper" not in without.wanted_ports
    assert config().wanted_ports["gripper"] == 0
    assert "gripper" not in Emulator(without, StepClock()).servers
    assert PORTS["gripper"] == 63352


async def test_readiness() -> None:
    async with Emulator(config()) as emulator:
        await check_ready(HOST, emulator.ports)


def test_invalid_configurations() -> None:
    assert choose_gripper(None, None) is None
    assert choose_gripper("Robotiq-2F-85", 30.0) is MODEL
    for name, width, problem in (
        ("hand", None, "unknown gripper 'hand': choose one of robotiq-2f-85"),
        (None, 30.0, "no effect without a gripper"),
        ("robotiq-2f-85", 85.0, "narrower than 85 mm"),
        ("robotiq-2f-85", float("nan"), "wider than 0"),
    ):
        with pytest.raises(ConfigError, match=problem):
            choose_gripper(name, width)
    controller = ControllerConfig(model=load_model("ur3"), gripper=MODEL)
    with pytest.raises(ConfigError, match="must be from 0 to 2183"):
        EmulatorConfig(controller=controller, port_offset=2184)
