"""RTDE packages: one row per package tests encoding, decoding and byte-by-byte feeding.

Bytes marked C++ are from the tests of the official C++ client (tests/test_rtde_*.cpp), those
marked Python were read back with the official Python client's serializer; the rest is
written out from the RTDE guide.
"""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.rtde.codec import (
    ClientMessage,
    GetVersion,
    InputData,
    MessageLevel,
    OutputData,
    Package,
    Pause,
    PauseReply,
    ProtocolReply,
    RequestProtocol,
    RTDEDecoder,
    SetupInputs,
    SetupInputsReply,
    SetupOutputs,
    SetupOutputsReply,
    Start,
    StartReply,
    TextMessage,
    VersionReply,
    decode_reply,
    decode_request,
)
from urproto.versions import PolyscopeVersion

FULL_DATA = bytes.fromhex(
    "40d0758c49ba5e35bff99c77d110b460bffba233d110b460c0019fbe68885a30bfe9db22a22168c03ff98587a0000000bf9fbe74442d1800"
)

REQUESTS = [
    pytest.param(RequestProtocol(2), 1, "0005560002", id="V2 (C++)"),
    pytest.param(RequestProtocol(1), 1, "0005560001", id="V1 (C++)"),
    pytest.param(GetVersion(), 2, "000376", id="v (C++)"),
    pytest.param(Start(), 2, "000353", id="S (C++)"),
    pytest.param(Pause(), 2, "000350", id="P (C++)"),
    pytest.param(
        SetupOutputs(("actual_q", "actual_qd"), 500.0),
        2,
        "001d4f407f400000000000" + b"actual_q,actual_qd".hex(),
        id="O v2 (C++)",
    ),
    pytest.param(SetupOutputs(("actual_q", "actual_qd")), 1, "00154f" + b"actual_q,actual_qd".hex(), id="O v1 (C++)"),
    pytest.param(
        SetupInputs(("speed_slider_mask", "speed_slider_fraction")),
        2,
        "002a49" + b"speed_slider_mask,speed_slider_fraction".hex(),
        id="I (C++)",
    ),
    pytest.param(InputData(1, b"\x00\x00\x00\x01"), 2, "0008550100000001", id="U v2 (C++)"),
    pytest.param(InputData(1, b"\x00\x00\x00\x01"), 1, "0008550100000001", id="U v1"),
    pytest.param(ClientMessage("hi", "me", MessageLevel.WARNING), 2, "000a4d026869026d6502", id="M v2"),
    pytest.param(ClientMessage("hi", "me", MessageLevel.WARNING), 1, "000a4d026869026d6502", id="M v1"),
]

REPLIES = [
    pytest.param(ProtocolReply(True), 1, "00045601", id="V (C++)"),
    pytest.param(ProtocolReply(False), 1, "00045600", id="V refused"),
    pytest.param(VersionReply(PolyscopeVersion(5, 8)), 2, "00137600000005000000080000000000000000", id="v 5.8.0 (C++)"),
    pytest.param(StartReply(True), 2, "00045301", id="S (C++)"),
    pytest.param(PauseReply(True), 2, "00045001", id="P (C++)"),
    pytest.param(SetupOutputsReply(("DOUBLE", "VECTOR6D"), 1), 2, "00134f01" + b"DOUBLE,VECTOR6D".hex(), id="O v2"),
    pytest.param(
        SetupOutputsReply(("NOT_FOUND", "VECTOR6D"), 0),
        2,
        "00164f00" + b"NOT_FOUND,VECTOR6D".hex(),
        id="O v2 refused (C++, without header)",
    ),
    pytest.param(SetupOutputsReply(("DOUBLE", "VECTOR6D")), 1, "00124f" + b"DOUBLE,VECTOR6D".hex(), id="O v1"),
    pytest.param(SetupInputsReply(("UINT32", "DOUBLE"), 1), 2, "00114901" + b"UINT32,DOUBLE".hex(), id="I (C++)"),
    pytest.param(SetupInputsReply(("IN_USE", "IN_USE"), 0), 2, "00114900" + b"IN_USE,IN_USE".hex(), id="I refused"),
    pytest.param(OutputData(FULL_DATA), 2, "003c5501" + FULL_DATA.hex(), id="U v2 (C++, without header)"),
    pytest.param(OutputData(FULL_DATA), 1, "003b55" + FULL_DATA.hex(), id="U v1 (C++, without header)"),
    pytest.param(TextMessage("hi", "RTDE", MessageLevel.INFO), 2, "000c4d0268690452544445" + "03", id="M v2 (Python)"),
    pytest.param(TextMessage("hi", "", MessageLevel.ERROR), 1, "00064d016869", id="M v1"),
]


@each_row(("message", "protocol", "wire"), REQUESTS)
def test_request(message, protocol, wire):
    data = bytes.fromhex(wire)
    assert message.encode(protocol) == data
    assert [decode_request(package, protocol) for package in RTDEDecoder().feed(data)] == [message]


@each_row(("message", "protocol", "wire"), REPLIES)
def test_reply(message, protocol, wire):
    data = bytes.fromhex(wire)
    assert message.encode(protocol) == data
    assert [decode_reply(package, protocol) for package in RTDEDecoder().feed(data)] == [message]


@each_row(("message", "protocol", "wire"), REQUESTS + REPLIES)
def test_byte_by_byte(message, protocol, wire):
    decoder = RTDEDecoder()
    fed = [decoder.feed(bytes([byte])) for byte in bytes.fromhex(wire)]
    assert all(packages == [] for packages in fed[:-1])
    (package,) = fed[-1]
    assert package.encode() == message.encode(protocol)


def test_several_packages_in_one_segment():
    wire = RequestProtocol(2).encode(1) + SetupOutputs(("timestamp",), 125.0).encode(2) + Start().encode(2)
    first, second, third = RTDEDecoder().feed(wire)
    assert decode_request(first, 1) == RequestProtocol(2)
    assert decode_request(second, 2) == SetupOutputs(("timestamp",), 125.0)
    assert decode_request(third, 2) == Start()


def test_the_trailing_comma_of_ur_rtde_is_not_a_name():
    package = Package(ord("I"), b"input_int_register_0,")
    assert decode_request(package, 2) == SetupInputs(("input_int_register_0",))


def test_no_names_at_all():
    assert decode_request(Package(ord("I"), b""), 2) == SetupInputs(())


def test_long_texts_are_cut_to_255_bytes():
    message = decode_reply(RTDEDecoder().feed(TextMessage("x" * 300, "y" * 300).encode(2))[0], 2)
    assert message == TextMessage("x" * 255, "y" * 255)


@each_row("size", [0, 1, 2])
def test_impossible_size_ends_the_stream(size):
    decoder = RTDEDecoder()
    with pytest.raises(RemoteProtocolError, match=f"size {size}"):
        decoder.feed(struct.pack(">HB", size, ord("V")))
    with pytest.raises(RemoteProtocolError):
        decoder.feed(Start().encode(2))


def test_packages_before_the_impossible_size_are_not_lost():
    decoder = RTDEDecoder()
    assert decoder.feed(Start().encode(2) + b"\0\0\0") == [Package(ord("S"), b"")]
    assert decoder.error is not None
    with pytest.raises(RemoteProtocolError):
        decoder.feed(b"")


@each_row(
    ("package", "text"),
    [
        (Package(2, b"\0\0"), "type 2"),
        (Package(ord("V"), b"\0"), "REQUEST_PROTOCOL_VERSION"),
        (Package(ord("O"), b"\0\0"), "SETUP_OUTPUTS"),
        (Package(ord("U"), b""), "DATA_PACKAGE"),
        (Package(ord("M"), b"\x05ab"), "TEXT_MESSAGE"),
    ],
)
def test_a_bad_request_is_named_and_leaves_the_stream_usable(package, text):
    decoder = RTDEDecoder()
    bad, good = decoder.feed(package.encode() + Start().encode(2))
    with pytest.raises(RemoteProtocolError, match=text):
        decode_request(bad, 2)
    assert decode_request(good, 2) == Start()


@each_row(
    "message",
    [RequestProtocol(70000), SetupOutputs(("timestamp",)), InputData(300, b""), InputData(1, bytes(65535))],
)
def test_unencodable_values_are_refused(message):
    with pytest.raises(LocalProtocolError):
        message.encode(2)


@given(st.binary(max_size=200), st.sampled_from([1, 2]))
def test_any_payload_decodes_or_is_a_protocol_error(payload, protocol):
    for kind in [*b"VvMUOISP", 0]:
        for decode in (decode_request, decode_reply):
            with contextlib.suppress(RemoteProtocolError):
                decode(Package(kind, payload), protocol)
