"""One-time requests to controllers: the services of ROS 2, without ROS.

A request is passed to the hardware through command interfaces. Its answer comes back through another one: WAITING, then
SUCCESS or FAILURE. One request is carried out at a time; the others wait in a queue.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Final, TypeVar

from client.controllers.controller import Controller, Interfaces
from client.controllers.parameters import PrefixParameters, without_effect
from client.driver.endpoint import notify

FAILURE: Final = 0.0
SUCCESS: Final = 1.0
WAITING: Final = 2.0
_EFFECT_S: Final = 2.0  # guess: ten times the slowest


@dataclass(frozen=True, slots=True)
class CallParameters(PrefixParameters):
    check_io_successful_retries: int = without_effect(10, "the timeout is measured in robot time")


Parameters = TypeVar("Parameters", bound=PrefixParameters)


class CallingController(Controller[Parameters]):
    """Base class: every request is a `Call`, which the robot answers through a command interface."""

    def __init__(self, name: str, parameters: Parameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._calls = Calls(self.commands)
        self._silence = ""  # why the robot cannot answer

    def on_activate(self, time_s: float) -> None:
        self._calls = Calls(self.commands, self.parameters.tf_prefix)

    def on_deactivate(self) -> None:
        self._calls.end_all("the controller was deactivated")

    def on_silence(self, reason: str) -> None:
        self._silence = reason
        self._calls.end_all(reason)

    def update(self, time_s: float, period_s: float) -> None:
        self._silence = ""
        self._calls.update(time_s)

    def _send(
        self, title: str, values: Mapping[str, float], answer: str, has_effect: Callable[[], bool] | None = None
    ) -> "Call":
        """See `Calls.send`.

        Raises ControllerError while the controller is not active or the robot silent, and for non-finite numbers.
        """
        self.check_active()
        if self._silence:
            raise self.error(f"{title}: {self._silence}")
        if wrong := [value for value in values.values() if not isfinite(value)]:
            raise self.error(f"{title}: {wrong[0]} cannot be set: give finite numbers")
        return self._calls.send(title, values, answer, has_effect)


class Call:
    """One request.

    success: None until it is answered. message: why it failed. on_end: callbacks that are called with success.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.success: bool | None = None
        self.message = ""
        self.on_end: list[Callable[[bool], object]] = []

    def end(self, success: bool, message: str = "") -> None:
        """Answer it; only the first answer counts."""
        if self.success is None:
            self.success, self.message = success, message
            notify(self.on_end, success)


@dataclass(slots=True)
class _Pending:
    call: Call
    values: Mapping[str, float]
    has_effect: Callable[[], bool] | None
    since_s: float | None = None


class Calls:
    """The queue of requests of one controller.

    commands: its command interfaces. prefix: prefix of their names, left out in calls of `send`.
    """

    def __init__(self, commands: Interfaces, prefix: str = "") -> None:
        self._commands = commands
        self._prefix = prefix
        self._queue: deque[tuple[_Pending, str]] = deque()

    def send(
        self, title: str, values: Mapping[str, float], answer: str, has_effect: Callable[[], bool] | None = None
    ) -> Call:
        """Queue a request: set command interfaces, wait for the answer and, with ``has_effect``, until it is true."""
        call = Call(title)
        self._queue.append((_Pending(call, values, has_effect), self._prefix + answer))
        return call

    def update(self, time_s: float) -> None:
        if not self._queue:
            return
        first, answer = self._queue[0]
        if first.since_s is None:
            first.since_s = time_s
            self._commands[answer] = WAITING
            for name, value in first.values.items():
                self._commands[self._prefix + name] = value
            return
        self._check_answer(first, self._commands[answer], time_s - first.since_s)
        if first.call.success is not None:
            self._queue.popleft()

    def _check_answer(self, first: _Pending, answer: float, elapsed_s: float) -> None:
        if answer == FAILURE:
            first.call.end(False, f"{first.call.title}: the robot did not accept it: see its log")
        elif answer == SUCCESS and (first.has_effect is None or first.has_effect()):
            first.call.end(True)
        elif answer == SUCCESS and elapsed_s > _EFFECT_S:
            first.call.end(False, f"{first.call.title}: no effect was seen within {_EFFECT_S:g} s")

    def end_all(self, reason: str) -> None:
        """Fail all pending requests with this reason."""
        while self._queue:
            waiting, _ = self._queue.popleft()
            waiting.call.end(False, f"{waiting.call.title}: {reason}")
