"""A controller and clients without sockets, for the tests of the servers."""

import asyncio
from collections.abc import Callable
from typing import Any

from emulator.mailbox import Command
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer
from emulator.snapshot import Snapshot
from urproto.facts import Situation
from urproto.versions import PolyscopeVersion

CB3 = PolyscopeVersion(3, 15, 8, 106339)
E_SERIES = PolyscopeVersion(5, 22, 0, 1)


class FakeController:
    """Takes commands and publishes snapshots like the real one, and records the commands."""

    def __init__(
        self, version: PolyscopeVersion = CB3, answer: Callable[[Command], Any] = lambda command: None
    ) -> None:
        self.version = version
        self.situation = Situation(version)
        self.snapshot = Snapshot(step=5125, timestamp=41.0)
        self.commands: list[Command] = []
        self._answer = answer
        self._queue: list[tuple[Command, Callable[[Any], None] | None]] = []
        self._subscribers: list[Callable[[Snapshot], None]] = []

    def post(self, command: Command, reply: Callable[[Any], None] | None = None, client: str = "") -> None:
        self._queue.append((command, reply))

    def subscribe(self, callback: Callable[[Snapshot], None]) -> Callable[[], None]:
        self._subscribers.append(callback)
        return lambda: self._subscribers.remove(callback)

    def tick(self, periods: int = 1, **changes: Any) -> None:
        """Execute the posted commands, then publish a snapshot with these changes."""
        for _ in range(periods):
            queue, self._queue = self._queue, []
            for command, reply in queue:
                self.commands.append(command)
                if reply is not None:
                    reply(self._answer(command))
            snapshot = self.snapshot.successor()
            snapshot.step += 1
            snapshot.timestamp = snapshot.step * self.version.series.period_s
            snapshot.messages = ()
            for name, value in changes.items():
                setattr(snapshot, name, value)
            self.snapshot = snapshot
            for callback in tuple(self._subscribers):
                callback(snapshot)


class MemoryTransport(asyncio.Transport):
    """A transport in memory. While ``stalled``, the client does not read and nothing is delivered."""

    def __init__(self) -> None:
        super().__init__({"peername": ("memory", 0)})
        self.delivered = bytearray()
        self.stalled = False
        self.aborted = False
        self._unsent = bytearray()
        self._closing = False
        self._reading = True
        self.protocol: asyncio.BaseProtocol | None = None

    def write(self, data: bytes) -> None:  # type: ignore[override] # the base allows more kinds of bytes
        assert not self._closing
        (self._unsent if self.stalled else self.delivered).extend(data)

    def unstall(self) -> None:
        self.stalled = False
        self.delivered += self._unsent
        self._unsent.clear()

    def get_write_buffer_size(self) -> int:
        return len(self._unsent)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def is_closing(self) -> bool:
        return self._closing

    def is_reading(self) -> bool:
        return self._reading

    def pause_reading(self) -> None:
        self._reading = False

    def resume_reading(self) -> None:
        self._reading = True

    def write_eof(self) -> None:
        """This client closes its side as soon as the other side has closed."""
        self.close()

    def close(self) -> None:
        if not self._closing:
            self._closing = True
            assert self.protocol is not None
            self.protocol.connection_lost(None)

    def abort(self) -> None:
        self.aborted = True
        self.close()


class MemoryClient:
    """One client of a server, without a network."""

    def __init__(self, server: PortServer) -> None:
        if server._unsubscribe is None:
            server._unsubscribe = server.controller.subscribe(server.publish)
        self.connection: Connection = server.connect()
        self.transport = MemoryTransport()
        self.transport.protocol = self.connection
        self.connection.connection_made(self.transport)

    @property
    def connected(self) -> bool:
        return not self.transport.is_closing()

    def feed(self, data: bytes, chunk: int = 4096) -> None:
        """Send bytes to the server in pieces, as long as it listens."""
        for start in range(0, len(data), chunk):
            if not self.connected:
                return
            piece = data[start : start + chunk]
            self.connection.get_buffer(-1)[: len(piece)] = piece
            self.connection.buffer_updated(len(piece))

    def take(self) -> bytes:
        """Bytes delivered by the server since the last call."""
        data = bytes(self.transport.delivered)
        self.transport.delivered.clear()
        return data

    def end(self) -> None:
        """Half-close the connection."""
        if self.connected and not self.connection.eof_received():
            self.transport.close()

    def vanish(self) -> None:
        if self.connected:
            self.transport.close()
