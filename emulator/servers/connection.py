"""The connection to one client of a port, in both directions.

A client that reads too slowly does not affect others. State packages, which the next one supersedes, are skipped while
earlier bytes still wait for the client. Everything else must be delivered; if too much of it waits, the connection is
closed.
"""

import asyncio
import logging
import os
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from emulator.logs import ReportedErrors
from emulator.servers.admission import Reason, RejectedClients
from emulator.servers.hooks import BytesHook, Direction, Hooks
from emulator.servers.read_budget import ReadBudget
from emulator.servers.web import WRONG_PORT, Opening
from urproto.compat_asyncio import pause_reading
from urproto.errors import RemoteProtocolError

SEND_BUFFER: Final = 256 * 1024
"""Size of the system's buffer for a client that does not read, which limits the age of what it reads later (guess)."""

_READ_BYTES: Final = 1024  # at a time: parsing them takes some ms even if each byte is a message (guess)
_MAX_REST: Final = 64 * 1024  # bytes of a client that has left: its last program (guess)
_MAX_UNDELIVERED: Final = 1024 * 1024  # bytes that must be delivered and are not read (guess)
_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)  # Linux; in force until the next delayed one
_CLOSED: Final = -1  # as a file descriptor
_LINGER_S: Final = 1.0  # for a client that keeps sending after its final answer (guess)
_RESET: Final = struct.pack("ii", 1, 0)  # SO_LINGER: on, no time: closing sends RST

_logger = logging.getLogger(__name__)

Message = TypeVar("Message")


class Owner(Protocol):
    """The part of a port that its connections use."""

    name: str
    hooks: "Hooks[Connection]"
    turned_away: RejectedClients
    read_budget: ReadBudget
    reported: ReportedErrors
    connections: "list[Connection]"

    @property
    def port(self) -> int: ...

    @property
    def robot_time_s(self) -> float: ...

    def client_connected(self, connection: "Connection") -> None: ...

    def client_disconnected(self, connection: "Connection") -> None: ...


@dataclass(slots=True)
class _Held:
    """Bytes that hooks hold back in one direction. then: called when all have passed."""

    size: int = 0
    then: Callable[[], None] | None = None


class Connection(asyncio.BufferedProtocol):
    """One client of one port. This base class ignores what the client sends.

    most_undelivered: bytes that may wait for a client that does not read. for_browsers: whether web browsers may use
    the port; on others they are disconnected. patient: whether first bytes may be held back until it is known who sent
    them. outlives_client: whether what a client sent is read even if it has reset the connection. ended: whether the
    client has closed its side.
    """

    most_undelivered = _MAX_UNDELIVERED
    for_browsers = False
    patient = True
    outlives_client = True

    def __init__(self, server: Owner) -> None:
        self.server = server
        self._transport: asyncio.Transport  # from the time when the client is connected
        self._read_buffer = bytearray(_READ_BYTES)
        self._unread = b""  # what was received and waits for the read budget
        self.peer = "?"
        self._sent, self._received = _Held(), _Held()
        self._skipped = 0  # states that were skipped since the client last read everything
        self._wants_reading = True
        self._stalls: set[object] = set()  # reasons for not reading from it
        self.ended = False
        self._lingering: asyncio.TimerHandle | None = None  # while data from the client is discarded
        self._opening = None if self.for_browsers else Opening(patient=self.patient)

    # for subclasses

    def opened(self) -> None:
        """Called when the client is connected, for example to send a greeting."""

    def received(self, data: bytes) -> None:
        """Called with bytes from the client, split anywhere. RemoteProtocolError closes the connection."""

    def at_end(self) -> bool:
        """Called when the client has closed its side; True keeps the connection open for answers."""
        return False

    def lost(self) -> None:
        """Called when the connection is closed."""

    def send(self, data: bytes) -> None:
        """Send bytes that must be delivered; a client that lets too many wait is disconnected."""
        if self._transport.is_closing():
            return
        if self.server.hooks.on_bytes:
            data = self.server.hooks.bytes(self, Direction.SENT, data)
        self._write(data)

    def send_message(self, message: Message, encode: Callable[[Message], bytes]) -> None:
        """Send a message, unless a hook drops it."""
        passed = self.server.hooks.message(self, Direction.SENT, message)
        if passed is not None:
            self.send(encode(passed))

    def send_state(self, data: bytes) -> None:
        """Send bytes that the next ones supersede; they are skipped while earlier bytes still wait."""
        if not self.takes_state:
            self.skip_state()
            return
        if self._skipped:
            self._trace("has caught up: %d states were skipped", self._skipped)
            self._skipped = 0
        self.send(data)

    def skip_state(self) -> None:
        """Skip a state, because the client has not read what was sent before."""
        if not self._skipped and self.is_open:
            self._trace("lags: states are skipped until it reads the %d bytes that wait for it", self.undelivered)
        self._skipped += 1

    @property
    def takes_state(self) -> bool:
        """Whether nothing that was sent before still waits."""
        return self._sent.size < SEND_BUFFER and not self._transport.get_write_buffer_size()

    def close(self) -> None:
        """Deliver what was sent, then close the connection."""
        if self._sent.size:
            self._sent.then = self._transport.close
        else:
            self._transport.close()

    def hang_up(self) -> None:
        """Deliver what was sent, and close the connection when the client closes its side, or after 1 s.

        A connection that is closed while bytes from the client are unread is reset, and the client may lose the answer.
        """
        if self._sent.size:
            self.close()
        elif self.is_open and self._lingering is None:
            self._lingering = asyncio.get_running_loop().call_later(_LINGER_S, self.close_now)
            self._transport.write_eof()

    def close_now(self) -> None:
        """Close the connection, without waiting for a client that does not read."""
        if self.undelivered:
            self.abort()
        else:
            self.close()

    def abort(self) -> None:
        """Close the connection and drop what waits for the client here; what the system has is still delivered."""
        self._transport.abort()

    def acknowledge(self) -> None:
        """Acknowledge what has been received immediately, where the system permits it.

        The system of a client that does not set TCP_NODELAY holds back its next bytes until then. Acknowledged by the
        next package only, they would arrive just too late for their control period, and so would all that follow.
        """
        if _QUICK_ACK is not None:
            self._set_option(socket.IPPROTO_TCP, _QUICK_ACK, 1)

    def read_on(self, going: bool) -> None:
        """Read from the client, or leave its bytes in the system's buffer for now."""
        self._wants_reading = going
        self._read()

    # for hooks and faults

    @property
    def is_open(self) -> bool:
        """False once the connection is closing."""
        return not self._transport.is_closing()

    @property
    def unsent(self) -> int:
        """Number of bytes beyond the system's buffer, because the client does not read."""
        return self._transport.get_write_buffer_size()

    @property
    def undelivered(self) -> int:
        """Number of unsent bytes, and of those that hooks hold back."""
        return self.unsent + self._sent.size

    def stall(self, reason: object) -> None:
        """Do not read from the client until ``unstall`` for the same reason."""
        self._stalls.add(reason)
        self._read()

    def unstall(self, reason: object) -> None:
        """Read from the client again, unless another reason remains."""
        self._stalls.discard(reason)
        self._read()
        self.serve()

    def reset(self) -> None:
        """Abort the connection, so that the client receives a reset (RST) instead of a regular end (FIN)."""
        self._set_option(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self.abort()

    def set_send_buffer(self, size: int | None) -> None:
        """Set the size of the system's send buffer; None for the usual size."""
        self._set_option(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER if size is None else size)

    def keep(self, direction: Direction, count: int) -> None:
        """Register that a hook holds back this number of bytes, which it will pass on."""
        self._held(direction).size += count

    def pass_on(self, direction: Direction, data: bytes, after: "BytesHook[Connection]") -> None:
        """Pass on bytes that a hook held back."""
        held = self._held(direction)
        held.size -= len(data)
        if not self.is_open:
            return
        passed = self.server.hooks.bytes(self, direction, data, after)
        if direction is Direction.RECEIVED:
            self._receive(passed)
        else:
            self._write(passed)
        if held.then is not None and not held.size:
            held.then()

    # both sides

    def _trace(self, text: str, *values: object) -> None:
        """Log an event of the client, with robot time, for ``--log-level debug``."""
        if _logger.isEnabledFor(logging.DEBUG):
            server = self.server
            _logger.debug("%.3f s: %s: %s " + text, server.robot_time_s, server.name, self.peer, *values)

    def _held(self, direction: Direction) -> _Held:
        return self._sent if direction is Direction.SENT else self._received

    def _write(self, data: bytes) -> None:
        transport = self._transport
        if transport.get_write_buffer_size() + self._sent.size + len(data) > self.most_undelivered:
            text = "does not read what it is sent and is disconnected"
            self.server.turned_away.count(Reason.NOT_READING, self.peer, text)
            transport.abort()
        elif data:
            transport.write(data)

    def _receive(self, data: bytes) -> None:
        if self._lingering is not None:
            return
        try:
            if self._opening is not None:
                data = self._judge(self._opening, data)
            if data:
                self.received(data)
        except RemoteProtocolError as error:
            self.server.turned_away.count(Reason.INVALID, self.peer, f"is disconnected: {error}")
            self.close()
        except MemoryError:
            text = "is disconnected: no memory for the data it sent"
            self.server.turned_away.count(Reason.NO_MEMORY, self.peer, text)
            self.abort()

    def _judge(self, opening: Opening, data: bytes) -> bytes:
        """The bytes to read of a new connection; that of a web browser is aborted."""
        passed = opening.feed(data)
        if isinstance(opening.verdict, Reason):
            self.server.turned_away.count(opening.verdict, self.peer, WRONG_PORT[opening.verdict])
            self.abort()
        elif not opening.verdict:
            self._opening = None
        return passed

    def _at_end(self) -> bool:
        """Read held-back first bytes, which were not a browser's request after all; then whether to stay open."""
        self.ended = True
        opening, self._opening = self._opening, None
        if opening is not None:
            self._receive(opening.rest())
        return self.is_open and self.at_end()

    def _end(self) -> None:
        if not self._at_end():
            self.close()

    @property
    def _reads(self) -> bool:
        return self._wants_reading and not self._stalls

    def _read(self) -> None:
        transport = self._transport
        if transport.is_closing() or transport.is_reading() is self._reads:
            return
        if self._reads:
            transport.resume_reading()
        else:
            pause_reading(transport)

    def _set_option(self, level: int, option: int, value: int | bytes) -> None:
        own = self._transport.get_extra_info("socket")
        if own is not None and own.fileno() != _CLOSED:
            own.setsockopt(level, option, value)

    # asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.peer = _peer_name(transport)
        transport.set_write_buffer_limits(high=self.most_undelivered)
        if not self.server.hooks.admits(self):
            transport.abort()
            return
        self.server.client_connected(self)
        self._trace("connected")
        self.opened()

    def get_buffer(self, sizehint: int) -> bytearray:
        return self._read_buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._unread = bytes(self._read_buffer[:nbytes])
        self.serve()

    def serve(self) -> None:
        """Do the work that the client causes, unless it is stalled; the read budget stalls it if none is left."""
        budget = self.server.read_budget
        if self.has_work and self.is_open and not self._stalls and budget.admits(self):
            began_s = time.thread_time()
            self.work()
            budget.spent(self, time.thread_time() - began_s)

    @property
    def has_work(self) -> bool:
        """Whether something that was received waits for ``work``."""
        return bool(self._unread)

    def work(self) -> None:
        """Read what was received."""
        data, self._unread = self._unread, b""
        self._arrived(data)

    def _arrived(self, data: bytes) -> None:
        if self.server.hooks.on_bytes:
            data = self.server.hooks.bytes(self, Direction.RECEIVED, data)
        self._receive(data)

    def eof_received(self) -> bool:
        if self._lingering is not None:
            return False
        if not self._received.size:
            return self._at_end()
        self._received.then = self._end
        return True

    def _read_rest(self) -> None:
        """Read what the client sent before it reset the connection: asyncio drops it if a write sees the reset first.

        Clients that close the connection with unread states reset it, right after their last command.
        """
        own = self._transport.get_extra_info("socket")
        if own is None or not self._reads or not self.outlives_client:
            return
        began_s = time.thread_time()
        with suppress(OSError):
            for _ in range(_MAX_REST // _READ_BYTES):
                if not self._reads or not (data := os.read(own.fileno(), _READ_BYTES)):
                    break
                self._arrived(data)
        self.server.read_budget.spent(self, time.thread_time() - began_s)

    def connection_lost(self, exc: Exception | None) -> None:
        connected = self in self.server.connections
        if exc is not None and connected:
            self._read_rest()
        if self._lingering is not None:
            self._lingering.cancel()
        self.server.client_disconnected(self)
        if connected:
            self._trace("disconnected%s", f": {exc}" if exc else "")
            self.lost()


def _peer_name(transport: asyncio.BaseTransport) -> str:
    address = transport.get_extra_info("peername")
    return f"{address[0]}:{address[1]}" if address else "a client"
