"""A fault as a value: what goes wrong, from when to when, and how often.

    @register
    @dataclass(frozen=True, kw_only=True)
    class DropConnection(ClientFault):
        \"""End the connections.\"""

        occasion: ClassVar[str] = "each period in which somebody is connected"

        def act(self, site, strikes): ...

``act`` is a generator: what comes before its first yield is the beginning, it goes on once a control period (of robot
time: faults go faster or stand still as the robot does), and its ``finally`` takes everything back. A kind that says
on what ``occasion`` it strikes asks ``strikes()`` each time; one that does not, lasts from its beginning to its end.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass, fields
from random import Random
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, TypeAlias, TypeVar

from msgspec import Meta

if TYPE_CHECKING:
    from emulator.faults.site import Site

__all__ = ["KINDS", "Act", "Fault", "FaultError", "FaultImpossible", "Share", "Strikes", "register"]

Act: TypeAlias = Generator[None, None, None]
Share: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]


class FaultError(ValueError):
    """There is no such fault: unknown, with wrong arguments, or in contradiction with itself or another one."""


class FaultImpossible(Exception):  # noqa: N818 - named for what is the case
    """This robot cannot have the fault."""


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """When a fault begins and ends, and how often it strikes.

    at: uptime [s] at which it begins; after: or so many seconds from now; else at once.
    until: uptime [s] at which it ends; lasting: or so many seconds after its beginning; else when it is cleared.
    once: it ends with its first strike. probability: of a strike, on each occasion. seed: of its chance.
    """

    at: float | None = None
    after: float | None = None
    until: float | None = None
    lasting: float | None = None
    once: bool = False
    probability: Share = 1.0
    seed: int = 0

    kind: ClassVar[str] = ""
    occasion: ClassVar[str] = ""  # on what it may strike; "" for what lasts
    outside: ClassVar[bool] = False  # it goes on while the controller is off

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise FaultError(f"{field.name} must be finite, not {value}")
        for one, other in (("at", "after"), ("until", "lasting")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise FaultError(f"{one} and {other} contradict each other: give one of them")
        for name in ("after", "lasting"):
            if (getattr(self, name) or 0.0) < 0.0:
                raise FaultError(f"{name} cannot be negative")
        if self.at is not None and self.until is not None and self.until <= self.at:
            raise FaultError(f"it would end at {self.until:g} s, before it begins at {self.at:g} s")
        if not self.occasion and (self.once or self.probability < 1.0):
            raise FaultError(f"{self.kind} lasts from its beginning to its end: it has no probability and no once")

    def claims(self, site: "Site") -> set[str]:
        """What can have one fault at a time."""
        return set()

    def check(self, site: "Site") -> None:  # noqa: B027 - most kinds are always possible
        """Raise FaultImpossible if this robot cannot have it."""

    @abstractmethod
    def act(self, site: "Site", strikes: "Strikes") -> Act:
        """Begin, go on once a control period, take everything back in the end."""


class Strikes:
    """Whether one fault strikes on an occasion. ``count``: how often it did. ``random``: its chance."""

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
_Kind = TypeVar("_Kind", bound=type[Fault])


def register(kind: _Kind) -> _Kind:
    """Make a class a kind of fault, by its name: DropConnection is ``drop_connection``."""
    kind.kind = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
    KINDS[kind.kind] = kind
    return kind
