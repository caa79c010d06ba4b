"""Digital and analog inputs and outputs of the control box and the tool flange; registers; the base light.

Digital signals share one word each way: bits 0-7 standard, 8-15 configurable, 16-17
tool (RTDE and primary interface agree on this). Analog values are kept in amperes and
volts; programs and RTDE set outputs as a ratio of the range.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from emulator.snapshot import Marked, Snapshot
from urproto.modes import AnalogDomain, ToolDigitalOutputMode, ToolOutputMode
from urproto.robots.pose import rotvec_to_matrix
from urproto.signals import DigitalGroup
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6, rotate

if TYPE_CHECKING:
    from emulator.robot.arm import Arm


BIT_COUNT: Final = 128  # RTDE guide
NUMBER_COUNT: Final = 48  # RTDE guide; 24 before 3.9 / 5.3
_INT32_MIN: Final = -(2**31)
_INT32_MAX: Final = 2**31 - 1
MODBUS_GENERAL_PURPOSE: Final = range(128, 256)
"""Registers of the Modbus server that programs and clients may use as they like."""

# Ranges of the control box's analog outputs (user manual: 4-20 mA or 0-10 V).
_CURRENT_LOW_A: Final = 0.004
_CURRENT_HIGH_A: Final = 0.020
_VOLTAGE_HIGH_V: Final = 10.0
_TOOL_VOLTAGES: Final = (0, 12, 24)  # V


class RegisterBank(Marked):
    """One direction: booleans packed into an integer, int32 values, doubles.

    The tuples handed out stay the same object until a value changes.
    """

    def __init__(self) -> None:
        self.bits = 0
        self.ints: tuple[int, ...] = (0,) * NUMBER_COUNT
        self.doubles: tuple[float, ...] = (0.0,) * NUMBER_COUNT

    def get_bit(self, index: int) -> bool:
        """Boolean register 0-127. Raises IndexError outside."""
        return bool(self.bits >> _checked(index, BIT_COUNT) & 1)

    def set_bit(self, index: int, value: bool) -> None:
        """Write boolean register 0-127. Raises IndexError outside."""
        mask = 1 << _checked(index, BIT_COUNT)
        self.bits = self.bits | mask if value else self.bits & ~mask

    def set_bits(self, first: int, count: int, value: int) -> None:
        """Write ``count`` booleans from ``first`` on, packed into an integer (bit 0 is ``first``)."""
        mask = ((1 << count) - 1) << first
        self.bits = self.bits & ~mask | value << first & mask

    def get_int(self, index: int) -> int:
        """Integer register 0-47. Raises IndexError outside."""
        return self.ints[_checked(index, NUMBER_COUNT)]

    def set_int(self, index: int, value: int) -> None:
        """Write integer register 0-47. Raises IndexError, or OverflowError beyond 32 bits."""
        if not _INT32_MIN <= value <= _INT32_MAX:
            raise OverflowError(f"{value} does not fit an integer register, which has 32 bits, signed")
        if self.ints[_checked(index, NUMBER_COUNT)] != value:
            self.ints = (*self.ints[:index], int(value), *self.ints[index + 1 :])

    def get_double(self, index: int) -> float:
        """Double register 0-47. Raises IndexError outside."""
        return self.doubles[_checked(index, NUMBER_COUNT)]

    def set_double(self, index: int, value: float) -> None:
        """Write double register 0-47. Raises IndexError outside."""
        old = self.doubles[_checked(index, NUMBER_COUNT)]
        if old != value or math.copysign(1.0, old) != math.copysign(1.0, value):
            self.doubles = (*self.doubles[:index], float(value), *self.doubles[index + 1 :])


class Registers:
    """``input`` is what clients write, ``output`` what programs write."""

    def __init__(self) -> None:
        self.input = RegisterBank()
        self.output = RegisterBank()
        self.banks = self.input, self.output

    def publish(self, snapshot: Snapshot) -> None:
        """Write the registers that have changed since the last snapshot."""
        given, made = self.input, self.output
        if given.take_change():
            snapshot.input_bit_registers = given.bits
            snapshot.input_int_registers, snapshot.input_double_registers = given.ints, given.doubles
        if made.take_change():
            snapshot.output_bit_registers = made.bits
            snapshot.output_int_registers, snapshot.output_double_registers = made.ints, made.doubles


class ModbusRegisters:
    """Registers that belong to the Modbus server alone: the general-purpose ones, and the uptime latched last."""

    def __init__(self) -> None:
        self.general = [0] * len(MODBUS_GENERAL_PURPOSE)
        self.uptime = [0] * 5  # ms, s, min, h, days

    def latch_uptime(self, seconds: float) -> None:
        """Keep the time since the controller started until the next call."""
        milliseconds = round(seconds * 1000.0)
        whole = milliseconds // 1000
        self.uptime = [milliseconds % 1000, whole % 60, whole // 60 % 60, whole // 3600 % 24, whole // 86400]


def _checked(index: int, count: int) -> int:
    if not 0 <= index < count:
        raise IndexError(f"there is no register {index}: use 0 to {count - 1}")
    return index


@dataclass(frozen=True, slots=True)
class BaseLight:
    """The base light. ``mode``: "iec" shows the state of the arm in the colours of IEC 60204-1 (that it starts like
    this is a guess), "solid" the ``colour`` (red, green, blue, each 0 to 255), "off" nothing."""

    mode: Literal["iec", "solid", "off"] = "iec"
    colour: tuple[int, int, int] | None = None


@dataclass
class ForceInput:
    """External force/torque sensor: enabled by ``ft_rtde_input_enable``, fed by RTDE's external_force_torque.

    wrench_flange: measured in the flange's axes, at ``measuring_offset`` from the flange
    [N, Nm, m] (that the axes are the flange's is a guess). sensor_mass and sensor_cog: the
    sensor's own weight [kg, m], stored for programs to read; its readings are taken as
    already free of it.
    """

    enabled: bool = False
    wrench_flange: Vector6 = ZERO6
    sensor_mass: float = 0.0
    measuring_offset: Vector3 = ZERO3
    sensor_cog: Vector3 = ZERO3

    def wrench_base(self, arm: "Arm") -> Vector6:
        """The wrench in the base frame, at the TCP the arm had in the last period."""
        if self.wrench_flange == ZERO6:
            return ZERO6
        flange = arm.flange_pose
        m = rotvec_to_matrix(*flange[3:])
        force = rotate(m, self.wrench_flange[:3])
        tx, ty, tz = rotate(m, self.wrench_flange[3:])
        ox, oy, oz = rotate(m, self.measuring_offset)
        x, y, z = (f + o - t for f, o, t in zip(flange, (ox, oy, oz), arm.tcp_pose, strict=False))
        fx, fy, fz = force
        return (fx, fy, fz, tx + y * fz - z * fy, ty + z * fx - x * fz, tz + x * fy - y * fx)


class Signals(Marked):
    """State of all signals. Inputs are set from outside the robot, outputs by programs and clients.

    analog_inputs: what the analog inputs of the control box initially measure.
    """

    def __init__(self, analog_inputs: AnalogDomain = AnalogDomain.VOLTAGE) -> None:
        self.digital_inputs = 0
        self.digital_outputs = 0
        self.analog_inputs = [0.0, 0.0]  # A or V by domain
        self.analog_input_domains = [analog_inputs, analog_inputs]
        self.analog_output_ratios = [0.0, 0.0]  # 0..1 of the range
        self.analog_output_domains = [AnalogDomain.CURRENT, AnalogDomain.CURRENT]
        self.tool_analog_inputs = [0.0, 0.0]  # A or V by domain
        self.tool_analog_input_domains = [AnalogDomain.VOLTAGE, AnalogDomain.VOLTAGE]
        self.tool_voltage = 0  # V
        self.tool_output_mode = ToolOutputMode.DIGITAL
        self.tool_digital_output_modes = [ToolDigitalOutputMode.SINKING_NPN, ToolDigitalOutputMode.SINKING_NPN]

    def get_digital_input(self, group: DigitalGroup, index: int) -> bool:
        """Level of one input. Raises IndexError for a signal the group does not have."""
        return bool(self.digital_inputs >> group.bit(index) & 1)

    def set_digital_input(self, group: DigitalGroup, index: int, level: bool) -> None:
        """Drive one input from outside. Raises IndexError for a signal the group does not have."""
        mask = 1 << group.bit(index)
        self.digital_inputs = self.digital_inputs | mask if level else self.digital_inputs & ~mask

    def get_digital_output(self, group: DigitalGroup, index: int) -> bool:
        """Level of one output. Raises IndexError for a signal the group does not have."""
        return bool(self.digital_outputs >> group.bit(index) & 1)

    def set_digital_output(self, group: DigitalGroup, index: int, level: bool) -> None:
        """Set one output. Raises IndexError for a signal the group does not have."""
        mask = 1 << group.bit(index)
        self.digital_outputs = self.digital_outputs | mask if level else self.digital_outputs & ~mask

    def apply_outputs(self, group: DigitalGroup, mask: int, levels: int) -> None:
        """Set those outputs of the group whose bit is in ``mask`` (bit 0 is the group's first)."""
        word_mask = (mask & ((1 << group.count) - 1)) << group.first
        self.digital_outputs = self.digital_outputs & ~word_mask | levels << group.first & word_mask

    def set_analog_output(self, index: int, ratio: float) -> None:
        """Set analog output 0 or 1 to a ratio of its range, clipped to 0..1; NaN is ignored.

        Raises IndexError.
        """
        slot = _analog(index)
        if not math.isnan(ratio):
            self.analog_output_ratios[slot] = min(max(float(ratio), 0.0), 1.0)

    def analog_output(self, index: int) -> float:
        """Analog output 0 or 1 in A or V, depending on its domain. Raises IndexError."""
        ratio = self.analog_output_ratios[_analog(index)]
        if self.analog_output_domains[index] is AnalogDomain.VOLTAGE:
            return ratio * _VOLTAGE_HIGH_V
        return _CURRENT_LOW_A + ratio * (_CURRENT_HIGH_A - _CURRENT_LOW_A)

    def set_tool_voltage(self, voltage: int) -> None:
        """Tool supply voltage: 0, 12 or 24 V. Raises ValueError for another one."""
        if voltage not in _TOOL_VOLTAGES:
            raise ValueError(f"the tool voltage must be 0, 12 or 24 V, not {voltage}")
        self.tool_voltage = int(voltage)

    @property
    def analog_io_types(self) -> int:
        """Domains of AI0, AI1, AO0, AO1 in bits 0-3; 1 is voltage."""
        (i0, i1), (o0, o1) = self.analog_input_domains, self.analog_output_domains
        return i0 | i1 << 1 | o0 << 2 | o1 << 3

    @property
    def tool_analog_input_types(self) -> int:
        """Domains of the tool's analog inputs in bits 0-1; 1 is voltage."""
        first, second = self.tool_analog_input_domains
        return first | second << 1

    def publish(self, snapshot: Snapshot) -> None:
        """Write inputs and outputs to a snapshot, if any have changed since the last one."""
        if not self.take_change():
            return
        snapshot.actual_digital_input_bits = self.digital_inputs
        snapshot.actual_digital_output_bits = self.digital_outputs
        snapshot.actual_configurable_digital_input_bits = self.digital_inputs >> 8 & 0xFF
        snapshot.actual_configurable_digital_output_bits = self.digital_outputs >> 8 & 0xFF
        snapshot.analog_io_types = self.analog_io_types
        snapshot.standard_analog_input0, snapshot.standard_analog_input1 = self.analog_inputs
        snapshot.standard_analog_output0 = self.analog_output(0)
        snapshot.standard_analog_output1 = self.analog_output(1)
        snapshot.tool_analog_input_types = self.tool_analog_input_types
        snapshot.tool_analog_input0, snapshot.tool_analog_input1 = self.tool_analog_inputs
        snapshot.tool_output_voltage = self.tool_voltage
        snapshot.tool_output_mode = self.tool_output_mode
        snapshot.tool_digital_output0_mode, snapshot.tool_digital_output1_mode = self.tool_digital_output_modes


def _analog(index: int) -> int:
    if index not in (0, 1):
        raise IndexError(f"there is no analog signal {index}: use 0 or 1")
    return index
