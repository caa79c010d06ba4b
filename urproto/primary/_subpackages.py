"""The sub-packages of a robot state.

Newer versions only append to the bodies. Each dataclass therefore lists the fields of its oldest form in ``_layout``,
and later fields with their first versions in ``_later``. Decoding relies on the size alone.

First versions, with their sources, are rows of ``urproto/facts/primary.csv``. The layouts: captures of a 5.4, an early
5.x and a 5.24 simulator and of a late CB3 arm; the rest is from the vendor's client interface documents as interpreted
by several public clients.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import chain
from typing import Any, ClassVar

from urproto._wire import Reader, pack
from urproto.compat import Self
from urproto.facts import availability
from urproto.modes import (
    ControlMode,
    JointMode,
    KinematicsStatus,
    RobotMode,
    SafetyMode,
    ToolDigitalOutputMode,
    ToolMode,
    ToolOutputMode,
)
from urproto.primary._wire import frame
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6
from urproto.versions import Availability, PolyscopeVersion

Layout = tuple[tuple[str, str], ...]

_ALWAYS = Availability.since("3.0", "5.0")
_JOINTS = 6


def _count(layout: str) -> int:
    """The number of values in a layout such as ``6d``."""
    return int(layout[:-1] or 1)


def _size(layout: Layout) -> int:
    return struct.calcsize(">" + "".join(how for _, how in layout))


@dataclass(frozen=True, slots=True, kw_only=True)
class SubPackage:
    """Base class of the sub-packages."""

    type: ClassVar[int]
    available: ClassVar[Availability] = _ALWAYS
    _layout: ClassVar[Layout] = ()
    _later: ClassVar[tuple[tuple[Availability, Layout], ...]] = ()

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The sub-package with its header. Raises LocalProtocolError when a value does not fit."""
        return frame(self.type, self._body(version))

    def _body(self, version: PolyscopeVersion) -> bytes:
        later = (layout for since, layout in self._later if since.covers(version))
        plan = self._layout + tuple(chain.from_iterable(later))
        values: list[Any] = []
        for name, how in plan:
            value = getattr(self, name)
            values.extend(value) if _count(how) > 1 else values.append(value)
        return pack("".join(how for _, how in plan), *values)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        values = dict(_read_fields(reader, cls._layout))
        for _, layout in cls._later:
            if reader.remaining >= _size(layout):
                values.update(_read_fields(reader, layout))
        return cls(**values)


def _read_fields(reader: Reader, layout: Layout) -> Iterator[tuple[str, Any]]:
    for name, how in layout:
        values = reader.unpack(how)
        yield name, values if _count(how) > 1 else values[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeData(SubPackage):
    """State of the robot. robot_mode is a RobotMode, control_mode a ControlMode.

    timestamp_us counts from the controller's start [us]. real_robot_connected is true in the simulator as well.
    """

    type: ClassVar[int] = 0
    _layout: ClassVar[Layout] = (
        ("timestamp_us", "Q"),
        ("real_robot_connected", "?"),
        ("real_robot_enabled", "?"),
        ("robot_power_on", "?"),
        ("emergency_stopped", "?"),
        ("protective_stopped", "?"),
        ("program_running", "?"),
        ("program_paused", "?"),
        ("robot_mode", "b"),
        ("control_mode", "B"),
        ("target_speed_fraction", "d"),
        ("speed_scaling", "d"),
    )
    _later: ClassVar[tuple[tuple[Availability, Layout], ...]] = (
        (availability("primary.mode.speed_limit"), (("target_speed_fraction_limit", "d"),)),
        (availability("primary.mode.reserved"), (("reserved", "B"),)),
    )

    timestamp_us: int
    real_robot_connected: bool = True
    real_robot_enabled: bool = True
    robot_power_on: bool
    emergency_stopped: bool
    protective_stopped: bool
    program_running: bool
    program_paused: bool
    robot_mode: int = RobotMode.RUNNING
    control_mode: int = ControlMode.POSITION
    target_speed_fraction: float
    speed_scaling: float
    target_speed_fraction_limit: float = 1.0
    reserved: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class JointState:
    """State of a joint: rad, rad/s, A, V, degC; mode is a JointMode. e-Series does not send a micro temperature."""

    q_actual: float
    q_target: float
    qd_actual: float
    current: float
    voltage: float
    motor_temperature: float
    micro_temperature: float = 0.0
    mode: int = JointMode.RUNNING


@dataclass(frozen=True, slots=True, kw_only=True)
class JointData(SubPackage):
    """The six joints, base first."""

    type: ClassVar[int] = 1
    _joint: ClassVar[str] = "3d4fB"

    joints: tuple[JointState, ...]

    def _body(self, version: PolyscopeVersion) -> bytes:
        names = [field.name for field in fields(JointState)]
        return b"".join(pack(self._joint, *(getattr(joint, name) for name in names)) for joint in self.joints)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        names = [field.name for field in fields(JointState)]
        values = [reader.unpack(cls._joint) for _ in range(_JOINTS)]
        return cls(joints=tuple(JointState(**dict(zip(names, joint, strict=True))) for joint in values))


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolData(SubPackage):
    """The board in the tool flange: A or V, V, A, degC; tool_mode is a ToolMode."""

    type: ClassVar[int] = 2
    _layout: ClassVar[Layout] = (
        ("analog_input_range0", "B"),
        ("analog_input_range1", "B"),
        ("analog_input0", "d"),
        ("analog_input1", "d"),
        ("tool_voltage_48V", "f"),
        ("tool_output_voltage", "B"),
        ("tool_current", "f"),
        ("tool_temperature", "f"),
        ("tool_mode", "B"),
    )

    analog_input_range0: int = 1  # range and domain as a 5.24 simulator sends them
    analog_input_range1: int = 1
    analog_input0: float = 0.0
    analog_input1: float = 0.0
    tool_voltage_48V: float = 0.0
    tool_output_voltage: int = 0
    tool_current: float = 0.0
    tool_temperature: float = 0.0
    tool_mode: int = ToolMode.RUNNING


@dataclass(frozen=True, slots=True, kw_only=True)
class EuromapData:
    """The Euromap 67 interface; only sent by control boxes that have one."""

    input_bits: int = 0
    output_bits: int = 0
    voltage_24V: float = 0.0
    current: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterboardData(SubPackage):
    """The control box: digital bits 0-7 standard, 8-15 configurable, 16-17 tool; A or V; degC.

    A domain is an AnalogDomain, safety_mode a SafetyMode. safety_checksum is the same number as in SafetyData; its name
    is a guess. The selector and the three-position device are 1 in captures of e-Series simulators and 0 in the CB3
    capture.
    """

    type: ClassVar[int] = 3
    _layout: ClassVar[Layout] = (
        ("digital_input_bits", "I"),
        ("digital_output_bits", "I"),
        ("analog_input_range0", "B"),
        ("analog_input_range1", "B"),
        ("analog_input0", "d"),
        ("analog_input1", "d"),
        ("analog_output_domain0", "b"),
        ("analog_output_domain1", "b"),
        ("analog_output0", "d"),
        ("analog_output1", "d"),
        ("board_temperature", "f"),
        ("robot_voltage_48V", "f"),
        ("robot_current", "f"),
        ("io_current", "f"),
        ("safety_mode", "B"),
        ("reduced_mode", "?"),
    )
    _tail: ClassVar[tuple[tuple[Availability, Layout], ...]] = (
        (_ALWAYS, (("safety_checksum", "I"),)),
        (
            availability("primary.masterboard.selectors"),
            (("operational_mode_selector", "B"), ("three_position_device", "B")),
        ),
        (availability("primary.masterboard.internal"), (("internal", "B"),)),
    )

    digital_input_bits: int = 0
    digital_output_bits: int = 0
    analog_input_range0: int = 1  # this and internal as in all captures
    analog_input_range1: int = 1
    analog_input0: float = 0.0
    analog_input1: float = 0.0
    analog_output_domain0: int = 0
    analog_output_domain1: int = 0
    analog_output0: float = 0.0
    analog_output1: float = 0.0
    board_temperature: float = 0.0
    robot_voltage_48V: float = 48.0
    robot_current: float = 0.0
    io_current: float = 0.0
    safety_mode: int = SafetyMode.NORMAL
    reduced_mode: bool = False
    euromap: EuromapData | None = None
    safety_checksum: int = 0
    operational_mode_selector: int = 0
    three_position_device: int = 0
    internal: int = 1

    def _body(self, version: PolyscopeVersion) -> bytes:
        euromap = self.euromap
        body = SubPackage._body(self, version) + pack("b", euromap is not None)
        if euromap is not None:
            body += pack("2I2f", euromap.input_bits, euromap.output_bits, euromap.voltage_24V, euromap.current)
        tail = [item for since, layout in self._tail if since.covers(version) for item in layout]
        return body + b"".join(pack(how, getattr(self, name)) for name, how in tail)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        values = dict(_read_fields(reader, cls._layout))
        if reader.unpack("b")[0]:
            names = [field.name for field in fields(EuromapData)]
            values["euromap"] = EuromapData(**dict(zip(names, reader.unpack("2I2f"), strict=True)))
        for _, layout in cls._tail:
            if reader.remaining >= _size(layout):
                values.update(_read_fields(reader, layout))
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class CartesianInfo(SubPackage):
    """pose_base_tcp and tcp_offset (flange to TCP): x, y, z [m] and rotation vector [rad]."""

    type: ClassVar[int] = 4
    _layout: ClassVar[Layout] = (("pose_base_tcp", "6d"),)
    _later: ClassVar[tuple[tuple[Availability, Layout], ...]] = (
        (availability("primary.cartesian.tcp_offset"), (("tcp_offset", "6d"),)),
    )

    pose_base_tcp: Vector6
    tcp_offset: Vector6 = ZERO6


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicsInfo(SubPackage):
    """Denavit-Hartenberg parameters [rad, m, m, rad], calibrated or nominal.

    A simulator sends nominal ones with all checksums 2^32-1 and status OK. The short form, sent by some versions,
    contains only the status.
    """

    type: ClassVar[int] = 5
    available: ClassVar[Availability] = availability("primary.kinematics")
    _layout: ClassVar[Layout] = (
        ("checksum", "6I"),
        ("dh_theta", "6d"),
        ("dh_a", "6d"),
        ("dh_d", "6d"),
        ("dh_alpha", "6d"),
        ("status", "I"),
    )

    checksum: tuple[int, ...] = (0xFFFFFFFF,) * 6
    dh_theta: Vector6 = ZERO6
    dh_a: Vector6 = ZERO6
    dh_d: Vector6 = ZERO6
    dh_alpha: Vector6 = ZERO6
    status: int = KinematicsStatus.NOT_INITIALISED

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        if reader.remaining == 4:
            return cls(status=reader.unpack("I")[0])
        return cls(**dict(_read_fields(reader, cls._layout)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfigurationData(SubPackage):
    """Limits and defaults of the arm: rad, rad/s, rad/s2, m/s, m/s2, m.

    robot_type is a RobotType, sub_type a RobotSubType, controller_box a ControllerBox.
    """

    type: ClassVar[int] = 6
    _rest: ClassVar[Layout] = (
        ("v_joint_default", "d"),
        ("a_joint_default", "d"),
        ("v_tool_default", "d"),
        ("a_tool_default", "d"),
        ("eq_radius", "d"),
        ("dh_a", "6d"),
        ("dh_d", "6d"),
        ("dh_alpha", "6d"),
        ("dh_theta", "6d"),
        ("masterboard_version", "i"),
        ("controller_box", "i"),
        ("robot_type", "i"),
        ("sub_type", "i"),
    )

    q_min: Vector6
    q_max: Vector6
    qd_max: Vector6
    qdd_max: Vector6
    v_joint_default: float
    a_joint_default: float
    v_tool_default: float
    a_tool_default: float
    eq_radius: float
    dh_a: Vector6
    dh_d: Vector6
    dh_alpha: Vector6
    dh_theta: Vector6
    masterboard_version: int
    controller_box: int
    robot_type: int
    sub_type: int

    def _body(self, version: PolyscopeVersion) -> bytes:
        limits = chain.from_iterable(
            chain(zip(self.q_min, self.q_max, strict=True), zip(self.qd_max, self.qdd_max, strict=True))
        )
        rest = [(how, getattr(self, name)) for name, how in self._rest]
        return pack("24d", *limits) + b"".join(
            pack(how, *value) if _count(how) > 1 else pack(how, value) for how, value in rest
        )

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        position, speed = reader.unpack("12d"), reader.unpack("12d")
        return cls(
            q_min=position[0::2],
            q_max=position[1::2],
            qd_max=speed[0::2],
            qdd_max=speed[1::2],
            **dict(_read_fields(reader, cls._rest)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceModeData(SubPackage):
    """Task frame of force mode and the square of the Jacobian's determinant.

    frame: in the base frame [m, rotation vector], zero without force mode. Clients disagree whether it is a frame or a
    wrench; the capture of an arm that measures a force has zeros here and the force in CalibrationData.
    """

    type: ClassVar[int] = 7
    _layout: ClassVar[Layout] = (("frame", "6d"), ("dexterity", "d"))

    frame: Vector6 = ZERO6
    dexterity: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AdditionalInfo(SubPackage):
    """Freedrive button and its permission. reserved is 1 in every capture."""

    type: ClassVar[int] = 8
    available: ClassVar[Availability] = availability("primary.additional")
    _layout: ClassVar[Layout] = (("freedrive_button_pressed", "?"), ("freedrive_button_enabled", "?"))
    _later: ClassVar[tuple[tuple[Availability, Layout], ...]] = (
        (availability("primary.additional.io_freedrive"), (("io_enabled_freedrive", "?"),)),
        (availability("primary.additional.reserved"), (("reserved", "B"),)),
    )

    freedrive_button_pressed: bool = False
    freedrive_button_enabled: bool = True
    io_enabled_freedrive: bool = False
    reserved: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationData(SubPackage):
    """Internal: a wrench [N, Nm]; zero from simulators, the measured force from an arm."""

    type: ClassVar[int] = 9
    _layout: ClassVar[Layout] = (("wrench", "6d"),)

    wrench: Vector6 = ZERO6


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyData(SubPackage):
    """Internal: elbow in the base frame [m] and a checksum. All names are guesses."""

    type: ClassVar[int] = 10
    available: ClassVar[Availability] = availability("primary.safety")
    _layout: ClassVar[Layout] = (
        ("checksum", "I"),
        ("flag0", "B"),
        ("flag1", "B"),
        ("elbow_position", "3d"),
        ("elbow_radius", "d"),
    )

    checksum: int = 0
    flag0: int = 1
    flag1: int = 1
    elbow_position: Vector3 = ZERO3
    elbow_radius: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolCommunicationInfo(SubPackage):
    """Serial line at the tool connector (e-Series); the defaults are those of a simulator."""

    type: ClassVar[int] = 11
    available: ClassVar[Availability] = availability("primary.tool_communication")
    _layout: ClassVar[Layout] = (
        ("enabled", "?"),
        ("baud_rate", "i"),
        ("parity", "i"),
        ("stop_bits", "i"),
        ("rx_idle_chars", "f"),
        ("tx_idle_chars", "f"),
    )

    enabled: bool = False
    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolModeInfo(SubPackage):
    """Use of the tool output pins (e-Series)."""

    type: ClassVar[int] = 12
    available: ClassVar[Availability] = availability("primary.tool_mode")
    _layout: ClassVar[Layout] = (
        ("output_mode", "B"),
        ("digital_output0_mode", "B"),
        ("digital_output1_mode", "B"),
    )

    output_mode: int = ToolOutputMode.DIGITAL
    digital_output0_mode: int = ToolDigitalOutputMode.SINKING_NPN
    digital_output1_mode: int = ToolDigitalOutputMode.SINKING_NPN


@dataclass(frozen=True, slots=True, kw_only=True)
class SingularityInfo(SubPackage):
    """Internal: proximity of singularities (client interface document of 5.9; its numbers are not published).

    No capture of a simulator (5.4 to 5.24) or of an arm contains it, so the emulator does not send it.
    """

    type: ClassVar[int] = 13
    available: ClassVar[Availability] = availability("primary.singularity")
    _layout: ClassVar[Layout] = (("severity", "B"), ("kind", "B"))

    severity: int
    kind: int
