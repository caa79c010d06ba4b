"""Modbus: signals on other devices, and the memory of the robot's own server.

PolyScope adds the signals of the installation at the start of every program. A missing device
affects only programs that use its signals.
"""

from collections.abc import Sequence
from typing import Any, Final

from emulator.builtins.geometry import OUT_OF_RANGE
from emulator.builtins.host import Frames, ProgramHost
from emulator.builtins.ioconfig import wants_freedrive
from emulator.fieldbus import modbus_map
from emulator.services.modbus import SIGNAL_TYPES, ModbusSignal, ModbusUnit
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Any_, Bool, Int, ListArg, Num, Str

LIBRARY = Library("modbus", host=True, faults=OUT_OF_RANGE)

_ADDED_TYPES: Final = tuple(type_ for type_ in SIGNAL_TYPES if type_ != 23)
_MAX_COMMAND: Final = 252  # bytes behind the function code: Modbus Application Protocol


@LIBRARY.builtin(work=130)
def modbus_add_signal(
    host: ProgramHost,
    IP: Str,
    slave_number: Int,
    signal_address: Int,
    signal_type: Int,
    signal_name: Str,
    sequential_mode: Bool = False,
    register_count: Int = 1,
) -> None:
    """Add a signal that polls its device 10 times a second; it replaces one of the same name.

    `signal_type`: 0 digital input, 1 digital output, 2 register input, 3 register output,
    15 and 16 several digital or register outputs. `sequential_mode`: send the device no request
    before it has answered the last one.
    """
    if signal_type not in _ADDED_TYPES:
        raise RuntimeFault(f"modbus_add_signal: signal_type must be one of {_ADDED_TYPES}, not {signal_type}")
    host.programs.modbus.add(
        ModbusUnit(IP, slave_number),
        signal_type,
        signal_address,
        register_count,
        signal_name,
        sequential=sequential_mode,
    )


@LIBRARY.builtin(cb3=None, e="5.10", work=130)
def modbus_add_rw_signal(
    host: ProgramHost,
    IP: Str,
    slave_number: Int,
    read_address: Int,
    read_register_count: Int,
    write_address: Int,
    write_register_count: Int,
    signal_name: Str,
    sequential_mode: Bool = False,
) -> None:
    """Add a signal that reads registers and, once it has been set, writes others in the same request."""
    host.programs.modbus.add_read_write(
        ModbusUnit(IP, slave_number),
        (read_address, read_register_count),
        (write_address, write_register_count),
        signal_name,
        sequential=sequential_mode,
    )


@LIBRARY.builtin()
def modbus_delete_signal(host: ProgramHost, signal_name: Str) -> None:
    """Remove a signal; one that does not exist is ignored."""
    host.programs.modbus.delete(signal_name)


@LIBRARY.builtin()
def modbus_get_signal_status(host: ProgramHost, signal_name: Str, is_secondary_program: Bool = False) -> Frames[Any_]:
    """The value last read or set: a bool, an unsigned integer, or a list of them; False or 0 at first.

    A signal that is read on demand (0 Hz) is read now, and the call waits for it except in a
    secondary program. If the device has not answered for longer than the signal's watchdog
    allows, the program ends with an error.
    """
    signals = host.programs.modbus
    signal = signals.get(signal_name)
    if signal.frequency_hz <= 0:
        signals.request_update(signal_name)
        while not host.secondary and signals.pending(signal):
            yield
    return _value(signals.readable(signal_name))


@LIBRARY.builtin(cb3=None, e="5.10")
def modbus_get_error(host: ProgramHost, signal_name: Str, error_source: Int = 0) -> int:
    """Error code of a signal, 0 without error.

    `error_source`: 1 the device's exception code; 2 the connection's error (an errno, -1
    connecting, -2 disconnected); 0 both, with the connection's in the upper 16 bits.
    """
    if error_source not in (0, 1, 2):
        raise RuntimeFault(f"modbus_get_error: error_source must be 0, 1 or 2, not {error_source}")
    signal = host.programs.modbus.get(signal_name)
    if error_source == 1:
        return signal.device_error
    if error_source == 2:
        return signal.connection_error
    return signal.connection_error * 0x10000 | signal.device_error


@LIBRARY.builtin(cb3=None, e="5.10")
def modbus_get_time_since_signal_invalid(host: ProgramHost, signal_name: Str) -> float:
    """Time since the last successful request of a signal in error [s]; 0 for a signal without error."""
    return host.programs.modbus.invalid_s(host.programs.modbus.get(signal_name))


@LIBRARY.builtin(work=60)
def modbus_send_custom_command(
    host: ProgramHost, IP: Str, slave_number: Int, function_code: Int, data: ListArg
) -> None:
    """Send a request of any kind to a device; its answer is ignored."""
    if not 1 <= function_code <= 127:
        raise RuntimeFault(f"modbus_send_custom_command: function_code must be 1 to 127, not {function_code}")
    if len(data) > _MAX_COMMAND or not all(type(byte) is int and 0 <= byte <= 255 for byte in data):
        raise RuntimeFault(f"modbus_send_custom_command: data must be at most {_MAX_COMMAND} bytes, 0 to 255")
    host.programs.modbus.send_command(ModbusUnit(IP, slave_number), function_code, bytes(data))


@LIBRARY.builtin()
def modbus_set_digital_input_action(host: ProgramHost, signal_name: Str, action: Str) -> None:
    """Set what a digital input does while no program runs: "default" (nothing) or "freedrive"."""
    signal = host.programs.modbus.get(signal_name)
    if signal.output or not signal.kind.bits:
        raise RuntimeFault(f'"{signal_name}" is a {signal.kind.title}, not a digital input')
    actions = host.machine.freedrive_inputs
    if wants_freedrive(action):
        actions.watch_signal(signal_name)
    else:
        actions.remove("modbus", signal_name)


@LIBRARY.builtin()
def modbus_set_output_register(
    host: ProgramHost, signal_name: Str, register_value: Any_, is_secondary_program: Bool = False
) -> None:
    """Set a register output: a word, 0 to 65535, or a list of them; registers beyond a short list keep their values."""
    host.programs.modbus.set(signal_name, _numbers(register_value), bits=False)


@LIBRARY.builtin()
def modbus_set_output_signal(
    host: ProgramHost, signal_name: Str, digital_value: Any_, is_secondary_program: Bool = False
) -> None:
    """Set a digital output: a bool or a list of them; coils beyond a short list keep their values."""
    values = digital_value if isinstance(digital_value, list) else [digital_value]
    if not all(type(value) is bool for value in values):
        raise RuntimeFault("modbus_set_output_signal: digital_value must be a bool or a list of bools")
    host.programs.modbus.set(signal_name, [int(value) for value in values], bits=True)


@LIBRARY.builtin()
def modbus_set_signal_update_frequency(host: ProgramHost, signal_name: Str, update_frequency: Int) -> None:
    """Set how often a signal polls its device [Hz], up to 500; 0 and -1: only when a program reads or sets it."""
    host.programs.modbus.set_frequency(signal_name, update_frequency)


@LIBRARY.builtin(cb3=None, e="5.10")
def modbus_request_update_signal_value(host: ProgramHost, signal_name: Str) -> None:
    """Poll a signal's device now, whatever its frequency."""
    host.programs.modbus.request_update(signal_name)


@LIBRARY.builtin(cb3=None, e="5.10")
def modbus_set_signal_watchdog(host: ProgramHost, signal_name: Str, new_timeout_in_sec: Num) -> None:
    """Set how long a signal may be in error before its use ends the program: 0 to 300 [s], 2 by default."""
    host.programs.modbus.set_watchdog(signal_name, new_timeout_in_sec)


@LIBRARY.builtin(cb3=None, e="5.10")
def modbus_reset_connection(host: ProgramHost, connection_id: Str, is_blocking: Bool = True) -> Frames[None]:
    """Reconnect to the devices at an address; `is_blocking`: wait until no signal there is in error."""
    signals = host.programs.modbus
    there = signals.reset(connection_id)
    while is_blocking and signals.recovering(there):
        yield


@LIBRARY.builtin()
def modbus_set_runstate_dependent_choice(host: ProgramHost, signal_name: Str, runstate_choice: Int) -> None:
    """Set how an output follows the run state.

    `runstate_choice`: 0 keep, 1 low, 2 high while no program runs; 3 high while one runs and
    low otherwise; on e-Series also 4 low when a program ends with an error or a protective stop,
    5 the same, and high from a program's start.
    """
    host.programs.modbus.set_runstate_choice(signal_name, runstate_choice)


# the robot's own server


@LIBRARY.builtin()
def read_port_bit(host: ProgramHost, address: Int) -> bool:
    """Read a coil of the robot's Modbus server."""
    return bool(modbus_map.read_coil(host.machine, address))


@LIBRARY.builtin(work=60)
def read_port_register(host: ProgramHost, address: Int) -> int:
    """Read a register of the robot's Modbus server, signed: -32768 to 32767. 128 to 255 are free for any use."""
    word = modbus_map.read_register(host.machine, address)
    return word - 0x10000 if word & 0x8000 else word


@LIBRARY.builtin()
def write_port_bit(host: ProgramHost, address: Int, value: Bool) -> None:
    """Set a coil of the robot's Modbus server."""
    modbus_map.write_coil(host.machine, address, value)


@LIBRARY.builtin()
def write_port_register(host: ProgramHost, address: Int, value: Num) -> None:
    """Set a register of the robot's Modbus server: -32768 to 65535; fractions are truncated."""
    if not -0x8000 <= value <= 0xFFFF:
        raise RuntimeFault(f"write_port_register: {value} does not fit a register: -32768 to 65535")
    modbus_map.write_register(host.machine, address, int(value) & 0xFFFF)


def _value(signal: ModbusSignal) -> bool | int | list[int]:
    values: Sequence[int] = [bool(value) for value in signal.values] if signal.kind.bits else signal.values
    return values[0] if len(values) == 1 else list(values)


def _numbers(value: Any) -> list[int]:
    values = value if isinstance(value, list) else [value]
    if not all(type(number) is int or (type(number) is float and number.is_integer()) for number in values):
        raise RuntimeFault("modbus_set_output_register: register_value must be an integer or a list of integers")
    return [int(number) for number in values]
