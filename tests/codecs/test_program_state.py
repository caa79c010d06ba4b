"""Program state messages: values both ways in both generations of type codes."""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.primary.framing import OtherMessage, PrimaryDecoder
from urproto.primary.program_state import (
    GlobalVariableNames,
    GlobalVariableValues,
    MatrixValue,
    PoseValue,
    UnknownProgramState,
    VariableMessage,
    decode_program_state,
)
from urproto.versions import PolyscopeVersion

OLD = PolyscopeVersion(3, 13)
NEW = PolyscopeVersion(3, 15)
E_OLD = PolyscopeVersion(5, 8)
E_NEW = PolyscopeVersion(5, 9)

POSE = PoseValue((0.5, -1.0, 2.0, 0.0, 0.25, 3.0))
POSE_HEX = "3f000000 bf800000 40000000 00000000 3e800000 40400000"

# value, its bytes with the codes before 3.14 / 5.9, and with the ones after
VALUES = [
    pytest.param(None, "00 0a", "00 0a", id="none"),
    pytest.param("ab", "03 0002 6162 0a", "03 0002 6162 0a", id="string"),
    pytest.param(True, "0c 01 0a", "0d 01 0a", id="bool"),
    pytest.param(-2, "0e fffffffe 0a", "0f fffffffe 0a", id="int"),
    pytest.param(0.5, "0f 3f000000 0a", "10 3f000000 0a", id="float"),
    pytest.param(POSE, f"0a {POSE_HEX} 0a", f"0c {POSE_HEX} 0a", id="pose"),
    pytest.param((1, True), "05 0002 0e 00000001 0c 01 0a", "11 0002 0f 00000001 0d 01 0a", id="list"),
    pytest.param((), "05 0000 0a", "11 0000 0a", id="empty list"),
]


@each_row(("value", "old", "new"), VALUES)
@each_row("version", [OLD, E_OLD, NEW, E_NEW], ids=str)
def test_values(value, old, new, version):
    wire = bytes.fromhex(old if version in (OLD, E_OLD) else new)
    message = GlobalVariableValues(timestamp_us=7, start_index=3, values=(value,))
    data = message.encode(version)
    assert data[16:] == wire
    assert PrimaryDecoder(version).feed(data) == [message]


def test_matrix():
    matrix = MatrixValue(((1, 2.0), (3, 4.0)))
    data = GlobalVariableValues(values=(matrix,)).encode(E_NEW)
    assert data[16:] == bytes.fromhex("12 0002 0002 0f00000001 1040000000 0f00000003 1040800000 0a")
    assert decode_program_state(data[5:], E_NEW).values == (matrix,)
    with pytest.raises(LocalProtocolError, match="matrix"):
        GlobalVariableValues(values=(matrix,)).encode(OLD)
    with pytest.raises(LocalProtocolError, match="rows"):
        GlobalVariableValues(values=(MatrixValue(((1,), (1, 2))),)).encode(E_NEW)


def test_alternative_string_and_number_codes_are_decoded():
    payload = struct.pack(">QBH", 0, 1, 0) + bytes.fromhex("04 0001 61 0a 0e 3f000000 0a")
    assert decode_program_state(payload, NEW).values == ("a", 0.5)


@each_row(("names", "text"), [((), b""), (("a",), b"a\n"), (("a", "b_1"), b"a\nb_1\n")])
def test_names(names, text):
    message = GlobalVariableNames(timestamp_us=1, start_index=2, names=names)
    data = message.encode(NEW)
    assert data == struct.pack(">iBQBH", 16 + len(text), 25, 1, 0, 2) + text
    assert PrimaryDecoder(NEW).feed(data) == [message]
    assert decode_program_state(data[5:].removesuffix(b"\n"), NEW).names == names


def test_variable_as_text():
    message = VariableMessage(timestamp_us=5, title="height", text="0.5")
    data = message.encode(NEW)
    assert data == struct.pack(">iBQBB", 24, 25, 5, 2, 6) + b"height0.5"
    assert PrimaryDecoder(NEW).feed(data) == [message]


def test_unknown_kinds_are_kept():
    message = UnknownProgramState(timestamp_us=4, kind=9, body=b"xyz")
    assert PrimaryDecoder().feed(message.encode(NEW)) == [message]


@each_row(
    ("body", "reason"),
    [("63", "type code 99"), ("0f 0000", "too early"), ("0d 01 0b", "line feed"), ("11 0001" * 40, "nested deeper")],
)
def test_unreadable_values_are_kept_with_the_reason(body, reason):
    payload = struct.pack(">QBH", 0, 1, 0) + bytes.fromhex(body)
    with pytest.raises(RemoteProtocolError, match=reason):
        decode_program_state(payload, NEW)
    (kept,) = PrimaryDecoder(NEW).feed(struct.pack(">iB", len(payload) + 5, 25) + payload)
    assert kept == OtherMessage(25, payload, kept.error)
    assert reason in kept.error


@each_row("value", [2**31, 1e300, tuple([0] * 70000)])
def test_values_the_wire_cannot_carry(value):
    with pytest.raises(LocalProtocolError):
        GlobalVariableValues(values=(value,)).encode(NEW)


@given(st.binary(max_size=120), st.integers(0, 3), st.sampled_from([OLD, NEW]))
def test_any_payload_decodes_or_is_a_protocol_error(body, kind, version):
    with contextlib.suppress(RemoteProtocolError):
        decode_program_state(struct.pack(">QB", 0, kind) + body, version)
