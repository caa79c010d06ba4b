"""The memory of the robot's Modbus server: what each register and coil reads and writes.

One table for programs (``read_port_register`` and its family) and for clients of the
server. Registers are 16-bit words; negative quantities are in two's complement. Addresses
that are not in the table do not exist; some can only be read, some only be written.

Source: the vendor's article on the Modbus server (16377), as transcribed in public
projects. Guesses: that quantities too big for a word saturate, and that a joint's angle is
given from 0 to a full turn beside its count of turns.
"""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from emulator.io.modbus_io import (
    Cell,
    PortError,
    ReadCell,
    WriteCell,
    analog_registers,
    digital_coils,
    digital_registers,
)
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

if TYPE_CHECKING:
    from emulator.controller import Controller


def answer_request(controller: "Controller", pdu: bytes) -> bytes:
    """Carry a request out; the answer, which says so when the request is refused.

    A request that writes to an address that cannot be written changes nothing.
    """
    try:
        request = decode_request(pdu)
        return encode_response(request, _carry_out(controller, request))
    except (ModbusException, PortError) as refused:
        return exception_response(pdu[0], refused.code)


def _carry_out(controller: "Controller", request: ModbusRequest) -> list[int]:
    addresses = range(request.address, request.address + request.count)
    written = range(request.address, request.address + len(request.values))
    match request.function:
        case Function.READ_COILS | Function.READ_DISCRETE_INPUTS:
            return [read_coil(controller, address) for address in addresses]
        case Function.READ_HOLDING_REGISTERS | Function.READ_INPUT_REGISTERS:
            return [read_register(controller, address) for address in addresses]
        case Function.WRITE_COIL | Function.WRITE_COILS:
            check_writable(COILS, written, "coil")
            for address, value in zip(written, request.values, strict=True):
                write_coil(controller, address, bool(value))
        case Function.WRITE_REGISTER | Function.WRITE_REGISTERS:
            check_writable(REGISTERS, written, "register")
            for address, value in zip(written, request.values, strict=True):
                write_register(controller, address, value)
        case _:
            raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)
    return []


_GENERAL: Final = range(128, 256)
_TURN: Final = 2.0 * math.pi


class PortMemory:
    """What only the server keeps: the general purpose registers 128 to 255, and the up-time latched last."""

    def __init__(self) -> None:
        self.general = [0] * len(_GENERAL)
        self.uptime = [0] * 5  # ms, s, min, h, days

    def latch_uptime(self, seconds: float) -> None:
        """Keep the time since the controller started until the next call."""
        milliseconds = round(seconds * 1000.0)
        whole = milliseconds // 1000
        self.uptime = [milliseconds % 1000, whole % 60, whole // 60 % 60, whole // 3600 % 24, whole // 86400]


def read_register(controller: "Controller", address: int) -> int:
    """A register, 0 to 65535. Raises PortError."""
    return _word(_reader(REGISTERS, address, "register")(controller))


def write_register(controller: "Controller", address: int, word: int) -> None:
    """Set a register to a word, 0 to 65535. Raises PortError."""
    _writer(REGISTERS, address, "register")(controller, word)


def read_coil(controller: "Controller", address: int) -> bool:
    """A coil. Raises PortError."""
    return bool(_reader(COILS, address, "coil")(controller))


def write_coil(controller: "Controller", address: int, level: bool) -> None:
    """Set a coil. Raises PortError."""
    _writer(COILS, address, "coil")(controller, int(level))


def check_writable(table: dict[int, Cell], addresses: Iterable[int], what: str) -> None:
    """Raises PortError unless all of these can be written."""
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
    """A quantity as a word: rounded, saturated, negative ones in two's complement."""
    if not math.isfinite(value):
        return 0
    return min(max(round(value), -0x8000), 0xFFFF) & 0xFFFF


# the robot's state


def _vector(first: int, name: str, factor: float, start: int = 0, count: int = 6) -> dict[int, Cell]:
    """Registers for elements of a snapshot's vector, from ``start`` on."""

    def cell(index: int) -> Cell:
        return Cell(lambda controller: getattr(controller.snapshot, name)[index] * factor)

    return {first + at: cell(start + at) for at in range(count)}


def _pose(first: int, name: str, position_factor: float) -> dict[int, Cell]:
    """Six registers: three for a position or velocity, three in mrad or mrad/s."""
    return {**_vector(first, name, position_factor, 0, 3), **_vector(first + 3, name, 1000.0, 3, 3)}


def _angle(joint: int) -> Cell:
    return Cell(lambda controller: math.floor(controller.snapshot.actual_q[joint] % _TURN * 1000.0))


def _turns(joint: int) -> Cell:
    return Cell(lambda controller: math.floor(controller.snapshot.actual_q[joint] / _TURN))


def _robot_bit(bit: RobotStatusBits) -> Cell:
    return Cell(lambda controller: bool(controller.snapshot.robot_status_bits & bit))


def _safety_bit(bit: SafetyStatusBits) -> Cell:
    return Cell(lambda controller: bool(controller.snapshot.safety_status_bits & bit))


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
        256: Cell(lambda controller: controller.version.major),
        257: Cell(lambda controller: controller.version.minor),
        258: Cell(lambda controller: controller.snapshot.robot_mode),
        **_FLAGS,
        266: Cell(lambda controller: controller.snapshot.safety_mode),
        **{270 + joint: _angle(joint) for joint in range(6)},
        **_vector(280, "actual_qd", 1000.0),
        **_vector(290, "actual_current", 1000.0),
        **_vector(300, "joint_temperatures", 1.0),
        **_vector(310, "joint_mode", 1),
        **{320 + joint: _turns(joint) for joint in range(6)},
        **_pose(400, "actual_TCP_pose", 10000.0),
        **_pose(410, "actual_TCP_speed", 1000.0),
        **_pose(420, "tcp_offset", 1000.0),
        450: Cell(lambda controller: controller.snapshot.actual_robot_current * 1000.0),
        451: Cell(lambda controller: controller.snapshot.io_current * 1000.0),
        768: Cell(lambda controller: controller.snapshot.tool_mode),
        769: Cell(lambda controller: controller.snapshot.tool_temperature),
        770: Cell(lambda controller: controller.snapshot.tool_output_current * 1000.0),
    }


# the server's own memory, and the registers shared with RTDE


def _general(index: int) -> Cell:
    def write(controller: "Controller", word: int) -> None:
        controller.port_memory.general[index] = word

    return Cell(lambda controller: controller.port_memory.general[index], write)


def _uptime(index: int) -> Cell:
    return Cell(lambda controller: controller.port_memory.uptime[index])


def _input_bit(index: int) -> Cell:
    return Cell(
        lambda controller: controller.registers.input.get_bit(index),
        lambda controller, bit: controller.registers.input.set_bit(index, bool(bit)),
    )


def _output_bit(index: int) -> Cell:
    return Cell(lambda controller: controller.registers.output.get_bit(index))


REGISTERS: Final[dict[int, Cell]] = {
    **digital_registers(),
    **analog_registers(),
    **{address: _general(at) for at, address in enumerate(_GENERAL)},
    **_state_registers(),
    2048: Cell(write=lambda controller, _: controller.port_memory.latch_uptime(controller.time_s)),
    **{2049 + at: _uptime(at) for at in range(5)},
}

COILS: Final[dict[int, Cell]] = {
    **digital_coils(),
    **_FLAGS,
    **{300 + index: _input_bit(index) for index in range(128)},
    **{500 + index: _output_bit(index) for index in range(128)},
}
