"""Faults of connections and ports. Faults of the bytes themselves are in `emulator.faults.line`."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from emulator.faults.fault import Act, Fault, FaultImpossibleError, Site, Strikes, added, register
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import Port

NotNegative = Annotated[float, Meta(ge=0.0)]
_ONLY_BY_NAME = "control"  # faults of all ports omit it, because faults are cleared through it


@dataclass(frozen=True, kw_only=True)
class PortFault(Fault):
    """A fault of one port, given by the name of its server, or of all ports except that of the control API.

    "scripts" stands for the connections that programs open.
    """

    port: str = ""

    def check(self, site: Site) -> None:
        self.servers(site)

    def servers(self, site: Site) -> list[Port]:
        if self.port:
            return [site.server(self.port)]
        site.server("dashboard")  # raises if the robot has no ports
        return [server for name, server in site.servers.items() if name != _ONLY_BY_NAME]


@dataclass(frozen=True, kw_only=True)
class ListenerFault(PortFault):
    """A fault that closes the port for a while."""

    def servers(self, site: Site) -> list[Port]:
        found = [server for server in super().servers(site) if server.port]
        if not found:
            raise FaultImpossibleError(f"{self.port} are connections that the robot opens: there is no port to close")
        return found

    def claims(self, site: Site) -> set[str]:
        return {f"the listener of {server.name}" for server in self.servers(site)}


@dataclass(frozen=True, kw_only=True)
class ClientFault(PortFault):
    """A fault of the connections to a port. peer: only of this client, given by its address, or address:port."""

    peer: str = ""

    def concerns(self, connection: Connection) -> bool:
        return self.peer in ("", connection.peer, connection.peer.rpartition(":")[0])

    def connections(self, site: Site) -> Iterator[Connection]:
        for server in self.servers(site):
            yield from filter(self.concerns, tuple(server.connections))


@register
class DropConnection(ClientFault):
    """Connections are closed, by a reset (RST) or in the regular way (FIN); once by default."""

    occasion: ClassVar[str] = "each period with a connected client"
    how: Literal["reset", "end"] = "reset"
    once: bool = True

    def act(self, site: Site, strikes: Strikes) -> Act:
        while not strikes.spent:
            connected = list(self.connections(site))
            if connected and strikes():
                for connection in connected:
                    connection.reset() if self.how == "reset" else connection.close_now()
            yield


@register
class RefuseConnections(ListenerFault):
    """The port does not listen: the system refuses new clients. Existing connections stay."""

    def act(self, site: Site, strikes: Strikes) -> Act:
        servers = self.servers(site)
        for server in servers:
            server.close_port()
        try:
            while True:
                yield
        finally:
            for server in servers:
                server.open_port()


@register
class TurnAway(ClientFault):
    """New connections are accepted and reset immediately."""

    occasion: ClassVar[str] = "each new connection"

    def act(self, site: Site, strikes: Strikes) -> Act:
        def admits(connection: Connection) -> bool:
            if not (self.concerns(connection) and strikes()):
                return True
            connection.reset()
            return False

        with ExitStack() as hooks:
            for server in self.servers(site):
                hooks.enter_context(added(server.hooks.on_connect, admits))
            while not strikes.spent:
                yield


@register
class HalfOpen(ClientFault):
    """New connections are accepted, but nothing is sent or read on them; they are reset when the fault ends."""

    occasion: ClassVar[str] = "each new connection"

    def act(self, site: Site, strikes: Strikes) -> Act:
        victims: set[Connection] = set()

        def admits(connection: Connection) -> bool:
            if self.concerns(connection) and strikes():
                victims.add(connection)
                connection.stall(strikes)
            return True

        def discard(connection: Connection, direction: Direction, data: bytes) -> bytes:
            return b"" if connection in victims else data

        with ExitStack() as hooks:
            for server in self.servers(site):
                hooks.enter_context(added(server.hooks.on_connect, admits))
                hooks.enter_context(added(server.hooks.on_bytes, discard))
            hooks.callback(_reset, victims)
            while not strikes.spent or any(victim.is_open for victim in victims):
                yield
                victims.difference_update([victim for victim in victims if not victim.is_open])


def _reset(connections: set[Connection]) -> None:
    for connection in connections:
        connection.reset()


@register
class KickSlowReaders(ClientFault):
    """Clients that read too slowly are reset: when more than ``buffer_bytes`` wait for them for ``patience_s``.

    The buffers of the client's own system take further bytes before that.
    """

    occasion: ClassVar[str] = "each client that reads too slowly"
    patience_s: NotNegative = 1.0
    buffer_bytes: Annotated[int, Meta(ge=1024)] = 16 * 1024

    def act(self, site: Site, strikes: Strikes) -> Act:
        patience = site.periods(self.patience_s)
        slow: dict[Connection, int] = {}
        known: set[Connection] = set()
        try:
            while not strikes.spent:
                connected = set(self.connections(site))
                for connection in connected - known:
                    connection.set_send_buffer(self.buffer_bytes)
                known = connected
                slow = {one: slow.get(one, 0) + 1 for one in connected if one.unsent}
                for connection, periods in slow.items():
                    if periods > patience and strikes():
                        connection.reset()
                yield
        finally:
            for connection in known:
                connection.set_send_buffer(None)


@register
class RestartPort(ListenerFault):
    """The server of a port crashes: its connections are reset, and the port does not listen for ``outage_s``."""

    outage_s: NotNegative = 1.0

    def act(self, site: Site, strikes: Strikes) -> Act:
        servers = self.servers(site)
        for server in servers:
            server.close_port()
            for connection in tuple(server.connections):
                connection.reset()
        try:
            for _ in range(site.periods(self.outage_s)):
                yield
        finally:
            for server in servers:
                server.open_port()
