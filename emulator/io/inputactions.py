"""Inputs that put the arm into freedrive: what set_..._input_action() asks for."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from emulator.io.signals import DigitalGroup
from urproto.modes import RuntimeState

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["InputActions"]


class InputActions:
    """Which inputs trigger freedrive. They outlive the program that said so, as the installation's do.

    While one of them is high, no program runs and the arm may move, the arm is in freedrive.
    """

    def __init__(self) -> None:
        self._levels: dict[tuple[str, int | str], Callable[[Controller], bool]] = {}
        self._free = False

    @property
    def free(self) -> bool:
        """True while an input holds the arm in freedrive."""
        return self._free

    def watch_digital(self, group: DigitalGroup, index: int) -> None:
        """Freedrive by a digital input. Raises IndexError for one the group does not have."""
        group.bit(index)
        self._levels[group.name, index] = lambda controller: controller.signals.get_digital_input(group, index)

    def watch_register(self, index: int) -> None:
        """Freedrive by a boolean input register."""
        self._levels["register", index] = lambda controller: controller.registers.input.get_bit(index)

    def watch_signal(self, name: str) -> None:
        """Freedrive by a Modbus signal; one that was deleted, or whose unit does not answer, counts as low."""
        self._levels["modbus", name] = lambda controller: controller.programs.modbus.is_high(name)

    def hold_button(self) -> None:
        """Freedrive for as long as the pendant's button is held: until it is forgotten."""
        self._levels["button", 0] = lambda _: True

    def forget(self, kind: str, index: int | str) -> None:
        """The input triggers nothing. ``kind``: the group's name, "register", "modbus" or "button"."""
        self._levels.pop((kind, index), None)

    def clear(self) -> None:
        """No input triggers anything."""
        self._levels.clear()

    def advance(self, controller: "Controller") -> None:
        """One control period, before programs run."""
        if not (self._levels or self._free):
            return
        allowed = controller.may_run and controller.programs.state is RuntimeState.STOPPED
        wanted = allowed and any(high(controller) for high in self._levels.values())
        if wanted and not self._free:
            controller.motion.freedrive()
            self._free = True
        elif not wanted:
            self.release(controller)

    def release(self, controller: "Controller") -> None:
        """Leave freedrive, if an input brought the arm there: a program takes over."""
        if self._free:
            controller.motion.end_freedrive()
            self._free = False
