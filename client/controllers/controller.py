"""What every controller is: parameters, interfaces it claims, a life cycle, and one update a cycle.

A new controller is one class decorated with `controller_type`; its docstring is its help.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from client.driver.endpoint import tell
from client.errors import ControllerError
from urproto.compat import Self, StrEnum


class Hardware(Protocol):
    """A robot as interfaces.

    states, commands: all there are. failure: why the arm cannot be moved and will not be by
    itself; None while all is well, also while the robot merely waits.
    """

    states: "Interfaces"
    commands: "Interfaces"
    failure: str | None

    def read(self, state: Mapping[str, Any], period_s: float) -> None:
        """Set the states from what the robot reported. Raises StateError, and sets nothing, when that cannot be."""

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Whether these command interfaces can be begun and ended together; raises ControllerError if not."""

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Begin and end them."""

    def write(self, time_s: float, period_s: float) -> None:
        """Do what is commanded."""

    def take_halt(self) -> str | None:
        """Why the arm was stopped by something else than its controllers since the last call; None if it was not."""


Message = TypeVar("Message")


class Topic(Generic[Message]):
    """The newest message of a kind, and who wants to be called with each.

    name: as in ROS 2, where ~ stands for the controller.
    """

    __slots__ = ("_listeners", "latest", "name")

    def __init__(self, name: str) -> None:
        self.name = name
        self.latest: Message | None = None
        self._listeners: list[Callable[[Message], object]] = []

    def subscribe(self, listener: Callable[[Message], object]) -> Callable[[], None]:
        """Call back with each message, within the control cycle: briefly. Gives what ends it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def publish(self, message: Message) -> None:
        """Keep it, and tell everybody; a listener that raises is logged and harms nobody else."""
        self.latest = message
        if self._listeners:
            tell(self._listeners, message)


NO_COMMAND: Final = math.nan
"""On a command interface: nothing to do."""


class UnknownInterfaceError(LookupError):
    """``names`` are not among the interfaces."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        super().__init__(f"there is no interface {', '.join(self.names)}")


class Interfaces:
    """State or command interfaces, named as in ros2_control ("elbow_joint/position"); each is NaN until it is set.

    `lend` gives a part of them, in any order: whoever has it reads and writes the same numbers.
    """

    __slots__ = ("_places", "_store", "names")

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        self._places = {name: place for place, name in enumerate(self.names)}
        self._store = [NO_COMMAND] * len(self.names)

    def lend(self, names: Sequence[str]) -> Self:
        """The interfaces with these names, in this order. Raises UnknownInterfaceError."""
        if unknown := [name for name in names if name not in self._places]:
            raise UnknownInterfaceError(unknown)
        part = object.__new__(type(self))
        part.names = tuple(names)
        part._places = {name: self._places[name] for name in part.names}
        part._store = self._store
        return part

    def get(self) -> list[float]:
        """All values, in the order of the names."""
        store = self._store
        return [store[place] for place in self._places.values()]

    def put(self, values: Sequence[float]) -> None:
        """Set all values, in the order of the names."""
        for place, value in zip(self._places.values(), values, strict=True):
            self._store[place] = value

    def fill(self, value: float) -> None:
        """Set all values to one."""
        for place in self._places.values():
            self._store[place] = value

    def take(self) -> list[float] | None:
        """All values, which are NaN from then on; None while any of them is NaN."""
        values = self.get()
        if any(value != value for value in values):
            return None
        self.fill(NO_COMMAND)
        return values

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> float:
        return self._store[self._places[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self._store[self._places[name]] = value


def in_short(interfaces: Iterable[str]) -> str:
    """Their kinds and how many there are of each, for people: "*_joint/position (6)"."""
    kinds = Counter[str]()
    for interface in interfaces:
        component, _, kind = interface.rpartition("/")
        kinds[f"*_joint/{kind}" if component.endswith("_joint") else f"{component}/*"] += 1
    return ", ".join(f"{kind} ({count})" for kind, count in kinds.items())


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

    def reconfigure(self, parameters: Parameters) -> None:
        """Take other parameters, also while active. Raises ControllerError, and keeps those that it has."""
        before, self.parameters = self.parameters, parameters
        if self.state is LifecycleState.UNCONFIGURED:
            return
        try:
            self.on_configure()
        except ControllerError:
            self.parameters = before
            self.on_configure()
            raise

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
