"""Outputs that follow the program or drive power, set by set_runstate_..._output_to_value()."""

from collections.abc import Callable
from typing import Final, TypeAlias

from emulator.io.signals import RegisterBank, Signals
from urproto.compat import IntEnum
from urproto.signals import DigitalGroup
from urproto.versions import Series


class OutputAction(IntEnum):
    """Actions. Unscheduled: a runtime exception, protective stop, violation or fault ended the program."""

    KEEP = 0
    LOW_WHEN_STOPPED = 1
    HIGH_WHEN_STOPPED = 2
    HIGH_WHILE_RUNNING = 3  # and low otherwise
    LOW_WHEN_UNSCHEDULED = 4
    HIGH_UNTIL_UNSCHEDULED = 5  # high from a program's start
    HIGH_WITH_POWER = 6  # drive power; low without it (guess)
    LOW_WITH_POWER = 7  # and the reverse


_A = OutputAction
_STARTED: Final = {_A.HIGH_WHILE_RUNNING: True, _A.HIGH_UNTIL_UNSCHEDULED: True}
_STOPPED: Final = {_A.LOW_WHEN_STOPPED: False, _A.HIGH_WHEN_STOPPED: True, _A.HIGH_WHILE_RUNNING: False}
_UNSCHEDULED: Final = {_A.LOW_WHEN_UNSCHEDULED: False, _A.HIGH_UNTIL_UNSCHEDULED: False}
_POWERED: Final = {_A.HIGH_WITH_POWER: True, _A.LOW_WITH_POWER: False}


def output_action(number: int, series: Series, *, power: bool) -> OutputAction:
    """The action of a number. ``power``: whether the output can follow drive power. Raises ValueError."""
    last = _A.HIGH_WHILE_RUNNING
    if series is Series.E:
        last = _A.LOW_WITH_POWER if power else _A.HIGH_UNTIL_UNSCHEDULED
    if not 0 <= number <= last:
        raise ValueError(f"the run-state action of this output must be 0 to {int(last)}, not {number}")
    return OutputAction(number)


def level_at_start(action: OutputAction) -> bool | None:
    """The level when a program starts; None leaves it unchanged."""
    return _STARTED.get(action)


def level_at_end(action: OutputAction, *, unscheduled: bool) -> bool | None:
    """The level when the program ends; None leaves it unchanged."""
    return _UNSCHEDULED.get(action, _STOPPED.get(action)) if unscheduled else _STOPPED.get(action)


def level_by_power(action: OutputAction, *, powered: bool) -> bool | None:
    """The level with or without drive power; None leaves it unchanged."""
    level = _POWERED.get(action)
    return level if level is None else level is powered


_Write: TypeAlias = Callable[[bool], None]


class RunstateOutputs:
    """The active actions. They outlive the program that set them, like those of the installation.

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

    def set_int_register(self, index: int, action: OutputAction) -> None:
        """Let an integer output register follow: it is 1 or 0. Raises IndexError."""
        self._registers.get_int(index)
        self._set(("int register", index), action, lambda level: self._registers.set_int(index, int(level)))

    def set_float_register(self, index: int, action: OutputAction) -> None:
        """Let a float output register follow: it is 1.0 or 0.0. Raises IndexError."""
        self._registers.get_double(index)
        self._set(("float register", index), action, lambda level: self._registers.set_double(index, float(level)))

    def set_analog(self, index: int, action: OutputAction) -> None:
        """Let an analog output follow. Raises IndexError."""
        self._signals.analog_output(index)
        self._set(("analog", index), action, lambda level: self._signals.set_analog_output(index, float(level)))

    def program_started(self) -> None:
        self._program_runs = True
        self._apply(level_at_start)

    def program_stopped(self, *, unscheduled: bool) -> None:
        """The main program is over. ``unscheduled``: by a runtime error, a protective stop, fault or violation."""
        self._program_runs = False
        self._apply(lambda action: level_at_end(action, unscheduled=unscheduled))

    def power_changed(self) -> None:
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
