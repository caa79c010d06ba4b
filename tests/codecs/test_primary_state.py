"""Robot state: recorded bytes both ways, sizes by version, construct as an oracle."""

import struct
from dataclasses import replace

import construct
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.modes import JointMode, RobotMode, RobotSubType, RobotType, SafetyMode
from urproto.primary.framing import MAX_MESSAGE_SIZE, OtherMessage, PrimaryDecoder
from urproto.primary.state import RawSubPackage, RobotStateData, decode_robot_state, encode_robot_state
from urproto.primary.subpackages import (
    ConfigurationData,
    EuromapData,
    JointData,
    KinematicsInfo,
    MasterboardData,
    ModeData,
)
from urproto.versions import PolyscopeVersion

V5_24 = PolyscopeVersion(5, 24)
RECORDED = [
    pytest.param("robot_state_full_5.24", V5_24, True, id="5.24 full"),
    pytest.param("robot_state_steady_5.x", PolyscopeVersion(5, 4), False, id="5.x steady"),
    pytest.param("robot_state_steady_cb3", PolyscopeVersion(3, 15, 8), False, id="CB3 steady"),
]


def decode(data: bytes) -> RobotStateData:
    (state,) = PrimaryDecoder().feed(data)
    assert isinstance(state, RobotStateData)
    return state


def sub_packages(message: bytes) -> dict[int, int]:
    """Type and size of each sub-package, read without the code under test."""
    sizes = {}
    offset = 5
    while offset < len(message):
        size, kind = struct.unpack_from(">iB", message, offset)
        sizes[kind] = size
        offset += size
    assert offset == len(message)
    return sizes


@each_row(("name", "version", "full"), RECORDED)
def test_recorded_states_are_reencoded_to_the_same_bytes(golden, name, version, full):
    data = golden(name)
    state = decode(data)
    assert state.unknown == ()
    assert encode_robot_state(state, version, full=full) == data


@each_row(("name", "version", "full"), RECORDED)
def test_byte_by_byte(golden, name, version, full):
    data = golden(name)
    decoder = PrimaryDecoder()
    fed = [decoder.feed(bytes([byte])) for byte in data]
    assert all(messages == [] for messages in fed[:-1])
    assert fed[-1] == [decode(data)]


def test_recorded_simulator_values(golden):
    """Values that other parsers read from the same bytes."""
    state = decode(golden("robot_state_full_5.24"))
    assert state.mode.timestamp_us == 25_643_784_000
    assert state.mode.robot_mode is not None
    assert RobotMode(state.mode.robot_mode) is RobotMode.RUNNING
    assert [round(joint.q_actual, 4) for joint in state.joints.joints] == [
        -1.6007,
        -1.7271,
        -2.203,
        -0.808,
        1.5951,
        -0.031,
    ]
    assert {joint.mode for joint in state.joints.joints} == {JointMode.RUNNING}
    assert state.kinematics.checksum == (0xFFFFFFFF,) * 6
    assert state.kinematics.dh_a == (0, -0.425, -0.3922, 0, 0, 0)
    assert state.kinematics.dh_d == (0.1625, 0, 0, 0.1333, 0.0997, 0.0996)
    assert state.kinematics.dh_alpha == (1.570796327, 0, 0, 1.570796327, -1.570796327, 0)
    configuration = state.configuration
    assert configuration.q_max == (6.3355451848,) * 6
    assert configuration.q_min == (-6.3355451848,) * 6
    assert configuration.qd_max == (3.341592653589793,) * 6
    assert configuration.qdd_max == (40.0,) * 6
    assert (configuration.v_tool_default, configuration.a_tool_default, configuration.eq_radius) == (0.25, 1.2, 0.25)
    assert (configuration.masterboard_version, configuration.controller_box) == (6, 4)
    assert (configuration.robot_type, configuration.sub_type) == (RobotType.UR5, RobotSubType.E_SERIES)
    assert (state.tool_communication.baud_rate, state.tool_communication.tx_idle_chars) == (115200, 3.5)
    assert state.safety.checksum == state.masterboard.safety_checksum


def test_recorded_steady_values(golden):
    state = decode(golden("robot_state_steady_5.x"))
    assert state.joints.joints[0].q_actual == 0.12321250481647548
    assert state.joints.joints[5].q_actual == 0.34937358852940126
    assert state.cartesian.pose_base_tcp[0] == 0.31732700100421085
    assert state.masterboard.robot_voltage_48V == 48
    assert state.kinematics is None
    assert state.configuration is None


def test_order_of_the_parts(golden):
    assert list(sub_packages(golden("robot_state_full_5.24"))) == [0, 1, 4, 5, 9, 3, 2, 6, 7, 8, 10, 11, 12]


def test_cb2_parts_that_are_too_short_are_kept_raw(golden):
    state = decode(golden("robot_state_cb2"))
    assert [(part.type, len(part.body)) for part in state.unknown] == [(0, 24), (3, 59)]
    assert round(state.joints.joints[0].q_actual, 3) == -3.860


@each_row(
    ("version", "sizes"),
    [
        ("3.0", {0: 38, 1: 251, 4: 53, 9: 53, 3: 72, 2: 37, 6: 445, 7: 61}),
        ("3.2", {0: 46, 1: 251, 4: 101, 9: 53, 3: 74, 2: 37, 6: 445, 7: 61, 8: 7}),
        ("3.3", {0: 46, 1: 251, 4: 101, 5: 225, 9: 53, 3: 74, 2: 37, 6: 445, 7: 61, 8: 8}),
        ("3.5", {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 74, 2: 37, 6: 445, 7: 61, 8: 8, 10: 43}),
        ("5.0.5", {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 74, 2: 37, 6: 445, 7: 61, 8: 8, 10: 43, 11: 26}),
        ("5.3", {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 74, 2: 37, 6: 445, 7: 61, 8: 8, 10: 43, 11: 26, 12: 8}),
        ("3.14", {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43}),
        ("3.15", {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43}),
        (
            "5.9",
            {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43, 11: 26, 12: 8},
        ),
        (
            "5.11",
            {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43, 11: 26, 12: 8},
        ),
        (
            "5.22",
            {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43, 11: 26, 12: 8},
        ),
        (
            "5.26",
            {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 10: 43, 11: 26, 12: 8},
        ),
    ],
)
def test_sizes_by_version(golden, version, sizes):
    state = decode(golden("robot_state_full_5.24"))
    message = encode_robot_state(state, PolyscopeVersion.parse(version), full=True)
    assert sub_packages(message) == sizes
    assert decode(message).mode.robot_mode == state.mode.robot_mode


def test_a_full_state_fits_the_buffer_of_the_official_client(golden):
    state = decode(golden("robot_state_full_5.24"))
    assert len(encode_robot_state(state, V5_24, full=True)) < 4092


def test_euromap_adds_16_bytes():
    board = MasterboardData(
        euromap=EuromapData(input_bits=1, output_bits=2, voltage_24V=24.0, current=0.5), safety_mode=SafetyMode.REDUCED
    )
    state = RobotStateData(masterboard=board)
    message = encode_robot_state(state, V5_24, full=False)
    assert sub_packages(message) == {3: 91}
    assert decode(message) == state


def test_short_kinematics_form():
    assert decode_robot_state(bytes.fromhex("00000009 05 00000002")).kinematics == KinematicsInfo(status=2)


def test_appended_bytes_of_newer_software_are_ignored(golden):
    """5.2x appends two 16-bit numbers to the configuration data."""
    state = decode(golden("robot_state_full_5.24"))
    body = state.configuration.encode(V5_24)[5:] + bytes(4)
    longer = struct.pack(">iB", len(body) + 5, 6) + body
    assert decode_robot_state(longer).configuration == state.configuration


def test_unknown_parts_are_preserved():
    payload = bytes.fromhex("00000007 63 abcd")
    state = decode_robot_state(payload)
    assert state.unknown == (RawSubPackage(0x63, b"\xab\xcd"),)
    assert encode_robot_state(state, V5_24, full=True)[5:] == payload


@each_row("payload", ["00", "00000004 00", "ffffffff 00", "00000006 00", "7fffffff 00 00"])
def test_sizes_that_do_not_add_up(payload):
    with pytest.raises(RemoteProtocolError):
        decode_robot_state(bytes.fromhex(payload))


@each_row("size", [-1, 0, 4, MAX_MESSAGE_SIZE + 1, 2**31 - 1])
def test_impossible_message_size_ends_the_stream(size):
    decoder = PrimaryDecoder()
    with pytest.raises(RemoteProtocolError):
        decoder.feed(struct.pack(">iB", size, 16))
    assert decoder.error is not None


def test_messages_before_an_impossible_size_are_not_lost():
    decoder = PrimaryDecoder()
    assert decoder.feed(bytes.fromhex("00000005 63 00000000 00")) == [OtherMessage(0x63, b"")]
    with pytest.raises(RemoteProtocolError):
        decoder.feed(b"")


def test_values_that_do_not_fit_are_refused(golden):
    state = decode(golden("robot_state_full_5.24"))
    with pytest.raises(LocalProtocolError):
        encode_robot_state(replace(state, mode=replace(state.mode, timestamp_us=-1)), V5_24, full=True)


def test_configuration_against_construct():
    """The interleaved limits are the most error-prone."""
    double = construct.Float64b
    oracle = construct.Struct(
        "position" / construct.Array(6, construct.Struct("low" / double, "high" / double)),
        "speed" / construct.Array(6, construct.Struct("v" / double, "a" / double)),
        "defaults" / construct.Array(5, double),
        "dh" / construct.Array(4, construct.Array(6, double)),
        "numbers" / construct.Array(4, construct.Int32sb),
    )
    row = [tuple(float(10 * number + joint) for joint in range(6)) for number in range(8)]
    data = ConfigurationData(
        q_min=row[0], q_max=row[1], qd_max=row[2], qdd_max=row[3],
        v_joint_default=1.0, a_joint_default=2.0, v_tool_default=3.0, a_tool_default=4.0, eq_radius=5.0,
        dh_a=row[4], dh_d=row[5], dh_alpha=row[6], dh_theta=row[7],
        masterboard_version=6, controller_box=4, robot_type=1, sub_type=3,
    )  # fmt: skip
    parsed = oracle.parse(data.encode(V5_24)[5:])
    assert [pair.low for pair in parsed.position] == list(row[0])
    assert [pair.high for pair in parsed.position] == list(row[1])
    assert [pair.v for pair in parsed.speed] == list(row[2])
    assert [pair.a for pair in parsed.speed] == list(row[3])
    assert list(parsed.defaults) == [1, 2, 3, 4, 5]
    assert [tuple(numbers) for numbers in parsed.dh] == row[4:]
    assert list(parsed.numbers) == [6, 4, 1, 3]


def test_mode_data_against_construct():
    oracle = construct.Struct(
        "timestamp" / construct.Int64ub,
        "flags" / construct.Array(7, construct.Flag),
        "mode" / construct.Int8sb,
        "control" / construct.Int8ub,
        "speeds" / construct.Array(3, construct.Float64b),
        "reserved" / construct.Int8ub,
    )
    data = ModeData(
        timestamp_us=2**40, real_robot_connected=True, real_robot_enabled=False, robot_power_on=True,
        emergency_stopped=False, protective_stopped=True, program_running=False, program_paused=True,
        robot_mode=RobotMode.NO_CONTROLLER, control_mode=2,
        target_speed_fraction=0.25, speed_scaling=0.5, target_speed_fraction_limit=0.75,
    )  # fmt: skip
    parsed = oracle.parse(data.encode(V5_24)[5:])
    assert (parsed.timestamp, parsed.mode, parsed.control, parsed.reserved) == (2**40, -1, 2, 0)
    assert list(parsed.flags) == [True, False, True, False, True, False, True]
    assert list(parsed.speeds) == [0.25, 0.5, 0.75]


def test_joint_data_requires_six_joints(golden):
    state = decode(golden("robot_state_full_5.24"))
    assert len(state.joints.joints) == 6
    assert isinstance(state.joints, JointData)


@given(st.binary(max_size=300), st.integers(0, 13))
def test_any_part_decodes_or_is_kept_raw(body, kind):
    payload = struct.pack(">iB", len(body) + 5, kind) + body
    state = decode_robot_state(payload)
    assert len(state.parts) + len(state.unknown) == 1
