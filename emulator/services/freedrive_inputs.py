"""Inputs that activate freedrive."""

from collections.abc import Callable

from emulator.io.signals import Registers, Signals
from emulator.motion import Motion
from emulator.services.modbus import ModbusSignals
from urproto.signals import DigitalGroup


class FreedriveInputs:
    """The inputs that activate freedrive. They outlive the program that set them, like those of the installation.

    The arm is in freedrive while one of them is high, no program runs and the arm may move.
    """

    def __init__(self, signals: Signals, registers: Registers, modbus: ModbusSignals, motion: Motion) -> None:
        self._signals, self._registers, self._modbus, self._motion = signals, registers, modbus, motion
        self._levels: dict[tuple[str, int | str], Callable[[], bool]] = {}
        self.free = False  # whether an input holds the arm in freedrive

    def watch_digital(self, group: DigitalGroup, index: int) -> None:
        """Freedrive by a digital input. Raises IndexError for one the group does not have."""
        group.bit(index)
        self._levels[group.name, index] = lambda: self._signals.get_digital_input(group, index)

    def watch_register(self, index: int) -> None:
        self._levels["register", index] = lambda: self._registers.input.get_bit(index)

    def watch_signal(self, name: str) -> None:
        """Freedrive by a Modbus signal; one that was deleted, or whose unit does not answer, counts as low."""
        self._levels["modbus", name] = lambda: self._modbus.is_high(name)

    def hold_button(self) -> None:
        """Activate freedrive while the pendant's button is held, until `remove`."""
        self._levels["button", 0] = lambda: True

    def remove(self, kind: str, index: int | str) -> None:
        """Remove an input's action. ``kind``: the group's name, "register", "modbus" or "button"."""
        self._levels.pop((kind, index), None)

    def clear(self) -> None:
        self._levels.clear()

    def advance(self, *, allowed: bool) -> None:
        """Advance one control period, before programs run. ``allowed``: the arm may move, and no program moves it."""
        if not (self._levels or self.free):
            return
        wanted = allowed and any(high() for high in self._levels.values())
        if wanted and not self.free:
            self._motion.commands.freedrive()
            self.free = True
        elif not wanted:
            self.release()

    def release(self) -> None:
        """Leave freedrive if an input activated it: a program takes over."""
        if self.free:
            self._motion.force_control.end()
            self.free = False
