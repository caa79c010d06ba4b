"""Modbus/TCP (TCP 502) for both ends: frames, requests and responses.

Source: Modbus Application Protocol 1.1b3 and Modbus Messaging on TCP/IP 1.0b. Words have 16 bits, most significant byte
first. Coils are packed eight to a byte, the first one in the least significant bit.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from urproto._wire import SizedMessageDecoder
from urproto.compat import IntEnum
from urproto.errors import LocalProtocolError, RemoteProtocolError

_HEADER: Final = struct.Struct(">HHHB")  # transaction, protocol (0), bytes that follow, unit
_ERROR_BIT: Final = 0x80
_MAX_PDU: Final = 253  # bytes
_MAX_WRITTEN_WHILE_READING: Final = 121
_COIL_ON: Final = 0xFF00


class Function(IntEnum):
    """The supported function codes."""

    READ_COILS = 1
    READ_DISCRETE_INPUTS = 2
    READ_HOLDING_REGISTERS = 3
    READ_INPUT_REGISTERS = 4
    WRITE_COIL = 5
    WRITE_REGISTER = 6
    WRITE_COILS = 15
    WRITE_REGISTERS = 16
    READ_WRITE_REGISTERS = 23


class ExceptionCode(IntEnum):
    """Reasons why a unit refuses a request; others exist."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_DATA_ADDRESS = 2
    ILLEGAL_DATA_VALUE = 3
    DEVICE_FAILURE = 4


_F = Function
_READ_BITS: Final = (_F.READ_COILS, _F.READ_DISCRETE_INPUTS)
_READ_WORDS: Final = (_F.READ_HOLDING_REGISTERS, _F.READ_INPUT_REGISTERS)
_MAX_COUNT: Final[dict[int, int]] = {  # values in one request
    _F.READ_COILS: 2000,
    _F.READ_DISCRETE_INPUTS: 2000,
    _F.READ_HOLDING_REGISTERS: 125,
    _F.READ_INPUT_REGISTERS: 125,
    _F.WRITE_COILS: 1968,
    _F.WRITE_REGISTERS: 123,
    _F.READ_WRITE_REGISTERS: 125,
}


class ModbusException(Exception):  # noqa: N818 - the protocol's own term
    """A unit understood the frame and refused the request. code: an ``ExceptionCode``, or another byte."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


@dataclass(frozen=True, slots=True)
class ModbusRequest:
    """A request to a unit.

    address, count: the values to read, or where ``values`` (words, or 0 and 1) are written; function 23 writes them to
    ``write_address``.
    """

    function: int
    address: int
    count: int = 1
    values: tuple[int, ...] = ()
    write_address: int = 0


@dataclass(frozen=True, slots=True)
class Frame:
    """A message in either direction. pdu: function code and data. A response repeats the transaction number."""

    transaction: int
    unit: int
    pdu: bytes


def encode_frame(frame: Frame) -> bytes:
    """The bytes of a message. Raises LocalProtocolError when it is empty or too long."""
    if not 0 < len(frame.pdu) <= _MAX_PDU:
        raise LocalProtocolError(f"a Modbus message has 1 to {_MAX_PDU} bytes, not {len(frame.pdu)}")
    return _HEADER.pack(frame.transaction, 0, len(frame.pdu) + 1, frame.unit) + frame.pdu


class FrameDecoder(SizedMessageDecoder[Frame]):
    """Splits a stream of bytes into messages. Bytes that are not a Modbus/TCP header end it."""

    header = _HEADER

    def _size(self, *header: int) -> int:
        _, protocol, size, _ = header
        if protocol or not 2 <= size <= _MAX_PDU + 1:
            raise RemoteProtocolError(f"not a Modbus/TCP header: protocol {protocol}, {size} bytes")
        return _HEADER.size + size - 1

    def _decode(self, message: bytes) -> Frame:
        transaction, _, _, unit = _HEADER.unpack_from(message)
        return Frame(transaction, unit, message[_HEADER.size :])


# requests


def encode_request(request: ModbusRequest) -> bytes:
    """Function code and data of a request. Raises LocalProtocolError if they do not fit into a frame."""
    try:
        return _encode_request(request)
    except struct.error as error:
        raise LocalProtocolError(f"{request} does not fit a Modbus message: {error}") from error


def _encode_request(request: ModbusRequest) -> bytes:
    function, address, values = request.function, request.address, request.values
    if function in (*_READ_BITS, *_READ_WORDS):
        return struct.pack(">BHH", function, address, request.count)
    if function == _F.WRITE_COIL:
        return struct.pack(">BHH", function, address, _COIL_ON if values[0] else 0)
    if function == _F.WRITE_REGISTER:
        return struct.pack(">BHH", function, address, values[0])
    if function == _F.WRITE_COILS:
        packed = _pack_bits(values)
        return struct.pack(">BHHB", function, address, len(values), len(packed)) + packed
    if function == _F.WRITE_REGISTERS:
        return struct.pack(">BHHB", function, address, len(values), 2 * len(values)) + _pack_words(values)
    if function == _F.READ_WRITE_REGISTERS:
        head = (function, address, request.count, request.write_address, len(values), 2 * len(values))
        return struct.pack(">BHHHHB", *head) + _pack_words(values)
    raise LocalProtocolError(f"Modbus function {function} is not supported")


def decode_request(pdu: bytes) -> ModbusRequest:
    """Decode the request in a frame. Raises ModbusException with the code for the response."""
    try:
        request = _decode_request(pdu)
    except struct.error as error:
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE) from error
    written = len(request.values)
    count = request.count if request.function in (*_READ_BITS, *_READ_WORDS, _F.READ_WRITE_REGISTERS) else written
    if not 1 <= count <= _MAX_COUNT.get(request.function, 1):
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
    if request.function == _F.READ_WRITE_REGISTERS and not 1 <= written <= _MAX_WRITTEN_WHILE_READING:
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
    return request


def _decode_request(pdu: bytes) -> ModbusRequest:
    function, data = pdu[0], pdu[1:]
    if function in (*_READ_BITS, *_READ_WORDS):
        address, count = struct.unpack(">HH", data)
        return ModbusRequest(function, address, count)
    if function in (_F.WRITE_COIL, _F.WRITE_REGISTER):
        address, value = struct.unpack(">HH", data)
        return ModbusRequest(function, address, values=(_coil(value) if function == _F.WRITE_COIL else value,))
    if function in (_F.WRITE_COILS, _F.WRITE_REGISTERS):
        address, count, size = struct.unpack_from(">HHB", data)
        values = _unpack(function == _F.WRITE_COILS, count, size, data[5:])
        return ModbusRequest(function, address, count, values)
    if function == _F.READ_WRITE_REGISTERS:
        address, count, write_address, write_count, size = struct.unpack_from(">HHHHB", data)
        return ModbusRequest(function, address, count, _unpack(False, write_count, size, data[9:]), write_address)
    raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)


def _coil(word: int) -> int:
    if word not in (0, _COIL_ON):
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
    return int(word == _COIL_ON)


# answers


def encode_response(request: ModbusRequest, values: Sequence[int]) -> bytes:
    """The response to a request that succeeded. values: those that were read."""
    function = request.function
    if function in _READ_BITS:
        packed = _pack_bits(values)
        return bytes((function, len(packed))) + packed
    if function in (*_READ_WORDS, _F.READ_WRITE_REGISTERS):
        return bytes((function, 2 * len(values))) + _pack_words(values)
    if function in (_F.WRITE_COIL, _F.WRITE_REGISTER):
        return encode_request(request)
    return struct.pack(">BHH", function, request.address, len(request.values))


def exception_response(function: int, code: int) -> bytes:
    """The response to a request that was refused."""
    return bytes((function | _ERROR_BIT, code))


def decode_response(request: ModbusRequest, pdu: bytes) -> tuple[int, ...]:
    """The values that were read; none for a request that only writes.

    Raises ModbusException if the unit refused, and RemoteProtocolError if this is not a response to the request.
    """
    function = request.function
    if len(pdu) == 2 and pdu[0] == function | _ERROR_BIT:
        raise ModbusException(pdu[1])
    try:
        if pdu[0] == function:
            if function in (*_READ_BITS, *_READ_WORDS, _F.READ_WRITE_REGISTERS):
                return _unpack(function in _READ_BITS, request.count, pdu[1], pdu[2:])
            if pdu == encode_response(request, ()):
                return ()
    except (IndexError, ModbusException, struct.error) as error:
        raise RemoteProtocolError(f"the response to Modbus function {function} has the wrong size") from error
    raise RemoteProtocolError(f"the response to Modbus function {function} belongs to another request")


def _pack_words(values: Sequence[int]) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


def _pack_bits(values: Sequence[int]) -> bytes:
    packed = sum(1 << place for place, value in enumerate(values) if value)
    return packed.to_bytes((len(values) + 7) // 8, "little")


def _unpack(bits: bool, count: int, size: int, data: bytes) -> tuple[int, ...]:
    """Unpack coils or words. Raises ModbusException when the sizes contradict each other."""
    if size != len(data) or size != ((count + 7) // 8 if bits else 2 * count):
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
    if not bits:
        return struct.unpack(f">{count}H", data)
    packed = int.from_bytes(data, "little")
    return tuple(packed >> place & 1 for place in range(count))
