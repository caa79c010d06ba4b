"""Client for the robot's Modbus server (port 502): registers and coils.

    async with ModbusClient("192.168.56.101") as modbus:
        await modbus.write_register(128, 7)
        words = await modbus.read_registers(128, 16)

    with BlockingModbusClient("192.168.56.101") as modbus:
        modbus.write_coil(16, True)                          # digital output 0

Words are 0 to 65535. Registers 128 to 255 are free for any use: programs read them with ``read_port_register``. A
request that the robot refuses raises RobotRefused.
"""

from collections.abc import Sequence
from typing import Final

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Flow
from urproto.errors import RobotRefused
from urproto.modbus import (
    ExceptionCode,
    Frame,
    FrameDecoder,
    Function,
    ModbusException,
    ModbusRequest,
    decode_response,
    encode_frame,
    encode_request,
)
from urproto.ports import CONTROLLER_PORTS

PORT: Final = CONTROLLER_PORTS["modbus"]
GENERAL_REGISTERS: Final = range(128, 256)
"""Addresses of the registers that are free for any use."""

_UNIT: Final = 255  # "not used", as the Messaging Guide specifies for a device with its own IP address
_EXCEPTIONS: Final = {
    int(ExceptionCode.ILLEGAL_FUNCTION): ("ILLEGAL_FUNCTION", "its Modbus server does not have this function"),
    int(ExceptionCode.ILLEGAL_DATA_ADDRESS): (
        "ILLEGAL_DATA_ADDRESS",
        "this address does not exist, or is read-only, or is write-only",
    ),
    int(ExceptionCode.ILLEGAL_DATA_VALUE): ("ILLEGAL_DATA_VALUE", "the value does not fit"),
    int(ExceptionCode.DEVICE_FAILURE): ("DEVICE_FAILURE", "check the robot"),
}


class ModbusCore:
    """Flows of one connection, one request at a time, without I/O."""

    def __init__(self) -> None:
        self._transaction = 0
        self._decoder = FrameDecoder()

    def start(self) -> Flow[None]:
        """Reset the state of an earlier connection."""
        self._decoder = FrameDecoder()
        yield from ()

    def read_registers(self, address: int, count: int) -> Flow[tuple[int, ...]]:
        """Read up to 125 registers (words), starting at ``address``."""
        return self._request(ModbusRequest(Function.READ_HOLDING_REGISTERS, address, count))

    def write_registers(self, address: int, words: Sequence[int]) -> Flow[tuple[int, ...]]:
        """Write up to 123 registers (words), starting at ``address``."""
        return self._request(ModbusRequest(Function.WRITE_REGISTERS, address, values=tuple(words)))

    def write_register(self, address: int, word: int) -> Flow[tuple[int, ...]]:
        """Write one register (word)."""
        return self._request(ModbusRequest(Function.WRITE_REGISTER, address, values=(word,)))

    def read_coils(self, address: int, count: int) -> Flow[tuple[int, ...]]:
        """Read up to 2000 coils (bits), starting at ``address``."""
        return self._request(ModbusRequest(Function.READ_COILS, address, count))

    def write_coil(self, address: int, level: bool) -> Flow[tuple[int, ...]]:
        """Write one coil (bit)."""
        return self._request(ModbusRequest(Function.WRITE_COIL, address, values=(int(level),)))

    def _request(self, request: ModbusRequest) -> Flow[tuple[int, ...]]:
        transaction = self._transaction = (self._transaction + 1) & 0xFFFF
        yield encode_frame(Frame(transaction, _UNIT, encode_request(request)))
        while True:
            for frame in self._decoder.feed((yield None)):
                if frame.transaction == transaction:  # otherwise it answers an earlier request that timed out
                    return _answer(request, frame.pdu)


def _answer(request: ModbusRequest, pdu: bytes) -> tuple[int, ...]:
    try:
        return decode_response(request, pdu)
    except ModbusException as error:
        title = f"Modbus {Function(request.function).name} at {request.address}"
        name, advice = _EXCEPTIONS.get(error.code, (str(error.code), ""))
        raise RobotRefused(title, f"exception {name}", advice) from error


class ModbusClient(AsyncConnection):
    """Modbus client for asyncio programs; use it with ``async with``, from one task at a time."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = ModbusCore()

    async def read_registers(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Read up to 125 registers (words), starting at ``address``."""
        return await self.run(self.core.read_registers(address, count))

    async def write_registers(self, address: int, words: Sequence[int]) -> None:
        """Write up to 123 registers (words), starting at ``address``."""
        await self.run(self.core.write_registers(address, words))

    async def write_register(self, address: int, word: int) -> None:
        """Write one register (word)."""
        await self.run(self.core.write_register(address, word))

    async def read_coils(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Read up to 2000 coils (bits), starting at ``address``."""
        return await self.run(self.core.read_coils(address, count))

    async def write_coil(self, address: int, level: bool) -> None:
        """Write one coil (bit)."""
        await self.run(self.core.write_coil(address, level))

    def _opening(self) -> Flow[None]:
        return self.core.start()


class BlockingModbusClient(BlockingConnection):
    """Modbus client for scripts and notebooks; use it with ``with``."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = ModbusCore()

    def read_registers(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Read up to 125 registers (words), starting at ``address``."""
        return self.run(self.core.read_registers(address, count))

    def write_registers(self, address: int, words: Sequence[int]) -> None:
        """Write up to 123 registers (words), starting at ``address``."""
        self.run(self.core.write_registers(address, words))

    def write_register(self, address: int, word: int) -> None:
        """Write one register (word)."""
        self.run(self.core.write_register(address, word))

    def read_coils(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Read up to 2000 coils (bits), starting at ``address``."""
        return self.run(self.core.read_coils(address, count))

    def write_coil(self, address: int, level: bool) -> None:
        """Write one coil (bit)."""
        self.run(self.core.write_coil(address, level))

    def _opening(self) -> Flow[None]:
        return self.core.start()
