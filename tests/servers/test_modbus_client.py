"""Modbus signals over TCP: a running emulator and independent units (pymodbus's server)."""

import asyncio
import errno
import logging
from collections.abc import AsyncIterator, Callable

import pytest
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.servers.modbus_client import ModbusClient
from emulator.services.modbus import DISCONNECTED, ModbusExchange, ModbusSignal, ModbusUnit
from urproto.compat_asyncio import timeout
from urproto.modbus import Function, ModbusRequest
from urproto.robots import load_model

HOST = "127.0.0.1"
READ = ModbusRequest(Function.READ_HOLDING_REGISTERS, 0, 2)


class Device:
    """An independent Modbus device: coils, inputs and registers 0 to 9, and a record of requests."""

    def __init__(self) -> None:
        self.requests: list[tuple[int, int, list[int] | list[bool] | None]] = []
        self.refusal: ExcCodes | None = None
        blocks = (
            [SimData(0, values=[True, False] * 5, datatype=DataType.BITS)],
            [SimData(0, values=[False, True] * 5, datatype=DataType.BITS)],
            [SimData(0, values=list(range(100, 110)), datatype=DataType.REGISTERS)],
            [SimData(0, values=list(range(65000, 65010)), datatype=DataType.REGISTERS)],
        )
        self.description = SimDevice(0, simdata=blocks, action=self._act)
        self._server: ModbusTcpServer | None = None

    async def _act(self, function, start, address, count, current, values) -> ExcCodes | None:
        self.requests.append((function, address, values))
        return self.refusal

    async def start(self, port: int = 0) -> int:
        self._server = ModbusTcpServer(self.description, address=(HOST, port))
        await self._server.serve_forever(background=True)
        assert self._server.transport is not None
        return int(self._server.transport.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        if self._server is not None:
            await self._server.shutdown()
            self._server = None


@pytest.fixture
async def device() -> AsyncIterator[Device]:
    device = Device()
    yield device
    await device.stop()


@pytest.fixture(autouse=True)
def nothing_leaks(caplog: pytest.LogCaptureFixture) -> AsyncIterator[None]:
    """No warning in our log, and no exception in the event loop's default handler."""
    yield
    loud = [
        record for record in caplog.records if record.levelno >= logging.WARNING and record.name != "pymodbus.logging"
    ]
    assert loud == []


def emulator(port: int) -> Emulator:
    controller = ControllerConfig(model=load_model("ur3e"), running=True)
    return Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, modbus_unit_port=port))


async def until(condition: Callable[[], bool]) -> None:
    async with timeout(10):
        while not condition():
            await asyncio.sleep(0.001)


async def finished(running: Emulator, name: str) -> object:
    """The final value of a program's global variable."""
    programs = running.controller.programs
    await until(lambda: name in programs.variables)
    return programs.variables[name]


async def send_script(running: Emulator, text: str) -> None:
    _, writer = await asyncio.open_connection(HOST, running.ports["secondary"])
    writer.write(text.encode())
    await writer.drain()
    writer.close()
    await writer.wait_closed()


def signal(running: Emulator, name: str) -> ModbusSignal:
    return running.controller.programs.modbus.get(name)


async def test_program_reads_and_writes_a_device(device: Device) -> None:
    """In sequential mode, since this device misses requests that arrive together."""
    port = await device.start()
    async with emulator(port) as running:
        await send_script(
            running,
            f"""def prog():
  modbus_add_signal("{HOST}", 255, 1, 0, "di", True)
  modbus_add_signal("{HOST}", 255, 0, 1, "do", True)
  modbus_add_signal("{HOST}", 255, 2, 2, "ri", True)
  modbus_add_signal("{HOST}", 255, 3, 3, "ro", True)
  modbus_add_signal("{HOST}", 255, 0, 15, "coils", True, 10)
  modbus_add_signal("{HOST}", 255, 5, 16, "words", True, 3)
  modbus_add_rw_signal("{HOST}", 255, 0, 2, 8, 2, "rw", True)
  modbus_set_signal_update_frequency("ro", 50)
  while modbus_get_error("rw") != 0 or modbus_get_error("words") != 0:
    sync()
  end
  one = modbus_get_signal_status("di")
  two = [modbus_get_signal_status("ri"), modbus_get_signal_status("ro")]
  bits = modbus_get_signal_status("coils")
  modbus_set_output_register("ro", 4711)
  modbus_set_output_signal("do", False)
  modbus_set_output_register("words", [1, 2])
  modbus_set_output_register("rw", [8, 9])
  done = modbus_get_signal_status("rw")
  while True:
    sync()
  end
end
""",
        )
        assert await finished(running, "done") == [100, 101]
        variables = running.controller.programs.variables
        assert variables["one"] is True
        assert variables["two"] == [65002, 103]
        assert variables["bits"] == [True, False] * 5
        written = {6: [4711], 15: [False], 16: [1, 2, 107], 23: [8, 9]}
        await until(lambda: all((function, values) in device_writes(device) for function, values in written.items()))


def device_writes(device: Device) -> list[tuple[int, object]]:
    return [(function, values) for function, _, values in device.requests if values]


async def test_a_device_connects_disconnects_and_reconnects(device: Device) -> None:
    port = await device.start()
    await device.stop()
    async with emulator(port) as running:
        await send_script(running, f'sec add():\n  modbus_add_signal("{HOST}", 255, 0, 3, "s")\nend\n')
        await until(lambda: len(running.controller.programs.modbus) == 1)
        await until(lambda: signal(running, "s").connection_error == errno.ECONNREFUSED)
        await device.start(port)
        await until(lambda: not signal(running, "s").in_error)
        assert signal(running, "s").values == (100,)
        await device.stop()
        await until(lambda: signal(running, "s").connection_error in (DISCONNECTED, errno.ECONNREFUSED))
        assert signal(running, "s").values == (100,), "the last valid value"


async def test_exception_responses_are_device_errors(device: Device) -> None:
    port = await device.start()
    async with emulator(port) as running:
        add = "".join(
            f'  modbus_add_signal("{HOST}", 1, {address}, 2, "{name}")\n' for name, address in (("a", 0), ("b", 50))
        )
        await send_script(running, f"sec add():\n{add}end\n")
        await until(lambda: len(running.controller.programs.modbus) == 2)
        await until(lambda: signal(running, "b").device_error == 2 and not signal(running, "a").in_error)
        device.refusal = ExcCodes.DEVICE_BUSY
        await until(lambda: signal(running, "a").device_error == 6)


# the backend alone, with devices that misbehave


async def answer(exchange: ModbusExchange) -> tuple[tuple[int, ...], int, int]:
    await until(lambda: exchange.done)
    return exchange.values, exchange.device_error, exchange.connection_error


class Peer:
    """A device whose bytes are written by the test."""

    def __init__(self) -> None:
        self.connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
        self.writers: list[asyncio.StreamWriter] = []

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        await self.connections.put((reader, writer))


@pytest.fixture
async def peer() -> AsyncIterator[tuple[Peer, ModbusClient]]:
    peer = Peer()
    server = await asyncio.start_server(peer.accept, HOST, 0)
    client = ModbusClient(server.sockets[0].getsockname()[1])
    yield peer, client
    await client.close()
    server.close()
    await asyncio.sleep(0.01)  # connections still being accepted
    for writer in peer.writers:
        writer.transport.abort()
    await asyncio.sleep(0)


UNIT = ModbusUnit(HOST, 9)
# As in the examples of the Modbus application protocol, in the header of Modbus/TCP.
ASKED = bytes.fromhex("0001 0000 0006 09 03 0000 0002")
ANSWER = bytes.fromhex("0001 0000 0007 09 03 04 000a 0102")


async def test_frames_byte_by_byte(peer: tuple[Peer, ModbusClient]) -> None:
    there, client = peer
    exchange = client.request(UNIT, READ, sequential=False)
    reader, writer = await there.connections.get()
    assert await reader.readexactly(len(ASKED)) == ASKED
    for byte in ANSWER:
        writer.write(bytes([byte]))
        await asyncio.sleep(0)
    assert await answer(exchange) == ((10, 258), 0, 0)


async def test_requests_do_not_wait_for_answers_unless_they_are_sequential(peer: tuple[Peer, ModbusClient]) -> None:
    there, client = peer
    free = [client.request(UNIT, READ, sequential=False) for _ in range(2)]
    alone = [client.request(UNIT, READ, sequential=True) for _ in range(2)]
    reader, writer = await there.connections.get()
    assert len(await reader.readexactly(24)) == 24
    writer.write(b"\0\2" + ANSWER[2:])  # out of order
    await until(lambda: free[1].done)
    assert not free[0].done
    writer.write(ANSWER)
    assert (await reader.readexactly(12))[:2] == b"\0\3"
    writer.write(b"\0\3" + ANSWER[2:])
    assert (await reader.readexactly(12))[:2] == b"\0\4"
    writer.write(b"\0\4" + ANSWER[2:])
    assert [await answer(exchange) for exchange in (*free, *alone)] == [((10, 258), 0, 0)] * 4
    assert len(there.writers) == 1, "one connection for a unit"


@pytest.mark.parametrize(
    "rubbish",
    [
        b"\0\1\0\0\0\7\t\3\x63\0\x0a\1\2",  # more words promised than sent
        b"\0\1\0\0\0\7\t\4\4\0\x0a\1\2",  # the answer to another function
        b"\0\1\0\0\0\2\t\3",  # nothing after the function code
        b"\0\1\0\5\0\7\t\3\4\0\x0a\1\2",  # another protocol
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
    ],
)
async def test_invalid_data_ends_only_the_connection(peer: tuple[Peer, ModbusClient], rubbish: bytes) -> None:
    there, client = peer
    exchange = client.request(UNIT, READ, sequential=False)
    reader, writer = await there.connections.get()
    await reader.readexactly(12)
    writer.write(rubbish)
    values, device_error, connection_error = await answer(exchange)
    assert (values, device_error) == ((), 0)
    assert connection_error in (errno.EPROTO, DISCONNECTED)
    assert await reader.read() == b""


async def test_a_lost_connection_fails_immediately_and_returns_after_a_pause(peer: tuple[Peer, ModbusClient]) -> None:
    there, client = peer
    exchange = client.request(UNIT, READ, sequential=False)
    reader, writer = await there.connections.get()
    await reader.readexactly(12)
    writer.close()
    assert await answer(exchange) == ((), 0, DISCONNECTED)
    assert await answer(client.request(UNIT, READ, sequential=False)) == ((), 0, DISCONNECTED), (
        "not before the pause is over"
    )
    client.reset(HOST)
    again = client.request(UNIT, READ, sequential=False)
    reader, writer = await there.connections.get()
    writer.write(ANSWER)
    assert await answer(again) == ((10, 258), 0, 0)


async def test_silence_is_a_timeout(peer: tuple[Peer, ModbusClient], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.servers.modbus_client._ANSWER_S", 0.02)
    there, client = peer
    assert await answer(client.request(UNIT, READ, sequential=True)) == ((), 0, errno.ETIMEDOUT)
    reader, writer = await there.connections.get()
    writer.write(ANSWER)  # too late, and ignored
    for _ in range(2):
        assert await answer(client.request(UNIT, READ, sequential=True)) == ((), 0, errno.ETIMEDOUT)
    await reader.read()  # the connection was given up: this ends


async def test_custom_commands_and_their_answers(peer: tuple[Peer, ModbusClient]) -> None:
    there, client = peer
    client.send(UNIT, b"\x41\1\2")
    reader, writer = await there.connections.get()
    assert await reader.readexactly(10) == bytes.fromhex("0001 0000 0004 09 41 01 02")
    writer.write(bytes.fromhex("0001 0000 0004 09 41 07 07"))
    exchange = client.request(UNIT, READ, sequential=False)
    await reader.readexactly(12)
    writer.write(b"\0\2" + ANSWER[2:])
    assert await answer(exchange) == ((10, 258), 0, 0)


async def test_closing_ends_pending_requests(peer: tuple[Peer, ModbusClient]) -> None:
    _, client = peer
    connecting = client.request(UNIT, READ, sequential=False)
    client.release(UNIT)
    assert await answer(connecting) == ((), 0, DISCONNECTED)
    client.request(UNIT, READ, sequential=False)
    await client.close()
    assert [task for task in asyncio.all_tasks() if task is not asyncio.current_task()] == []


async def test_a_flood_is_bounded(peer: tuple[Peer, ModbusClient]) -> None:
    _, client = peer
    exchanges = [client.request(UNIT, READ, sequential=True) for _ in range(300)]
    assert {exchange.connection_error for exchange in exchanges if exchange.done} == {errno.EAGAIN}


async def test_the_number_of_units_is_limited(peer: tuple[Peer, ModbusClient], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.servers.modbus_client._MAX_UNITS", 2)
    _, client = peer
    exchanges = [client.request(ModbusUnit(HOST, slave), READ, sequential=False) for slave in range(3)]
    assert [exchange.connection_error for exchange in exchanges] == [0, 0, errno.EMFILE]
    client.send(ModbusUnit(HOST, 9), b"\1")


@pytest.mark.parametrize("address", ["no.such.host.invalid", "256.0.0.1", "x" * 70 + ".", "\0"])
async def test_impossible_addresses(peer: tuple[Peer, ModbusClient], address: str) -> None:
    _, client = peer
    values, device_error, connection_error = await answer(
        client.request(ModbusUnit(address, 1), READ, sequential=False)
    )
    assert (values, device_error) == ((), 0)
    assert connection_error in (errno.EHOSTUNREACH, errno.EINVAL, errno.ETIMEDOUT)


def test_port_of_units_is_checked() -> None:
    with pytest.raises(ConfigError, match="port of Modbus units must be from 1 to 65535"):
        emulator(0)
