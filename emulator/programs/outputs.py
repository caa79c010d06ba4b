"""Outputs that follow the program: what set_runstate_..._output_to_value() asks for.

Actions: 0 keep, 1 low, 2 high while no program runs; 3 high while one runs and low
otherwise, 4 the reverse. For analog outputs: 0 keep, 1 minimum, 2 maximum.
"""

from collections.abc import Callable
from typing import Final

from emulator.registers import RegisterBank
from emulator.signals import DigitalGroup, Signals

__all__ = ["ANALOG_ACTIONS", "DIGITAL_ACTIONS", "RunstateOutputs"]

DIGITAL_ACTIONS: Final = range(5)
ANALOG_ACTIONS: Final = range(3)
_STOPPED: Final[dict[int, bool]] = {1: False, 2: True, 3: False, 4: True}  # level by action when no program runs
_STARTED: Final[dict[int, bool]] = {3: True, 4: False}


class RunstateOutputs:
    """The actions in force. They outlive the program that set them, as the installation's do."""

    def __init__(self, signals: Signals, registers: RegisterBank) -> None:
        self._signals = signals
        self._registers = registers
        self._digital: dict[tuple[str, int], tuple[int, Callable[[bool], None]]] = {}
        self._analog: dict[int, int] = {}

    def set_digital(self, group: DigitalGroup, index: int, action: int) -> None:
        """Let a digital output follow the program. Raises IndexError for a signal the group does not have."""
        group.bit(index)
        self._set((group.name, index), action, lambda level: self._signals.set_digital_output(group, index, level))

    def set_register(self, index: int, action: int) -> None:
        """Let a boolean output register follow the program. Raises IndexError."""
        self._registers.get_bit(index)
        self._set(("register", index), action, lambda level: self._registers.set_bit(index, level))

    def set_analog(self, index: int, action: int) -> None:
        """Let an analog output follow the program. Raises IndexError."""
        self._signals.analog_output(index)
        self._analog[index] = action

    def program_started(self) -> None:
        """A main program begins."""
        for action, write in self._digital.values():
            if action in _STARTED:
                write(_STARTED[action])

    def program_stopped(self) -> None:
        """The main program is over."""
        for action, write in self._digital.values():
            if action in _STOPPED:
                write(_STOPPED[action])
        for index, action in self._analog.items():
            if action:
                self._signals.set_analog_output(index, action - 1.0)

    def _set(self, key: tuple[str, int], action: int, write: Callable[[bool], None]) -> None:
        self._digital[key] = (action, write)
        if action in _STARTED:  # called by a program, so one is running
            write(_STARTED[action])
