"""Every sub-package and the realtime packet against construct declarations written from the reference tables.

The declarations of the primary interface are in primary_structs.
"""

from types import SimpleNamespace

import construct as c
from primary_structs import (
    I32,
    U8,
    D,
    additional,
    calibration,
    cartesian,
    force_mode,
    joints,
    kinematics,
    masterboard,
    safety,
    tool,
    tool_communication,
    tool_mode,
)

from tests.rows import each_row
from urproto.primary import subpackages as parts
from urproto.realtime import COLUMNS, realtime_packer
from urproto.versions import PolyscopeVersion

VERSIONS = ["3.0", "3.2", "3.14", "3.15.8", "5.9", "5.11", "5.22", "5.26"]
P6 = (1.5, 2.5, 3.5, 4.5, 5.5, 6.5)
T6 = (7.5, 8.5, 9.5, 10.5, 11.5, 12.5)
JOINTS = tuple(
    parts.JointState(
        q_actual=n + 0.1, q_target=n + 0.2, qd_actual=n + 0.3, current=n + 0.5, voltage=n + 0.25,
        motor_temperature=n + 20.5, micro_temperature=n + 21.5, mode=247 + n,
    )
    for n in range(6)
)  # fmt: skip
BOARD = parts.MasterboardData(
    digital_input_bits=0x30001, digital_output_bits=0x20003, analog_input_range0=2, analog_input_range1=3,
    analog_input0=0.5, analog_input1=1.5, analog_output_domain0=1, analog_output_domain1=0, analog_output0=2.5,
    analog_output1=3.5, board_temperature=37.5, robot_voltage_48V=48.5, robot_current=0.75, io_current=0.125,
    safety_mode=3, reduced_mode=True, safety_checksum=0xDEADBEEF, operational_mode_selector=1,
    three_position_device=1, internal=1,
)  # fmt: skip
CASES = [
    (joints, parts.JointData(joints=JOINTS), {}),
    (
        tool,
        parts.ToolData(
            analog_input_range0=1, analog_input_range1=0, analog_input0=0.5, analog_input1=1.5, tool_voltage_48V=48.5,
            tool_output_voltage=24, tool_current=0.25, tool_temperature=30.5, tool_mode=253,
        ),
        {"range0": 1, "range1": 0, "in0": 0.5, "in1": 1.5, "v48": 48.5, "out_v": 24, "amps": 0.25, "temp": 30.5,
         "mode": 253},
    ),
    (
        masterboard,
        BOARD,
        {"di": 0x30001, "do": 0x20003, "range0": 2, "range1": 3, "in0": 0.5, "in1": 1.5, "dom0": 1, "dom1": 0,
         "out0": 2.5, "out1": 3.5, "board_temp": 37.5, "v48": 48.5, "amps": 0.75, "io_amps": 0.125, "safety_mode": 3,
         "reduced": 1, "euromap": 0, "checksum": 0xDEADBEEF, "selector": 1, "three_position": 1, "internal": 1},
    ),
    (
        cartesian,
        parts.CartesianInfo(pose_base_tcp=P6, tcp_offset=T6),
        dict(zip(("x", "y", "z", "rx", "ry", "rz", "tcp_x", "tcp_y", "tcp_z", "tcp_rx", "tcp_ry", "tcp_rz"), P6 + T6,
                 strict=True)),
    ),
    (
        kinematics,
        parts.KinematicsInfo(checksum=(1, 2, 3, 4, 5, 6), dh_theta=P6, dh_a=T6, dh_d=P6, dh_alpha=T6, status=2),
        {"checksum": [1, 2, 3, 4, 5, 6], "theta": [*P6], "a": [*T6], "d": [*P6], "alpha": [*T6], "status": 2},
    ),
    (
        force_mode,
        parts.ForceModeData(frame=P6, dexterity=0.5),
        {**dict(zip(("x", "y", "z", "rx", "ry", "rz"), P6, strict=True)), "dexterity": 0.5},
    ),
    (
        additional,
        parts.AdditionalInfo(freedrive_button_pressed=True, freedrive_button_enabled=False, io_enabled_freedrive=True),
        {"pressed": 1, "enabled": 0, "io": 1, "reserved": 1},
    ),
    (calibration, parts.CalibrationData(wrench=T6), {"fx": 7.5, "frz": 12.5}),
    (
        safety,
        parts.SafetyData(checksum=7, flag0=0, flag1=1, elbow_position=(1.5, 2.5, 3.5), elbow_radius=0.13),
        {"checksum": 7, "flag0": 0, "flag1": 1, "elbow": [1.5, 2.5, 3.5], "radius": 0.13},
    ),
    (
        tool_communication,
        parts.ToolCommunicationInfo(
            enabled=True, baud_rate=9600, parity=2, stop_bits=2, rx_idle_chars=1.75, tx_idle_chars=4.5
        ),
        {"enabled": 1, "baud": 9600, "parity": 2, "stop": 2, "rx": 1.75, "tx": 4.5},
    ),
    (
        tool_mode,
        parts.ToolModeInfo(output_mode=1, digital_output0_mode=2, digital_output1_mode=3),
        {"mode": 1, "do0": 2, "do1": 3},
    ),
]  # fmt: skip


@each_row("version", VERSIONS)
@each_row(("declare", "part", "expected"), CASES, ids=[case[0].__name__ for case in CASES])
def test_sub_package_against_construct(declare, part, expected, version):
    oracle = declare(version)
    encoded = part.encode(PolyscopeVersion.parse(version))
    body = encoded[5:]
    assert c.Struct("size" / I32, "type" / U8).parse(encoded) == {"size": len(encoded), "type": part.type}
    assert oracle.sizeof() == len(body)
    parsed = oracle.parse(body)
    names = [field.name for field in oracle.subcons]
    assert {name: parsed[name] for name in expected if name in names} == {
        name: value for name, value in expected.items() if name in names
    }


def test_joints_against_construct():
    parsed = joints("5.22").parse(CASES[0][1].encode(PolyscopeVersion(5, 22))[5:])
    for n, joint in enumerate(parsed.joints):
        assert (joint.q_actual, joint.q_target, joint.qd_actual) == (n + 0.1, n + 0.2, n + 0.3)
        assert (joint.current, joint.voltage, joint.t_motor, joint.t_micro) == (n + 0.5, n + 0.25, n + 20.5, n + 21.5)
        assert joint.mode == 247 + n


# meaning and number of doubles, as the manual lists them
REALTIME = [
    ("timestamp", 1), ("target_q", 6), ("target_qd", 6), ("target_qdd", 6), ("target_current", 6),
    ("target_moment", 6), ("actual_q", 6), ("actual_qd", 6), ("actual_current", 6), ("joint_control_output", 6),
    ("actual_TCP_pose", 6), ("actual_TCP_speed", 6), ("actual_TCP_force", 6), ("target_TCP_pose", 6),
    ("target_TCP_speed", 6), ("actual_digital_input_bits", "bits"), ("joint_temperatures", 6),
    ("actual_execution_time", 1), ("test", 1), ("robot_mode", 1), ("joint_mode", 6), ("safety_mode", 1),
    ("internal1", 6), ("actual_tool_accelerometer", 3), ("internal2", 6), ("speed_scaling", 1),
    ("actual_momentum", 1), ("internal3", 2), ("actual_main_voltage", 1), ("actual_robot_voltage", 1),
    ("actual_robot_current", 1), ("actual_joint_voltage", 6),
]  # fmt: skip
REALTIME_3_2 = [("actual_digital_output_bits", "bits"), ("runtime_state", 1)]
REALTIME_3_5 = [("elbow_position", 3), ("elbow_velocity", 3)]
REALTIME_5_4 = [("safety_status", 1), ("internal4", 3)]
REALTIME_5_10 = [("payload", 1), ("payload_cog", 3), ("payload_inertia", 6)]
LAYOUTS = {
    "3.1": REALTIME,
    "3.4": REALTIME + REALTIME_3_2,
    "3.14": REALTIME + REALTIME_3_2 + REALTIME_3_5,
    "3.15.8": REALTIME + REALTIME_3_2 + REALTIME_3_5,
    "5.0": REALTIME + REALTIME_3_2 + REALTIME_3_5,
    "5.3": REALTIME + REALTIME_3_2 + REALTIME_3_5 + REALTIME_5_4[:1],
    "5.9": REALTIME + REALTIME_3_2 + REALTIME_3_5 + REALTIME_5_4,
    "5.11": REALTIME + REALTIME_3_2 + REALTIME_3_5 + REALTIME_5_4 + REALTIME_5_10,
    "5.22": REALTIME + REALTIME_3_2 + REALTIME_3_5 + REALTIME_5_4 + REALTIME_5_10,
}


@each_row("version", LAYOUTS)
def test_realtime_packet_against_construct(version):
    sent = {
        column.name: 10 * n + 1 if column.count == 1 else tuple(10.0 * n + part for part in range(column.count))
        for n, column in enumerate(COLUMNS)
        if column.name
    }
    fields = [name / (c.Int64ub if count == "bits" else D[count]) for name, count in LAYOUTS[version]]
    oracle = c.Struct("size" / I32, *fields, c.Terminated)
    packet = realtime_packer(PolyscopeVersion.parse(version))(SimpleNamespace(**sent))
    parsed = oracle.parse(packet)
    assert parsed.size == len(packet)
    for name, count in LAYOUTS[version]:
        wanted = sent.get(name, (0.0,) * (count if count != "bits" else 1))
        got = parsed[name] if count == "bits" else tuple(parsed[name])
        assert got == (wanted if count == "bits" or isinstance(wanted, tuple) else (float(wanted),)), name
