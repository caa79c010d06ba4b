"""Base of all controllers: parameters, claimed interfaces, a life cycle, and one update per cycle.

A new controller is one class decorated with `controller_type`; its docstring is its help.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar, get_args

from client.driver.endpoint import notify
from client.errors import ControllerError
from urproto.compat import Self, StrEnum

NO_COMMAND: Final = math.nan
"""Value of a command interface that commands nothing."""


class Hardware(Protocol):
    """A robot, represented by interfaces.

    states, commands: all its interfaces. failure: why the arm cannot move until someone intervenes; None without a
    failure, also while the robot merely waits.
    """

    states: "Interfaces"
    commands: "Interfaces"
    failure: str | None

    def read(self, state: Mapping[str, Any], period_s: float) -> None:
        """Set the state interfaces from a robot's state. For an invalid state, raises StateError and sets nothing."""

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Check that these command interfaces can be started and stopped together. Raises ControllerError if not."""

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Start and stop these command interfaces."""

    def write(self, time_s: float, period_s: float) -> None:
        """Carry out what is on the command interfaces."""

    def take_halt(self) -> str | None:
        """Return why something other than its controllers stopped the arm since the last call; None if nothing did."""


Message = TypeVar("Message")


class Topic(Generic[Message]):
    """The newest message of a topic, and its subscribers."""

    __slots__ = ("_listeners", "latest")

    def __init__(self) -> None:
        self.latest: Message | None = None
        self._listeners: list[Callable[[Message], object]] = []

    def subscribe(self, listener: Callable[[Message], object]) -> Callable[[], None]:
        """Call ``listener`` with each message, within the control cycle, so it must be quick.

        Returns a function that unsubscribes it.
        """
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def publish(self, message: Message) -> None:
        """Store a message and pass it to all subscribers; an exception of one is logged and affects no other."""
        self.latest = message
        if self._listeners:
            notify(self._listeners, message)


class UnknownInterfaceError(LookupError):
    """There are no interfaces with these ``names``."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        super().__init__(f"there is no interface {', '.join(self.names)}")


class Interfaces:
    """State or command interfaces, named as in ros2_control ("elbow_joint/position"); each is NaN until it is set.

    `lend` returns a view of some of them, in any order, that shares their values.
    """

    __slots__ = ("_indices", "_store", "names")

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        self._indices = {name: place for place, name in enumerate(self.names)}
        self._store = [NO_COMMAND] * len(self.names)

    def lend(self, names: Sequence[str]) -> Self:
        """A view of the interfaces with these names, in this order. Raises UnknownInterfaceError."""
        if unknown := [name for name in names if name not in self._indices]:
            raise UnknownInterfaceError(unknown)
        part = object.__new__(type(self))
        part.names = tuple(names)
        part._indices = {name: self._indices[name] for name in part.names}
        part._store = self._store
        return part

    def get(self) -> list[float]:
        """All values, in the order of the names."""
        store = self._store
        return [store[place] for place in self._indices.values()]

    def put(self, values: Sequence[float]) -> None:
        """Set all values, in the order of the names."""
        for place, value in zip(self._indices.values(), values, strict=True):
            self._store[place] = value

    def fill(self, value: float) -> None:
        for place in self._indices.values():
            self._store[place] = value

    def take(self) -> list[float] | None:
        """Return all values and reset them to NaN; None while any of them is NaN."""
        values = self.get()
        if any(value != value for value in values):
            return None
        self.fill(NO_COMMAND)
        return values

    def __contains__(self, name: object) -> bool:
        return name in self._indices

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> float:
        return self._store[self._indices[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self._store[self._indices[name]] = value


def interface_summary(interfaces: Iterable[str]) -> str:
    """Summary for messages, with the number of interfaces of each kind: "*_joint/position (6)"."""
    kinds = Counter[str]()
    for interface in interfaces:
        component, _, kind = interface.rpartition("/")
        kinds[f"*_joint/{kind}" if component.endswith("_joint") else f"{component}/*"] += 1
    return ", ".join(f"{kind} ({count})" for kind, count in kinds.items())


class LifecycleState(StrEnum):
    """States of a controller, with their names in ROS 2."""

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
"""(state, transition) -> state. Source: managed nodes of ROS 2; an active controller is deactivated first."""


@dataclass(frozen=True, slots=True)
class NoParameters:
    """Parameters of controllers that have none."""


Parameters = TypeVar("Parameters")


class Controller(Generic[Parameters]):
    """Base class of all controllers.

    name: its name in the controllers file. parameters: an instance of `parameters_type`. update_rate_hz: how often
    `update` is called. states, commands: the interfaces lent to it; empty while it is not active. A controller knows
    neither the robot nor a clock: its manager calls it.
    """

    parameters_type: ClassVar[type[Any]] = NoParameters
    type_name: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        """The parameters of ``class Mine(Controller[MyParameters])`` are of the type in brackets."""
        for base in vars(cls).get("__orig_bases__", ()):
            if isinstance(kind := get_args(base)[0], type) and "parameters_type" not in vars(cls):
                cls.parameters_type = kind

    def __init__(self, name: str, parameters: Parameters, update_rate_hz: float) -> None:
        self.name = name
        self.parameters = parameters
        self.update_rate_hz = update_rate_hz
        self.state = LifecycleState.UNCONFIGURED
        self.states = self.commands = Interfaces(())

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        """Names of the interfaces that it commands, exclusively while it is active."""
        return ()

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        """Names of the interfaces that it reads; names with * stand for all matches, of which there may be none."""
        return ()

    @property
    def active(self) -> bool:
        """True between activation and deactivation."""
        return self.state is LifecycleState.ACTIVE

    def on_configure(self) -> None:
        """Check the parameters. Raises ControllerError."""

    def reconfigure(self, parameters: Parameters) -> None:
        """Replace the parameters, also while active. If invalid, raises ControllerError and keeps the old ones."""
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
        """Start; states and commands have been lent. Raises ControllerError."""

    def on_deactivate(self) -> None:
        """Stop; the interfaces are withdrawn afterwards."""

    def on_halt(self, reason: str) -> None:
        """Handle a stop that had another cause: abort what is under way, and start afresh from the arm's position."""

    def on_silence(self, reason: str) -> None:
        """Handle a robot that sends no states: end what would wait for them, until `update` is called again."""

    def update(self, time_s: float, period_s: float) -> None:
        """Run one cycle: read the states, set the commands.

        time_s: the robot's time. period_s: time since the last cycle.
        """

    def check_active(self) -> None:
        """Raise ControllerError while the controller is not active."""
        if not self.active:
            raise self.error(f"it is {self.state}: activate it first")

    def error(self, reason: str) -> ControllerError:
        return ControllerError(self.name, reason)


CONTROLLER_TYPES: dict[str, type[Controller[Any]]] = {}
"""Controller classes by type name, as used in controllers files."""

AnyController = TypeVar("AnyController", bound=type[Controller[Any]])


def controller_type(*names: str) -> Callable[[AnyController], AnyController]:
    """Register a controller class under its ROS 2 type names, the usual one first."""

    def register(kind: AnyController) -> AnyController:
        kind.type_name = names[0]
        CONTROLLER_TYPES.update(dict.fromkeys(names, kind))
        return kind

    return register
