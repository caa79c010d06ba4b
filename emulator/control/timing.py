"""Verbs about time: its speed, pausing it, and advancing it step by step."""

import math
import operator
import re
from collections.abc import Callable
from typing import Any, Final, Protocol

from emulator.control.verbs import ControlledRobot, Verbs, Waiting, verb
from emulator.snapshot import Snapshot
from urproto.compat import IntEnum
from urproto.controlapi import BadArguments, NotPossible
from urproto.text import number

_COMPARISONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
_TERM: Final = re.compile(r"(\w+)(?:\[([0-9]{1,9})\])?\s*(==|!=|<=|>=|<|>)\s*(.+)")
_WORDS: Final = {"true": True, "false": False}
_FIELDS: Final = Snapshot()  # an example: every snapshot has values of the same types

Condition = Callable[[Snapshot], bool]


def parse_condition(text: str) -> Condition:
    """Comparisons of published fields with numbers, mode names or texts, joined by ``and``.

    Raises ValueError, which says what is wrong and what is possible.
    """
    terms = [_term(part.strip()) for part in re.split(r"\sand\s", text)]
    return lambda snapshot: all(term(snapshot) for term in terms)


def _term(text: str) -> Condition:
    match = _TERM.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a condition: write a field, ==, !=, <, <=, > or >=, and a value")
    name, index, sign, value = match.groups()
    example = _value_of(_FIELDS, name, index)
    compare, wanted = _COMPARISONS[sign], _constant(value.strip(), example)
    return lambda snapshot: compare(_value_of(snapshot, name, index), wanted)


def _value_of(snapshot: Snapshot, name: str, index: str | None) -> Any:
    try:
        value = vars(snapshot)[name]
        return value if index is None else value[int(index)]
    except (KeyError, TypeError, IndexError):
        place = name if index is None else f"{name}[{index}]"
        raise ValueError(f"there is no field {place}: the verb state lists the fields") from None


def _constant(text: str, example: Any) -> Any:
    """The text as a value of the example's kind."""
    if isinstance(example, IntEnum) and text.upper() in type(example).__members__:
        return type(example)[text.upper()]
    if isinstance(example, str):
        return text.strip("\"'")
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    try:
        return number(text)
    except ValueError:
        names = f", or one of {', '.join(type(example).__members__)}" if isinstance(example, IntEnum) else ""
        raise ValueError(f"{text!r} is not a value to compare with: give a number{names}") from None


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
        try:
            holds = parse_condition(condition)
        except ValueError as error:
            raise BadArguments(str(error)) from error
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
