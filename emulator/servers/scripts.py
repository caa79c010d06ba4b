"""What clients of the script ports (30001, 30002, 30003) send: programs, statements, text commands."""

import logging

from emulator.commands import RefusedScript, ScriptUnit
from emulator.servers.base import Connection, Direction, PortServer
from emulator.servers.command_queue import CommandQueue
from urscript.splitter import ScriptSplitter, Unit

__all__ = ["ScriptConnection"]

_logger = logging.getLogger(__name__)


class ScriptConnection(Connection):
    """Hands over one unit per control period, so that what a unit did is done when the next begins.

    A connection that may only read stays so: one of a read-only port, and one that was opened while an
    e-Series arm was in local control (documentation of the official client library: switch, then reconnect).
    """

    def __init__(self, server: PortServer, *, read_only: bool) -> None:
        super().__init__(server)
        self._read_only = read_only or server.controller.snapshot.local_control
        self._splitter = ScriptSplitter()
        self._queue = CommandQueue(server.controller, self._go_on)
        self._ended = False

    def received(self, data: bytes) -> None:
        self._splitter.add(data)
        self._take_units()

    def at_end(self) -> bool:
        """A unit whose last line end is missing counts all the same: clients close right after it (guess)."""
        self._ended = True
        self._splitter.add(b"\n")
        self._take_units()
        return False

    def _go_on(self, going: bool) -> None:
        """The queue is full, or empty again; units that came with those before wait in the splitter."""
        if going:
            self._take_units()
        self.read_on(going and not self._queue.full)

    def _take_units(self) -> None:
        while not self._queue.full:
            unit = self._splitter.next()
            if unit is None and self._ended:
                unit = self._splitter.rest()
            if unit is None:
                return
            self._hand_over(unit)

    def _hand_over(self, unit: Unit) -> None:
        if unit.kind == "error" or not unit.complete:
            problem = "is too long" if unit.kind == "error" else "ends in the middle"
            _logger.warning(
                "%s: what %s sent %s and is ignored: %.60r", self.server.name, self.peer, problem, unit.text
            )
            return
        passed = self.server.hooks.message(self, Direction.RECEIVED, unit)
        if passed is not None:
            refused = self._read_only
            self._queue.put(RefusedScript(passed.text) if refused else ScriptUnit(passed.text, passed.kind))
