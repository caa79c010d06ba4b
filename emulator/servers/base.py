"""What every port has in common: connections, what is sent to them, and hooks.

A client that reads too slowly harms nobody else. State, which the next package supersedes,
is skipped while earlier bytes still wait for it. Everything else must be delivered: when
too much of that waits, the connection ends.

Requests of one connection are carried out in order, a few per control period; the
connection is not read further while too many wait.

Hooks see and may change what passes. One that keeps bytes back says how many (``Connection.keep``) and passes them
on later (``Connection.pass_on``), to the hooks after it; meanwhile they count as bytes that wait for the client.
"""

import asyncio
import errno
import logging
import os
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Protocol, TypeAlias

from emulator.commands.requests import ServingFailed
from emulator.mailbox import Command
from emulator.servers.admission import Acceptor, ClientLimits, Reason, TurnedAway
from emulator.servers.read_budget import Intake
from emulator.servers.web import Opening, Visitor
from emulator.snapshot import Snapshot
from urproto.errors import RemoteProtocolError
from urproto.versions import PolyscopeVersion

_READ_BYTES: Final = 1024  # at once: a message a byte takes some ms then (guess)
_SEND_BUFFER: Final = 256 * 1024  # the system's, per connection: what a late reader finds is no older (guess)
_MOST_UNDELIVERED: Final = 1024 * 1024  # bytes that must be delivered and are not read (guess)
_BACKLOG: Final = 128
_LINGER_S: Final = 1.0  # for a client that talks on after it was told why nobody listens (guess)
_LISTEN_AGAIN_S: Final = 0.5  # between attempts to have a port back that somebody else took (guess)
_RESET: Final = struct.pack("ii", 1, 0)  # SO_LINGER: on, no time: closing sends RST
_WRONG_PORT: Final = {
    Visitor.HTTP: (
        Reason.HTTP,
        "sent an HTTP request and was disconnected; nothing of it was carried out. This is no web server: close the "
        "web page that did it, or mend the port in your program. HTTP is for the control API",
    ),
    Visitor.TLS: (
        Reason.TLS,
        "began with TLS and was disconnected. A robot's connections are not encrypted: close the web page that did it, "
        "or connect without TLS",
    ),
}

_logger = logging.getLogger(__name__)

Reply = Callable[[Any], None]


class ControllerDoor(Protocol):
    """All that a server sees of the controller."""

    @property
    def version(self) -> PolyscopeVersion: ...

    @property
    def snapshot(self) -> Snapshot: ...

    def post(self, command: Command, reply: Reply | None = None) -> None: ...

    def subscribe(self, callback: Callable[[Snapshot], None]) -> Callable[[], None]: ...


class Direction(Enum):
    """Which way something travels, as the controller sees it."""

    RECEIVED = "received"
    SENT = "sent"


BytesHook: TypeAlias = "Callable[[Connection, Direction, bytes], bytes]"


@dataclass
class Hooks:
    """Functions that see, and may change, what passes through a port. Called in order.

    on_connect: False turns the client away. on_bytes: returns the bytes that pass instead,
    possibly none. on_message: as on_bytes for one decoded request or encoded-to-be answer;
    None drops it. State broadcasts pass on_bytes only. on_state: what the state ports show
    instead of a period's snapshot.
    """

    on_connect: list[Callable[["Connection"], bool]] = field(default_factory=list)
    on_bytes: list[BytesHook] = field(default_factory=list)
    on_message: list[Callable[["Connection", Direction, Any], Any]] = field(default_factory=list)
    on_state: list[Callable[[Snapshot], Snapshot]] = field(default_factory=list)

    def admits(self, connection: "Connection") -> bool:
        """True when no hook turns the client away."""
        return all(hook(connection) for hook in self.on_connect)

    def bytes(
        self, connection: "Connection", direction: Direction, data: bytes, after: "BytesHook | None" = None
    ) -> bytes:
        """The bytes that pass, of all hooks or of those after one."""
        hooks = self.on_bytes
        for hook in hooks if after is None else hooks[_place_after(hooks, after) :]:
            if not data:
                break
            data = hook(connection, direction, data)
        return data

    def state(self, snapshot: Snapshot) -> Snapshot:
        """The snapshot that is shown."""
        for hook in self.on_state:
            snapshot = hook(snapshot)
        return snapshot

    def message(self, connection: "Connection", direction: Direction, message: Any) -> Any:
        """The message that passes, None when one of the hooks dropped it."""
        for hook in self.on_message:
            if message is not None:
                message = hook(connection, direction, message)
        return message


class Connection(asyncio.BufferedProtocol):
    """One client of one port. This base takes no notice of what the client sends.

    most_undelivered: bytes that may wait for a client that does not read. for_browsers: whether the first bytes may
    be a web browser's, who is disconnected elsewhere. patient: whether bytes may be kept back until that is known.
    """

    most_undelivered = _MOST_UNDELIVERED
    for_browsers = False
    patient = True

    def __init__(self, server: "PortServer") -> None:
        self.server = server
        self._transport: asyncio.Transport | None = None
        self._read_buffer = bytearray(_READ_BYTES)
        self.peer = "?"
        self._kept = {Direction.SENT: 0, Direction.RECEIVED: 0}  # bytes that hooks keep back
        self._late = 0  # of them, those that wait for the client
        self._wants_reading = True
        self._stalls: set[object] = set()  # who keeps it from being read
        self._closing = self._ended = False  # once what is kept back has passed
        self._deaf = False  # what the client still says is thrown away
        self._lingering: asyncio.TimerHandle | None = None
        self._opening = None if self.for_browsers else Opening(patient=self.patient)

    # for the kinds of connection

    def opened(self) -> None:
        """The client is connected; the place for a greeting."""

    def received(self, data: bytes) -> None:
        """Bytes from the client, in any split. RemoteProtocolError ends the connection."""

    def at_end(self) -> bool:
        """The client will send no more; True keeps the connection open for answers."""
        return False

    def lost(self) -> None:
        """The connection is gone."""

    def send(self, data: bytes) -> None:
        """Send bytes the client must get; a client that lets too many wait is dropped."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if self.server.hooks.on_bytes:
            data = self.server.hooks.bytes(self, Direction.SENT, data)
        self._write(transport, data)

    def send_state(self, data: bytes) -> None:
        """Send bytes that the next ones supersede: skipped when earlier ones still wait."""
        transport = self._transport
        if transport is not None and self._late < _SEND_BUFFER and not transport.get_write_buffer_size():
            self.send(data)

    def close(self) -> None:
        """Deliver what was sent, then end the connection."""
        if self._late:
            self._closing = True
        elif self._transport is not None:
            self._transport.close()

    def hang_up(self) -> None:
        """Deliver what was sent, and end the connection once the client has done so, or soon.

        A connection that is closed while bytes of the client are unread is reset, and the client may lose the answer.
        """
        transport = self._transport
        if transport is None or self._deaf:
            return
        if self._late:
            self.close()
            return
        self._deaf = True
        transport.write_eof()
        if self.is_open:
            self._lingering = asyncio.get_running_loop().call_later(_LINGER_S, self.close_now)

    def close_now(self) -> None:
        """End the connection, without waiting for a client that does not read."""
        transport = self._transport
        if transport is not None and (self._late or transport.get_write_buffer_size()):
            transport.abort()
        else:
            self.close()

    def read_on(self, going: bool) -> None:
        """Read the client's bytes, or leave them with the system for now."""
        self._wants_reading = going
        self._read()

    # for hooks and faults

    @property
    def is_open(self) -> bool:
        """False once it ends."""
        return self._transport is not None and not self._transport.is_closing()

    @property
    def unsent(self) -> int:
        """Bytes that the system does not take, because the client does not read."""
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    @property
    def undelivered(self) -> int:
        """Those, and what hooks keep back."""
        return self.unsent + self._late

    def stall(self, reason: object) -> None:
        """Leave the client's bytes with the system until ``unstall`` for the same reason."""
        self._stalls.add(reason)
        self._read()

    def unstall(self, reason: object) -> None:
        """Read again, unless there are other reasons."""
        self._stalls.discard(reason)
        self._read()

    def reset(self) -> None:
        """End the connection at once, so that the client gets a reset (RST) instead of an end (FIN)."""
        transport = self._transport
        if transport is not None:
            self._set_option(socket.SO_LINGER, _RESET)
            transport.abort()

    def set_send_buffer(self, size: int | None) -> None:
        """Let the system keep so many unread bytes; None for as many as usual."""
        self._set_option(socket.SO_SNDBUF, _SEND_BUFFER if size is None else size)

    def keep(self, direction: Direction, count: int) -> None:
        """A hook keeps this number of bytes back, and will pass them on."""
        self._kept[direction] += count
        self._late = self._kept[Direction.SENT]

    def pass_on(self, direction: Direction, data: bytes, after: BytesHook, count: int | None = None) -> None:
        """Pass on bytes that a hook kept back; ``count``: of those it kept, if not as many as it passes on."""
        self.keep(direction, -(len(data) if count is None else count))
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        passed = self.server.hooks.bytes(self, direction, data, after)
        if direction is Direction.RECEIVED:
            self._receive(passed)
        else:
            self._write(transport, passed)
        if self._closing and not self._late:
            transport.close()
        elif self._ended and not self._kept[Direction.RECEIVED] and not self._at_end():
            self.close()

    # both sides

    def _write(self, transport: asyncio.Transport, data: bytes) -> None:
        if transport.get_write_buffer_size() + self._late + len(data) > self.most_undelivered:
            _logger.warning("%s: %s does not read what it is sent and is disconnected", self.server.name, self.peer)
            transport.abort()
        elif data:
            transport.write(data)

    def _receive(self, data: bytes) -> None:
        if self._deaf:
            return
        try:
            if self._opening is not None:
                data = self._judge(self._opening, data)
            if data:
                self.received(data)
        except RemoteProtocolError as error:
            _logger.warning("%s: %s is disconnected: %s", self.server.name, self.peer, error)
            self.close()
        except MemoryError:
            _logger.warning("%s: %s is disconnected: no memory for what it sends", self.server.name, self.peer)
            if self._transport is not None:
                self._transport.abort()

    def _judge(self, opening: Opening, data: bytes) -> bytes:
        """What may be read of a connection that has just begun; a web browser's ends."""
        passed = opening.feed(data)
        if isinstance(opening.verdict, Visitor):
            reason, text = _WRONG_PORT[opening.verdict]
            self.server.turned_away.count(reason, self.peer, text)
            if self._transport is not None:
                self._transport.abort()
        elif not opening.verdict:
            self._opening = None
        return passed

    def _at_end(self) -> bool:
        """What began like a browser's request and did not go on was none."""
        opening, self._opening = self._opening, None
        if opening is not None and not isinstance(opening.verdict, Visitor):
            self._receive(opening.rest())
        return self.is_open and self.at_end()

    def _read(self) -> None:
        transport, going = self._transport, self._wants_reading and not self._stalls
        if transport is None or transport.is_closing() or transport.is_reading() is going:
            return
        if going:
            transport.resume_reading()
        else:
            transport.pause_reading()

    def _set_option(self, option: int, value: int | bytes) -> None:
        own = self._transport.get_extra_info("socket") if self._transport is not None else None
        if own is not None:
            own.setsockopt(socket.SOL_SOCKET, option, value)

    # asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.peer = _peer_name(transport)
        transport.set_write_buffer_limits(high=self.most_undelivered)
        if not self.server.hooks.admits(self):
            transport.abort()
            return
        self.server.connections.append(self)
        _logger.info("%s: %s connected", self.server.name, self.peer)
        self.opened()

    def get_buffer(self, sizehint: int) -> bytearray:
        return self._read_buffer

    def buffer_updated(self, nbytes: int) -> None:
        began_s = time.thread_time()
        self._arrived(bytes(self._read_buffer[:nbytes]))
        self.server.intake.spent(self, time.thread_time() - began_s)

    def _arrived(self, data: bytes) -> None:
        if self.server.hooks.on_bytes:
            data = self.server.hooks.bytes(self, Direction.RECEIVED, data)
        self._receive(data)

    def eof_received(self) -> bool:
        self._ended = bool(self._kept[Direction.RECEIVED])
        return not self._deaf and (self._ended or self._at_end())

    def _read_rest(self) -> None:
        """What the client sent before it reset the connection: asyncio drops that when a write notices the reset first.

        Clients that close with states unread reset it, right behind their last command.
        """
        own = self._transport.get_extra_info("socket") if self._transport is not None else None
        if own is None or self._stalls or not self._wants_reading:
            return
        with suppress(OSError):
            while data := os.read(own.fileno(), _READ_BYTES):
                self._arrived(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None and self in self.server.connections:
            self._read_rest()
        self._transport = None
        if self._lingering is not None:
            self._lingering.cancel()
        self.server.gone(self)
        if self in self.server.connections:
            self.server.connections.remove(self)
            _logger.info("%s: %s disconnected%s", self.server.name, self.peer, f" ({exc})" if exc else "")
            self.lost()


def _place_after(hooks: list[BytesHook], hook: BytesHook) -> int:
    return hooks.index(hook) + 1 if hook in hooks else len(hooks)


def _peer_name(transport: asyncio.BaseTransport) -> str:
    address = transport.get_extra_info("peername")
    return f"{address[0]}:{address[1]}" if address else "a client"


class PortServer:
    """Listens on one port and keeps the connections to it.

    limits: how many; turned_away: who did not get one. intake: what reading from them may cost.
    """

    def __init__(self, name: str, controller: ControllerDoor) -> None:
        self.name = name
        self.controller = controller
        self.hooks = Hooks()
        self.limits = ClientLimits()
        self.turned_away = TurnedAway(name)
        self.intake = Intake()
        self.connections: list[Connection] = []
        self._clients: dict[Connection, str] = {}  # and their addresses, also of those that are being welcomed
        self._welcoming: set[asyncio.Task[object]] = set()
        self._unsubscribe: Callable[[], None] | None = None
        self._listening: Acceptor | None = None
        self._address = ("", 0)
        self._returning: asyncio.Task[None] | None = None

    def connect(self) -> Connection:
        """The protocol object of a new connection."""
        return Connection(self)

    def publish(self, snapshot: Snapshot) -> None:
        """A control period is over; the place to send state."""

    def _tell(self, snapshot: Snapshot) -> None:
        """What fails here silences a port: the robot shows it on the others."""
        try:
            self.publish(snapshot)
        except Exception as error:
            self.controller.post(ServingFailed(self.name, error))

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
        self._unsubscribe = self.controller.subscribe(self._tell)

    def follow(self, controller: ControllerDoor) -> None:
        """Serve another controller from now on."""
        self.controller = controller
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = controller.subscribe(self._tell)

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
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None
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
            told = f"{clients} clients are connected to this port, as many as --most-clients allows"
        else:
            told = f"its address has {limits.address} clients here, as many as --most-clients-per-address allows"
        return reason, f"was turned away: {told}. Close those that are not needed"

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

    def gone(self, connection: Connection) -> None:
        """There is room for another client."""
        self._clients.pop(connection, None)


def _listen(name: str, host: str, port: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listening = socket.create_server(address[:2], family=family, backlog=_BACKLOG)
    except OSError as error:
        reason = "another program uses it" if error.errno == errno.EADDRINUSE else error.strerror
        raise OSError(error.errno, f"cannot listen on {host} port {port} ({name}): {reason}") from error
    # accepted sockets inherit these; without the first, packages wait up to 40 ms for the client's acknowledgement
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    return listening
