"""The sub-packages of a robot state.

Newer versions only append to the bodies. Each dataclass therefore has the fields of its oldest form first, and later
ones with their first versions. Decoding relies on the size alone.

First versions, with their sources, are rows of ``urproto/facts/primary.csv``. The layouts: captures of a 5.4, an early
5.x and a 5.24 simulator and of a late CB3 arm; the rest is from the vendor's client interface documents as interpreted
by several public clients.
"""

import struct
from dataclasses import dataclass, fields
from functools import cache
from itertools import chain, groupby
from typing import Annotated, Any, ClassVar

from urproto._wire import (
    Double,
    Flag,
    Float,
    Int8,
    Int32,
    Layout,
    Reader,
    SixDoubles,
    ThreeDoubles,
    UInt8,
    UInt32,
    UInt64,
    marked_fields,
    pack,
)
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
from urproto.vectors import ZERO3, ZERO6, Vector6
from urproto.versions import Availability, PolyscopeVersion

_ALWAYS = Availability.since("3.0", "5.0")
_JOINTS = 6


def _count(form: str) -> int:
    """The number of values in a form such as ``6d``."""
    return int(form[:-1] or 1)


def _size(layout: Layout) -> int:
    return struct.calcsize(">" + "".join(form for _, form in layout))


@cache
def _parts_of(kind: Any) -> tuple[Layout, tuple[tuple[Availability, Layout], ...]]:
    """The fields of the oldest form, and those that later versions append together."""
    forms = [(marks[1:], (name, marks[0])) for name, marks in marked_fields(kind)]
    groups = [(since, tuple(item for _, item in group)) for since, group in groupby(forms, lambda form: form[0])]
    (_, oldest), *later = groups
    return oldest, tuple((since[0], layout) for since, layout in later)


@dataclass(frozen=True, slots=True, kw_only=True)
class SubPackage:
    """Base class of the sub-packages."""

    type: ClassVar[int]
    available: ClassVar[Availability] = _ALWAYS

    @classmethod
    def _parts(cls) -> tuple[Layout, tuple[tuple[Availability, Layout], ...]]:
        kind: Any = cls  # which mypy does not take to be hashable
        return _parts_of(kind)

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The sub-package with its header. Raises LocalProtocolError when a value does not fit."""
        return frame(self.type, self._body(version))

    def _body(self, version: PolyscopeVersion) -> bytes:
        return self._packed(self._parts()[0]) + self._packed_later(version)

    def _packed_later(self, version: PolyscopeVersion) -> bytes:
        later = self._parts()[1]
        return b"".join(self._packed(layout) for since, layout in later if since.covers(version))

    def _packed(self, layout: Layout) -> bytes:
        values: list[Any] = []
        for name, form in layout:
            value = getattr(self, name)
            values.extend(value) if _count(form) > 1 else values.append(value)
        return pack("".join(form for _, form in layout), *values)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        return cls(**_read_fields(reader, cls._parts()[0]), **cls._read_later(reader))

    @classmethod
    def _read_later(cls, reader: Reader) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for _, layout in cls._parts()[1]:
            if reader.remaining >= _size(layout):
                values |= _read_fields(reader, layout)
        return values


def _read_fields(reader: Reader, layout: Layout) -> dict[str, Any]:
    read = ((name, form, reader.unpack(form)) for name, form in layout)
    return {name: values if _count(form) > 1 else values[0] for name, form, values in read}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeData(SubPackage):
    """State of the robot. robot_mode is a RobotMode, control_mode a ControlMode.

    timestamp_us counts from the controller's start [us]. real_robot_connected is true in the simulator as well.
    """

    type: ClassVar[int] = 0

    timestamp_us: UInt64
    real_robot_connected: Flag = True
    real_robot_enabled: Flag = True
    robot_power_on: Flag
    emergency_stopped: Flag
    protective_stopped: Flag
    program_running: Flag
    program_paused: Flag
    robot_mode: Int8 = RobotMode.RUNNING
    control_mode: UInt8 = ControlMode.POSITION
    target_speed_fraction: Double
    speed_scaling: Double
    target_speed_fraction_limit: Annotated[Double, availability("primary.mode.speed_limit")] = 1.0
    reserved: Annotated[UInt8, availability("primary.mode.reserved")] = 0


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

    analog_input_range0: UInt8 = 1  # range and domain as a 5.24 simulator sends them
    analog_input_range1: UInt8 = 1
    analog_input0: Double = 0.0
    analog_input1: Double = 0.0
    tool_voltage_48V: Float = 0.0
    tool_output_voltage: UInt8 = 0
    tool_current: Float = 0.0
    tool_temperature: Float = 0.0
    tool_mode: UInt8 = ToolMode.RUNNING


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

    digital_input_bits: UInt32 = 0
    digital_output_bits: UInt32 = 0
    analog_input_range0: UInt8 = 1  # this and internal as in all captures
    analog_input_range1: UInt8 = 1
    analog_input0: Double = 0.0
    analog_input1: Double = 0.0
    analog_output_domain0: Int8 = 0
    analog_output_domain1: Int8 = 0
    analog_output0: Double = 0.0
    analog_output1: Double = 0.0
    board_temperature: Float = 0.0
    robot_voltage_48V: Float = 48.0
    robot_current: Float = 0.0
    io_current: Float = 0.0
    safety_mode: UInt8 = SafetyMode.NORMAL
    reduced_mode: Flag = False
    euromap: EuromapData | None = None
    safety_checksum: Annotated[UInt32, _ALWAYS] = 0
    operational_mode_selector: Annotated[UInt8, availability("primary.masterboard.selectors")] = 0
    three_position_device: Annotated[UInt8, availability("primary.masterboard.selectors")] = 0
    internal: Annotated[UInt8, availability("primary.masterboard.internal")] = 1

    def _body(self, version: PolyscopeVersion) -> bytes:
        euromap = self.euromap
        body = self._packed(self._parts()[0]) + pack("b", euromap is not None)
        if euromap is not None:
            body += pack("2I2f", euromap.input_bits, euromap.output_bits, euromap.voltage_24V, euromap.current)
        return body + self._packed_later(version)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        values = _read_fields(reader, cls._parts()[0])
        if reader.unpack("b")[0]:
            names = [field.name for field in fields(EuromapData)]
            values["euromap"] = EuromapData(**dict(zip(names, reader.unpack("2I2f"), strict=True)))
        return cls(**values, **cls._read_later(reader))


@dataclass(frozen=True, slots=True, kw_only=True)
class CartesianInfo(SubPackage):
    """pose_base_tcp and tcp_offset (flange to TCP): x, y, z [m] and rotation vector [rad]."""

    type: ClassVar[int] = 4

    pose_base_tcp: SixDoubles
    tcp_offset: Annotated[SixDoubles, availability("primary.cartesian.tcp_offset")] = ZERO6


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicsInfo(SubPackage):
    """Denavit-Hartenberg parameters [rad, m, m, rad], calibrated or nominal.

    A simulator sends nominal ones with all checksums 2^32-1 and status OK. The short form, sent by some versions,
    contains only the status.
    """

    type: ClassVar[int] = 5
    available: ClassVar[Availability] = availability("primary.kinematics")

    checksum: Annotated[tuple[int, ...], "6I"] = (0xFFFFFFFF,) * 6
    dh_theta: SixDoubles = ZERO6
    dh_a: SixDoubles = ZERO6
    dh_d: SixDoubles = ZERO6
    dh_alpha: SixDoubles = ZERO6
    status: UInt32 = KinematicsStatus.NOT_INITIALISED

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        if reader.remaining == 4:
            return cls(status=reader.unpack("I")[0])
        return cls(**_read_fields(reader, cls._parts()[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfigurationData(SubPackage):
    """Limits and defaults of the arm: rad, rad/s, rad/s2, m/s, m/s2, m.

    robot_type is a RobotType, sub_type a RobotSubType, controller_box a ControllerBox.
    """

    type: ClassVar[int] = 6

    q_min: Vector6
    q_max: Vector6
    qd_max: Vector6
    qdd_max: Vector6
    v_joint_default: Double
    a_joint_default: Double
    v_tool_default: Double
    a_tool_default: Double
    eq_radius: Double
    dh_a: SixDoubles
    dh_d: SixDoubles
    dh_alpha: SixDoubles
    dh_theta: SixDoubles
    masterboard_version: Int32
    controller_box: Int32
    robot_type: Int32
    sub_type: Int32

    def _body(self, version: PolyscopeVersion) -> bytes:
        limits = chain.from_iterable(
            chain(zip(self.q_min, self.q_max, strict=True), zip(self.qd_max, self.qdd_max, strict=True))
        )
        return pack("24d", *limits) + SubPackage._body(self, version)

    @classmethod
    def _read(cls, reader: Reader) -> Self:
        position, speed = reader.unpack("12d"), reader.unpack("12d")
        return cls(
            q_min=position[0::2],
            q_max=position[1::2],
            qd_max=speed[0::2],
            qdd_max=speed[1::2],
            **_read_fields(reader, cls._parts()[0]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceModeData(SubPackage):
    """Task frame of force mode and the square of the Jacobian's determinant.

    frame: in the base frame [m, rotation vector], zero without force mode. Clients disagree whether it is a frame or a
    wrench; the capture of an arm that measures a force has zeros here and the force in CalibrationData.
    """

    type: ClassVar[int] = 7

    frame: SixDoubles = ZERO6
    dexterity: Double = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AdditionalInfo(SubPackage):
    """Freedrive button and its permission. reserved is 1 in every capture."""

    type: ClassVar[int] = 8
    available: ClassVar[Availability] = availability("primary.additional")

    freedrive_button_pressed: Flag = False
    freedrive_button_enabled: Flag = True
    io_enabled_freedrive: Annotated[Flag, availability("primary.additional.io_freedrive")] = False
    reserved: Annotated[UInt8, availability("primary.additional.reserved")] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationData(SubPackage):
    """Internal: a wrench [N, Nm]; zero from simulators, the measured force from an arm."""

    type: ClassVar[int] = 9

    wrench: SixDoubles = ZERO6


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyData(SubPackage):
    """Internal: elbow in the base frame [m] and a checksum. All names are guesses."""

    type: ClassVar[int] = 10
    available: ClassVar[Availability] = availability("primary.safety")

    checksum: UInt32 = 0
    flag0: UInt8 = 1
    flag1: UInt8 = 1
    elbow_position: ThreeDoubles = ZERO3
    elbow_radius: Double = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolCommunicationInfo(SubPackage):
    """Serial line at the tool connector (e-Series); the defaults are those of a simulator."""

    type: ClassVar[int] = 11
    available: ClassVar[Availability] = availability("primary.tool_communication")

    enabled: Flag = False
    baud_rate: Int32 = 115200
    parity: Int32 = 0
    stop_bits: Int32 = 1
    rx_idle_chars: Float = 1.5
    tx_idle_chars: Float = 3.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolModeInfo(SubPackage):
    """Use of the tool output pins (e-Series)."""

    type: ClassVar[int] = 12
    available: ClassVar[Availability] = availability("primary.tool_mode")

    output_mode: UInt8 = ToolOutputMode.DIGITAL
    digital_output0_mode: UInt8 = ToolDigitalOutputMode.SINKING_NPN
    digital_output1_mode: UInt8 = ToolDigitalOutputMode.SINKING_NPN


@dataclass(frozen=True, slots=True, kw_only=True)
class SingularityInfo(SubPackage):
    """Internal: proximity of singularities (client interface document of 5.9; its numbers are not published).

    No capture of a simulator (5.4 to 5.24) or of an arm contains it, so the emulator does not send it.
    """

    type: ClassVar[int] = 13
    available: ClassVar[Availability] = availability("primary.singularity")

    severity: UInt8
    kind: UInt8
