"""Realtime interface (TCP 30003, read-only 30013)."""

from emulator.servers.base import Connection, ControllerDoor, PortServer
from emulator.servers.scripts import ScriptConnection
from emulator.snapshot import Snapshot
from urproto.realtime import realtime_packer

__all__ = ["RealtimeServer"]


class RealtimeServer(PortServer):
    """One packet every control period. Takes scripts unless it is read-only."""

    def __init__(self, name: str, controller: ControllerDoor, *, read_only: bool) -> None:
        super().__init__(name, controller)
        self._read_only = read_only
        self._encode = realtime_packer(controller.version)

    def connect(self) -> Connection:
        return ScriptConnection(self, read_only=self._read_only)

    def publish(self, snapshot: Snapshot) -> None:
        if not self.connections:
            return
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        packet = self._encode(snapshot)
        for connection in tuple(self.connections):
            connection.send_state(packet)
