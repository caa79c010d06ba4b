"""A fault as a value: what goes wrong, when it begins and ends, and how often it strikes.

    @register
    @dataclass(frozen=True, kw_only=True)
    class DropConnection(ClientFault):
        \"""Connections are closed.\"""

        occasion: ClassVar[str] = "each period with a connected client"

        def act(self, site, strikes): ...

``act`` is a generator. The code before its first yield begins the fault; then it continues once per control period (of
robot time, so faults run faster or pause together with the robot), and its ``finally`` undoes everything. Kinds that
name an ``occasion`` on which they may strike call ``strikes()`` on each; other kinds last from beginning to end.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from random import Random
from typing import Annotated, ClassVar, Final, Protocol, TypeAlias, TypeVar

from msgspec import Meta

from emulator.controller import Controller
from emulator.servers.port import Port
from urproto.compat import dataclass_transform
from urproto.modes import JointMode, RobotMode, RuntimeState, ToolMode

_ROUNDING: Final = 1e-6  # of a control period; 0.008 / 0.002 must be 4 periods, not 5
_T = TypeVar("_T")


def publish_no_controller(controller: Controller) -> None:
    """Replace the last snapshot by one without a controller, which the control API and the pendant show."""
    snapshot = controller.snapshot.successor()
    snapshot.robot_mode = RobotMode.NO_CONTROLLER
    snapshot.joint_mode = (JointMode.NOT_RESPONDING,) * 6
    snapshot.tool_mode = ToolMode.NOT_RESPONDING
    snapshot.runtime_state = RuntimeState.STOPPED
    snapshot.program_running = snapshot.program_paused = False
    snapshot.messages = ()
    controller.publish_instead(snapshot)


def rebooted(before: Controller, boot_s: float, outage_s: float) -> Controller:
    """The controller after a restart: uptime 0, booting, the arm off where it stood; the wall clock has run on."""
    config = before.config
    wall_clock_s = before.wall_clock_ns / 1e9 + outage_s
    timings = replace(config.power_timings, controller_boot_s=boot_s)
    config = replace(
        config, uptime_s=0.0, running=False, initial_q=before.motion.q, wall_clock_s=wall_clock_s, timings=timings
    )
    return Controller(config)


class Rate(Protocol):
    """The clock of a robot in real time."""

    def delay_next(self, seconds: float, *, made_up: bool) -> None:
        """Delay the next control period [s of robot time]; made_up: the following ones catch up."""

    def set_drift(self, share: float) -> None:
        """Make the robot's time faster by this fraction, or slower if it is negative."""


class Machine(Protocol):
    """The control box as a whole."""

    def switch_off(self, *, silent: bool) -> None:
        """Switch the controller off after this period. silent: without closing any connection."""

    def switch_on(self, boot_s: float) -> None:
        """Boot a new controller, whose uptime begins at 0."""


@dataclass
class Site:
    """The robot on which faults act. Faults that need ports, clock or machine are impossible without them."""

    controller: "Controller"
    servers: Mapping[str, Port] = field(default_factory=dict)
    rate: Rate | None = None
    machine: Machine | None = None

    def server(self, name: str) -> Port:
        """The server of a port. Raises FaultImpossibleError."""
        if not self.servers:
            raise FaultImpossibleError("this robot has no ports")
        if name not in self.servers:
            raise FaultImpossibleError(f"this robot has no port {name!r}: choose from {', '.join(self.servers)}")
        return self.servers[name]

    def periods(self, seconds: float) -> int:
        """Control periods in a time, rounded up."""
        return max(0, math.ceil(seconds / self.controller.period_s - _ROUNDING))


@contextmanager
def added(items: list[_T], item: _T, *, first: bool = False) -> Iterator[None]:
    """Add an item to a list while the context is entered."""
    items.insert(0 if first else len(items), item)
    try:
        yield
    finally:
        items.remove(item)


Act: TypeAlias = Generator[None, None, None]
Share: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]


def until_ended(undo: Callable[[], object]) -> Act:
    """Wait until the fault ends, then undo what it has done."""
    try:
        while True:
            yield
    finally:
        undo()


class FaultError(ValueError):
    """The fault is unknown, has wrong arguments, or contradicts itself or another fault."""


class FaultImpossibleError(Exception):
    """This robot cannot have the fault."""


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """When a fault begins and ends, and how often it strikes.

    at: uptime [s] at which it begins; after: delay [s] from now; without either it begins immediately.
    until: uptime [s] at which it ends; lasting: duration [s]; without either it lasts until it is cleared.
    once: it ends with its first strike. probability: of a strike, on each occasion. seed: of its random numbers.
    """

    at: float | None = None
    after: float | None = None
    until: float | None = None
    lasting: float | None = None
    once: bool = False
    probability: Share = 1.0
    seed: int = 0

    kind: ClassVar[str] = ""
    occasion: ClassVar[str] = ""  # on which it may strike; "" for a kind that lasts
    outside: ClassVar[bool] = False  # it continues while the controller is off

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise FaultError(f"{entry.name} must be finite, not {value}")
        for one, other in (("at", "after"), ("until", "lasting")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise FaultError(f"{one} and {other} contradict each other: give one of them")
        for name in ("after", "lasting"):
            if (getattr(self, name) or 0.0) < 0.0:
                raise FaultError(f"{name} cannot be negative")
        if self.at is not None and self.until is not None and self.until <= self.at:
            raise FaultError(f"the fault would end at {self.until:g} s, before it begins at {self.at:g} s")
        if not self.occasion and (self.once or self.probability < 1.0):
            raise FaultError(f"{self.kind} lasts from its beginning to its end: leave out once and probability")

    def claims(self, site: "Site") -> set[str]:
        """The parts of the robot that the fault occupies, each of which can have one fault at a time."""
        return set()

    def check(self, site: "Site") -> None:  # noqa: B027 - most kinds are always possible
        """Raise FaultImpossibleError if this robot cannot have the fault."""

    @abstractmethod
    def act(self, site: "Site", strikes: "Strikes") -> Act:
        """Begin the fault, continue once per control period, and undo everything at the end."""


class Strikes:
    """Decides whether a fault strikes on an occasion. ``count``: number of strikes. ``random``: its random numbers."""

    def __init__(self, fault: Fault, number: int) -> None:
        self.random: Final = Random(f"{fault.kind} {number} {fault.seed}")  # the same on every machine
        self.count = 0
        self.spent = False
        self._once = fault.once
        self._probability = fault.probability

    def __call__(self) -> bool:
        if self.spent or (self._probability < 1.0 and self.random.random() >= self._probability):
            return False
        self.count += 1
        self.spent = self._once
        return True


KINDS: Final[dict[str, type[Fault]]] = {}
_Kind = TypeVar("_Kind", bound=Fault)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def register(kind: type[_Kind]) -> type[_Kind]:
    """Make a class a kind of fault, named after it: DropConnection is ``drop_connection``. Its fields are arguments."""
    made = dataclass(frozen=True, kw_only=True)(kind)
    made.kind = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
    KINDS[made.kind] = made
    return made
