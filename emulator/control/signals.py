"""Verbs about wires and memory: inputs, outputs, registers, encoders."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Final, Literal

from emulator.control.base import ControlBase
from emulator.control.verbs import BadArguments, verb
from emulator.guard import plausible
from emulator.io.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup
from urproto.modes import AnalogDomain

__all__ = ["SignalVerbs"]

Group = Literal["standard", "configurable", "tool"]
Domain = Literal["current", "voltage"]
Register = Literal["bit", "int", "double"]

_GROUPS: Final[dict[str, DigitalGroup]] = {group.name: group for group in (STANDARD, CONFIGURABLE, TOOL)}


class SignalVerbs(ControlBase):
    """Verbs about digital and analog signals and registers."""

    @verb
    def set_digital_input(self, index: int, level: bool, group: Group = "standard") -> None:
        """Drive a digital input: 0 to 7 of the control box, 0 to 7 of its configurable ones, 0 or 1 at the tool."""
        with _indices():
            self.controller.signals.set_digital_input(_GROUPS[group], index, level)

    @verb
    def set_digital_output(self, index: int, level: bool, group: Group = "standard") -> None:
        """Switch a digital output, as a program does."""
        with _indices():
            self.controller.signals.set_digital_output(_GROUPS[group], index, level)

    @verb
    def set_analog_input(self, index: int, value: float, domain: Domain | None = None, *, tool: bool = False) -> None:
        """Drive analog input 0 or 1 of the control box or the tool [A or V]; optionally change what it measures."""
        if index not in (0, 1):
            raise BadArguments(f"there is no analog input {index}: they are 0 and 1")
        if not plausible(value):
            raise BadArguments(f"no signal is at {value}: give A or V")
        signals = self.controller.signals
        values = signals.tool_analog_inputs if tool else signals.analog_inputs
        domains = signals.tool_analog_input_domains if tool else signals.analog_input_domains
        values[index] = value
        if domain is not None:
            domains[index] = AnalogDomain[domain.upper()]

    @verb
    def set_analog_output(self, index: int, ratio: float) -> None:
        """Set analog output 0 or 1 to a ratio (0 to 1) of its range."""
        if not plausible(ratio):
            raise BadArguments(f"an analog output is set to 0 to 1 of its range, not {ratio}")
        with _indices():
            self.controller.signals.set_analog_output(index, ratio)

    @verb
    def set_input_register(self, kind: Register, index: int, value: float) -> None:
        """Write a register that clients write and programs read."""
        bank = self.controller.registers.input
        with _indices():
            if not isfinite(value):
                raise BadArguments(f"a register takes numbers, not {value}")
            if kind == "bit":
                bank.set_bit(index, bool(value))
            elif kind == "double":
                bank.set_double(index, value)
            elif value != int(value):
                raise BadArguments(f"integer register {index} cannot hold {value}")
            else:
                bank.set_int(index, int(value))

    @verb
    def set_encoder_speed(self, index: int, ticks_per_s: float) -> None:
        """Let the emulated conveyor at encoder 0 or 1 run at this speed."""
        if not plausible(ticks_per_s):
            raise BadArguments(f"no conveyor runs at {ticks_per_s} ticks/s")
        with _indices():
            self.controller.encoders[index].simulated_speed = ticks_per_s


@contextmanager
def _indices() -> Iterator[None]:
    """What a wrong number raises, as a verb's error."""
    try:
        yield
    except (IndexError, OverflowError) as error:
        raise BadArguments(str(error)) from error
