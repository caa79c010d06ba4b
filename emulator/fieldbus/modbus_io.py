"""Inputs and outputs as registers and coils of the robot's Modbus server.

A word holds the standard signals from bit 0 on, followed by those of the tool (bits 8 and 9). Signal 0 is the lowest
bit: the vendor's article on registers and digital I/O (19252) reads channels with integer_to_binary_list. The full
scale of analog signals is a guess: 4-20 mA or 0-10 V.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from emulator.machine import Machine
from urproto.modbus import ExceptionCode
from urproto.modes import AnalogDomain
from urproto.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup

ReadCell = Callable[[Machine], float]
WriteCell = Callable[[Machine, int], None]

_FULL_SCALE: Final = 0xFFFF


class PortError(ValueError):
    """An address or a value that the server does not accept. ``code``: the exception code for the client."""

    def __init__(self, message: str, code: ExceptionCode = ExceptionCode.ILLEGAL_DATA_ADDRESS) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Cell:
    """One register or coil; ``read`` or ``write`` is None if it cannot be read or written."""

    read: ReadCell | None = None
    write: WriteCell | None = None


# digital signals: registers hold several, coils one each


def _inputs(first: DigitalGroup, second: DigitalGroup | None = None) -> ReadCell:
    return lambda machine: _packed(machine.signals.digital_inputs, first, second)


def _outputs(first: DigitalGroup, second: DigitalGroup | None = None) -> ReadCell:
    return lambda machine: _packed(machine.signals.digital_outputs, first, second)


def _packed(word: int, first: DigitalGroup, second: DigitalGroup | None) -> int:
    """Return the signals of the first group from bit 0 on, followed by those of the second."""
    packed = word >> first.first & (1 << first.count) - 1
    if second is None:
        return packed
    return packed | (word >> second.first & (1 << second.count) - 1) << first.count


def _set_outputs(
    mask: Callable[[int], int], levels: Callable[[int], int], first: DigitalGroup, second: DigitalGroup | None = None
) -> WriteCell:
    """Return a function that writes a word: ``mask`` selects outputs from the word, ``levels`` gives their levels."""

    def write(machine: Machine, word: int) -> None:
        machine.signals.apply_outputs(first, mask(word), levels(word))
        if second is not None:
            machine.signals.apply_outputs(second, mask(word) >> first.count, levels(word) >> first.count)

    return write


def _all(word: int) -> int:
    return 0xFFFF


def _same(word: int) -> int:
    return word


def _none(word: int) -> int:
    return 0


def digital_registers() -> dict[int, Cell]:
    """Return the registers that hold inputs and outputs, and those that set or clear outputs by a mask."""
    return {
        0: Cell(_inputs(STANDARD, TOOL)),
        1: Cell(_outputs(STANDARD, TOOL), _set_outputs(_all, _same, STANDARD, TOOL)),
        2: Cell(write=_set_outputs(_same, _same, STANDARD, TOOL)),
        3: Cell(write=_set_outputs(_same, _none, STANDARD, TOOL)),
        21: Cell(_inputs(TOOL)),
        22: Cell(_outputs(TOOL), _set_outputs(_all, _same, TOOL)),
        30: Cell(_inputs(CONFIGURABLE)),
        31: Cell(_outputs(CONFIGURABLE), _set_outputs(_all, _same, CONFIGURABLE)),
        32: Cell(write=_set_outputs(_same, _same, CONFIGURABLE)),
        33: Cell(write=_set_outputs(_same, _none, CONFIGURABLE)),
        24: Cell(lambda machine: machine.snapshot.euromap67_input_bits & 0xFFFF),
        25: Cell(lambda machine: machine.snapshot.euromap67_input_bits >> 16),
        26: Cell(lambda machine: machine.snapshot.euromap67_output_bits & 0xFFFF),
        27: Cell(lambda machine: machine.snapshot.euromap67_output_bits >> 16),
        28: Cell(lambda machine: machine.snapshot.euromap67_24V_voltage),
        29: Cell(lambda machine: machine.snapshot.euromap67_24V_current),
    }


def digital_coils() -> dict[int, Cell]:
    """Return the coils of the same signals."""
    cells: dict[int, Cell] = {}
    for group, inputs, outputs, set_, clear, offset in (
        (STANDARD, 0, 16, 32, 48, 0),
        (TOOL, 0, 16, 32, 48, STANDARD.count),
        (CONFIGURABLE, 128, 136, 144, 152, 0),
    ):
        for index in range(group.count):
            at = offset + index
            cells[inputs + at] = Cell(_input_level(group, index))
            cells[outputs + at] = Cell(_output_level(group, index), _output_write(group, index, None))
            cells[set_ + at] = Cell(write=_output_write(group, index, True))
            cells[clear + at] = Cell(write=_output_write(group, index, False))
    for undefined in range(STANDARD.count + TOOL.count, 16):  # unused bits of the words
        cells[undefined] = Cell(read=_zero)
        cells[16 + undefined] = Cell(_zero, _ignore)
        cells[32 + undefined] = cells[48 + undefined] = Cell(write=_ignore)
    for index in range(32):
        cells[64 + index] = Cell(_euromap("euromap67_input_bits", index))
        cells[96 + index] = Cell(_euromap("euromap67_output_bits", index))
    return cells


def _zero(machine: Machine) -> int:
    return 0


def _ignore(machine: Machine, word: int) -> None: ...


def _euromap(name: str, index: int) -> ReadCell:
    return lambda machine: getattr(machine.snapshot, name) >> index & 1


def _input_level(group: DigitalGroup, index: int) -> ReadCell:
    return lambda machine: machine.signals.get_digital_input(group, index)


def _output_level(group: DigitalGroup, index: int) -> ReadCell:
    return lambda machine: machine.signals.get_digital_output(group, index)


def _output_write(group: DigitalGroup, index: int, level: bool | None) -> WriteCell:
    """Return a function that sets an output: to the written bit, or to ``level``, if given, when a 1 is written."""

    def write(machine: Machine, bit: int) -> None:
        if level is None or bit:
            machine.signals.set_digital_output(group, index, bool(bit) if level is None else level)

    return write


# analog signals


def analog_registers() -> dict[int, Cell]:
    """Return the registers of analog signals, of their domains (0 current, 1 voltage), and of the tool voltage."""
    cells: dict[int, Cell] = {}
    for index in (0, 1):
        cells[4 + 2 * index] = _analog_input("analog_inputs", "analog_input_domains", index)
        cells[5 + 2 * index] = _domain("analog_input_domains", index)
        cells[8 + 2 * index] = _analog_input("tool_analog_inputs", "tool_analog_input_domains", index)
        cells[9 + 2 * index] = _domain("tool_analog_input_domains", index)
        cells[16 + 2 * index] = _analog_output(index)
        cells[17 + 2 * index] = _domain("analog_output_domains", index)
    cells[20] = Cell(lambda machine: machine.signals.tool_voltage, _write_tool_voltage)
    return cells


def _scaled(value: float, domain: AnalogDomain) -> float:
    ratio = value / 10.0 if domain is AnalogDomain.VOLTAGE else (value - 0.004) / 0.016
    return min(max(ratio, 0.0), 1.0) * _FULL_SCALE


def _analog_input(values: str, domains: str, index: int) -> Cell:
    """An analog input, whose value and domain are in these lists of the signals."""
    return Cell(
        lambda machine: _scaled(getattr(machine.signals, values)[index], getattr(machine.signals, domains)[index])
    )


def _analog_output(index: int) -> Cell:
    return Cell(
        lambda machine: machine.signals.analog_output_ratios[index] * _FULL_SCALE,
        lambda machine, word: machine.signals.set_analog_output(index, word / _FULL_SCALE),
    )


def _domain(domains: str, index: int) -> Cell:
    """The domain of an analog signal, in this list of the signals."""

    def write(machine: Machine, word: int) -> None:
        if word not in (0, 1):
            raise PortError(
                f"the domain of an analog signal is 0 (current) or 1 (voltage), not {word}",
                ExceptionCode.ILLEGAL_DATA_VALUE,
            )
        getattr(machine.signals, domains)[index] = AnalogDomain(word)

    return Cell(lambda machine: getattr(machine.signals, domains)[index], write)


def _write_tool_voltage(machine: Machine, word: int) -> None:
    try:
        machine.signals.set_tool_voltage(word)
    except ValueError as error:
        raise PortError(str(error), ExceptionCode.ILLEGAL_DATA_VALUE) from error
