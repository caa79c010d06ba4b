"""A proxy for every port of a robot that can record everything it relays.

    async with Proxy(robot_routes("192.168.56.101", "127.0.0.1"), recorder) as proxy:
        await asyncio.Event().wait()

Each client of the proxy gets a separate connection to the robot. Data is passed on unchanged, and so are the end of
sending and resets. An end that does not read stops only the sending of its counterpart. A port that the robot does not
offer is also closed on the proxy, until the robot opens it.
"""

import asyncio
import logging
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

from client.decoding.packets import SocketAddress
from client.errors import RobotUnreachableError
from client.traffic.ports import DRIVER_PORTS, ROBOT_PORTS, query_identity
from client.traffic.recording import FLUSH_S, ConnectionRecorder, ConversationRecorder, TrafficRecorder
from urproto.compat import Self
from urproto.compat_asyncio import pause_reading, timeout
from urproto.errors import LocalProtocolError

_LAST_PORT: Final = 65535
_PROBE_S: Final = 2.0  # interval at which closed ports are probed (guess)

_logger = logging.getLogger(__name__)

DIAL_S: Final = 5.0  # how long a robot may take to accept a connection (guess)
_LINGER: Final = struct.pack("ii", 1, 0)  # closing sends a reset


@dataclass(frozen=True, slots=True)
class Route:
    """One port of the proxy and its destination.

    port: the usual port of the protocol, under which it is recorded. listen, listen_port: address of the proxy; 0 is
    any port. host, target: the destination. mirrored: the port is closed here while it is closed there. Otherwise it
    is always open and never probed, since some servers take a connection that ends immediately for a lost one.
    """

    name: str
    port: int
    listen: str
    listen_port: int
    host: str
    target: int
    mirrored: bool = True


def robot_routes(
    host: str,
    listen: str = "127.0.0.1",
    ports: Iterable[tuple[str, int]] = ROBOT_PORTS.items(),
    *,
    port_offset: int = 0,
    listen_offset: int = 0,
) -> list[Route]:
    """Routes for the ports of a robot. The offsets are added to the usual ports of the robot and of the proxy.

    Raises LocalProtocolError if the sum is not a port number.
    """
    routes = [Route(name, port, listen, port + listen_offset, host, port + port_offset) for name, port in ports]
    for route in routes:
        for port in (route.listen_port, route.target):
            if not 0 < port <= _LAST_PORT:
                raise LocalProtocolError(f"{route.name} would be on port {port}: choose another offset")
    return routes


def driver_routes(driver_address: str, listen: str) -> list[Route]:
    """Routes for the ports of a driver, for programs of a robot that connect to ``listen`` instead of the driver."""
    return [
        Route(name, port, listen, port, driver_address, port, mirrored=False) for name, port in DRIVER_PORTS.items()
    ]


def peer_routes(peers: Iterable[tuple[str, int]], listen: str, *, listen_offset: int = 0) -> list[Route]:
    """Routes for devices that programs of a robot connect to, each on its own port."""
    return [
        Route(f"{host}:{port}", port, listen, port + listen_offset, host, port, mirrored=False) for host, port in peers
    ]


class Proxy:
    """The routes, open while the context is entered.

    report: called with messages for the user. not_open: reason why a port cannot be listened on, by the route's name.
    """

    def __init__(
        self,
        routes: Iterable[Route],
        recorder: ConversationRecorder | None = None,
        report: Callable[[str], None] = _logger.info,
    ) -> None:
        self.routes = {route.name: route for route in routes}
        self.not_open: dict[str, str] = {}
        self._recorder = recorder
        self._report = report
        self._servers: dict[str, asyncio.Server] = {}
        self._ports: dict[str, int] = {}
        self._reported: set[str] = set()
        self._relays: set[Relay] = set()
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def ports(self) -> dict[str, int]:
        """The port of this machine for each route that is open now."""
        return {name: self._ports[name] for name in self._servers}

    async def __aenter__(self) -> Self:
        """Open the ports. Raises RobotUnreachableError if none is open there, OSError if none can be opened here."""
        try:
            await self._probe(self.routes.values())
            self._check()
            self._tasks = [asyncio.create_task(self._keep_probing())]
            if self._recorder is not None:
                self._tasks.append(asyncio.create_task(self._keep_flushing(self._recorder)))
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    async def _close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for name in list(self._servers):
            self._shut(name)
        relays = list(self._relays)
        for relay in relays:
            relay.close()
        await asyncio.gather(*(relay.finished.wait() for relay in relays))
        if self._recorder is not None:
            self._recorder.flush()

    def _check(self) -> None:
        if self._servers:
            return
        if self.not_open:
            raise OSError("; ".join(dict.fromkeys(self.not_open.values())))
        route = next(iter(self.routes.values()))
        ports = ", ".join(str(route.target) for route in self.routes.values())
        raise RobotUnreachableError(route.host, route.target, f"nor to any other of the ports {ports}")

    # which ports are open

    async def _keep_probing(self) -> None:
        while True:
            await asyncio.sleep(_PROBE_S)
            closed = self.routes.keys() - self._servers.keys() - self.not_open.keys()
            await self._probe(self.routes[name] for name in sorted(closed))

    async def _probe(self, routes: Iterable[Route]) -> None:
        await asyncio.gather(*(self._open_if_offered(route) for route in routes))

    async def _open_if_offered(self, route: Route) -> None:
        refusal = await _refusal(route) if route.mirrored else None
        if refusal is None:
            await self._open(route)
        else:
            self._report_refused(route, refusal)

    def _report_refused(self, route: Route, reason: str) -> None:
        if route.name not in self._reported:
            self._reported.add(route.name)
            self._report(
                f"{route.name}: {route.host}:{route.target} does not accept connections ({reason}); closed here as well"
            )

    async def _open(self, route: Route) -> None:
        loop = asyncio.get_running_loop()
        port = self._ports.get(route.name, route.listen_port)
        try:
            server = await loop.create_server(lambda: self._accept(route), route.listen, port)
        except OSError as error:
            self.not_open[route.name] = f"{route.name}: cannot listen on {route.listen}:{port} ({reason_of(error)})"
            self._report(self.not_open[route.name])
            return
        self._servers[route.name] = server
        self._ports[route.name] = server.sockets[0].getsockname()[1]
        if route.name in self._reported:
            self._reported.discard(route.name)
            self._report(f"{route.name}: {route.host}:{route.target} accepts connections now")

    def _shut(self, name: str) -> None:
        self._servers.pop(name).close()

    # connections

    def _accept(self, route: Route) -> asyncio.BaseProtocol:
        def on_finished(relay: Relay) -> None:
            self._relays.discard(relay)
            if relay.refusal is not None:
                self._report_refused(route, relay.refusal)
                if route.mirrored and route.name in self._servers:
                    self._shut(route.name)

        relay = Relay(route.host, route.target, route.port, self._recorder, on_finished)
        self._relays.add(relay)
        return relay.client

    async def _keep_flushing(self, recorder: ConversationRecorder) -> None:
        while True:
            await asyncio.sleep(FLUSH_S)
            recorder.flush()


async def _refusal(route: Route) -> str | None:
    """Why a connection to the port fails; None if it succeeds."""
    try:
        async with timeout(DIAL_S):
            _, writer = await asyncio.open_connection(route.host, route.target)
    except OSError as error:  # TimeoutError is one
        return reason_of(error)
    writer.close()
    with suppress(OSError):
        await writer.wait_closed()
    return None


@asynccontextmanager
async def record(
    host: str,
    path: Path,
    listen: str = "127.0.0.1",
    *,
    port_offset: int = 0,
    report: Callable[[str], None] = _logger.info,
) -> AsyncIterator[Proxy]:
    """A proxy of all ports of a robot that records to ``path``. Raises FileError, RobotUnreachableError."""
    comments = await query_identity(host, port_offset)
    recorder = TrafficRecorder(path, comments, problem=report)
    try:
        async with Proxy(robot_routes(host, listen, port_offset=port_offset), recorder, report) as proxy:
            yield proxy
    finally:
        recorder.close()


class Relay:
    """Relays one client's connection to its server.

    finished: set at the end. refusal: why the server could not be reached. client: the protocol of the accepted
    connection. port: the port number under which the server is recorded.
    """

    def __init__(
        self, host: str, target: int, port: int, recorder: ConversationRecorder | None, ended: Callable[["Relay"], None]
    ) -> None:
        self.finished = asyncio.Event()
        self.refusal: str | None = None
        self.client = _End(self, from_client=True)
        self._server: _End | None = None
        self._where = (host, target)
        self._port = port
        self._recorder = recorder
        self._recorded: ConnectionRecorder | None = None
        self._ended = ended
        self._open = 0
        self._dialing: asyncio.Task[None] | None = None

    def close(self) -> None:
        """End both connections; data in transit is lost."""
        if self._dialing is not None:
            self._dialing.cancel()
        for end in (self.client, self._server):
            if end is not None and end.transport is not None:
                end.transport.abort()

    # events of the two ends

    def made(self, end: "_End") -> None:
        """An end is connected."""
        self._open += 1
        if end is self.client:
            assert end.transport is not None
            pause_reading(end.transport)
            self._dialing = asyncio.get_running_loop().create_task(self._dial())

    def data(self, end: "_End", data: bytes) -> None:
        """An end has sent bytes."""
        if self._recorded is not None:
            self._recorded.data(end.from_client, data)
        other = self._opposite(end)
        if other is not None and other.transport is not None and not other.transport.is_closing():
            other.transport.write(data)

    def on_half_closed(self, end: "_End") -> None:
        """An end has closed its sending direction."""
        if self._recorded is not None:
            self._recorded.end(end.from_client)
        other = self._opposite(end)
        if other is None or other.transport is None:
            return
        other.transport.write_eof()
        if other.ended:
            for each in (end, other):
                assert each.transport is not None
                each.transport.close()

    def on_paused(self, end: "_End", held: bool) -> None:
        """An end does not read (held), or reads again: reading from the other end is paused or resumed."""
        other = self._opposite(end)
        if other is None or other.transport is None:
            return
        if held:
            other.transport.pause_reading()
        else:
            other.transport.resume_reading()

    def on_lost(self, end: "_End", error: Exception | None) -> None:
        """An end's connection is over."""
        self._open -= 1
        other = self._opposite(end)
        if other is not None and other.transport is not None and not other.transport.is_closing():
            if self._recorded is not None:
                self._recorded.reset(end.from_client)
            _reset(other.transport)
        if end is self.client and self._dialing is not None:
            self._dialing.cancel()
        self._finish_if_closed()

    def _opposite(self, end: "_End") -> "_End | None":
        return self._server if end is self.client else self.client

    def _finish_if_closed(self) -> None:
        if not self._open and not self.finished.is_set() and (self._dialing is None or self._dialing.done()):
            self.finished.set()
            self._ended(self)

    # the server's end

    async def _dial(self) -> None:
        try:
            await self._connect()
        except OSError as error:  # TimeoutError is one
            self.refusal = reason_of(error)
            assert self.client.transport is not None
            _reset(self.client.transport)
        finally:
            asyncio.get_running_loop().call_soon(self._finish_if_closed)

    async def _connect(self) -> None:
        server = _End(self, from_client=False)
        self._server = server
        try:
            async with timeout(DIAL_S):
                await asyncio.get_running_loop().create_connection(lambda: server, *self._where)
        except BaseException:
            self._server = None
            if server.transport is not None:
                server.transport.abort()
            raise
        assert self.client.transport is not None
        self.client.transport.resume_reading()

    def connected(self, server: "_End") -> None:
        """Both ends are connected: start recording."""
        if self._recorder is not None:
            client, address = self.client.peer, server.peer.address
            self._recorded = self._recorder.connection(client, SocketAddress(address, self._port))


class _End(asyncio.Protocol):
    """One end and its connection to the proxy. ended: it has closed its sending direction."""

    def __init__(self, relay: Relay, *, from_client: bool) -> None:
        self.transport: asyncio.Transport | None = None
        self.peer = SocketAddress("0.0.0.0", 0)
        self.from_client = from_client
        self.ended = False
        self._relay = relay

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)  # uvloop's transport is not a subclass
        address, port = transport.get_extra_info("peername")[:2]
        self.peer = SocketAddress(address, port)
        if not self.from_client:
            self._relay.connected(self)
        self._relay.made(self)

    def data_received(self, data: bytes) -> None:
        self._relay.data(self, data)

    def eof_received(self) -> bool:
        self.ended = True
        self._relay.on_half_closed(self)
        return True

    def pause_writing(self) -> None:
        self._relay.on_paused(self, True)

    def resume_writing(self) -> None:
        self._relay.on_paused(self, False)

    def connection_lost(self, exc: Exception | None) -> None:
        self._relay.on_lost(self, exc)
        self.transport = None


def _reset(transport: asyncio.Transport) -> None:
    """End a connection so that the other side sees a reset."""
    with_socket = transport.get_extra_info("socket")
    if with_socket is not None:
        with_socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER)
    transport.abort()


def reason_of(error: OSError) -> str:
    """The reason why a connection failed, in a few words."""
    if isinstance(error, TimeoutError):
        return f"no answer within {DIAL_S:g} s"
    if isinstance(error, socket.gaierror) or error.errno is None:
        return error.strerror or str(error)
    return os.strerror(error.errno)  # asyncio's own texts repeat the address
