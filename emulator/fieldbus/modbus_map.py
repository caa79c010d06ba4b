"""The memory map of the robot's Modbus server: what each register and coil reads and writes.

Programs (``read_port_register`` and related functions) and clients of the server share one map. Registers are 16-bit
words; negative quantities are in two's complement. Addresses that are not in the map do not exist; some can only be
read, some can only be written.

A client reads the map in blocks, and it has gaps: reserved addresses, 259, and the masks that can only be written. The
article has an exception for an illegal "request address", which is taken to be the first one: the rest of a block reads
as 0 where there is nothing to read (guess).

Source: the vendor's article on the Modbus server (16377), as transcribed in public projects. The angle of a joint is
from 0 to a full turn, next to its number of turns, which is 65535 for negative angles (Universal Robots forum, thread
641). That quantities that are too large for a word saturate is a guess.
"""

import math
from collections.abc import Iterable
from typing import Final

from emulator.fieldbus.modbus_io import (
    Cell,
    PortError,
    ReadCell,
    WriteCell,
    analog_registers,
    digital_coils,
    digital_registers,
)
from emulator.io.signals import MODBUS_GENERAL_PURPOSE
from emulator.machine import Machine
from urproto.modbus import (
    ExceptionCode,
    Function,
    ModbusException,
    ModbusRequest,
    decode_request,
    encode_response,
    exception_response,
)
from urproto.modes import RobotStatusBits, SafetyStatusBits

_TURN: Final = 2.0 * math.pi


def answer_request(machine: Machine, pdu: bytes) -> bytes:
    """Carry out a request and return the response, an exception response if the request is refused.

    A request that includes an address that cannot be written changes nothing.
    """
    try:
        request = decode_request(pdu)
        return encode_response(request, _carry_out(machine, request))
    except (ModbusException, PortError) as refused:
        return exception_response(pdu[0], refused.code)


def _carry_out(machine: Machine, request: ModbusRequest) -> list[int]:
    addresses = range(request.address, request.address + request.count)
    written = range(request.address, request.address + len(request.values))
    match request.function:
        case Function.READ_COILS | Function.READ_DISCRETE_INPUTS:
            return _read_block(machine, COILS, addresses, "coil")
        case Function.READ_HOLDING_REGISTERS | Function.READ_INPUT_REGISTERS:
            return _read_block(machine, REGISTERS, addresses, "register")
        case Function.WRITE_COIL | Function.WRITE_COILS:
            check_writable(COILS, written, "coil")
            for address, value in zip(written, request.values, strict=True):
                write_coil(machine, address, bool(value))
        case Function.WRITE_REGISTER | Function.WRITE_REGISTERS:
            check_writable(REGISTERS, written, "register")
            for address, value in zip(written, request.values, strict=True):
                write_register(machine, address, value)
        case _:
            raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)
    return []


def _read_block(machine: Machine, table: dict[int, Cell], addresses: range, what: str) -> list[int]:
    """Values of consecutive addresses, 0 where there is nothing to read. Raises PortError for the first address."""
    _reader(table, addresses[0], what)
    cells = (table.get(address) for address in addresses)
    return [_word(cell.read(machine)) if cell is not None and cell.read is not None else 0 for cell in cells]


def read_register(machine: Machine, address: int) -> int:
    """Return the value of a register, 0 to 65535. Raises PortError."""
    return _word(_reader(REGISTERS, address, "register")(machine))


def write_register(machine: Machine, address: int, word: int) -> None:
    """Set a register to a word, 0 to 65535. Raises PortError."""
    _writer(REGISTERS, address, "register")(machine, word)


def read_coil(machine: Machine, address: int) -> bool:
    """Return the level of a coil. Raises PortError."""
    return bool(_reader(COILS, address, "coil")(machine))


def write_coil(machine: Machine, address: int, level: bool) -> None:
    """Set a coil. Raises PortError."""
    _writer(COILS, address, "coil")(machine, int(level))


def check_writable(table: dict[int, Cell], addresses: Iterable[int], what: str) -> None:
    """Raises PortError unless all addresses can be written."""
    for address in addresses:
        _writer(table, address, what)


def _reader(table: dict[int, Cell], address: int, what: str) -> ReadCell:
    read = _cell(table, address, what).read
    if read is None:
        raise PortError(f"{what} {address} of the Modbus server can only be written")
    return read


def _writer(table: dict[int, Cell], address: int, what: str) -> WriteCell:
    write = _cell(table, address, what).write
    if write is None:
        raise PortError(f"{what} {address} of the Modbus server can only be read")
    return write


def _cell(table: dict[int, Cell], address: int, what: str) -> Cell:
    cell = table.get(address)
    if cell is None:
        raise PortError(f"the Modbus server has no {what} {address}; registers 128 to 255 are free for any use")
    return cell


def _word(value: float) -> int:
    """Convert a quantity to a word: rounded, saturated, a negative one in two's complement."""
    if not math.isfinite(value):
        return 0
    return min(max(round(value), -0x8000), 0xFFFF) & 0xFFFF


# the robot's state


def _vector(first: int, name: str, factor: float, start: int = 0, count: int = 6) -> dict[int, Cell]:
    """Return registers for elements of a vector in the snapshot, from index ``start`` on."""

    def cell(index: int) -> Cell:
        return Cell(lambda machine: getattr(machine.snapshot, name)[index] * factor)

    return {first + at: cell(start + at) for at in range(count)}


def _pose(first: int, name: str, position_factor: float) -> dict[int, Cell]:
    """Return six registers: three for a position or velocity, three in mrad or mrad/s."""
    return {**_vector(first, name, position_factor, 0, 3), **_vector(first + 3, name, 1000.0, 3, 3)}


def _angle(joint: int) -> Cell:
    return Cell(lambda machine: math.floor(machine.snapshot.actual_q[joint] % _TURN * 1000.0))


def _turns(joint: int) -> Cell:
    return Cell(lambda machine: math.floor(machine.snapshot.actual_q[joint] / _TURN))


def _robot_bit(bit: RobotStatusBits) -> Cell:
    return Cell(lambda machine: bool(machine.snapshot.robot_status_bits & bit))


def _safety_bit(bit: SafetyStatusBits) -> Cell:
    return Cell(lambda machine: bool(machine.snapshot.safety_status_bits & bit))


_FLAGS: Final[dict[int, Cell]] = {  # at the same addresses among registers and coils
    260: _robot_bit(RobotStatusBits.POWER_ON),
    261: _safety_bit(SafetyStatusBits.PROTECTIVE_STOPPED),
    262: _safety_bit(SafetyStatusBits.EMERGENCY_STOPPED),
    263: _robot_bit(RobotStatusBits.TEACH_BUTTON),
    264: _robot_bit(RobotStatusBits.POWER_BUTTON),
    265: _safety_bit(SafetyStatusBits.STOPPED_DUE_TO_SAFETY),
}


def _state_registers() -> dict[int, Cell]:
    return {
        256: Cell(lambda machine: machine.version.major),
        257: Cell(lambda machine: machine.version.minor),
        258: Cell(lambda machine: machine.snapshot.robot_mode),
        **_FLAGS,
        266: Cell(lambda machine: machine.snapshot.safety_mode),
        **{270 + joint: _angle(joint) for joint in range(6)},
        **_vector(280, "actual_qd", 1000.0),
        **_vector(290, "actual_current", 1000.0),
        **_vector(300, "joint_temperatures", 1.0),
        **_vector(310, "joint_mode", 1),
        **{320 + joint: _turns(joint) for joint in range(6)},
        **_pose(400, "actual_TCP_pose", 10000.0),
        **_pose(410, "actual_TCP_speed", 1000.0),
        **_pose(420, "tcp_offset", 1000.0),
        450: Cell(lambda machine: machine.snapshot.actual_robot_current * 1000.0),
        451: Cell(lambda machine: machine.snapshot.io_current * 1000.0),
        768: Cell(lambda machine: machine.snapshot.tool_mode),
        769: Cell(lambda machine: machine.snapshot.tool_temperature),
        770: Cell(lambda machine: machine.snapshot.tool_output_current * 1000.0),
    }


# memory of the server itself, and registers that are shared with RTDE


def _general(index: int) -> Cell:
    def write(machine: Machine, word: int) -> None:
        machine.modbus_registers.general[index] = word

    return Cell(lambda machine: machine.modbus_registers.general[index], write)


def _uptime(index: int) -> Cell:
    return Cell(lambda machine: machine.modbus_registers.uptime[index])


def _input_bit(index: int) -> Cell:
    return Cell(
        lambda machine: machine.registers.input.get_bit(index),
        lambda machine, bit: machine.registers.input.set_bit(index, bool(bit)),
    )


def _output_bit(index: int) -> Cell:
    return Cell(lambda machine: machine.registers.output.get_bit(index))


REGISTERS: Final[dict[int, Cell]] = {
    **digital_registers(),
    **analog_registers(),
    **{address: _general(at) for at, address in enumerate(MODBUS_GENERAL_PURPOSE)},
    **_state_registers(),
    2048: Cell(write=lambda machine, _: machine.modbus_registers.latch_uptime(machine.time_s)),
    **{2049 + at: _uptime(at) for at in range(5)},
}

COILS: Final[dict[int, Cell]] = {
    **digital_coils(),
    **_FLAGS,
    **{300 + index: _input_bit(index) for index in range(128)},
    **{500 + index: _output_bit(index) for index in range(128)},
}
