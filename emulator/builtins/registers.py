"""Registers shared with external clients, the controller's own flags, and the RTDE watchdog."""

from typing import Final, cast

from emulator.builtins.geometry import OUT_OF_RANGE
from emulator.builtins.host import ProgramHost
from emulator.services.watchdog import WatchdogAction
from urproto.rtde.fields import INPUT_FIELDS
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Bool, Int, Num, Str

LIBRARY = Library("registers", host=True, faults=OUT_OF_RANGE)

_ACTIONS: Final = ("ignore", "pause", "stop")


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_input_boolean_register(host: ProgramHost, address: Int) -> bool:
    """Boolean input register 0 to 127."""
    return host.machine.registers.input.get_bit(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_input_integer_register(host: ProgramHost, address: Int) -> int:
    """Integer input register 0 to 47."""
    return host.machine.registers.input.get_int(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_input_float_register(host: ProgramHost, address: Int) -> float:
    """Float input register 0 to 47."""
    return host.machine.registers.input.get_double(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_output_boolean_register(host: ProgramHost, address: Int) -> bool:
    """Boolean output register 0 to 127."""
    return host.machine.registers.output.get_bit(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_output_integer_register(host: ProgramHost, address: Int) -> int:
    """Integer output register 0 to 47."""
    return host.machine.registers.output.get_int(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def read_output_float_register(host: ProgramHost, address: Int) -> float:
    """Float output register 0 to 47."""
    return host.machine.registers.output.get_double(address)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def write_output_boolean_register(host: ProgramHost, address: Int, value: Bool) -> None:
    """Set boolean output register 0 to 127."""
    host.machine.registers.output.set_bit(address, value)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def write_output_integer_register(host: ProgramHost, address: Int, value: Int) -> None:
    """Set integer output register 0 to 47."""
    host.machine.registers.output.set_int(address, value)


@LIBRARY.builtin(cb3="3.3", e="5.0")
def write_output_float_register(host: ProgramHost, address: Int, value: Num) -> None:
    """Set float output register 0 to 47."""
    host.machine.registers.output.set_double(address, value)


@LIBRARY.builtin()
def get_flag(host: ProgramHost, n: Int) -> bool:
    """Flag 0 to 31; flags keep their values when a program ends."""
    return host.programs.flags[_flag(host, n)]


@LIBRARY.builtin()
def set_flag(host: ProgramHost, n: Int, b: Bool) -> None:
    """Set flag 0 to 31."""
    host.programs.flags[_flag(host, n)] = b


@LIBRARY.builtin(cb3="3.3", e="5.0")  # Script Manual CB3 3.3.4
def rtde_set_watchdog(host: ProgramHost, variable_name: Str, min_frequency: Num, action: Str = "pause") -> None:
    """Require an RTDE input variable to be written at least `min_frequency` times a second [Hz].

    `action` when it is not: "pause" or "stop" the program, or "ignore". The watchdog ends with
    the program; 0 Hz disables it.
    """
    field = INPUT_FIELDS.get(variable_name)
    if field is None or not field.available.covers(host.machine.version):
        raise RuntimeFault(f"rtde_set_watchdog: there is no RTDE input variable {variable_name!r} in this version")
    wanted = action.lower()  # the program of the vendor's RTDE client says "PAUSE"
    if wanted not in _ACTIONS:
        raise RuntimeFault(f'rtde_set_watchdog: action must be "ignore", "pause" or "stop", not "{action}"')
    if min_frequency < 0:
        raise RuntimeFault(f"rtde_set_watchdog: min_frequency must be 0 or more, not {min_frequency}")
    host.watch(variable_name, min_frequency, cast(WatchdogAction, wanted))


def _flag(host: ProgramHost, n: int) -> int:
    if not 0 <= n < len(host.programs.flags):
        raise RuntimeFault(f"there is no flag {n}: use 0 to {len(host.programs.flags) - 1}")
    return n
