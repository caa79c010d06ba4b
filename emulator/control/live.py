"""The verbs of a robot whose ports are open."""

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar, cast

from emulator.control.base import Waiting
from emulator.control.control import Control
from emulator.control.timing import Pace
from emulator.control.verbs import verb
from emulator.controller import Controller
from emulator.faults.injector import FaultInjector
from emulator.servers.admission import TurnedAway

__all__ = ["LiveControl", "Port"]

_T = TypeVar("_T")


class Port(Protocol):
    """What the verbs want to know of a server."""

    @property
    def port(self) -> int: ...

    @property
    def peers(self) -> list[str]: ...

    @property
    def turned_away(self) -> TurnedAway: ...


class LiveControl(Control):
    """As Control. A verb that takes time returns its steps: a server continues them after each control period."""

    def __init__(self, controller: Controller, pace: Pace, ports: Mapping[str, Port], faults: FaultInjector) -> None:
        super().__init__(controller, pace, faults)
        self._ports = ports

    @verb
    def ports(self) -> dict[str, int]:
        """The port each server listens on, by its name."""
        return {name: server.port for name, server in self._ports.items()}

    @verb
    def connections(self) -> dict[str, list[str]]:
        """Who is connected to each port: addresses of the clients, in the order they came."""
        return {name: server.peers for name, server in self._ports.items()}

    @verb
    def turned_away(self) -> dict[str, dict[str, int]]:
        """How many clients each port has turned away since the start, by reason; only ports that did.

        http, tls: what web browsers send; port full, address full: more clients than the limits allow;
        no descriptors: the process has no room for more files and connections.
        """
        return {name: counts for name, server in self._ports.items() if (counts := server.turned_away.counts)}

    def _wait(self, steps: Waiting[_T]) -> _T:
        return cast(_T, steps)


def is_waiting(result: Any) -> bool:
    """Whether a verb returned steps instead of its result."""
    return hasattr(result, "__next__")
