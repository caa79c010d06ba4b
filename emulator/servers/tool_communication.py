"""The tool's serial line as a stream (TCP 54321), as the vendor's RS485 URCap offers it.

That URCap runs ``socat``, one process a connection, and a lock on the line: the first client
has the line to itself, others are connected and wait until it is theirs.
"""

from emulator.commands import ToolBytes
from emulator.servers.base import Connection, ControllerDoor, Direction, PortServer
from emulator.servers.command_queue import CommandQueue
from emulator.snapshot import Snapshot

__all__ = ["ToolCommunicationServer"]


class ToolCommunicationServer(PortServer):
    """Bytes both ways, whatever they mean."""

    def __init__(self, controller: ControllerDoor) -> None:
        super().__init__("tool line", controller)

    def connect(self) -> Connection:
        return _ToolConnection(self)

    def publish(self, snapshot: Snapshot) -> None:
        if snapshot.tool_bytes and self.connections:
            self.connections[0].send(snapshot.tool_bytes)


class _ToolConnection(Connection):
    patient = False  # a device may answer to a single letter

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._queue = CommandQueue(server.controller, self._read_on)

    def opened(self) -> None:
        self._read_on(True)

    def received(self, data: bytes) -> None:
        passed = self.server.hooks.message(self, Direction.RECEIVED, data)
        if passed:
            self._queue.put(ToolBytes(passed))

    def lost(self) -> None:
        if self.server.connections:
            self.server.connections[0].read_on(True)

    def _read_on(self, going: bool) -> None:
        """Only the owner of the line is read."""
        self.read_on(going and self.server.connections[:1] == [self])
