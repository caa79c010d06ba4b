"""Verbs about time: how fast it goes, and going on step by step."""

import math
from typing import Protocol

from emulator.control.base import ControlBase, Waiting
from emulator.control.conditions import Condition, parse_condition
from emulator.control.verbs import BadArguments, NotPossible, verb
from emulator.controller import Controller

__all__ = ["Pace", "TimeVerbs"]


class Pace(Protocol):
    """How a robot's time goes by. ``speed``: simulated seconds per second, inf for as fast as it goes."""

    @property
    def speed(self) -> float: ...

    @property
    def paused(self) -> bool: ...

    def set_speed(self, speed: float) -> None: ...

    def pause(self) -> None: ...

    def resume(self) -> None: ...


class TimeVerbs(ControlBase):
    """Verbs about time."""

    def __init__(self, controller: Controller, pace: Pace) -> None:
        super().__init__(controller)
        self.pace = pace

    @verb
    def time(self) -> dict[str, float | bool]:
        """Uptime [s], control period [s], speed (simulated seconds per second, 0 for as fast as it goes), paused."""
        speed = self.pace.speed
        return {
            "time_s": self.controller.time_s,
            "period_s": self.controller.period_s,
            "speed": speed if math.isfinite(speed) else 0.0,
            "paused": self.pace.paused,
        }

    @verb
    def set_speed(self, speed: float) -> None:
        """Let time go faster or slower: simulated seconds per second; 0 is as fast as it goes."""
        if speed < 0.0:
            raise BadArguments(f"time cannot run at {speed} seconds per second")
        self.pace.set_speed(speed or math.inf)

    @verb
    def pause_time(self) -> None:
        """Stop time; the ports stay open. ``step`` and ``run_until`` go on, ``resume_time`` ends it."""
        self.pace.pause()

    @verb
    def resume_time(self) -> None:
        """Let time go on."""
        self.pace.resume()

    @verb
    def step(self, periods: int = 1) -> float:
        """Let that many control periods go by, after ``pause_time``; the uptime [s] then."""
        if periods < 1:
            raise BadArguments(f"{periods} periods: give 1 or more")
        if not self.pace.paused:
            raise NotPossible("time goes by itself: pause_time first")
        self._wait(self._periods(periods))
        return self.controller.time_s

    @verb
    def run_until(self, condition: str, timeout_s: float = 60.0) -> float:
        """Wait until a condition on the state holds, for example ``robot_mode == RUNNING and actual_q[0] > 0.5``.

        Returns the uptime [s]. Fails after ``timeout_s`` of robot time. Paused time runs meanwhile.
        """
        try:
            holds = parse_condition(condition)
        except ValueError as error:
            raise BadArguments(str(error)) from error
        if not self._wait(self._until(holds, timeout_s)):
            raise NotPossible(f"{condition!r} did not become true within {timeout_s:g} s of robot time")
        return self.controller.time_s

    def _periods(self, count: int) -> Waiting[None]:
        self.pace.resume()
        try:
            for _ in range(count):
                yield
        finally:
            self.pace.pause()

    def _until(self, holds: Condition, timeout_s: float) -> Waiting[bool]:
        paused = self.pace.paused
        self.pace.resume()
        try:
            for _ in range(math.ceil(timeout_s / self.controller.period_s)):
                if holds(self.controller.snapshot):
                    return True
                yield
            return holds(self.controller.snapshot)
        finally:
            if paused:
                self.pace.pause()
