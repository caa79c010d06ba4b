"""Verbs about time: its speed, pausing it, and advancing it step by step."""

import math
from typing import Protocol

from emulator.control.conditions import Condition, parse_condition
from emulator.control.verbs import ControlledRobot, Verbs, Waiting, refusing, verb
from urproto.controlapi import BadArguments, NotPossible


class Pace(Protocol):
    """Controls how a robot's time advances. ``speed``: simulated seconds per second, inf for as fast as possible."""

    @property
    def speed(self) -> float: ...

    @property
    def paused(self) -> bool: ...

    def set_speed(self, speed: float) -> None: ...

    def pause(self) -> None: ...

    def resume(self) -> None: ...


class ManualPace:
    """Time that advances only when a caller steps it."""

    speed = math.inf
    paused = True

    def set_speed(self, speed: float) -> None:
        raise NotPossible("this robot is in virtual time: it is stepped, as fast as possible, and has no speed")

    def pause(self) -> None:
        """Do nothing: this time is always paused."""

    def resume(self) -> None:
        """Do nothing: the caller advances this time."""


class TimeVerbs(Verbs):
    """Verbs about time."""

    changes = False

    def __init__(self, robot: ControlledRobot, pace: Pace) -> None:
        super().__init__(robot)
        self._pace = pace

    @verb
    def time(self) -> dict[str, float | bool]:
        """Uptime [s], control period [s], speed (simulated seconds per second, 0 for as fast as possible), paused."""
        speed = self._pace.speed
        return {
            "time_s": self.controller.time_s,
            "period_s": self.controller.period_s,
            "speed": speed if math.isfinite(speed) else 0.0,
            "paused": self._pace.paused,
        }

    @verb
    def set_speed(self, speed: float) -> None:
        """Set the speed of time in simulated seconds per second; 0 is as fast as possible."""
        if speed < 0.0:
            raise BadArguments(f"time cannot run at {speed} seconds per second")
        self._pace.set_speed(speed or math.inf)

    @verb
    def pause_time(self) -> None:
        """Stop time; the ports stay open. ``step`` and ``run_until`` advance it, ``resume_time`` ends the pause."""
        self._pace.pause()

    @verb
    def resume_time(self) -> None:
        """Let time run again."""
        self._pace.resume()

    @verb
    def step(self, periods: int = 1) -> float:
        """Advance paused time by a number of control periods, and return the uptime [s]."""
        if periods < 1:
            raise BadArguments(f"the number of periods must be at least 1, not {periods}")
        if not self._pace.paused:
            raise NotPossible("time is running: call pause_time first")
        return self._wait(self._periods(periods))

    @verb
    def run_until(self, condition: str, timeout_s: float = 60.0) -> float:
        """Wait until a condition on the state is true, for example ``robot_mode == RUNNING and actual_q[0] > 0.5``.

        Returns the uptime [s]. Fails after ``timeout_s`` of robot time. Time runs during the wait, even if it is
        paused.
        """
        with refusing(BadArguments):
            holds = parse_condition(condition)
        return self._wait(self._until(condition, holds, timeout_s))

    def _periods(self, count: int) -> Waiting[float]:
        self._pace.resume()
        try:
            for _ in range(count):
                yield
        finally:
            self._pace.pause()
        return self.controller.time_s

    def _until(self, condition: str, holds: Condition, timeout_s: float) -> Waiting[float]:
        paused = self._pace.paused
        self._pace.resume()
        try:
            for _ in range(math.ceil(timeout_s / self.controller.period_s)):
                if holds(self.controller.snapshot):
                    break
                yield
        finally:
            if paused:
                self._pace.pause()
        if not holds(self.controller.snapshot):
            raise NotPossible(
                f"{condition!r} did not become true within {timeout_s:g} s of robot time; "
                "check the condition, or wait longer (timeout_s)"
            )
        return self.controller.time_s
