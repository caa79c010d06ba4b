"""Watchdogs on RTDE inputs: a program stops or pauses when its client falls silent."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = ["Watchdog", "WatchdogAction", "Watchdogs"]

WatchdogAction = Literal["ignore", "pause", "stop"]


@dataclass
class Watchdog:
    """``variable`` must be written at least every ``interval`` control periods; ``since``: counts from this step."""

    variable: str
    interval: float
    action: WatchdogAction
    since: int


class Watchdogs:
    """The watchdogs of the running program, one per input variable."""

    def __init__(self) -> None:
        self._watched: dict[str, Watchdog] = {}

    def set(self, watchdog: Watchdog) -> None:
        """Start a watchdog; it replaces an earlier one on the same variable."""
        self._watched[watchdog.variable] = watchdog

    def __bool__(self) -> bool:
        """True when anything is watched."""
        return bool(self._watched)

    def remove(self, variable: str) -> None:
        """Watch a variable no longer."""
        self._watched.pop(variable, None)

    def clear(self) -> None:
        """Forget all of them, as at the end of a program."""
        self._watched.clear()

    def restart(self, step: int) -> None:
        """Give every watchdog a fresh interval, as when a paused program resumes."""
        for watchdog in self._watched.values():
            watchdog.since = step

    def expired(self, step: int, refreshed: Mapping[str, int]) -> list[Watchdog]:
        """Those that starved, given the step at which each variable was last written.

        Each is told once and then has another interval.
        """
        if not self._watched:
            return []
        starved = [
            watchdog
            for watchdog in self._watched.values()
            if step - max(watchdog.since, refreshed.get(watchdog.variable, 0)) > watchdog.interval
        ]
        for watchdog in starved:
            watchdog.since = step
        return starved
