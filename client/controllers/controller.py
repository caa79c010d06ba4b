"""What every controller is: parameters, interfaces it claims, a life cycle, and one update a cycle.

A new controller is one class decorated with `controller_type`; its docstring is its help.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Final, Generic, TypeVar

from client.controllers.interfaces import Interfaces
from client.errors import ControllerError

__all__ = ["CONTROLLER_TYPES", "LIFE_CYCLE", "Controller", "LifecycleState", "NoParameters", "controller_type"]


class LifecycleState(StrEnum):
    """Of a controller, as ROS 2 names them."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


LIFE_CYCLE: Final = {
    (LifecycleState.UNCONFIGURED, "configure"): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, "activate"): LifecycleState.ACTIVE,
    (LifecycleState.ACTIVE, "deactivate"): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, "cleanup"): LifecycleState.UNCONFIGURED,
    (LifecycleState.UNCONFIGURED, "shutdown"): LifecycleState.FINALIZED,
    (LifecycleState.INACTIVE, "shutdown"): LifecycleState.FINALIZED,
}
"""(state, transition) -> state. Source: managed nodes of ROS 2; a controller that is active is deactivated first."""


@dataclass(frozen=True, slots=True)
class NoParameters:
    """For controllers without any."""


Parameters = TypeVar("Parameters")


class Controller(Generic[Parameters]):
    """Base of all controllers.

    name: as the file says. parameters: an instance of `parameters_type`. update_rate_hz: how
    often `update` is called. states, commands: what it was lent; empty while it is not active.
    It knows no robot and no clock, and does only what it is called for.
    """

    parameters_type: ClassVar[type[Any]] = NoParameters
    type_name: ClassVar[str] = ""

    def __init__(self, name: str, parameters: Parameters, update_rate_hz: float) -> None:
        self.name = name
        self.parameters = parameters
        self.update_rate_hz = update_rate_hz
        self.state = LifecycleState.UNCONFIGURED
        self.states = self.commands = Interfaces(())

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        """Names of what it commands; nobody else may command these while it is active."""
        return ()

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        """Names of what it reads; those with * stand for all that match, which may be none."""
        return ()

    @property
    def active(self) -> bool:
        """True between activation and deactivation."""
        return self.state is LifecycleState.ACTIVE

    def on_configure(self) -> None:
        """Check the parameters. Raises ControllerError."""

    def on_activate(self, time_s: float) -> None:
        """Begin; states and commands have been lent. Raises ControllerError."""

    def on_deactivate(self) -> None:
        """End; the interfaces are taken back afterwards."""

    def on_halt(self, reason: str) -> None:
        """The arm was stopped by something else: give up what is under way, and begin anew where it stands."""

    def update(self, time_s: float, period_s: float) -> None:
        """One cycle: read the states, set the commands.

        time_s: the robot's time. period_s: since the last cycle.
        """

    def check_active(self) -> None:
        """Raises ControllerError while the controller is not active."""
        if not self.active:
            raise self.error(f"it is {self.state}: activate it first")

    def error(self, reason: str) -> ControllerError:
        """An error of this controller, to be raised."""
        return ControllerError(self.name, reason)


CONTROLLER_TYPES: dict[str, type[Controller[Any]]] = {}
"""Type name, as in a controllers file -> class."""

AnyController = TypeVar("AnyController", bound=type[Controller[Any]])


def controller_type(*names: str) -> Callable[[AnyController], AnyController]:
    """Make a class known under type names of ROS 2, the usual one first."""

    def register(kind: AnyController) -> AnyController:
        kind.type_name = names[0]
        CONTROLLER_TYPES.update(dict.fromkeys(names, kind))
        return kind

    return register
