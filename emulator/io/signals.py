"""Digital and analog inputs and outputs of the control box and the tool flange.

Digital signals share one word each way: bits 0-7 standard, 8-15 configurable, 16-17
tool (RTDE and primary interface agree on this). Analog values are kept in amperes and
volts; programs and RTDE set outputs as a ratio of the range.
"""

import math
from typing import Final

from emulator.snapshot import Snapshot
from urproto.modes import AnalogDomain, ToolDigitalOutputMode, ToolOutputMode

__all__ = ["CONFIGURABLE", "STANDARD", "TOOL", "DigitalGroup", "Signals"]

# Ranges of the control box's analog outputs (user manual: 4-20 mA or 0-10 V).
_CURRENT_LOW_A: Final = 0.004
_CURRENT_HIGH_A: Final = 0.020
_VOLTAGE_HIGH_V: Final = 10.0
_TOOL_VOLTAGES: Final = (0, 12, 24)  # V


class DigitalGroup:
    """A run of bits in the digital words: ``first`` bit and ``count``."""

    def __init__(self, name: str, first: int, count: int) -> None:
        self.name = name
        self.first = first
        self.count = count

    def bit(self, index: int) -> int:
        """Position of signal ``index`` in the word. Raises IndexError outside the group."""
        if not 0 <= index < self.count:
            raise IndexError(f"there is no {self.name} digital signal {index}: they are 0 to {self.count - 1}")
        return self.first + index


STANDARD: Final = DigitalGroup("standard", 0, 8)
CONFIGURABLE: Final = DigitalGroup("configurable", 8, 8)
TOOL: Final = DigitalGroup("tool", 16, 2)


class Signals:
    """State of all signals. Inputs are set from outside the robot, outputs by programs and clients.

    early_simulator: analog inputs of the box measure currents to begin with, as in a recording of one; in captures of
    later simulators, and of an arm, they measure voltages.
    """

    def __init__(self, *, early_simulator: bool = False) -> None:
        self.digital_inputs = 0
        self.digital_outputs = 0
        self.analog_inputs = [0.0, 0.0]  # A or V by domain
        own = AnalogDomain.CURRENT if early_simulator else AnalogDomain.VOLTAGE
        self.analog_input_domains = [own, own]
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
        """Set analog output 0 or 1 to a ratio of its range, clipped to 0..1; no number changes
        nothing. Raises IndexError."""
        slot = _analog(index)
        if not math.isnan(ratio):
            self.analog_output_ratios[slot] = min(max(float(ratio), 0.0), 1.0)

    def analog_output(self, index: int) -> float:
        """Analog output 0 or 1 in A or V, by its domain. Raises IndexError."""
        ratio = self.analog_output_ratios[_analog(index)]
        if self.analog_output_domains[index] is AnalogDomain.VOLTAGE:
            return ratio * _VOLTAGE_HIGH_V
        return _CURRENT_LOW_A + ratio * (_CURRENT_HIGH_A - _CURRENT_LOW_A)

    def set_tool_voltage(self, voltage: int) -> None:
        """Tool supply voltage: 0, 12 or 24 V. Raises ValueError for another one."""
        if voltage not in _TOOL_VOLTAGES:
            raise ValueError(f"the tool supply can be 0, 12 or 24 V, not {voltage}")
        self.tool_voltage = int(voltage)

    @property
    def analog_io_types(self) -> int:
        """Domains of AI0, AI1, AO0, AO1 in bits 0-3; 1 is voltage."""
        return _pack_domains([*self.analog_input_domains, *self.analog_output_domains])

    @property
    def tool_analog_input_types(self) -> int:
        """Domains of the tool's analog inputs in bits 0-1; 1 is voltage."""
        return _pack_domains(self.tool_analog_input_domains)

    def publish(self, snapshot: Snapshot) -> None:
        """Write inputs and outputs to a snapshot."""
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
        raise IndexError(f"there is no analog signal {index}: they are 0 and 1")
    return index


def _pack_domains(domains: list[AnalogDomain]) -> int:
    return sum(domain << bit for bit, domain in enumerate(domains))
