"""What controllers have in common that are asked for settings: a line of calls, from activation to deactivation."""

from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar

from client.controllers.calls import Call, Calls
from client.controllers.controller import Controller

__all__ = ["CallingController", "Prefixed"]


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
    ) -> Call:
        """See `Calls.send`. Raises ControllerError while it is not active."""
        self.check_active()
        return self._calls.send(what, values, answer, seen)
