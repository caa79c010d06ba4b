"""The robot's Modbus server (port 502): its registers and coils.

    async with ModbusClient("192.168.56.101") as modbus:
        await modbus.write_register(128, 7)
        words = await modbus.read_registers(128, 16)

    with BlockingModbusClient("192.168.56.101") as modbus:
        modbus.write_coil(16, True)                          # digital output 0

Words are 0 to 65535. Registers 128 to 255 are free for any use: programs have them as
``read_port_register``. A request the robot refuses is a RobotRefused.
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

_UNIT: Final = 255  # "not used", as the Messaging Guide wants it for a device with an address of its own
_EXCEPTIONS: Final = {
    int(ExceptionCode.ILLEGAL_FUNCTION): ("ILLEGAL_FUNCTION", "its Modbus server does not have this function"),
    int(ExceptionCode.ILLEGAL_DATA_ADDRESS): (
        "ILLEGAL_DATA_ADDRESS",
        "there is nothing at this address, or it can only be read, or only be written",
    ),
    int(ExceptionCode.ILLEGAL_DATA_VALUE): ("ILLEGAL_DATA_VALUE", "the value does not fit"),
    int(ExceptionCode.DEVICE_FAILURE): ("DEVICE_FAILURE", "look at the robot"),
}


class ModbusCore:
    """Flows of one connection, one request at a time, without I/O."""

    def __init__(self) -> None:
        self._transaction = 0
        self._decoder = FrameDecoder()

    def start(self) -> Flow[None]:
        """Forget what belonged to an earlier connection."""
        self._decoder = FrameDecoder()
        yield from ()

    def read_registers(self, address: int, count: int) -> Flow[tuple[int, ...]]:
        """Words from an address on, 125 at most."""
        return self._request(ModbusRequest(Function.READ_HOLDING_REGISTERS, address, count))

    def write_registers(self, address: int, words: Sequence[int]) -> Flow[tuple[int, ...]]:
        """Words from an address on, 123 at most."""
        return self._request(ModbusRequest(Function.WRITE_REGISTERS, address, values=tuple(words)))

    def write_register(self, address: int, word: int) -> Flow[tuple[int, ...]]:
        """One word."""
        return self._request(ModbusRequest(Function.WRITE_REGISTER, address, values=(word,)))

    def read_coils(self, address: int, count: int) -> Flow[tuple[int, ...]]:
        """Bits from an address on, 2000 at most."""
        return self._request(ModbusRequest(Function.READ_COILS, address, count))

    def write_coil(self, address: int, level: bool) -> Flow[tuple[int, ...]]:
        """One bit."""
        return self._request(ModbusRequest(Function.WRITE_COIL, address, values=(int(level),)))

    def _request(self, request: ModbusRequest) -> Flow[tuple[int, ...]]:
        transaction = self._transaction = (self._transaction + 1) & 0xFFFF
        yield encode_frame(Frame(transaction, _UNIT, encode_request(request)))
        while True:
            for frame in self._decoder.feed((yield None)):
                if frame.transaction == transaction:  # else that of a request which was given up
                    return _answer(request, frame.pdu)


def _answer(request: ModbusRequest, pdu: bytes) -> tuple[int, ...]:
    try:
        return decode_response(request, pdu)
    except ModbusException as error:
        what = f"Modbus {Function(request.function).name} at {request.address}"
        name, advice = _EXCEPTIONS.get(error.code, (str(error.code), ""))
        raise RobotRefused(what, f"exception {name}", advice) from error


class ModbusClient(AsyncConnection):
    """For asyncio programs; one task at a time."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = ModbusCore()

    async def read_registers(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Words from an address on, 125 at most."""
        return await self.run(self.core.read_registers(address, count))

    async def write_registers(self, address: int, words: Sequence[int]) -> None:
        """Words from an address on, 123 at most."""
        await self.run(self.core.write_registers(address, words))

    async def write_register(self, address: int, word: int) -> None:
        """One word."""
        await self.run(self.core.write_register(address, word))

    async def read_coils(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Bits from an address on, 2000 at most."""
        return await self.run(self.core.read_coils(address, count))

    async def write_coil(self, address: int, level: bool) -> None:
        """One bit."""
        await self.run(self.core.write_coil(address, level))

    def _opening(self) -> Flow[None]:
        return self.core.start()


class BlockingModbusClient(BlockingConnection):
    """For scripts and notebooks."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = ModbusCore()

    def read_registers(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Words from an address on, 125 at most."""
        return self.run(self.core.read_registers(address, count))

    def write_registers(self, address: int, words: Sequence[int]) -> None:
        """Words from an address on, 123 at most."""
        self.run(self.core.write_registers(address, words))

    def write_register(self, address: int, word: int) -> None:
        """One word."""
        self.run(self.core.write_register(address, word))

    def read_coils(self, address: int, count: int = 1) -> tuple[int, ...]:
        """Bits from an address on, 2000 at most."""
        return self.run(self.core.read_coils(address, count))

    def write_coil(self, address: int, level: bool) -> None:
        """One bit."""
        self.run(self.core.write_coil(address, level))

    def _opening(self) -> Flow[None]:
        return self.core.start()
