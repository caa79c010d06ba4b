"""What an output does when a program starts or ends: the run-state choices of URScript, Modbus signals included.

0 to 3 are in every Script Manual, 4 to 7 in newer ones of the e-Series. That all e-Series versions have them is a
guess.
"""

from enum import IntEnum
from typing import Final

from urproto.versions import Series

__all__ = ["OutputAction", "level_at_end", "level_at_start", "level_by_power", "output_action"]


class OutputAction(IntEnum):
    """Unscheduled: a runtime exception, protective stop, violation or fault ended the program."""

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
    """The level once a program runs; None leaves it."""
    return _STARTED.get(action)


def level_at_end(action: OutputAction, *, unscheduled: bool) -> bool | None:
    """The level once no program runs any more; None leaves it."""
    return _UNSCHEDULED.get(action, _STOPPED.get(action)) if unscheduled else _STOPPED.get(action)


def level_by_power(action: OutputAction, *, powered: bool) -> bool | None:
    """The level with or without drive power; None leaves it."""
    level = _POWERED.get(action)
    return level if level is None else level is powered
