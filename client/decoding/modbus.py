"""Modbus/TCP messages as text. An answer is decoded with the request of its transaction, if that was captured."""

import struct
from collections import OrderedDict
from collections.abc import Iterator

from client.decoding import formatting
from client.decoding.streams import FramedStream, Framing, Line, problem
from urproto import modbus
from urproto.errors import RemoteProtocolError
from urproto.modbus import ExceptionCode, Frame, Function, ModbusException, ModbusRequest
from urproto.modes import mode_name

_HEADER = struct.Struct(">HHHB")
_MAX_UNANSWERED = 64  # requests remembered
_ERROR_BIT = 0x80
_READS = (Function.READ_COILS, Function.READ_DISCRETE_INPUTS, Function.READ_HOLDING_REGISTERS,
          Function.READ_INPUT_REGISTERS, Function.READ_WRITE_REGISTERS)  # fmt: skip
_BITS = _READS[:2]


def _size(header: bytes) -> int:
    _, protocol, size, _ = _HEADER.unpack_from(header)
    if protocol or not 2 <= size <= 254:
        raise RemoteProtocolError(f"protocol {protocol} and {size} bytes are not a header")
    return int(size) + _HEADER.size - 1


FRAMING = Framing("Modbus", _HEADER.size, _size, lambda header: True)


class ModbusConversation:
    """Both directions of one connection."""

    def __init__(self) -> None:
        self._requests: OrderedDict[tuple[int, int], ModbusRequest] = OrderedDict()
        self.from_robot = FramedStream(FRAMING, self._from_robot)
        self.from_client = FramedStream(FRAMING, self._from_client)
        self.unknown = FramedStream(FRAMING, self._from_unknown)

    def _from_unknown(self, data: bytes) -> Iterator[Line]:
        yield from (self._from_robot if _is_answer(data[_HEADER.size :]) else self._from_client)(data)

    def _from_client(self, data: bytes) -> Iterator[Line]:
        frame = _frame(data)
        try:
            request = modbus.decode_request(frame.pdu)
        except ModbusException as error:
            yield problem(f"{_head('request', frame)}: {_exception(error.code)} {formatting.value(frame.pdu)}")
            return
        self._requests[frame.transaction, frame.unit] = request
        if len(self._requests) > _MAX_UNANSWERED:
            self._requests.popitem(last=False)
        yield Line(f"{_head('request', frame)}: {_request(request)}")

    def _from_robot(self, data: bytes) -> Iterator[Line]:
        frame = _frame(data)
        request = self._requests.pop((frame.transaction, frame.unit), None)
        head = _head("answer", frame)
        if frame.pdu[0] & _ERROR_BIT and len(frame.pdu) == 2:
            yield Line(f"{head}: refused, {_exception(frame.pdu[1])}" + (f" ({_request(request)})" if request else ""))
        elif request is None:
            yield Line(f"{head}: {_without_request(frame.pdu)}")
        else:
            yield Line(f"{head}: {_with_values(request, modbus.decode_response(request, frame.pdu))}")


def _frame(data: bytes) -> Frame:
    transaction, _, _, unit = _HEADER.unpack_from(data)
    return Frame(transaction, unit, data[_HEADER.size :])


def _is_answer(pdu: bytes) -> bool:
    """Whether a message from an unknown side is an answer. A write of one value is the same in both directions."""
    function = pdu[0]
    if function & _ERROR_BIT:
        return True
    if function in _READS:
        return len(pdu) > 1 and len(pdu) == 2 + pdu[1]
    return function in (Function.WRITE_COILS, Function.WRITE_REGISTERS) and len(pdu) == 5


def _head(what: str, frame: Frame) -> str:
    function = frame.pdu[0] & ~_ERROR_BIT
    name = mode_name(Function, function).lower()
    return f"{what} {frame.transaction} unit {frame.unit} {name if not name.isdigit() else f'function {name}'}"


def _exception(code: int) -> str:
    return f"exception {mode_name(ExceptionCode, code)}"


def _request(request: ModbusRequest) -> str:
    values = formatting.value(request.values)
    if request.function == Function.READ_WRITE_REGISTERS:
        return f"{_span(request)}, {request.write_address} := {values}"
    return f"{request.address} := {values}" if request.values else _span(request)


def _with_values(request: ModbusRequest, values: tuple[int, ...]) -> str:
    return f"{_span(request)} = {formatting.value(values)}" if values else f"{_request(request)} done"


def _span(request: ModbusRequest) -> str:
    last = request.address + request.count - 1
    return f"{request.address}..{last}" if request.count > 1 else str(request.address)


def _without_request(pdu: bytes) -> str:
    """An answer whose request was not captured: bits in whole bytes, words, or the repeated request."""
    if not _is_answer(pdu) or pdu[0] not in _READS:
        return f"{formatting.value(pdu[1:])} (the request was not seen)"
    count = pdu[1] * 8 if pdu[0] in _BITS else pdu[1] // 2
    values = modbus.decode_response(ModbusRequest(pdu[0], 0, count), pdu)
    return f"{formatting.value(values)} (the request was not seen)"
