"""Builds the robot state of the primary interface from a snapshot."""

import struct
from dataclasses import replace
from zlib import crc32

from emulator.motion.reach import dexterity
from emulator.robot.electrics import ROOM_C
from emulator.snapshot import Snapshot
from urproto.modes import AnalogDomain, KinematicsStatus, RobotMode, SafetyMode, SafetyStatusBits
from urproto.primary.state import RobotStateData
from urproto.primary.subpackages import (
    AdditionalInfo,
    CalibrationData,
    CartesianInfo,
    ConfigurationData,
    ForceModeData,
    JointData,
    JointState,
    KinematicsInfo,
    MasterboardData,
    ModeData,
    SafetyData,
    ToolCommunicationInfo,
    ToolData,
    ToolModeInfo,
)
from urproto.robots import DH, RobotModel
from urproto.vectors import as_six
from urproto.versions import Series

_MASTERBOARD_VERSION = 6  # CB3 (configuration files of URSim 3.5.0); a UR5e simulator 5.24 sends it as well
# added to each joint's highest speed: v_max in the configuration files of URSim 3.5.0 and of a UR5e's controller, which
# have all joints from the UR3's to the UR10e's
_SPEED_MARGIN_RAD_S = 0.2
_POWERED = frozenset({RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING})


def robot_state(snapshot: Snapshot, model: RobotModel) -> RobotStateData:
    """Return all parts of the state; the encoder omits those that a version or a repeated state does not have."""
    on_e_series = model.series is Series.E
    return RobotStateData(
        mode=_mode(snapshot),
        joints=_joints(snapshot, on_e_series),
        cartesian=CartesianInfo(pose_base_tcp=snapshot.actual_TCP_pose, tcp_offset=snapshot.tcp_offset),
        kinematics=kinematics_info(model),
        # internal: zero in captures of simulators, in the one of an arm about as large as its sensed force (guess)
        calibration=CalibrationData(wrench=snapshot.actual_TCP_force),
        masterboard=_masterboard(snapshot, on_e_series),
        tool=_tool(snapshot),
        configuration=configuration_data(model),
        force_mode=ForceModeData(frame=snapshot.force_mode_frame, dexterity=dexterity(model.dh, snapshot.actual_q)),
        additional=AdditionalInfo(io_enabled_freedrive=snapshot.io_freedrive),
        safety=SafetyData(
            checksum=snapshot.safety_checksum,
            flag0=on_e_series,
            flag1=on_e_series,
            elbow_position=snapshot.elbow_position,
            elbow_radius=model.elbow_radius,
        ),
        tool_communication=ToolCommunicationInfo(**snapshot.tool_communication._asdict()),
        tool_mode=ToolModeInfo(
            output_mode=snapshot.tool_output_mode,
            digital_output0_mode=snapshot.tool_digital_output0_mode,
            digital_output1_mode=snapshot.tool_digital_output1_mode,
        ),
    )


def kinematics_info(model: RobotModel) -> KinematicsInfo:
    """Return the Denavit-Hartenberg parameters: nominal, as a simulator sends them, or those of a calibrated arm."""
    dh = model.dh if model.calibration is None else model.calibration
    info = KinematicsInfo(dh_theta=dh.theta, dh_a=dh.a, dh_d=dh.d, dh_alpha=dh.alpha)
    if model.calibration is None:
        return info
    return replace(info, checksum=_checksums(dh), status=KinematicsStatus.LINEARISED)


def _checksums(dh: DH) -> tuple[int, ...]:
    """Return the CRC-32 of the bytes of each joint's parameters. How a robot computes it is unknown: a guess."""
    joints = zip(dh.theta, dh.a, dh.d, dh.alpha, strict=True)
    return tuple(crc32(struct.pack(">4d", *joint)) for joint in joints)


def configuration_data(model: RobotModel) -> ConfigurationData:
    """Return the limits, defaults and type numbers of the arm."""
    dh = model.dh
    return ConfigurationData(
        q_min=model.q_min,
        q_max=model.q_max,
        qd_max=as_six(speed + _SPEED_MARGIN_RAD_S for speed in model.qd_max),
        qdd_max=model.qdd_max,
        v_joint_default=model.v_joint_default,
        a_joint_default=model.a_joint_default,
        v_tool_default=model.v_tool_default,
        a_tool_default=model.a_tool_default,
        eq_radius=model.eq_radius,
        dh_a=dh.a,
        dh_d=dh.d,
        dh_alpha=dh.alpha,
        dh_theta=dh.theta,
        masterboard_version=_MASTERBOARD_VERSION,
        controller_box=model.controller_box,
        robot_type=model.robot_type,
        sub_type=model.sub_type,
    )


def _mode(snapshot: Snapshot) -> ModeData:
    safety_bits = snapshot.safety_status_bits
    return ModeData(
        timestamp_us=round(snapshot.timestamp * 1e6),
        real_robot_enabled=not snapshot.simulation,
        robot_power_on=snapshot.robot_mode in _POWERED,
        emergency_stopped=bool(safety_bits & SafetyStatusBits.EMERGENCY_STOPPED),
        protective_stopped=snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP,
        program_running=snapshot.program_running,
        program_paused=snapshot.program_paused,
        robot_mode=snapshot.robot_mode,
        control_mode=snapshot.control_mode,
        target_speed_fraction=snapshot.target_speed_fraction,
        speed_scaling=snapshot.speed_scaling,
    )


def _joints(snapshot: Snapshot, on_e_series: bool) -> JointData:
    # the deprecated micro temperatures of a CB3 arm stay near room temperature; e-Series sends none
    micro_temperature = 0.0 if on_e_series else ROOM_C
    rows = zip(
        snapshot.actual_q,
        snapshot.target_q,
        snapshot.actual_qd,
        snapshot.actual_current,
        snapshot.actual_joint_voltage,
        snapshot.joint_temperatures,
        snapshot.joint_mode,
        strict=True,
    )
    return JointData(
        joints=tuple(
            JointState(
                q_actual=q,
                q_target=q_target,
                qd_actual=qd,
                current=current,
                voltage=voltage,
                motor_temperature=temperature,
                micro_temperature=micro_temperature,
                mode=mode,
            )
            for q, q_target, qd, current, voltage, temperature, mode in rows
        )
    )


def _masterboard(snapshot: Snapshot, on_e_series: bool) -> MasterboardData:
    types = snapshot.analog_io_types
    return MasterboardData(
        digital_input_bits=snapshot.actual_digital_input_bits,
        digital_output_bits=snapshot.actual_digital_output_bits,
        analog_input_range0=types & 1,
        analog_input_range1=types >> 1 & 1,
        analog_input0=snapshot.standard_analog_input0,
        analog_input1=snapshot.standard_analog_input1,
        analog_output_domain0=AnalogDomain(types >> 2 & 1),
        analog_output_domain1=AnalogDomain(types >> 3 & 1),
        analog_output0=snapshot.standard_analog_output0,
        analog_output1=snapshot.standard_analog_output1,
        board_temperature=snapshot.board_temperature,
        robot_voltage_48V=snapshot.actual_robot_voltage,
        robot_current=snapshot.actual_robot_current,
        io_current=snapshot.io_current,
        safety_mode=snapshot.safety_mode,
        reduced_mode=snapshot.safety_mode is SafetyMode.REDUCED,
        safety_checksum=snapshot.safety_checksum,
        operational_mode_selector=on_e_series,
        three_position_device=on_e_series,
    )


def _tool(snapshot: Snapshot) -> ToolData:
    types = snapshot.tool_analog_input_types
    return ToolData(
        analog_input_range0=types & 1,
        analog_input_range1=types >> 1 & 1,
        analog_input0=snapshot.tool_analog_input0,
        analog_input1=snapshot.tool_analog_input1,
        tool_voltage_48V=snapshot.tool_board_voltage,
        tool_output_voltage=snapshot.tool_output_voltage,
        tool_current=snapshot.tool_output_current,
        tool_temperature=snapshot.tool_temperature,
        tool_mode=snapshot.tool_mode,
    )
