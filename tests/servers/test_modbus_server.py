"""The robot's Modbus/TCP server with an independent client (pymodbus)."""

from collections.abc import AsyncIterator

import pytest
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.pdu import ModbusPDU

from emulator.app import Emulator
from emulator.commands.requests import ModbusCall
from emulator.config import EmulatorConfig
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.servers.hooks import Direction
from urproto.robots import load_model
from urproto.signals import STANDARD

HOST = "127.0.0.1"


@pytest.fixture(params=["ur3", "ur5e"])
async def emulator(request: pytest.FixtureRequest) -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model(request.param), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        yield emulator


@pytest.fixture
async def client(emulator: Emulator) -> AsyncIterator[AsyncModbusTcpClient]:
    client = AsyncModbusTcpClient(HOST, port=emulator.ports["modbus"], retries=0, reconnect_delay=0)
    assert await client.connect()
    yield client
    client.close()


def words(response: ModbusPDU) -> list[int]:
    assert not response.isError(), response
    return list(response.registers)


async def test_state_of_the_arm(emulator: Emulator, client: AsyncModbusTcpClient) -> None:
    version = emulator.controller.version
    assert words(await client.read_holding_registers(256, count=3)) == [version.major, version.minor, 7]
    assert words(await client.read_input_registers(260, count=7)) == [1, 0, 0, 0, 0, 0, 1]
    pose = emulator.controller.snapshot.actual_TCP_pose
    x, y, z, *rotation = (
        client.convert_from_registers([word], client.DATATYPE.INT16)
        for word in words(await client.read_holding_registers(400, count=6))
    )
    assert [x / 10_000, y / 10_000, z / 10_000] == pytest.approx(pose[:3], abs=6e-5)
    assert [angle / 1000 for angle in rotation] == pytest.approx(pose[3:], abs=6e-4)


async def test_a_block_is_read_across_the_gaps_of_the_map(emulator: Emulator, client: AsyncModbusTcpClient) -> None:
    """Where there is nothing to read, it is 0: at 259, at the masks for writing, in reserved ranges, at the end."""
    version = emulator.controller.version
    assert words(await client.read_holding_registers(256, count=8)) == [version.major, version.minor, 7, 0, 1, 0, 0, 0]
    await client.write_registers(128, [11, 12])
    assert words(await client.read_input_registers(0, count=125))[34:] == [0] * 91
    assert words(await client.read_holding_registers(28, count=102))[-2:] == [11, 12]
    assert words(await client.read_holding_registers(255, count=10))[1:5] == [version.major, version.minor, 7, 0]
    assert words(await client.read_holding_registers(2053, count=4))[1:] == [0, 0, 0]
    await client.write_coil(136, True)
    coils = await client.read_coils(128, count=40)
    assert [index for index, level in enumerate(coils.bits[:40]) if level] == [8]


@pytest.mark.parametrize("unit", [0, 1, 255])
async def test_any_unit_number_addresses_the_robot(client: AsyncModbusTcpClient, unit: int) -> None:
    assert words(await client.read_holding_registers(258, device_id=unit)) == [7]


async def test_registers_are_written_and_read(client: AsyncModbusTcpClient) -> None:
    assert not (await client.write_register(128, 4711)).isError()
    assert not (await client.write_registers(254, [1, 65535])).isError()
    assert words(await client.read_holding_registers(128, count=2)) == [4711, 0]
    assert words(await client.read_input_registers(254, count=2)) == [1, 65535]


async def test_a_program_and_a_client_share_the_registers(emulator: Emulator, client: AsyncModbusTcpClient) -> None:
    await client.write_register(130, 65535)
    emulator.controller.programs.submit(
        "def echo():\n  while read_port_register(131) == 0:\n    sync()\n  end\n"
        "  write_port_register(132, read_port_register(130) * 2)\nend\n"
    )
    await client.write_register(131, 1)
    while words(await client.read_holding_registers(132)) == [0]:
        pass
    assert words(await client.read_holding_registers(132)) == [65534], "-1 times 2"


async def test_outputs_as_registers_and_coils(emulator: Emulator, client: AsyncModbusTcpClient) -> None:
    signals = emulator.controller.signals
    await client.write_register(1, 0b101)
    await client.write_coil(17, True)
    await client.write_coils(20, [True, True])
    assert signals.digital_outputs == 0b110111
    await client.write_register(3, 0b1)
    assert words(await client.read_holding_registers(1)) == [0b110110]
    signals.set_digital_input(STANDARD, 6, True)
    assert (await client.read_discrete_inputs(0, count=8)).bits == [False] * 6 + [True, False]
    assert (await client.read_coils(16, count=8)).bits[:8] == [False, True, True, False, True, True, False, False]
    await client.write_coil(301, True)
    assert emulator.controller.registers.input.get_bit(1)


async def test_refusals(emulator: Emulator, client: AsyncModbusTcpClient) -> None:
    answers = [
        await client.read_holding_registers(34),
        await client.read_holding_registers(259, count=10),
        await client.read_coils(160),
        await client.read_holding_registers(2),
        await client.write_register(400, 1),
        await client.write_registers(0, [1, 1]),
        await client.write_register(20, 13),
        await client.write_coil(500, True),
        await client.readwrite_registers(read_address=128, read_count=1, write_address=128, values=[1]),
        await client.mask_write_register(address=128, and_mask=1, or_mask=1),
    ]
    assert [(answer.isError(), answer.exception_code) for answer in answers] == [
        *[(True, 2)] * 6,
        (True, 3),
        (True, 2),
        *[(True, 1)] * 2,
    ]
    assert emulator.controller.signals.digital_outputs == 0, "a request that is refused changed nothing"


async def test_hooks_see_and_change_messages() -> None:
    seen = []

    def hook(connection, direction, message):
        seen.append((direction, message.pdu[0]))
        return None if message.pdu[0] == 6 else message

    config = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")), ephemeral_ports=True)
    async with Emulator(config) as emulator:
        emulator.servers["modbus"].hooks.on_message.append(hook)
        client = AsyncModbusTcpClient(HOST, port=emulator.ports["modbus"], retries=0, reconnect_delay=0)
        await client.connect()
        await client.write_register(128, 1, no_response_expected=True)
        assert words(await client.read_holding_registers(128)) == [0]
        client.close()
    assert seen == [(Direction.RECEIVED, 6), (Direction.RECEIVED, 3), (Direction.SENT, 3)]


def test_requests_are_executed_in_the_tick() -> None:
    controller = Controller(ControllerConfig(model=load_model("ur3")))
    answers: list[bytes] = []
    controller.post(ModbusCall(bytes.fromhex("06 0080 0007")), answers.append)
    assert answers == []
    controller.tick()
    assert answers == [bytes.fromhex("06 0080 0007")]
    assert controller.modbus_registers.general[0] == 7
    assert ModbusCall(b"\3").failure == b"\x83\4"
