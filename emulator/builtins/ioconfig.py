"""Configuration of signals. PolyScope writes these calls at the start of every program."""

from emulator.builtins.geometry import OUT_OF_RANGE
from emulator.builtins.host import ProgramHost
from emulator.devices.tool_line import SerialSettings
from emulator.services.outputs import OutputAction, output_action
from urproto.modes import AnalogDomain, ToolDigitalOutputMode, ToolOutputMode
from urproto.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Bool, Int, ListArg, Num, Str

LIBRARY = Library("ioconfiguration", host=True, faults=OUT_OF_RANGE)

# Script Manual, set_analog_inputrange: 0-5 V counts as 0-10 V; the bipolar ranges of old control boxes are gone
_BOX_RANGES = {0: AnalogDomain.VOLTAGE, 2: AnalogDomain.VOLTAGE}
_TOOL_RANGES = {0: AnalogDomain.VOLTAGE, 1: AnalogDomain.VOLTAGE, 2: AnalogDomain.CURRENT}
_BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 1000000, 2000000, 5000000)  # Script Manual, set_tool_communication
_OLD_NOTE = "undocumented; public programs pass only an empty list; that listed outputs follow the program is a guess"


@LIBRARY.builtin()
def set_analog_outputdomain(host: ProgramHost, port: Int, domain: Int) -> None:
    """Set the domain of analog output 0 or 1: 0 current, 1 voltage."""
    host.machine.signals.analog_output_domains[_port(port)] = _domain(domain)


@LIBRARY.builtin()
def set_standard_analog_input_domain(host: ProgramHost, port: Int, domain: Int) -> None:
    """Set the domain of analog input 0 or 1: 0 current, 1 voltage."""
    host.machine.signals.analog_input_domains[_port(port)] = _domain(domain)


@LIBRARY.builtin()
def set_tool_analog_input_domain(host: ProgramHost, port: Int, domain: Int) -> None:
    """Set the domain of tool analog input 0 or 1: 0 current, 1 voltage."""
    host.machine.signals.tool_analog_input_domains[_port(port)] = _domain(domain)


@LIBRARY.builtin(note="deprecated")
def set_analog_inputrange(host: ProgramHost, port: Int, range_: Int) -> None:
    """Set the domain of an analog input by its range: `port` 0 and 1 in the control box, 2 and 3 in the tool.

    `range`: 0 and 2 are voltages in the control box; 0 and 1 are voltages in the tool, 2 is a current.
    """
    if not 0 <= port <= 3:
        raise RuntimeFault(f"there is no analog input {port}: use 0 to 3")
    signals, ranges = host.machine.signals, _TOOL_RANGES if port >= 2 else _BOX_RANGES
    if range_ not in ranges:
        raise RuntimeFault(f"set_analog_inputrange: the range of input {port} must be one of {list(ranges)}")
    domains = signals.tool_analog_input_domains if port >= 2 else signals.analog_input_domains
    domains[port % 2] = ranges[range_]


@LIBRARY.builtin(cb3=None, e="5.0")
def set_tool_output_mode(host: ProgramHost, mode: Int) -> None:
    """Set the use of the tool outputs: 0 digital outputs, 1 dual-pin power."""
    if mode not in (0, 1):
        raise RuntimeFault(f"set_tool_output_mode: mode must be 0 (digital) or 1 (dual-pin power), not {mode}")
    host.machine.signals.tool_output_mode = ToolOutputMode(mode)


@LIBRARY.builtin(cb3=None, e="5.0")
def set_tool_digital_output_mode(host: ProgramHost, n: Int, mode: Int) -> None:
    """Set the type of tool output 0 or 1: 1 sinking, 2 sourcing, 3 push/pull (0 counts as 1)."""
    if not 0 <= mode <= 3:
        raise RuntimeFault(f"set_tool_digital_output_mode: mode must be 1, 2 or 3, not {mode}")
    host.machine.signals.tool_digital_output_modes[_port(n)] = ToolDigitalOutputMode(max(mode, 1))


@LIBRARY.builtin(cb3=None, e="5.0", note="a device is connected to the line by --tool-device")
def set_tool_communication(
    host: ProgramHost,
    enabled: Bool,
    baud_rate: Int,
    parity: Int,
    stop_bits: Int,
    rx_idle_chars: Num,
    tx_idle_chars: Num,
) -> None:
    """Set up the tool's serial line, which clients reach on port 54321.

    `parity`: 0 none, 1 odd, 2 even. Idle times are given in characters.
    """
    if baud_rate not in _BAUD_RATES:
        raise RuntimeFault(f"set_tool_communication: baud_rate must be one of {_BAUD_RATES}, not {baud_rate}")
    if parity not in (0, 1, 2) or stop_bits not in (1, 2):
        raise RuntimeFault("set_tool_communication: parity must be 0, 1 or 2, and stop_bits 1 or 2")
    host.machine.tool_line.settings = SerialSettings(
        enabled, baud_rate, parity, stop_bits, rx_idle_chars, tx_idle_chars
    )


@LIBRARY.builtin()
def set_standard_digital_input_action(host: ProgramHost, port: Int, action: Str) -> None:
    """Set what standard digital input 0 to 7 does while no program runs: "default" (nothing) or "freedrive"."""
    _input_action(host, STANDARD, port, action)


@LIBRARY.builtin()
def set_configurable_digital_input_action(host: ProgramHost, port: Int, action: Str) -> None:
    """Set what configurable digital input 0 to 7 does while no program runs: "default" (nothing) or "freedrive"."""
    _input_action(host, CONFIGURABLE, port, action)


@LIBRARY.builtin()
def set_tool_digital_input_action(host: ProgramHost, port: Int, action: Str) -> None:
    """Set what tool digital input 0 or 1 does while no program runs: "default" (nothing) or "freedrive"."""
    _input_action(host, TOOL, port, action)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def set_gp_boolean_input_action(host: ProgramHost, port: Int, action: Str) -> None:
    """Set what a boolean input register does while no program runs: "default" (nothing) or "freedrive"."""
    actions = host.machine.freedrive_inputs
    host.machine.registers.input.get_bit(port)
    if wants_freedrive(action):
        actions.watch_register(port)
    else:
        actions.remove("register", port)


@LIBRARY.builtin()
def set_input_actions_to_default(host: ProgramHost) -> None:
    """Remove the actions of all inputs."""
    host.machine.freedrive_inputs.clear()


@LIBRARY.builtin(work=90)
def set_runstate_standard_digital_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how standard digital output 0 to 7 follows the run state.

    `state`: 0 keep, 1 low, 2 high while no program runs; 3 high while one runs and low otherwise. On e-Series
    also 4 low when a program ends with an error, protective stop, violation or fault; 5 the same, and high from a
    program's start; 6 high, 7 low while the robot has drive power, and the reverse without.
    """
    _runstate(host, STANDARD, outputId, state)


@LIBRARY.builtin(work=90)
def set_runstate_configurable_digital_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how configurable digital output 0 to 7 follows the run state; `state` as for the standard ones."""
    _runstate(host, CONFIGURABLE, outputId, state)


@LIBRARY.builtin(work=90)
def set_runstate_tool_digital_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how tool digital output 0 or 1 follows the run state; `state` 0 to 5 as for the standard ones."""
    _runstate(host, TOOL, outputId, state)


@LIBRARY.builtin(cb3="3.3", e="5.0", work=90)
def set_runstate_gp_boolean_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how a boolean output register follows the run state; `state` as for the standard outputs."""
    host.programs.outputs.set_register(outputId, _action(host, state))


# Script Manual CB3 3.15.4; that 3.15.0 has the two is a guess. The e-Series manuals 5.11 and 5.12 do not list them.
@LIBRARY.builtin(cb3="3.15", e=None, work=90)
def set_runstate_gp_integer_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how integer output register 0 to 47 follows the run state: low is 0, high is 1; `state` as above."""
    host.programs.outputs.set_int_register(outputId, _action(host, state))


@LIBRARY.builtin(cb3="3.15", e=None, work=90)
def set_runstate_gp_float_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how float output register 0 to 47 follows the run state: low is 0.0, high is 1.0; `state` as above."""
    host.programs.outputs.set_float_register(outputId, _action(host, state))


@LIBRARY.builtin(work=90)
def set_runstate_standard_analog_output_to_value(host: ProgramHost, outputId: Int, state: Int) -> None:
    """Set how analog output 0 or 1 follows the run state: low is its minimum, high its maximum; `state` as above."""
    host.programs.outputs.set_analog(outputId, _action(host, state))


@LIBRARY.builtin(status="partial", note=_OLD_NOTE, work=200)
def set_runstate_outputs(host: ProgramHost, outputs: ListArg) -> None:
    """Set which standard outputs, by number, are high while a program runs."""
    _runstate_list(host, STANDARD, outputs)


@LIBRARY.builtin(status="partial", note=_OLD_NOTE, work=200)
def set_runstate_standard_digital_outputs(host: ProgramHost, outputs: ListArg) -> None:
    """Set which standard outputs, by number, are high while a program runs."""
    _runstate_list(host, STANDARD, outputs)


@LIBRARY.builtin(status="partial", note=_OLD_NOTE, work=200)
def set_runstate_configurable_digital_outputs(host: ProgramHost, outputs: ListArg) -> None:
    """Set which configurable outputs, by number, are high while a program runs."""
    _runstate_list(host, CONFIGURABLE, outputs)


def _runstate_list(host: ProgramHost, group: DigitalGroup, outputs: list[int]) -> None:
    for index in outputs:
        if not isinstance(index, int):
            raise RuntimeFault(f"the list must contain numbers of outputs, not {index!r}")
        _runstate(host, group, index, OutputAction.HIGH_WHILE_RUNNING)


def _runstate(host: ProgramHost, group: DigitalGroup, index: int, state: int) -> None:
    host.programs.outputs.set_digital(group, index, _action(host, state, power=group is not TOOL))


def _action(host: ProgramHost, state: int, *, power: bool = True) -> OutputAction:
    return output_action(state, host.machine.version.series, power=power)


def _input_action(host: ProgramHost, group: DigitalGroup, port: int, action: str) -> None:
    actions = host.machine.freedrive_inputs
    group.bit(port)
    if wants_freedrive(action):
        actions.watch_digital(group, port)
    else:
        actions.remove(group.name, port)


def wants_freedrive(action: str) -> bool:
    """Whether an input's action is freedrive. Raises RuntimeFault for an unknown action."""
    if action not in ("default", "freedrive"):
        raise RuntimeFault(f'an input action must be "default" or "freedrive", not "{action}"')
    return action == "freedrive"


def _port(port: int) -> int:
    if port not in (0, 1):
        raise RuntimeFault(f"there is no port {port}: use 0 or 1")
    return port


def _domain(domain: int) -> AnalogDomain:
    if domain not in (0, 1):
        raise RuntimeFault(f"a domain must be 0 (current) or 1 (voltage), not {domain}")
    return AnalogDomain(domain)
