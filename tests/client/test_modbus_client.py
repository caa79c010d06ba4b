"""The client of a robot's Modbus server: against another maker's server, and against an emulator."""

import asyncio
import logging
from collections.abc import AsyncIterator

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from client.errors import ConnectionLostError, NoAnswerError
from client.modbus import BlockingModbusClient, ModbusClient, ModbusCore
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modbus import Frame, Function, ModbusRequest, encode_frame
from urproto.robots import load_model

HOST = "127.0.0.1"


@pytest.fixture
async def other_makers_port() -> AsyncIterator[int]:
    """A unit of pymodbus with coils, inputs and registers 0 to 9."""
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
    blocks = (
        [SimData(0, values=[True, False] * 5, datatype=DataType.BITS)],
        [SimData(0, values=[False] * 10, datatype=DataType.BITS)],
        [SimData(0, values=list(range(100, 110)), datatype=DataType.REGISTERS)],
        [SimData(0, values=[0] * 10, datatype=DataType.REGISTERS)],
    )
    server = ModbusTcpServer(SimDevice(0, simdata=blocks), address=(HOST, 0))
    await server.serve_forever(background=True)
    assert server.transport is not None
    yield int(server.transport.sockets[0].getsockname()[1])
    await server.shutdown()


async def test_registers_and_coils_of_another_maker(other_makers_port: int) -> None:
    async with ModbusClient(HOST, other_makers_port) as client:
        assert await client.read_registers(2, 3) == (102, 103, 104)
        await client.write_registers(0, [1, 0xFFFF])
        await client.write_register(2, 7)
        assert await client.read_registers(0, 3) == (1, 0xFFFF, 7)
        assert await client.read_coils(0, 3) == (1, 0, 1)
        await client.write_coil(1, True)
        assert await client.read_coils(0, 3) == (1, 1, 1)
        with pytest.raises(RobotRefused, match="READ_HOLDING_REGISTERS at 50': exception ILLEGAL"):
            await client.read_registers(50)
        assert await client.read_registers(3) == (103,)


async def test_a_robots_registers() -> None:
    controller = ControllerConfig(model=load_model("ur3"), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        port = emulator.ports["modbus"]
        async with ModbusClient(HOST, port) as client:
            await client.write_register(130, 77)
            assert emulator.controller.modbus_registers.general[2] == 77
            with pytest.raises(RobotRefused, match="WRITE_REGISTER at 99': exception ILLEGAL_DATA_ADDRESS"):
                await client.write_register(99, 1)
        assert await asyncio.to_thread(_blocking, port) == ((77,), (1,))
        assert emulator.controller.signals.digital_outputs == 1


def _blocking(port: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    with BlockingModbusClient(HOST, port) as client:
        client.write_coil(16, True)
        client.write_registers(200, [5, 6])
        client.write_register(200, 4)
        assert client.read_registers(200, 2) == (4, 6)
        return client.read_registers(130), client.read_coils(16)


def test_an_answer_to_a_request_that_was_given_up_is_passed_over() -> None:
    core = ModbusCore()
    given_up = core.request(ModbusRequest(Function.READ_HOLDING_REGISTERS, 0, 1))
    next(given_up)
    given_up.close()
    flow = core.request(ModbusRequest(Function.READ_HOLDING_REGISTERS, 0, 1))
    next(flow)
    next(flow)
    late = encode_frame(Frame(1, 255, b"\x03\x02\x00\x01"))
    right = encode_frame(Frame(2, 255, b"\x03\x02\x00\x02"))
    assert flow.send(late + right[:4]) is None
    with pytest.raises(StopIteration) as end:
        flow.send(right[4:])
    assert end.value.value == (2,)


def test_what_no_message_can_carry_is_not_sent() -> None:
    for function, words in ((Function.WRITE_REGISTER, (0x10000,)), (Function.WRITE_REGISTERS, (0,) * 200)):
        with pytest.raises(LocalProtocolError):
            next(ModbusCore().write(ModbusRequest(function, 0, values=words)))


async def test_a_silent_and_a_vanished_unit() -> None:
    async def gone(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        data = await reader.read(12)
        if data[8]:  # address 256 and up: answer by going away
            writer.close()
        else:
            await reader.read()
            writer.close()

    server = await asyncio.start_server(gone, HOST, 0)
    port = server.sockets[0].getsockname()[1]
    async with server:
        async with ModbusClient(HOST, port) as client:
            with pytest.raises(ConnectionLostError):
                await client.read_registers(256)
        async with ModbusClient(HOST, port, timeout_s=0.05) as client:
            with pytest.raises(NoAnswerError):
                await client.read_registers(0)
