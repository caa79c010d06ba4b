"""A port, which accepts clients, and a port of a controller, which publishes state to all of them.

Requests of one connection are executed in order, a few per control period. While too many wait, nothing more is read
from the connection (`emulator.servers.command_queue`).
"""

import asyncio
import errno
import logging
import socket
from collections.abc import Callable
from typing import Any, Final, Protocol

from emulator.commands.requests import ServingFailed
from emulator.logs import ReportedErrors
from emulator.mailbox import Command
from emulator.servers.admission import Acceptor, ClientLimits, Reason, RejectedClients
from emulator.servers.connection import SEND_BUFFER, Connection
from emulator.servers.hooks import Hooks
from emulator.servers.read_budget import ReadBudget
from emulator.servers.send_scheduler import SendScheduler
from emulator.snapshot import Snapshot
from urproto.facts import Situation
from urproto.versions import PolyscopeVersion

_BACKLOG: Final = 128
_RETRY_LISTEN_S: Final = 0.5  # between attempts to reopen a port that another program uses (guess)

_logger = logging.getLogger(__name__)

Reply = Callable[[Any], None]


class ServedController(Protocol):
    """The part of the controller that servers use."""

    @property
    def version(self) -> PolyscopeVersion: ...

    @property
    def situation(self) -> Situation: ...

    @property
    def snapshot(self) -> Snapshot: ...

    def post(self, command: Command, reply: Reply | None = None, client: str = "") -> None: ...

    def subscribe(self, callback: Callable[[Snapshot], None]) -> Callable[[], None]: ...


class Port:
    """Listens on one port and owns the connections to it.

    limits: maximum number of connections. turned_away: counts of clients that were rejected. read_budget: limits the
    time spent on reading from clients. reported: the bugs that the log has described.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.hooks = Hooks[Connection]()
        self.limits = ClientLimits()
        self.turned_away = RejectedClients(name)
        self.read_budget = ReadBudget()
        self.reported = ReportedErrors()
        self.connections: list[Connection] = []
        self._clients: dict[Connection, str] = {}  # with their addresses, including those that are being accepted
        self._accepting: set[asyncio.Task[object]] = set()
        self._listening: Acceptor | None = None
        self._address = ("", 0)
        self._returning: asyncio.Task[None] | None = None

    def connect(self) -> Connection:
        """The protocol object of a new connection."""
        return Connection(self)

    @property
    def robot_time_s(self) -> float:
        """Uptime of the controller [s], for the log; 0 for a port that belongs to none."""
        return 0.0

    @property
    def port(self) -> int:
        """The port the server listens on, or listened on last."""
        return self._address[1]

    @property
    def listening(self) -> bool:
        """Whether new clients are accepted."""
        return self._listening is not None

    @property
    def peers(self) -> list[str]:
        """Addresses of the clients, in the order in which they connected."""
        return [connection.peer for connection in self.connections]

    async def start(self, host: str, port: int) -> None:
        """Listen; port 0 selects a free port. Raises OSError that names the port and the reason."""
        await self._listen(host, port)

    def take_over(self, other: "Port") -> None:
        """Take over hooks, counts and, until this server listens, the port of its predecessor."""
        self.hooks, self.turned_away, self._address = other.hooks, other.turned_away, other._address

    async def stop(self) -> None:
        """Close all connections and stop listening."""
        returning = self._returning
        self.leave()
        if returning is not None:
            await asyncio.wait([returning])
        if self._accepting:
            await asyncio.wait(self._accepting)
        for connection in tuple(self.connections):
            connection.close_now()
        while self.connections:
            await asyncio.sleep(0)

    def leave(self) -> None:
        """Stop accepting clients; connections stay open."""
        self.close_port()

    def close_port(self) -> None:
        """Stop accepting clients: the system refuses them. Existing connections stay."""
        if self._returning is not None:
            self._returning.cancel()
            self._returning = None
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    def open_port(self) -> None:
        """Listen again on the same port, in a task that keeps trying while another program uses the port."""
        if self._listening is None and self._returning is None:
            self._returning = asyncio.get_running_loop().create_task(self._reopen())

    async def _reopen(self) -> None:
        while True:
            try:
                await self._listen(*self._address)
                break
            except OSError as error:
                _logger.warning("%s", error)
                await asyncio.sleep(_RETRY_LISTEN_S)
        self._returning = None

    async def _listen(self, host: str, port: int) -> None:
        listening = _listen(self.name, host, port)
        self._address = (host, int(listening.getsockname()[1]))
        self._listening = Acceptor(listening, self._refusal, self._accept, self.turned_away)

    def _refusal(self, address: str) -> tuple[Reason, str] | None:
        """Why another client from this address is rejected, if it is."""
        limits, clients = self.limits, len(self._clients)
        reason = limits.broken_by(clients, list(self._clients.values()).count(address))
        if reason is None:
            return None
        if reason is Reason.PORT_FULL:
            why = f"{clients} clients are connected to this port, as many as --most-clients allows"
        else:
            why = f"its address has {limits.address} clients here, as many as --most-clients-per-address allows"
        return reason, f"was turned away: {why}. Close connections that are not needed"

    def _accept(self, client: socket.socket, address: str) -> None:
        connection = self.connect()
        self._clients[connection] = address
        accepting = asyncio.get_running_loop().create_task(self._connect(connection, client))
        self._accepting.add(accepting)
        accepting.add_done_callback(self._accepting.discard)

    async def _connect(self, connection: Connection, client: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(lambda: connection, client)
        except OSError as error:
            self.client_disconnected(connection)
            _logger.info("%s: a client disconnected while it was being accepted: %s", self.name, error)

    def client_connected(self, connection: Connection) -> None:
        self.connections.append(connection)

    def client_disconnected(self, connection: Connection) -> None:
        self._clients.pop(connection, None)
        if connection in self.connections:
            self.connections.remove(connection)


class PortServer(Port):
    """A port of a controller, whose state it publishes.

    send_scheduler: limits the time spent on sending state to clients.
    """

    def __init__(self, name: str, controller: ServedController) -> None:
        super().__init__(name)
        self.controller = controller
        self.send_scheduler = SendScheduler()
        self._publishes = False
        self._unsubscribe: Callable[[], None] | None = None  # while it publishes and there is a client

    def publish(self, snapshot: Snapshot) -> None:
        """Send state: called after each control period while clients are connected."""

    def _on_period(self, snapshot: Snapshot) -> None:
        """Publish. An error, after which this port may be silent, is reported through the other ports."""
        try:
            self.publish(snapshot)
        except Exception as error:
            self.controller.post(ServingFailed(self.name, error))

    @property
    def robot_time_s(self) -> float:
        return self.controller.snapshot.timestamp

    async def start(self, host: str, port: int) -> None:
        await super().start(host, port)
        self._publishes = True
        self._subscribe()

    def follow(self, controller: ServedController) -> None:
        """Serve another controller from now on."""
        self._end_subscription()
        self.controller = controller
        self._subscribe()

    def leave(self) -> None:
        """Stop accepting clients and publishing; connections stay open."""
        self._publishes = False
        self._end_subscription()
        super().leave()

    def client_connected(self, connection: Connection) -> None:
        super().client_connected(connection)
        self._subscribe()

    def client_disconnected(self, connection: Connection) -> None:
        super().client_disconnected(connection)
        self.send_scheduler.remove(connection)
        if not self.connections:
            self._end_subscription()

    def _subscribe(self) -> None:
        """Subscribe to the control periods if there are clients to publish to."""
        if self._unsubscribe is None and self._publishes and self.connections:
            self._unsubscribe = self.controller.subscribe(self._on_period)

    def _end_subscription(self) -> None:
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None


def _listen(name: str, host: str, port: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listening = socket.create_server(address[:2], family=family, backlog=_BACKLOG)
    except OSError as error:
        reason = "another program uses it" if error.errno == errno.EADDRINUSE else error.strerror
        raise OSError(error.errno, f"cannot listen on {host} port {port} ({name}): {reason}") from error
    # accepted sockets inherit these; without TCP_NODELAY, packages wait up to 40 ms for the client's acknowledgement
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    return listening
