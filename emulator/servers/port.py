"""A port: who is let in, and what is published to all of its clients.

Requests of one connection are carried out in order, a few per control period; the
connection is not read further while too many wait (`emulator.servers.command_queue`).
"""

import asyncio
import errno
import logging
import socket
from collections.abc import Callable
from typing import Any, Final, Protocol

from emulator.commands.requests import ServingFailed
from emulator.mailbox import Command
from emulator.servers.admission import Acceptor, ClientLimits, Reason, TurnedAway
from emulator.servers.connection import SEND_BUFFER, Connection
from emulator.servers.hooks import Hooks
from emulator.servers.read_budget import Intake
from emulator.servers.turns import Turns
from emulator.snapshot import Snapshot
from urproto.versions import PolyscopeVersion

_BACKLOG: Final = 128
_LISTEN_AGAIN_S: Final = 0.5  # between attempts to have a port back that somebody else took (guess)

_logger = logging.getLogger(__name__)

Reply = Callable[[Any], None]


class ServedController(Protocol):
    """All that a server sees of the controller."""

    @property
    def version(self) -> PolyscopeVersion: ...

    @property
    def snapshot(self) -> Snapshot: ...

    def post(self, command: Command, reply: Reply | None = None) -> None: ...

    def subscribe(self, callback: Callable[[Snapshot], None]) -> Callable[[], None]: ...


class PortServer:
    """Listens on one port and keeps the connections to it.

    limits: how many; turned_away: who did not get one. intake: what reading from them may cost; turns: what sending
    state to them may.
    """

    def __init__(self, name: str, controller: ServedController) -> None:
        self.name = name
        self.controller = controller
        self.hooks = Hooks[Connection]()
        self.limits = ClientLimits()
        self.turned_away = TurnedAway(name)
        self.intake = Intake()
        self.turns = Turns()
        self.connections: list[Connection] = []
        self._clients: dict[Connection, str] = {}  # and their addresses, also of those that are being welcomed
        self._welcoming: set[asyncio.Task[object]] = set()
        self._publishes = False
        self._unsubscribe: Callable[[], None] | None = None  # while it publishes and there is a client
        self._listening: Acceptor | None = None
        self._address = ("", 0)
        self._returning: asyncio.Task[None] | None = None

    def connect(self) -> Connection:
        """The protocol object of a new connection."""
        return Connection(self)

    def publish(self, snapshot: Snapshot) -> None:
        """A control period is over and somebody is connected; the place to send state."""

    def _tell(self, snapshot: Snapshot) -> None:
        """What fails here silences a port: the robot shows it on the others."""
        try:
            self.publish(snapshot)
        except Exception as error:
            self.controller.post(ServingFailed(self.name, error))

    @property
    def robot_time_s(self) -> float:
        """Uptime of the controller at the end of its last control period [s]."""
        return self.controller.snapshot.timestamp

    @property
    def port(self) -> int:
        """The port it listens on, or did last."""
        return self._address[1]

    @property
    def listening(self) -> bool:
        """Whether new clients are let in."""
        return self._listening is not None

    @property
    def peers(self) -> list[str]:
        """Addresses of the clients, in the order they came."""
        return [connection.peer for connection in self.connections]

    async def start(self, host: str, port: int) -> None:
        """Listen. Port 0 takes a free one. Raises OSError saying which port and why."""
        await self._listen(host, port)
        self._publishes = True
        self._heed()

    def follow(self, controller: ServedController) -> None:
        """Serve another controller from now on."""
        self._heed_no_more()
        self.controller = controller
        self._heed()

    def _heed(self) -> None:
        """Hear of the control periods while there is somebody to tell of them."""
        if self._unsubscribe is None and self._publishes and self.connections:
            self._unsubscribe = self.controller.subscribe(self._tell)

    def _heed_no_more(self) -> None:
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def succeed(self, other: "PortServer") -> None:
        """Take over the hooks of a server that is gone, its counts, and its port until there is another."""
        self.hooks, self.turned_away, self._address = other.hooks, other.turned_away, other._address

    async def stop(self) -> None:
        """End every connection and listen no longer."""
        returning = self._returning
        self.leave()
        if returning is not None:
            await asyncio.wait([returning])
        if self._welcoming:
            await asyncio.wait(self._welcoming)
        for connection in tuple(self.connections):
            connection.close_now()
        while self.connections:
            await asyncio.sleep(0)

    def leave(self) -> None:
        """Be silent: no client is let in, nothing is published, connections stay open."""
        self._publishes = False
        self._heed_no_more()
        self.close_port()

    def close_port(self) -> None:
        """Let nobody in; who is connected stays. New clients are refused by the system."""
        if self._returning is not None:
            self._returning.cancel()
            self._returning = None
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    def open_port(self) -> None:
        """Listen again where it did, as soon as the event loop gets to it; tries on while another program is there."""
        if self._listening is None and self._returning is None:
            self._returning = asyncio.get_running_loop().create_task(self._return())

    async def _return(self) -> None:
        while True:
            try:
                await self._listen(*self._address)
                break
            except OSError as error:
                _logger.warning("%s", error)
                await asyncio.sleep(_LISTEN_AGAIN_S)
        self._returning = None

    async def _listen(self, host: str, port: int) -> None:
        listening = _listen(self.name, host, port)
        self._address = (host, int(listening.getsockname()[1]))
        self._listening = Acceptor(listening, self._refusal, self._welcome, self.turned_away)

    def _refusal(self, address: str) -> tuple[Reason, str] | None:
        """What keeps one more client from this address out."""
        limits, clients = self.limits, len(self._clients)
        reason = limits.broken_by(clients, list(self._clients.values()).count(address))
        if reason is None:
            return None
        if reason is Reason.PORT_FULL:
            why = f"{clients} clients are connected to this port, as many as --most-clients allows"
        else:
            why = f"its address has {limits.address} clients here, as many as --most-clients-per-address allows"
        return reason, f"was turned away: {why}. Close those that are not needed"

    def _welcome(self, client: socket.socket, address: str) -> None:
        connection = self.connect()
        self._clients[connection] = address
        welcoming = asyncio.get_running_loop().create_task(self._connect(connection, client))
        self._welcoming.add(welcoming)
        welcoming.add_done_callback(self._welcoming.discard)

    async def _connect(self, connection: Connection, client: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(lambda: connection, client)
        except OSError as error:
            self.gone(connection)
            _logger.info("%s: a client vanished while it connected: %s", self.name, error)

    def came(self, connection: Connection) -> None:
        """A client is connected."""
        self.connections.append(connection)
        self._heed()

    def gone(self, connection: Connection) -> None:
        """There is room for another client."""
        self._clients.pop(connection, None)
        self.turns.forget(connection)
        if connection in self.connections:
            self.connections.remove(connection)
        if not self.connections:
            self._heed_no_more()


def _listen(name: str, host: str, port: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listening = socket.create_server(address[:2], family=family, backlog=_BACKLOG)
    except OSError as error:
        reason = "another program uses it" if error.errno == errno.EADDRINUSE else error.strerror
        raise OSError(error.errno, f"cannot listen on {host} port {port} ({name}): {reason}") from error
    # accepted sockets inherit these; without the first, packages wait up to 40 ms for the client's acknowledgement
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    return listening
