"""What clients of the script ports (30001, 30002, 30003) send: programs, statements, text commands."""

from urscript.splitter import ScriptSplitter, Unit

from emulator.commands import ScriptUnit
from emulator.servers.base import CommandQueue, Connection, Direction, PortServer

__all__ = ["ScriptConnection"]


class ScriptConnection(Connection):
    """Hands over one unit per control period, so that what a unit did is done when the next begins."""

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._splitter = ScriptSplitter()
        self._queue = CommandQueue(server.controller, self.read_on)

    def received(self, data: bytes) -> None:
        self._hand_over(self._splitter.feed(data))

    def at_end(self) -> bool:
        """A program whose last line end is missing still counts when the client closes right after it."""
        self._hand_over(self._splitter.flush())
        return False

    def _hand_over(self, units: list[Unit]) -> None:
        for unit in units:
            passed = self.server.hooks.message(self, Direction.RECEIVED, unit)
            if passed is not None:
                self._queue.put(ScriptUnit(passed.text, passed.kind))
