"""A port of the driver that the robot's program connects to.

Here the driver is the server. One robot is served at a time, and anybody may connect: port scanners do. So
a newcomer has to prove that it is the robot's program. A program of this driver's own says a token that
the driver has put into it, and takes the place of the old connection at once: it was started again before the end
of the last one was noticed. Who says something else is sent away. Who says nothing, as the vendor's program does, waits
until its endpoint's owner admits it, and never replaces a program that has proved itself.
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

LONGEST_REAL_TIME_S: Final = 0.2  # the client library's: an arm in motion is not left alone for longer
SETPOINT_TIMEOUT_S: Final = 0.02  # its default for a setpoint
KEEP_ALIVE_TIMEOUT_S: Final = 1.0  # its default for a keep-alive
_STOP_MS: Final = 100
_LONGEST_MS: Final = 2**31 - 1


@lru_cache(maxsize=64)  # asked for with every setpoint
def read_timeout_ms(mode: ControlMode, timeout_s: float, period_s: float) -> int:
    """The timeout [ms] that is sent for `timeout_s` in this mode.

    At least one control period `period_s` [s]; in real-time modes at most 0.2 s. 0 waits for
    ever, except in real-time modes, where it is one period. Raises LocalProtocolError for a
    negative timeout.
    """
    if not timeout_s >= 0.0:
        raise LocalProtocolError(f"a timeout is 0 s or more, not {timeout_s}")
    if mode is ControlMode.STOPPED:
        return _STOP_MS
    if timeout_s == 0.0 and not mode.real_time:
        return 0
    longest = LONGEST_REAL_TIME_S if mode.real_time else _LONGEST_MS / 1000.0
    return max(1, round(1000.0 * min(max(timeout_s, period_s), longest)))


_MOST_UNSENT: Final = 8192  # bytes of a trajectory, beyond what the system buffers; guess
_HINT: Final = "start the program on the robot and wait for it"
_MOST_WAITING: Final = 8  # connections that have not proved themselves, on each port; guess
_PATIENCE_S: Final = 10.0  # for one that does not; guess
_ACCEPTING: Final = 3  # rounds of the event loop until a connection that was accepted is made: a task, and a call

_logger = logging.getLogger(__name__)


class Peer(asyncio.Protocol):
    """A connection of a robot, or of somebody who may be one."""

    address: str
    """Where it comes from."""
    proven: bool
    """It has said the token."""
    arrived_s: float
    """When it came, by the loop's clock [s]."""
    unread: bytes | None
    """The beginning of its greeting; None once it has greeted, or will not."""

    def __init__(self, endpoint: "Endpoint") -> None:
        self._endpoint = endpoint
        self._may_write = asyncio.Event()
        self._may_write.set()
        self._loop = asyncio.get_running_loop()
        self.gone = self._loop.create_future()
        self.address = ""
        self.proven = False
        self.arrived_s = self._loop.time()
        self.unread = b""
        self.transport: asyncio.Transport
        self._socket: socket.socket

    def abort(self) -> None:
        """End the connection at once, without waiting for what is not sent yet."""
        self.transport.abort()

    def write(self, data: bytes) -> None:
        """Send now, from any thread and past the event loop, which may be busy. A robot that does not read is gone."""
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:  # the connection has ended, of which the loop will hear
            return
        if sent < len(data):
            _logger.error("%s does not read what it is sent on port %d", self.address, self._endpoint.port)
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self.abort)

    async def write_all(self, data: bytes) -> None:
        """Send as fast as the robot reads."""
        self.transport.write(data)
        await self._may_write.wait()

    # asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)  # uvloop's is of no such class
        self.address = str(transport.get_extra_info("peername")[0])
        self._socket = socket.socket(fileno=os.dup(transport.get_extra_info("socket").fileno()))
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transport.set_write_buffer_limits(_MOST_UNSENT)
        self._endpoint._arrived(self)

    def data_received(self, data: bytes) -> None:
        self._endpoint._received(self, data)

    def pause_writing(self) -> None:
        self._may_write.clear()

    def resume_writing(self) -> None:
        self._may_write.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._may_write.set()
        self._socket.close()
        self.gone.set_result(None)
        self._endpoint._left(self)


async def _let_in(server: asyncio.Server) -> None:
    """Accept nobody more, and let in who was accepted just now: closed before, asyncio would leave them open."""
    loop = asyncio.get_running_loop()
    with suppress(NotImplementedError, RuntimeError):  # other event loops accept in other ways
        for listening in server.sockets:
            loop.remove_reader(listening.fileno())
    for _ in range(_ACCEPTING):
        await asyncio.sleep(0)


class Endpoint:
    """A server for one robot; use it with ``async with``."""

    port: int
    """0 takes a free one, which it then is."""
    host: str
    """The own address to listen on, all of them when empty."""
    token: str
    """What the robot's program says first. Without one, who comes first is the robot until it leaves, then the next."""
    waiting: list[Peer]
    """Who has connected and not proved itself, oldest first."""
    listeners: list[Callable[[bool], None]]
    """Called with True and False as the robot comes and goes."""

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
        """Listen. Raises OSError when the port is taken."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: Peer(self), self.host or None, self.port, reuse_address=True)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Stop listening and end every connection; closing twice does no harm."""
        if self._server is not None:
            server, self._server = self._server, None
            await _let_in(server)
            server.close()
        while self._peers:
            peer = next(iter(self._peers))
            peer.transport.close() if not peer.transport.get_write_buffer_size() else peer.abort()
            await peer.gone

    @property
    def connected(self) -> bool:
        """True while a robot is there."""
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
        """Wait for a robot. Raises ProgramNotRunningError when none comes."""
        try:
            await self._wait_until(True, timeout_s)
        except TimeoutError:
            raise ProgramNotRunningError(self.port, f"none came within {timeout_s:g} s; {_HINT}") from None

    async def wait_disconnected(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait until no robot is there. Raises ProgramStaysError."""
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

    def _arrived(self, peer: Peer) -> None:
        self._peers.add(peer)
        robot = self._peer
        if robot is None and not self.token:
            self.admit(peer)
        elif robot is not None and robot.address != peer.address and (robot.proven or not self.token):
            self._send_away(peer, f"this port serves {robot.address}")
        else:
            if len(self.waiting) >= _MOST_WAITING:  # the oldest goes: a program of ours proves itself at once
                self._send_away(self.waiting[0], f"{_MOST_WAITING} others wait here")
            self.waiting.append(peer)
            asyncio.get_running_loop().call_later(_PATIENCE_S, self._lose_patience, peer)

    def admit(self, peer: Peer) -> None:
        """From here on this connection is the robot's; the last one is ended."""
        if peer in self.waiting:
            self.waiting.remove(peer)
        before, self._peer = self._peer, None
        if before is not None:
            before.abort()
            self._lost(before)
        self._peer = peer
        self._found(peer)

    def _received(self, peer: Peer, data: bytes) -> None:
        if peer.unread is not None:
            data = self._greeted(peer, peer.unread + data)
        if data and peer is self._peer:
            self.data_received(data)

    def _greeted(self, peer: Peer, data: bytes) -> bytes:
        """Look for a greeting at the beginning of what somebody says; what follows it."""
        greeting = split_greeting(data)
        if greeting is None:
            peer.unread = data
            return b""
        peer.unread = None
        token, rest = greeting
        if token is None and peer is not self._peer:
            self._send_away(peer, f"no control program says {data[:40]!r}")
        elif token and token == self.token:
            peer.proven = True
            if peer is not self._peer:
                self.admit(peer)
        return rest

    def _send_away(self, peer: Peer, why: str) -> None:
        _logger.warning("%s is sent away from port %d: %s", peer.address, self.port, why)
        if peer in self.waiting:
            self.waiting.remove(peer)
        peer.abort()

    def _lose_patience(self, peer: Peer) -> None:
        if peer in self.waiting:
            self._send_away(peer, f"it has not shown for {_PATIENCE_S:g} s that it is the robot's program")

    def _left(self, peer: Peer) -> None:
        self._peers.discard(peer)
        if peer in self.waiting:
            self.waiting.remove(peer)
        if peer is self._peer:
            self._peer = None
            self._lost(peer)
            if self.waiting and not self.token:
                self.admit(self.waiting[0])

    # for kinds of endpoints

    def data_received(self, data: bytes) -> None:
        """Bytes from the robot; of this kind none are expected."""
        _logger.info("the robot says %r on port %d, which means nothing", data[:80], self.port)

    def _found(self, peer: Peer) -> None:
        self._tell(True)

    def _lost(self, peer: Peer) -> None:
        self._tell(False)

    def _tell(self, connected: bool) -> None:
        tell(self.listeners, connected)


def tell(listeners: Sequence[Callable[..., object]], *news: object) -> None:
    """Call each of them; one that raises is logged and harms nobody else."""
    for listener in tuple(listeners):
        try:
            listener(*news)
        except Exception:
            _logger.exception("a callback failed")


SENDER_PORT: Final = 50002
_LONGEST_REQUEST: Final = 1024  # bytes without a line end (guess)


class ScriptSender(Endpoint):
    """Answers every request with the program; any number of robots may ask at the same time.

    program: gives the text, bare statements between the URCap's anchors. The connection stays open, and the program has
    no end mark: so does the protocol.
    """

    requests: int
    """How many there were."""

    def __init__(self, program: Callable[[], str], port: int = SENDER_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self.requests = 0
        self._program = program
        self._unread: dict[Peer, bytes] = {}

    def _arrived(self, peer: Peer) -> None:
        self._peers.add(peer)
        self._unread[peer] = b""

    def _received(self, peer: Peer, data: bytes) -> None:
        *lines, rest = (self._unread[peer] + data).split(b"\n")
        self._unread[peer] = rest
        for line in lines:
            self._answer(peer, line)
        if len(rest) > _LONGEST_REQUEST:
            _logger.warning("%s sends no request but %d bytes", peer.address, len(rest))
            peer.abort()

    def _answer(self, peer: Peer, line: bytes) -> None:
        if line.rstrip(b"\r") != REQUEST_PROGRAM.rstrip(b"\n"):
            _logger.warning("%s asks for %r; this port only hands out the program", peer.address, line[:80])
            return
        self.requests += 1
        peer.transport.write(to_bytes(self._program()) + b"\n")

    def _left(self, peer: Peer) -> None:
        self._peers.discard(peer)
        self._unread.pop(peer, None)


REVERSE_PORT: Final = 50001


@dataclass(slots=True)
class StreamStatistics:
    """Of setpoints that follow each other in one mode, by this machine's clock."""

    sent: int = 0
    """How many."""
    skipped: int = 0
    """Control periods for which none was sent, beyond one that was a little late."""
    late: int = 0
    """How often the robot had to wait for longer than it may, and stopped the arm."""
    longest_gap_s: float = 0.0
    """Between two of them [s]."""

    def __str__(self) -> str:
        return (
            f"{self.sent} setpoints sent, {self.skipped} control periods without one, "
            f"longest gap {1000.0 * self.longest_gap_s:.0f} ms"
        )


class ReverseEndpoint(Endpoint):
    """Sends what the arm is to do; while a robot is connected here its program runs.

    Every method sends at once, from any thread, and raises ProgramNotRunningError without a robot and
    LocalProtocolError for values that cannot be sent. timeout_s: how long the program waits for the message after this
    one before it stops the arm; see `read_timeout_ms` for its limits.
    """

    period_s: float
    """The robot's control period [s]."""
    mode: ControlMode
    """Of the last message."""
    stream: StreamStatistics
    """Of the setpoints since the last message that was none."""

    def __init__(self, port: int = REVERSE_PORT, host: str = "", period_s: float = Series.E.period_s) -> None:
        super().__init__(port, host)
        self.period_s = period_s
        self.mode = ControlMode.IDLE
        self.stream = StreamStatistics()
        self._lock = threading.RLock()
        self._sent_s = 0.0  # when, by the monotonic clock, and
        self._timeout_s = 0.0  # how long the robot waits after that
        self._was_late = ""  # why the arm was stopped, until who sends setpoints was told

    def setpoint(self, mode: ControlMode, values: Sequence[float], timeout_s: float = SETPOINT_TIMEOUT_S) -> None:
        """One setpoint (6,) of a real-time mode, in the units `ReverseMessage.setpoint` gives.

        Raises LateSetpointError, once, when the robot has waited for it too long: the arm was stopped, the program
        goes on, and this setpoint was not sent.
        """
        message = ReverseMessage.setpoint(mode, values, self._timeout_ms(mode, timeout_s))
        with self._lock:
            peer = self.peer
            now = time.monotonic()
            if self.mode.real_time and self._sent_s:
                self._note_gap(now - self._sent_s)
            if self._was_late:
                why, self._was_late = self._was_late, ""
                raise LateSetpointError("a stream of setpoints", why)
            if not self.mode.real_time:
                self.stream = StreamStatistics()
            self.stream.sent += 1
            self._write(peer, message, now)

    def keep_alive(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Nothing to do: an arm in motion is brought to rest."""
        with self._lock:
            self._rest(timeout_s)
            self._was_late = ""

    def _rest(self, timeout_s: float) -> None:
        self._send(ReverseMessage.keep_alive(self._timeout_ms(ControlMode.IDLE, timeout_s)))

    def trajectory(self, action: TrajectoryAction, points: int = 0, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end a trajectory of so many points."""
        self._send(ReverseMessage.trajectory(action, points, self._timeout_ms(ControlMode.FORWARD, timeout_s)))

    def freedrive(self, action: FreedriveAction, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end freedrive."""
        self._send(ReverseMessage.freedrive(action, self._timeout_ms(ControlMode.FREEDRIVE, timeout_s)))

    def stop(self) -> None:
        """End the control program."""
        self._send(ReverseMessage.stop())

    def continue_mode(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """The keep-alive of the present mode. Setpoints have none: an arm whose setpoints cease is brought to rest."""
        with self._lock:
            if self.mode is ControlMode.FORWARD:
                self.trajectory(TrajectoryAction.NOOP, 0, timeout_s)
            elif self.mode is ControlMode.FREEDRIVE:
                self.freedrive(FreedriveAction.NOOP, timeout_s)
            elif self.mode is ControlMode.IDLE:
                self._rest(timeout_s)

    def end_late_stream(self) -> None:
        """Let the program go on when setpoints have ceased for longer than the robot waits; the arm is at rest then."""
        with self._lock:
            if self.mode.real_time and self.quiet_s > self._timeout_s:
                self._note_gap(self.quiet_s)

    def take_late(self) -> str:
        """Why the arm was stopped, if it was for want of setpoints and nobody has been told yet."""
        why, self._was_late = self._was_late, ""
        return why

    def note_late(self, why: str) -> None:
        """The robot says that it had to wait for too long."""
        with self._lock:
            if self.connected and self.mode.real_time:
                self._be_late(why)

    @property
    def quiet_s(self) -> float:
        """How long nothing has been sent to the robot that is there, or was."""
        return time.monotonic() - self._sent_s if self._sent_s else 0.0

    def _note_gap(self, gap_s: float) -> None:
        self.stream.longest_gap_s = max(self.stream.longest_gap_s, gap_s)
        self.stream.skipped += max(0, round(gap_s / self.period_s) - 1)
        if gap_s > self._timeout_s:
            self._be_late(
                f"this machine sent no setpoint for {1000.0 * gap_s:.0f} ms, and the robot waits "
                f"{1000.0 * self._timeout_s:.0f} ms"
            )

    def _be_late(self, why: str) -> None:
        self.stream.late += 1
        self._was_late = why
        _logger.warning("the arm was stopped: %s (%s)", why, self.stream)
        self._rest(KEEP_ALIVE_TIMEOUT_S)  # which the program waits for: what follows is a new motion

    def _timeout_ms(self, mode: ControlMode, timeout_s: float) -> int:
        return read_timeout_ms(mode, timeout_s, self.period_s)

    def _send(self, message: ReverseMessage) -> None:
        with self._lock:
            self._write(self.peer, message, time.monotonic())

    def _write(self, peer: Peer, message: ReverseMessage, now: float) -> None:
        peer.write(message.encode())
        self.mode = message.mode
        self._sent_s, self._timeout_s = now, message.read_timeout_ms / 1000.0

    def _tell(self, connected: bool) -> None:
        with self._lock:
            self.mode = ControlMode.IDLE
            self._was_late = ""
            if connected:
                self._sent_s = 0.0
        super()._tell(connected)
