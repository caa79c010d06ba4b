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

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Connection, Flow, FlowMethod
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

    def write(self, request: ModbusRequest) -> Flow[None]:
        """Carry out a request to write."""
        yield from self.request(request)

    def request(self, request: ModbusRequest) -> Flow[tuple[int, ...]]:
        """Carry out one request, and return the values of its answer."""
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


class _Modbus(Connection):
    """The operations of the asynchronous and the blocking client."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = ModbusCore()

    def _opening(self) -> Flow[None]:
        return self.core.start()

    @FlowMethod
    def read_registers(self, address: int, count: int = 1) -> Flow[tuple[int, ...]]:
        """Read up to 125 registers (words), starting at ``address``."""
        return self.core.request(ModbusRequest(Function.READ_HOLDING_REGISTERS, address, count))

    @FlowMethod
    def write_registers(self, address: int, words: Sequence[int]) -> Flow[None]:
        """Write up to 123 registers (words), starting at ``address``."""
        return self.core.write(ModbusRequest(Function.WRITE_REGISTERS, address, values=tuple(words)))

    @FlowMethod
    def write_register(self, address: int, word: int) -> Flow[None]:
        """Write one register (word)."""
        return self.core.write(ModbusRequest(Function.WRITE_REGISTER, address, values=(word,)))

    @FlowMethod
    def read_coils(self, address: int, count: int = 1) -> Flow[tuple[int, ...]]:
        """Read up to 2000 coils (bits), starting at ``address``."""
        return self.core.request(ModbusRequest(Function.READ_COILS, address, count))

    @FlowMethod
    def write_coil(self, address: int, level: bool) -> Flow[None]:
        """Write one coil (bit)."""
        return self.core.write(ModbusRequest(Function.WRITE_COIL, address, values=(int(level),)))


class ModbusClient(_Modbus, AsyncConnection):
    """Modbus client for asyncio programs; use it with ``async with``, from one task at a time."""


class BlockingModbusClient(_Modbus, BlockingConnection):
    """Modbus client for scripts and notebooks; use it with ``with``."""
