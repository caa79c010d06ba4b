"""Requests to the robot's Modbus server: what they do to the controller, and their answers.

The server understands functions 1 to 6, 15 and 16 (the vendor's article on it, 16377).
Coils and discrete inputs are one table, as are holding and input registers (guess).
"""

from typing import TYPE_CHECKING

from emulator.io.modbus_map import (
    COILS,
    REGISTERS,
    PortError,
    check_writable,
    read_coil,
    read_register,
    write_coil,
    write_register,
)
from urproto.modbus import (
    ExceptionCode,
    Function,
    ModbusException,
    ModbusRequest,
    decode_request,
    encode_response,
    exception_response,
)

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["answer_request"]


def answer_request(controller: "Controller", pdu: bytes) -> bytes:
    """Carry a request out; the answer, which says so when the request is refused.

    A request that writes to an address that cannot be written changes nothing.
    """
    try:
        request = decode_request(pdu)
        return encode_response(request, _carry_out(controller, request))
    except (ModbusException, PortError) as refused:
        return exception_response(pdu[0], refused.code)


def _carry_out(controller: "Controller", request: ModbusRequest) -> list[int]:
    addresses = range(request.address, request.address + request.count)
    written = range(request.address, request.address + len(request.values))
    match request.function:
        case Function.READ_COILS | Function.READ_DISCRETE_INPUTS:
            return [read_coil(controller, address) for address in addresses]
        case Function.READ_HOLDING_REGISTERS | Function.READ_INPUT_REGISTERS:
            return [read_register(controller, address) for address in addresses]
        case Function.WRITE_COIL | Function.WRITE_COILS:
            check_writable(COILS, written, "coil")
            for address, value in zip(written, request.values, strict=True):
                write_coil(controller, address, bool(value))
        case Function.WRITE_REGISTER | Function.WRITE_REGISTERS:
            check_writable(REGISTERS, written, "register")
            for address, value in zip(written, request.values, strict=True):
                write_register(controller, address, value)
        case _:
            raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)
    return []
