"""Digital and analog signals of the control box and the tool."""

from emulator.builtins.geometry import OUT_OF_RANGE
from emulator.builtins.host import ProgramHost
from urproto.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Bool, Int, Num

LIBRARY = Library("io", host=True, physical=True, faults=OUT_OF_RANGE)

_OLD_TOOL = 8  # get_digital_in(8) and (9) read the tool's inputs: numbering from before configurable signals existed


def _read_input(host: ProgramHost, group: DigitalGroup, n: int) -> bool:
    return host.machine.signals.get_digital_input(group, n)


def _read_output(host: ProgramHost, group: DigitalGroup, n: int) -> bool:
    return host.machine.signals.get_digital_output(group, n)


def _write_output(host: ProgramHost, group: DigitalGroup, n: int, level: bool) -> None:
    host.machine.signals.set_digital_output(group, n, level)


def _old(n: int) -> tuple[DigitalGroup, int]:
    return (STANDARD, n) if n < _OLD_TOOL else (TOOL, n - _OLD_TOOL)


@LIBRARY.builtin()
def get_standard_digital_in(host: ProgramHost, n: Int) -> bool:
    """Standard digital input 0 to 7."""
    return _read_input(host, STANDARD, n)


@LIBRARY.builtin()
def get_configurable_digital_in(host: ProgramHost, n: Int) -> bool:
    """Configurable digital input 0 to 7."""
    return _read_input(host, CONFIGURABLE, n)


@LIBRARY.builtin()
def get_tool_digital_in(host: ProgramHost, n: Int) -> bool:
    """Tool digital input 0 or 1."""
    return _read_input(host, TOOL, n)


@LIBRARY.builtin(note="deprecated")
def get_digital_in(host: ProgramHost, n: Int) -> bool:
    """Standard digital input 0 to 7; 8 and 9 are the tool's."""
    return _read_input(host, *_old(n))


@LIBRARY.builtin()
def get_standard_digital_out(host: ProgramHost, n: Int) -> bool:
    """Level of standard digital output 0 to 7."""
    return _read_output(host, STANDARD, n)


@LIBRARY.builtin()
def get_configurable_digital_out(host: ProgramHost, n: Int) -> bool:
    """Level of configurable digital output 0 to 7."""
    return _read_output(host, CONFIGURABLE, n)


@LIBRARY.builtin()
def get_tool_digital_out(host: ProgramHost, n: Int) -> bool:
    """Level of tool digital output 0 or 1."""
    return _read_output(host, TOOL, n)


@LIBRARY.builtin(note="deprecated")
def get_digital_out(host: ProgramHost, n: Int) -> bool:
    """Level of standard digital output 0 to 7; 8 and 9 are the tool's."""
    return _read_output(host, *_old(n))


@LIBRARY.builtin(work=60)
def set_standard_digital_out(host: ProgramHost, n: Int, b: Bool) -> None:
    """Set standard digital output 0 to 7."""
    _write_output(host, STANDARD, n, b)


@LIBRARY.builtin(work=60)
def set_configurable_digital_out(host: ProgramHost, n: Int, b: Bool) -> None:
    """Set configurable digital output 0 to 7."""
    _write_output(host, CONFIGURABLE, n, b)


@LIBRARY.builtin(work=60)
def set_tool_digital_out(host: ProgramHost, n: Int, b: Bool) -> None:
    """Set tool digital output 0 or 1."""
    _write_output(host, TOOL, n, b)


@LIBRARY.builtin(note="deprecated", work=60)
def set_digital_out(host: ProgramHost, n: Int, b: Bool) -> None:
    """Set standard digital output 0 to 7; 8 and 9 are the tool's."""
    group, index = _old(n)
    _write_output(host, group, index, b)


@LIBRARY.builtin()
def get_standard_analog_in(host: ProgramHost, n: Int) -> float:
    """Analog input 0 or 1 [A or V, depending on its domain]."""
    return host.machine.signals.analog_inputs[_analog(n, "analog input")]


@LIBRARY.builtin()
def get_tool_analog_in(host: ProgramHost, n: Int) -> float:
    """Tool analog input 0 or 1 [A or V, depending on its domain]."""
    return host.machine.signals.tool_analog_inputs[_analog(n, "tool analog input")]


@LIBRARY.builtin(note="deprecated")
def get_analog_in(host: ProgramHost, n: Int) -> float:
    """Analog input 0 or 1; 2 and 3 are the tool's [A or V, depending on its domain]."""
    return get_standard_analog_in(host, n) if n < 2 else get_tool_analog_in(host, n - 2)


@LIBRARY.builtin()
def get_standard_analog_out(host: ProgramHost, n: Int) -> float:
    """Analog output 0 or 1 as a ratio of its range, 0 to 1."""
    return host.machine.signals.analog_output_ratios[_analog(n, "analog output")]


@LIBRARY.builtin(note="deprecated")
def get_analog_out(host: ProgramHost, n: Int) -> float:
    """Analog output 0 or 1 as a ratio of its range, 0 to 1."""
    return get_standard_analog_out(host, n)


@LIBRARY.builtin()
def set_standard_analog_out(host: ProgramHost, n: Int, f: Num) -> None:
    """Set analog output 0 or 1 to a ratio of its range; clipped to 0 to 1."""
    host.machine.signals.set_analog_output(n, f)


@LIBRARY.builtin(note="deprecated")
def set_analog_out(host: ProgramHost, n: Int, f: Num) -> None:
    """Set analog output 0 or 1 to a ratio of its range; clipped to 0 to 1."""
    set_standard_analog_out(host, n, f)


@LIBRARY.builtin()
def set_tool_voltage(host: ProgramHost, voltage: Int) -> None:
    """Set the supply voltage of the tool: 0, 12 or 24 [V]."""
    host.machine.signals.set_tool_voltage(voltage)


def _analog(n: int, what: str) -> int:
    if n not in (0, 1):
        raise RuntimeFault(f"there is no {what} {n}: use 0 or 1")
    return n
