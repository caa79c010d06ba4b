"""The realtime packet: sizes and offsets of the manual's table, and both directions."""

import contextlib
import struct
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import RemoteProtocolError
from urproto.modes import RobotMode
from urproto.realtime import COLUMNS, RealtimeDecoder, decode_realtime, packet_size, realtime_packer
from urproto.versions import PolyscopeVersion

V3_15 = PolyscopeVersion(3, 15, 8)
V5_22 = PolyscopeVersion(5, 22)

# offset from the packet's start, as parsers of other projects use them
OFFSETS = {
    "timestamp": 4, "target_q": 12, "target_qd": 60, "target_qdd": 108, "target_current": 156, "target_moment": 204,
    "actual_q": 252, "actual_qd": 300, "actual_current": 348, "joint_control_output": 396, "actual_TCP_pose": 444,
    "actual_TCP_speed": 492, "actual_TCP_force": 540, "target_TCP_pose": 588, "target_TCP_speed": 636,
    "actual_digital_input_bits": 684, "joint_temperatures": 692, "actual_execution_time": 740, "robot_mode": 756,
    "joint_mode": 764, "safety_mode": 812, "actual_tool_accelerometer": 868, "speed_scaling": 940,
    "actual_momentum": 948, "actual_main_voltage": 972, "actual_robot_voltage": 980, "actual_robot_current": 988,
    "actual_joint_voltage": 996, "actual_digital_output_bits": 1044, "runtime_state": 1052, "elbow_position": 1060,
    "elbow_velocity": 1084, "safety_status": 1108, "payload": 1140, "payload_cog": 1148, "payload_inertia": 1172,
}  # fmt: skip


def values():
    """Every column with distinct numbers."""
    return {
        column.name: 100 * number + 1
        if column.count == 1
        else tuple(float(100 * number + part) for part in range(column.count))
        for number, column in enumerate(COLUMNS)
        if column.name is not None
    }


@each_row(
    ("version", "size"),
    [
        ("3.0", 1044), ("3.1", 1044), ("3.2", 1060), ("3.4", 1060), ("3.5", 1108), ("3.15.8", 1108), ("5.0", 1108),
        ("5.1", 1116), ("5.3", 1116), ("5.4", 1140), ("5.9", 1140), ("5.10", 1220), ("5.22", 1220),
    ],
)  # fmt: skip
def test_sizes(version, size):
    packet = realtime_packer(PolyscopeVersion.parse(version))(SimpleNamespace(**values()))
    assert len(packet) == packet_size(PolyscopeVersion.parse(version)) == size
    assert struct.unpack(">i", packet[:4]) == (size,)


@each_row("name", OFFSETS)
def test_offsets(name):
    packet = realtime_packer(V5_22)(SimpleNamespace(**values()))
    expected = values()[name]
    if name.endswith("_bits"):
        assert struct.unpack_from(">Q", packet, OFFSETS[name]) == (expected,)
    elif isinstance(expected, tuple):
        assert struct.unpack_from(f">{len(expected)}d", packet, OFFSETS[name]) == expected
    else:
        assert struct.unpack_from(">d", packet, OFFSETS[name]) == (expected,)


def test_every_named_column_has_an_offset_above():
    assert set(OFFSETS) == set(values())


@each_row("version", ["3.0", "3.2", "3.5", "5.1", "5.4", "5.10"])
@each_row("step", [1, 100, 5000])
def test_round_trip_in_any_split(version, step):
    version = PolyscopeVersion.parse(version)
    packet = realtime_packer(version)(SimpleNamespace(**values()))
    sent = {column.name for column in COLUMNS if column.name and column.since.covers(version)}
    decoder = RealtimeDecoder()
    stream = packet * 2
    states = [state for at in range(0, len(stream), step) for state in decoder.feed(stream[at : at + step])]
    assert states == [{name: value for name, value in values().items() if name in sent}] * 2


def test_modes_are_encoded_as_doubles():
    packet = realtime_packer(V3_15)(SimpleNamespace(**{**values(), "robot_mode": RobotMode.RUNNING}))
    assert struct.unpack_from(">d", packet, 756) == (7.0,)
    assert decode_realtime(packet)["robot_mode"] == RobotMode.RUNNING


def test_newer_software_may_append():
    packet = realtime_packer(V5_22)(SimpleNamespace(**values())) + bytes(16)
    assert decode_realtime(packet) == values()


@each_row("size", [-1, 0, 4, 5, 812, 1109, 70000])
def test_impossible_sizes_end_the_stream(size):
    decoder = RealtimeDecoder()
    with pytest.raises(RemoteProtocolError):
        decoder.feed(struct.pack(">i", size) + bytes(max(size, 0)))
    with pytest.raises(RemoteProtocolError):
        decoder.feed(b"")


def test_packets_before_an_impossible_size_are_not_lost():
    packet = realtime_packer(V3_15)(SimpleNamespace(**values()))
    decoder = RealtimeDecoder()
    assert len(decoder.feed(packet + bytes(4))) == 1
    assert decoder.error is not None


@given(st.binary(max_size=1300))
def test_any_packet_decodes_or_is_a_protocol_error(packet):
    with contextlib.suppress(RemoteProtocolError):
        decode_realtime(packet)
