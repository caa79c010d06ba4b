"""Faults of RTDE, and of the state that ports publish."""

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from emulator.faults.fault import Act, Fault, FaultImpossibleError, Site, Strikes, added, register, until_ended
from emulator.faults.network import ClientFault
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.rtde import RTDEServer
from emulator.servers.rtde_session import RTDEHost
from emulator.snapshot import Snapshot
from urproto.rtde.codec import PackageType

_KIND: Final = 2  # index of a package's type, after its size
StatePort = Literal[
    "rtde",
    "realtime",
    "primary",
    "secondary",
    "realtime read-only",
    "primary read-only",
    "secondary read-only",
]


def _host(site: Site) -> RTDEHost:
    server = site.server("rtde")
    assert isinstance(server, RTDEServer)
    return server.host


@dataclass(frozen=True, kw_only=True)
class DataFault(ClientFault):
    """A fault of RTDE's data packages."""

    port: Literal["rtde"] = "rtde"

    def act(self, site: Site, strikes: Strikes) -> Act:
        def pass_or_drop(connection: Connection, direction: Direction, data: bytes) -> bytes:
            is_data = direction is Direction.SENT and data[_KIND] == PackageType.DATA_PACKAGE
            return b"" if is_data and self.concerns(connection) and (not self.occasion or strikes()) else data

        with added(site.server("rtde").hooks.on_bytes, pass_or_drop, first=True):  # while packages are still complete
            while not strikes.spent:
                yield


@register
class PauseRtde(DataFault):
    """RTDE sends no data packages, but answers every request."""


@register
class SkipRtde(DataFault):
    """Single RTDE data packages are omitted."""

    occasion: ClassVar[str] = "each data package"


@register
class StaleData(Fault):
    """A state port keeps publishing the state at the beginning of the fault; its timestamp ``runs`` or ``stands``."""

    port: StatePort = "rtde"
    timestamp: Literal["runs", "stands"] = "runs"

    def check(self, site: Site) -> None:
        site.server(self.port)

    def act(self, site: Site, strikes: Strikes) -> Act:
        old = site.controller.snapshot

        def show(snapshot: Snapshot) -> Snapshot:
            shown = old.successor()
            shown.step, shown.messages = snapshot.step, snapshot.messages  # keeps the rate of packages, and messages
            if self.timestamp == "runs":
                shown.timestamp = snapshot.timestamp
            return shown

        with added(site.server(self.port).hooks.on_state, show):
            while True:
                yield


@dataclass(frozen=True, kw_only=True)
class VariableFault(Fault):
    """A fault of one RTDE variable."""

    field: str

    def claims(self, site: Site) -> set[str]:
        return {f"the RTDE variable {self.field}"}


@register
class RtdeFieldNotFound(VariableFault):
    """RTDE recipes with this variable are answered with NOT_FOUND, as by a controller that is too old for it."""

    def check(self, site: Site) -> None:
        host = _host(site)
        if self.field not in host.outputs and self.field not in host.inputs:
            raise FaultImpossibleError(f"PolyScope {host.version} has no RTDE variable {self.field!r}")

    def act(self, site: Site, strikes: Strikes) -> Act:
        host = _host(site)
        host.hide(self.field, True)
        yield from until_ended(lambda: host.hide(self.field, False))


@register
class RtdeInputInUse(VariableFault):
    """RTDE input recipes with this variable are answered with IN_USE, as if another client used it."""

    def check(self, site: Site) -> None:
        host = _host(site)
        if self.field not in host.inputs:
            raise FaultImpossibleError(f"PolyScope {host.version} has no RTDE input {self.field!r}")

    def act(self, site: Site, strikes: Strikes) -> Act:
        reservations = _host(site).reservations
        while reservations.taken(self.field, strikes):  # until then a client uses it, with the same effect
            yield
        reservations.take((self.field,), strikes)
        yield from until_ended(lambda: reservations.release(strikes))


@register
class OldRtdeProtocol(Fault):
    """RTDE supports protocol 1 only, and refuses requests for protocol 2."""

    def check(self, site: Site) -> None:
        _host(site)

    def claims(self, site: Site) -> set[str]:
        return {"the RTDE protocol"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        host = _host(site)
        known, host.protocols = host.protocols, (1,)
        try:
            while True:
                yield
        finally:
            host.protocols = known
