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
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Final, cast

from client.connection import DEFAULT_TIMEOUT_S
from client.errors import LateSetpointError, ProgramNotRunningError, ProgramStaysError
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError
from urproto.external_control import (
    REQUEST_PROGRAM,
    ControlMode,
    FreedriveAction,
    ReverseMessage,
    TrajectoryAction,
    split_greeting,
)
from urproto.text import to_bytes
from urproto.versions import Series

MAX_REAL_TIME_S: Final = 0.2  # source: the client library, which limits how long an arm moves without a message
SETPOINT_TIMEOUT_S: Final = 0.02  # the client library's default for a setpoint
KEEP_ALIVE_TIMEOUT_S: Final = 1.0  # the client library's default for a keep-alive
_STOP_MS: Final = 100
_MAX_TIMEOUT_MS: Final = 2**31 - 1
_MAX_UNSENT: Final = 8192  # bytes of a trajectory, in addition to the system's buffers; guess
_HINT: Final = "start the program on the robot and wait for it"
_MAX_WAITING: Final = 8  # connections that have not proved themselves yet, per port; guess
_AUTHENTICATION_TIMEOUT_S: Final = 10.0  # how long such a connection may wait; guess
_ACCEPTING: Final = 3  # rounds of the event loop from accepting a connection to connection_made: a task, and a call
SENDER_PORT: Final = 50002
_MAX_REQUEST: Final = 1024  # bytes without a line end (guess)
REVERSE_PORT: Final = 50001


@lru_cache(maxsize=64)  # called for every setpoint
def read_timeout_ms(mode: ControlMode, timeout_s: float, period_s: float) -> int:
    """Return the timeout [ms] to send for `timeout_s` in this mode.

    It is at least one control period `period_s` [s]. 0 waits forever, except in real-time modes, where it means one
    period. Raises LocalProtocolError for a negative timeout, and in real-time modes for one above 0.2 s.
    """
    if not timeout_s >= 0.0:
        raise LocalProtocolError(f"a timeout is 0 s or more, not {timeout_s}")
    if mode.real_time and timeout_s > MAX_REAL_TIME_S:
        raise LocalProtocolError(
            f"a robot waits at most {MAX_REAL_TIME_S:g} s for the next setpoint, not {timeout_s}: send them more often"
        )
    if mode is ControlMode.STOPPED:
        return _STOP_MS
    if timeout_s == 0.0 and not mode.real_time:
        return 0
    return max(1, round(min(1000.0 * max(timeout_s, period_s), _MAX_TIMEOUT_MS)))


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

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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


class ScriptSender(Endpoint):
    """Answers every request with the program; any number of robots may request it at the same time.

    program: returns the text, bare statements between the URCap's anchors. The connection stays open and the program
    has no end marker, as the protocol demands.
    """

    requests: int
    """Number of requests so far."""

    def __init__(self, program: Callable[[], str], port: int = SENDER_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self.requests = 0
        self._program = program
        self._unread: dict[Peer, bytes] = {}

    def _on_accepted(self, peer: Peer) -> None:
        self._peers.add(peer)
        self._unread[peer] = b""

    def _received(self, peer: Peer, data: bytes) -> None:
        *lines, rest = (self._unread[peer] + data).split(b"\n")
        self._unread[peer] = rest
        for line in lines:
            self._answer(peer, line)
        if len(rest) > _MAX_REQUEST:
            _logger.warning("%s sent %d bytes without a request: disconnected", peer.address, len(rest))
            peer.abort()

    def _answer(self, peer: Peer, line: bytes) -> None:
        if line.rstrip(b"\r") != REQUEST_PROGRAM.rstrip(b"\n"):
            _logger.warning("%s requested %r: this port only serves the control program", peer.address, line[:80])
            return
        self.requests += 1
        peer.transport.write(to_bytes(self._program()) + b"\n")

    def _on_closed(self, peer: Peer) -> None:
        self._peers.discard(peer)
        self._unread.pop(peer, None)


@dataclass(slots=True)
class StreamStatistics:
    """Statistics of consecutive setpoints in one mode, by this machine's clock."""

    sent: int = 0
    """Number of setpoints sent."""
    skipped: int = 0
    """Number of control periods without a setpoint, not counting setpoints that were slightly late."""
    late: int = 0
    """How often the robot waited longer than the timeout, and stopped the arm."""
    longest_gap_s: float = 0.0
    """Longest time between two setpoints [s]."""

    def __str__(self) -> str:
        return (
            f"{self.sent} setpoints sent, {self.skipped} control periods without one, "
            f"longest gap {1000.0 * self.longest_gap_s:.0f} ms"
        )


class ReverseEndpoint(Endpoint):
    """Sends setpoints and modes; while a robot is connected to this port, its control program is running.

    Every method sends immediately, from any thread. It raises ProgramNotRunningError without a robot, and
    LocalProtocolError for values that cannot be sent. timeout_s: how long the program waits for the next message before
    it stops the arm; `read_timeout_ms` describes its limits.
    """

    period_s: float
    """The robot's control period [s]."""
    mode: ControlMode
    """Mode of the last message."""
    stream: StreamStatistics
    """Statistics of the setpoints since the last other message."""

    def __init__(self, port: int = REVERSE_PORT, host: str = "", period_s: float = Series.E.period_s) -> None:
        super().__init__(port, host)
        self.period_s = period_s
        self.mode = ControlMode.IDLE
        self.stream = StreamStatistics()
        self._lock = threading.RLock()
        self._sent_s = 0.0  # time of the last message, by the monotonic clock
        self._timeout_s = 0.0  # how long the robot waits after that
        self._late_reason = ""  # why the arm was stopped, until it has been reported to the sender of setpoints

    def setpoint(self, mode: ControlMode, values: Sequence[float], timeout_s: float = SETPOINT_TIMEOUT_S) -> None:
        """Send one setpoint (6,) of a real-time mode, in the units of `ReverseMessage.setpoint`.

        Raises LateSetpointError, once, if the robot has waited for it too long: the arm was stopped, the program
        continues, and this setpoint was not sent.
        """
        message = ReverseMessage.setpoint(mode, values, self._timeout_ms(mode, timeout_s))
        with self._lock:
            peer = self.peer
            now = time.monotonic()
            if self.mode.real_time and self._sent_s:
                self._record_gap(now - self._sent_s)
            if self._late_reason:
                why, self._late_reason = self._late_reason, ""
                raise LateSetpointError("a stream of setpoints", why)
            if not self.mode.real_time:
                self.stream = StreamStatistics()
            self.stream.sent += 1
            self._write(peer, message, now)

    def keep_alive(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Send that there is nothing to do; a moving arm is brought to rest."""
        with self._lock:
            self._rest(timeout_s)
            self._late_reason = ""

    def _rest(self, timeout_s: float) -> None:
        self._send(ReverseMessage.keep_alive(self._timeout_ms(ControlMode.IDLE, timeout_s)))

    def trajectory(self, action: TrajectoryAction, points: int = 0, timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Start, keep alive, or end a trajectory with this number of points."""
        self._send(ReverseMessage.trajectory(action, points, self._timeout_ms(ControlMode.FORWARD, timeout_s)))

    def freedrive(self, action: FreedriveAction, timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Start, keep alive, or end freedrive."""
        self._send(ReverseMessage.freedrive(action, self._timeout_ms(ControlMode.FREEDRIVE, timeout_s)))

    def stop(self) -> None:
        """End the control program."""
        self._send(ReverseMessage.stop())

    def continue_mode(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Send the keep-alive message of the present mode.

        Setpoint modes have none: when setpoints stop coming, the arm is brought to rest.
        """
        with self._lock:
            if self.mode is ControlMode.FORWARD:
                self.trajectory(TrajectoryAction.NOOP, 0, timeout_s)
            elif self.mode is ControlMode.FREEDRIVE:
                self.freedrive(FreedriveAction.NOOP, timeout_s)
            elif self.mode is ControlMode.IDLE:
                self._rest(timeout_s)

    def end_late_stream(self) -> None:
        """Keep the program running if setpoints stop for longer than the robot waits; the arm is then at rest."""
        with self._lock:
            if self.mode.real_time and self.silence_s > self._timeout_s:
                self._record_gap(self.silence_s)

    def pop_late_reason(self) -> str:
        """Return why the arm was stopped, if it was for a late setpoint that has not been reported yet; else ""."""
        why, self._late_reason = self._late_reason, ""
        return why

    def report_late(self, why: str) -> None:
        """Take note of the robot's message that a setpoint was late."""
        with self._lock:
            if self.connected and self.mode.real_time:
                self._handle_late(why)

    @property
    def silence_s(self) -> float:
        """Time since the last message to the current or last robot [s]."""
        return time.monotonic() - self._sent_s if self._sent_s else 0.0

    def _record_gap(self, gap_s: float) -> None:
        self.stream.longest_gap_s = max(self.stream.longest_gap_s, gap_s)
        self.stream.skipped += max(0, round(gap_s / self.period_s) - 1)
        if gap_s > self._timeout_s:
            self._handle_late(
                f"this machine sent no setpoint for {1000.0 * gap_s:.0f} ms, and the robot waits only "
                f"{1000.0 * self._timeout_s:.0f} ms"
            )

    def _handle_late(self, why: str) -> None:
        self.stream.late += 1
        self._late_reason = why
        _logger.warning("the arm was stopped: %s (%s)", why, self.stream)
        self._rest(KEEP_ALIVE_TIMEOUT_S)  # the program waits for this; the next setpoint begins a new motion

    def _timeout_ms(self, mode: ControlMode, timeout_s: float) -> int:
        return read_timeout_ms(mode, timeout_s, self.period_s)

    def _send(self, message: ReverseMessage) -> None:
        with self._lock:
            self._write(self.peer, message, time.monotonic())

    def _write(self, peer: Peer, message: ReverseMessage, now: float) -> None:
        peer.write(message.encode())
        self.mode = message.mode
        self._sent_s, self._timeout_s = now, message.read_timeout_ms / 1000.0

    def _notify(self, connected: bool) -> None:
        with self._lock:
            self.mode = ControlMode.IDLE
            self._late_reason = ""
            if connected:
                self._sent_s = 0.0
        super()._notify(connected)
