"""Outputs that follow the program or drive power: what set_runstate_..._output_to_value() asks for."""

from collections.abc import Callable
from typing import TypeAlias

from emulator.io.registers import RegisterBank
from emulator.io.signals import DigitalGroup, Signals
from emulator.programs.output_actions import OutputAction, level_at_end, level_at_start, level_by_power

__all__ = ["RunstateOutputs"]

_Write: TypeAlias = Callable[[bool], None]


class RunstateOutputs:
    """The actions in force. They outlive the program that set them, as the installation's do.

    An analog output that is high or low is at its maximum or minimum.
    """

    def __init__(self, signals: Signals, registers: RegisterBank, powered: Callable[[], bool]) -> None:
        self._signals = signals
        self._registers = registers
        self._powered = powered
        self._program_runs = False
        self._following: dict[tuple[str, int], tuple[OutputAction, _Write]] = {}

    def set_digital(self, group: DigitalGroup, index: int, action: OutputAction) -> None:
        """Let a digital output follow. Raises IndexError for a signal the group does not have."""
        group.bit(index)
        self._set((group.name, index), action, lambda level: self._signals.set_digital_output(group, index, level))

    def set_register(self, index: int, action: OutputAction) -> None:
        """Let a boolean output register follow. Raises IndexError."""
        self._registers.get_bit(index)
        self._set(("register", index), action, lambda level: self._registers.set_bit(index, level))

    def set_analog(self, index: int, action: OutputAction) -> None:
        """Let an analog output follow. Raises IndexError."""
        self._signals.analog_output(index)
        self._set(("analog", index), action, lambda level: self._signals.set_analog_output(index, float(level)))

    def program_started(self) -> None:
        """A main program begins."""
        self._program_runs = True
        self._apply(level_at_start)

    def program_stopped(self, *, unscheduled: bool) -> None:
        """The main program is over. ``unscheduled``: by an error of its own, a protective stop, fault or violation."""
        self._program_runs = False
        self._apply(lambda action: level_at_end(action, unscheduled=unscheduled))

    def power_changed(self) -> None:
        """Drive power came or went."""
        powered = self._powered()
        self._apply(lambda action: level_by_power(action, powered=powered))

    def _apply(self, level_of: Callable[[OutputAction], bool | None]) -> None:
        for action, write in self._following.values():
            level = level_of(action)
            if level is not None:
                write(level)

    def _set(self, key: tuple[str, int], action: OutputAction, write: _Write) -> None:
        self._following[key] = (action, write)
        level = level_at_start(action) if self._program_runs else level_at_end(action, unscheduled=False)
        if level is None:
            level = level_by_power(action, powered=self._powered())
        if level is not None:
            write(level)
