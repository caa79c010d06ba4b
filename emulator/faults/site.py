"""Where faults can be: the parts of one robot that they act on."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from emulator.faults.fault import FaultImpossible
from emulator.servers.base import PortServer

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["Machine", "Rate", "Site", "added"]

_ROUNDING: Final = 1e-6  # of a control period; 0.008 / 0.002 must be 4 periods, not 5
_T = TypeVar("_T")


class Rate(Protocol):
    """The clock of a robot in real time."""

    def delay_next(self, seconds: float, *, made_up: bool) -> None:
        """Let the next control period come late [s of robot time]; made_up: the ones after it catch up."""
        ...

    def set_drift(self, share: float) -> None:
        """Let the robot's time go faster by this share, or slower."""
        ...


class Machine(Protocol):
    """The control box as a whole."""

    def switch_off(self, *, silent: bool) -> None:
        """The controller is gone after this period. silent: so suddenly that nobody's connection is ended."""
        ...

    def switch_on(self, boot_s: float) -> None:
        """A new controller boots; its uptime begins at 0."""
        ...


@dataclass
class Site:
    """One robot. Without ports, clock or machine the faults that need them are impossible."""

    controller: "Controller"
    servers: Mapping[str, PortServer] = field(default_factory=dict)
    rate: Rate | None = None
    machine: Machine | None = None

    def server(self, name: str) -> PortServer:
        """The server of a port. Raises FaultImpossible."""
        if not self.servers:
            raise FaultImpossible("this robot has no ports")
        if name not in self.servers:
            raise FaultImpossible(f"this robot has no port {name!r}: it has {', '.join(self.servers)}")
        return self.servers[name]

    def periods(self, seconds: float) -> int:
        """Control periods in a time, rounded up."""
        return max(0, math.ceil(seconds / self.controller.period_s - _ROUNDING))


@contextmanager
def added(places: list[_T], thing: _T, *, first: bool = False) -> Iterator[None]:
    """Something is in a list while inside."""
    places.insert(0 if first else len(places), thing)
    try:
        yield
    finally:
        places.remove(thing)
