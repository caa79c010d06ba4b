"""Ports of the driver that the robot's program connects to.

Here the driver is the server. It serves one robot at a time, but any host can connect, and port scanners do. So a new
connection must prove that it is the robot's program:

- This driver's own program sends a token that the driver has put into it. It immediately replaces the old connection,
  because it may have been restarted before the driver noticed the end of the last one.
- A connection that sends anything else is rejected.
- A connection that sends nothing, like the vendor's program, waits until the endpoint's owner admits it. It never
  replaces a program that has proved itself.
"""

import asyncio
import logging
import os
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final, cast

from client.connection import DEFAULT_TIMEOUT_S
from client.errors import ProgramNotRunningError, ProgramStaysError
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.external_control import split_greeting

_MAX_UNSENT: Final = 8192  # bytes of a trajectory, in addition to the system's buffers; guess
_HINT: Final = "start the program on the robot and wait for it"
_MAX_WAITING: Final = 8  # connections that have not proved themselves yet, per port; guess
_AUTHENTICATION_TIMEOUT_S: Final = 10.0  # how long such a connection may wait; guess
_ACCEPTING: Final = 3  # rounds of the event loop from accepting a connection to connection_made: a task, and a call

# A robot that was switched off, or a firewall that forgot a connection, ends it without a word; the system notices that
# 4 s later. Results of a trajectory would otherwise be awaited for ever.
_NOTICE_LOSS: Final = tuple(
    (level, getattr(socket, name), value)
    for level, name, value in (
        (socket.SOL_SOCKET, "SO_KEEPALIVE", 1),
        (socket.IPPROTO_TCP, "TCP_KEEPIDLE", 1),  # seconds without data
        (socket.IPPROTO_TCP, "TCP_KEEPINTVL", 1),
        (socket.IPPROTO_TCP, "TCP_KEEPCNT", 3),
    )
    if hasattr(socket, name)
)

_logger = logging.getLogger(__name__)


class Peer(asyncio.Protocol):
    """A connection of a robot, or of a client that may be one."""

    address: str
    """Address of the client."""
    authenticated: bool
    """True once it has sent the token."""
    accepted_s: float
    """Time of the connection, by the event loop's clock [s]."""
    unread: bytes | None
    """The beginning of its greeting; None once the greeting is complete, or ruled out."""

    def __init__(self, endpoint: "Endpoint") -> None:
        self._endpoint = endpoint
        self._may_write = asyncio.Event()
        self._may_write.set()
        self._loop = asyncio.get_running_loop()
        self.closed = self._loop.create_future()
        self.address = ""
        self.authenticated = False
        self.accepted_s = self._loop.time()
        self.unread = b""
        self.transport: asyncio.Transport
        self._socket: socket.socket

    def abort(self) -> None:
        """Close the connection immediately, discarding unsent data."""
        self.transport.abort()

    def write(self, data: bytes) -> None:
        """Send immediately, from any thread, bypassing the event loop, which may be busy.

        A robot that does not read its data is disconnected.
        """
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:  # the connection has ended; the event loop notices this by itself
            return
        if sent < len(data):
            _logger.error("%s does not read its data on port %d: disconnected", self.address, self._endpoint.port)
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self.abort)

    async def write_all(self, data: bytes) -> None:
        """Send as fast as the robot reads."""
        self.transport.write(data)
        await self._may_write.wait()

    # asyncio.Protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)  # uvloop's is not a subclass of it
        self.address = str(transport.get_extra_info("peername")[0])
        self._socket = socket.socket(fileno=os.dup(transport.get_extra_info("socket").fileno()))
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for level, option, value in _NOTICE_LOSS:
            self._socket.setsockopt(level, option, value)
        self.transport.set_write_buffer_limits(_MAX_UNSENT)
        self._endpoint._on_accepted(self)

    def data_received(self, data: bytes) -> None:
        self._endpoint._received(self, data)

    def pause_writing(self) -> None:
        self._may_write.clear()

    def resume_writing(self) -> None:
        self._may_write.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._may_write.set()
        self._socket.close()
        self.closed.set_result(None)
        self._endpoint._on_closed(self)


async def _finish_accepting(server: asyncio.Server) -> None:
    """Stop accepting, and finish connections that were just accepted: otherwise asyncio would leave them open."""
    loop = asyncio.get_running_loop()
    with suppress(NotImplementedError, RuntimeError):  # other event loops accept differently
        for listening in server.sockets:
            loop.remove_reader(listening.fileno())
    for _ in range(_ACCEPTING):
        await asyncio.sleep(0)


class Endpoint:
    """A server for one robot; use it with ``async with``."""

    port: int
    """The port; 0 takes a free one, and is replaced by its number."""
    host: str
    """The local address to listen on; empty for all of them."""
    token: str
    """What the robot's program sends first. If empty, the first connection is the robot's until it leaves."""
    waiting: list[Peer]
    """Connections that have not proved themselves yet, oldest first."""
    listeners: list[Callable[[bool], None]]
    """Called with True when the robot connects, with False when it disconnects."""

    def __init__(self, port: int, host: str = "") -> None:
        self.port = port
        self.host = host
        self.token = ""
        self.waiting = []
        self.listeners = []
        self._peers: set[Peer] = set()
        self._peer: Peer | None = None
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> Self:
        """Listen. Raises OSError if the port is in use."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: Peer(self), self.host or None, self.port, reuse_address=True)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Stop listening and close every connection; may be called more than once."""
        if self._server is not None:
            server, self._server = self._server, None
            await _finish_accepting(server)
            server.close()
        while self._peers:
            peer = next(iter(self._peers))
            peer.transport.close() if not peer.transport.get_write_buffer_size() else peer.abort()
            await peer.closed

    @property
    def connected(self) -> bool:
        """True while a robot is connected."""
        return self._peer is not None

    @property
    def peer(self) -> Peer:
        """The robot's connection. Raises ProgramNotRunningError without one."""
        if self._peer is None:
            raise ProgramNotRunningError(self.port, _HINT)
        return self._peer

    @property
    def current_peer(self) -> Peer | None:
        """The robot's connection, or None."""
        return self._peer

    async def wait_connected(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait for a robot to connect. Raises ProgramNotRunningError on timeout."""
        try:
            await self._wait_until(True, timeout_s)
        except TimeoutError:
            raise ProgramNotRunningError(self.port, f"none connected within {timeout_s:g} s; {_HINT}") from None

    async def wait_disconnected(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait until no robot is connected. Raises ProgramStaysError on timeout."""
        try:
            await self._wait_until(False, timeout_s)
        except TimeoutError:
            raise ProgramStaysError(self.port, timeout_s) from None

    async def _wait_until(self, connected: bool, timeout_s: float) -> None:
        async with timeout(timeout_s):
            while self.connected is not connected:
                future = asyncio.get_running_loop().create_future()

                def changed(_: bool, future: "asyncio.Future[None]" = future) -> None:
                    if not future.done():
                        future.set_result(None)

                self.listeners.append(changed)
                try:
                    await future
                finally:
                    self.listeners.remove(changed)

    # what connections report

    def _on_accepted(self, peer: Peer) -> None:
        self._peers.add(peer)
        robot = self._peer
        if robot is None and not self.token:
            self.admit(peer)
        elif robot is not None and robot.address != peer.address and (robot.authenticated or not self.token):
            self._reject(peer, f"this port serves {robot.address}")
        else:
            if len(self.waiting) >= _MAX_WAITING:  # reject the oldest: this driver's program proves itself immediately
                self._reject(self.waiting[0], f"{_MAX_WAITING} other connections are waiting")
            self.waiting.append(peer)
            asyncio.get_running_loop().call_later(_AUTHENTICATION_TIMEOUT_S, self._reject_unauthenticated, peer)

    def admit(self, peer: Peer) -> None:
        """Take this connection for the robot's from now on; the previous one is closed."""
        if peer in self.waiting:
            self.waiting.remove(peer)
        before, self._peer = self._peer, None
        if before is not None:
            before.abort()
            self._on_disconnected(before)
        self._peer = peer
        self._on_connected(peer)

    def _received(self, peer: Peer, data: bytes) -> None:
        if peer.unread is not None:
            data = self._check_greeting(peer, peer.unread + data)
        if data and peer is self._peer:
            self.data_received(data)

    def _check_greeting(self, peer: Peer, data: bytes) -> bytes:
        """Check the first data of a connection for a greeting; return the data after it."""
        greeting = split_greeting(data)
        if greeting is None:
            peer.unread = data
            return b""
        peer.unread = None
        token, rest = greeting
        if token is None and peer is not self._peer:
            self._reject(peer, f"it is not a control program, it sent {data[:40]!r}")
        elif token and token == self.token:
            peer.authenticated = True
            if peer is not self._peer:
                self.admit(peer)
        return rest

    def _reject(self, peer: Peer, why: str) -> None:
        _logger.warning("connection from %s to port %d rejected: %s", peer.address, self.port, why)
        if peer in self.waiting:
            self.waiting.remove(peer)
        peer.abort()

    def _reject_unauthenticated(self, peer: Peer) -> None:
        if peer in self.waiting:
            self._reject(
                peer, f"it did not identify itself as the robot's program within {_AUTHENTICATION_TIMEOUT_S:g} s"
            )

    def _on_closed(self, peer: Peer) -> None:
        self._peers.discard(peer)
        if peer in self.waiting:
            self.waiting.remove(peer)
        if peer is self._peer:
            self._peer = None
            self._on_disconnected(peer)
            if self.waiting and not self.token:
                self.admit(self.waiting[0])

    # for subclasses

    def data_received(self, data: bytes) -> None:
        """Handle bytes from the robot; the base class expects none."""
        _logger.info("unexpected data from the robot on port %d: %r", self.port, data[:80])

    def _on_connected(self, peer: Peer) -> None:
        self._notify(True)

    def _on_disconnected(self, peer: Peer) -> None:
        self._notify(False)

    def _notify(self, connected: bool) -> None:
        notify(self.listeners, connected)


def notify(listeners: Sequence[Callable[..., object]], *arguments: object) -> None:
    """Call every listener; the exception of one is logged and does not affect the others."""
    for listener in tuple(listeners):
        try:
            listener(*arguments)
        except Exception:
            _logger.exception("a callback failed")
