"""What controllers are asked to do once: services of ROS 2, without ROS.

A command goes to the hardware by command interfaces, its answer comes back by one more:
WAITING, then SUCCESS or FAILURE. One is under way at a time, the others wait in line.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Final, Protocol, TypeVar

from client.controllers.controller import Controller, Interfaces
from client.driver.endpoint import tell


class Prefixed(Protocol):
    """Parameters of which one is in front of all names of interfaces."""

    @property
    def tf_prefix(self) -> str: ...


Parameters = TypeVar("Parameters", bound=Prefixed)


class CallingController(Controller[Parameters]):
    """Base: every request is a `Call`, which the robot answers by a command interface."""

    def __init__(self, name: str, parameters: Parameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._calls = Calls(self.commands)

    def on_activate(self, time_s: float) -> None:
        self._calls = Calls(self.commands, self.parameters.tf_prefix)

    def on_deactivate(self) -> None:
        self._calls.end_all("the controller was deactivated")

    def update(self, time_s: float, period_s: float) -> None:
        self._calls.update(time_s)

    def _send(
        self, what: str, values: Mapping[str, float], answer: str, seen: Callable[[], bool] | None = None
    ) -> "Call":
        """See `Calls.send`. Raises ControllerError while it is not active, and for what no message carries."""
        self.check_active()
        if wrong := [value for value in values.values() if not isfinite(value)]:
            raise self.error(f"{what}: {wrong[0]} cannot be set: give finite numbers")
        return self._calls.send(what, values, answer, seen)


FAILURE: Final = 0.0
SUCCESS: Final = 1.0
WAITING: Final = 2.0
_EFFECT_S: Final = 2.0  # guess: ten times what the slowest takes


class Call:
    """One request. success: None until it is answered; message: why not. on_end: called with success."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.success: bool | None = None
        self.message = ""
        self.on_end: list[Callable[[bool], object]] = []

    def end(self, success: bool, message: str = "") -> None:
        """Answer it; only the first answer counts."""
        if self.success is None:
            self.success, self.message = success, message
            tell(self.on_end, success)


@dataclass(slots=True)
class _Waiting:
    call: Call
    values: Mapping[str, float]
    seen: Callable[[], bool] | None
    since_s: float | None = None


class Calls:
    """The requests of one controller.

    commands: its command interfaces. prefix: in front of the names that are used here.
    """

    def __init__(self, commands: Interfaces, prefix: str = "") -> None:
        self._commands = commands
        self._prefix = prefix
        self._line: deque[tuple[_Waiting, str]] = deque()

    def send(self, what: str, values: Mapping[str, float], answer: str, seen: Callable[[], bool] | None = None) -> Call:
        """Set command interfaces, and wait for the answer; then, if given, until the effect is seen."""
        call = Call(what)
        self._line.append((_Waiting(call, values, seen), self._prefix + answer))
        return call

    def update(self, time_s: float) -> None:
        """Once a cycle."""
        if not self._line:
            return
        first, answer = self._line[0]
        if first.since_s is None:
            first.since_s = time_s
            self._commands[answer] = WAITING
            for name, value in first.values.items():
                self._commands[self._prefix + name] = value
            return
        self._look(first, self._commands[answer], time_s - first.since_s)
        if first.call.success is not None:
            self._line.popleft()

    def _look(self, first: _Waiting, answer: float, waited_s: float) -> None:
        if answer == FAILURE:
            first.call.end(False, f"{first.call.what}: the robot did not take it, its log says why")
        elif answer == SUCCESS and (first.seen is None or first.seen()):
            first.call.end(True)
        elif answer == SUCCESS and waited_s > _EFFECT_S:
            first.call.end(False, f"{first.call.what}: no effect is seen within {_EFFECT_S:g} s")

    def end_all(self, reason: str) -> None:
        """Nobody answers any more."""
        while self._line:
            waiting, _ = self._line.popleft()
            waiting.call.end(False, f"{waiting.call.what}: {reason}")
