"""General purpose registers: 128 booleans, 48 integers and 48 doubles each way.

Inputs are written by clients (RTDE, fieldbuses), outputs by programs. Registers keep
their values when a program stops; only a restart of the controller clears them. The
lower ranges (bits 0-63, numbers 0-23) are meant for fieldbuses, the upper for external
clients; nothing enforces that, as on the controller.
"""

import math
from typing import Final

from emulator.snapshot import Snapshot

__all__ = ["BIT_COUNT", "NUMBER_COUNT", "RegisterBank", "Registers"]

BIT_COUNT: Final = 128  # RTDE guide
NUMBER_COUNT: Final = 48  # RTDE guide; 24 before 3.9 / 5.3
_INT32_MIN: Final = -(2**31)
_INT32_MAX: Final = 2**31 - 1


class RegisterBank:
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
            raise OverflowError(f"{value} does not fit an integer register: it holds 32 bits, signed")
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

    def publish(self, snapshot: Snapshot) -> None:
        """Write all of them to a snapshot."""
        given, made = self.input, self.output
        snapshot.input_bit_registers = given.bits
        snapshot.input_int_registers, snapshot.input_double_registers = given.ints, given.doubles
        snapshot.output_bit_registers = made.bits
        snapshot.output_int_registers, snapshot.output_double_registers = made.ints, made.doubles


def _checked(index: int, count: int) -> int:
    if not 0 <= index < count:
        raise IndexError(f"there is no register {index}: they are numbered 0 to {count - 1}")
    return index
