"""Modbus/TCP messages against those of pymodbus."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu import bit_message as bits
from pymodbus.pdu import register_message as words

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.modbus import (
    Frame,
    FrameDecoder,
    Function,
    ModbusException,
    ModbusRequest,
    decode_request,
    decode_response,
    encode_frame,
    encode_request,
    encode_response,
    exception_response,
)

COILS = (1, 0, 1, 1, 0, 0, 1, 1, 1, 0)
CASES = [
    # our request, the values read, pymodbus's request, pymodbus's response
    (
        ModbusRequest(1, 19, 10),
        COILS,
        bits.ReadCoilsRequest(address=19, count=10),
        bits.ReadCoilsResponse(bits=[bool(coil) for coil in COILS]),
    ),
    (
        ModbusRequest(2, 196, 3),
        (1, 1, 0),
        bits.ReadDiscreteInputsRequest(address=196, count=3),
        bits.ReadDiscreteInputsResponse(bits=[True, True, False]),
    ),
    (
        ModbusRequest(3, 107, 3),
        (555, 0, 65535),
        words.ReadHoldingRegistersRequest(address=107, count=3),
        words.ReadHoldingRegistersResponse(registers=[555, 0, 65535]),
    ),
    (
        ModbusRequest(4, 8, 1),
        (10,),
        words.ReadInputRegistersRequest(address=8, count=1),
        words.ReadInputRegistersResponse(registers=[10]),
    ),
    (
        ModbusRequest(5, 172, values=(1,)),
        (),
        bits.WriteSingleCoilRequest(address=172, bits=[True]),
        bits.WriteSingleCoilResponse(address=172, bits=[True]),
    ),
    (
        ModbusRequest(6, 1, values=(3,)),
        (),
        words.WriteSingleRegisterRequest(address=1, registers=[3]),
        words.WriteSingleRegisterResponse(address=1, registers=[3]),
    ),
    (
        ModbusRequest(15, 19, 10, COILS),
        (),
        bits.WriteMultipleCoilsRequest(address=19, bits=[bool(coil) for coil in COILS]),
        bits.WriteMultipleCoilsResponse(address=19, count=10),
    ),
    (
        ModbusRequest(16, 1, 2, (10, 258)),
        (),
        words.WriteMultipleRegistersRequest(address=1, registers=[10, 258]),
        words.WriteMultipleRegistersResponse(address=1, count=2),
    ),
    (
        ModbusRequest(23, 3, 2, (255, 255, 256), 14),
        (254, 2765),
        words.ReadWriteMultipleRegistersRequest(
            read_address=3, read_count=2, write_address=14, write_registers=[255, 255, 256]
        ),
        words.ReadWriteMultipleRegistersResponse(registers=[254, 2765]),
    ),
]
OURS = [case[0] for case in CASES]


def pdu(message: ModbusPDU) -> bytes:
    return bytes([message.function_code]) + message.encode()


@each_row(("request_", "values", "theirs", "response"), CASES, ids=lambda case: type(case).__name__)
def test_requests_and_responses(request_, values, theirs, response):
    assert encode_request(request_) == pdu(theirs)
    assert decode_request(pdu(theirs)) == request_
    assert encode_response(request_, values) == pdu(response)
    assert decode_response(request_, pdu(response)) == values


@each_row("request_", OURS, ids=lambda case: case.function)
def test_exceptions(request_):
    wire = exception_response(request_.function, 6)
    assert wire == pdu(ExceptionResponse(request_.function, 6))
    with pytest.raises(ModbusException) as refused:
        decode_response(request_, wire)
    assert refused.value.code == 6


def test_frames():
    theirs = words.ReadHoldingRegistersRequest(address=107, count=3, dev_id=17, transaction_id=4660)
    wire = FramerSocket(DecodePDU(True)).buildFrame(theirs)
    frame = Frame(4660, 17, pdu(theirs))
    assert encode_frame(frame) == wire
    assert FrameDecoder().feed(wire * 3) == [frame] * 3


@each_row(
    ("pdu", "code"),
    [
        (b"\x07", 1),
        (b"\x2b\x0e\1\0", 1),
        (b"\3", 3),
        (b"\3\0\0\0\0", 3),
        (b"\3\0\0\0\x7e", 3),
        (b"\1\0\0\x07\xd1", 3),
        (b"\5\0\0\1\0", 3),
        (b"\x10\0\0\0\1\2\0", 3),
        (b"\x10\0\0\0\1\3\0\1\2", 3),
        (b"\x0f\0\0\0\0\0", 3),
        (b"\x17\0\0\0\1\0\0\0\0\0", 3),
    ],
)
def test_bad_requests_have_an_exception_code(pdu, code):
    with pytest.raises(ModbusException) as refused:
        decode_request(pdu)
    assert refused.value.code == code


@given(
    st.one_of(
        st.binary(min_size=1, max_size=40),
        st.integers(1, 23).flatmap(lambda f: st.binary(min_size=4, max_size=12).map(lambda d: bytes([f]) + d)),
    )
)
def test_any_request_is_understood_or_refused(data):
    try:
        request = decode_request(data)
    except ModbusException:
        return
    assert decode_request(encode_request(request)) == request


@given(st.sampled_from(OURS), st.binary(max_size=40))
def test_any_response_is_an_answer_or_a_protocol_error(request_, data):
    try:
        values = decode_response(request_, data)
    except (ModbusException, RemoteProtocolError):
        return
    assert len(values) == (request_.count if request_.function in (1, 2, 3, 4, 23) else 0)


@each_row(
    "request_",
    [
        ModbusRequest(Function.WRITE_REGISTER, 0, values=(65536,)),
        ModbusRequest(Function.READ_COILS, -1),
        ModbusRequest(99, 0),
    ],
)
def test_requests_that_do_not_fit(request_):
    with pytest.raises(LocalProtocolError):
        encode_request(request_)


def test_frame_that_is_too_long():
    with pytest.raises(LocalProtocolError, match="1 to 253 bytes, not 254"):
        encode_frame(Frame(1, 1, b"x" * 254))
