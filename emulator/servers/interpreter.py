"""Interpreter mode (TCP 30020): lines of statements in, an answer for each.

The port is open all the time; without a running program every line is discarded. Lines go to the
controller at once, not one after the other, because commands such as ``abort`` must not wait for
the answers of statements before them.
"""

import logging

from emulator.commands.requests import InterpreterLine
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from urproto.interpreter import Reason, StatementDecoder, TooLong, discard, encode_answer

_AT_ONCE = 64  # lines of one connection in a control period (guess)

_logger = logging.getLogger(__name__)


class InterpreterServer(PortServer):
    """What any client sends goes into one queue; the answers go to who sent it."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("interpreter", controller)

    def connect(self) -> Connection:
        return _InterpreterConnection(self)


class _InterpreterConnection(Connection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = StatementDecoder()
        self._queue = CommandQueue(server.controller, self.read_on, _AT_ONCE)
        self._unanswered = 0
        self._ended = False

    def received(self, data: bytes) -> None:
        for line in self._decoder.feed(data):
            if isinstance(line, TooLong):
                self._send(discard(Reason.TOO_LONG, line.start))
                continue
            passed = self.server.hooks.message(self, Direction.RECEIVED, line)
            if passed is not None:
                self._unanswered += 1
                self._queue.put(InterpreterLine(passed, self._answer))

    def at_end(self) -> bool:
        """Statements need a line end (Script Manual); those that have one are answered before the connection ends."""
        if self._decoder.rest:
            _logger.warning("%s: a line of %s has no end and is ignored", self.server.name, self.peer)
        self._ended = True
        return self._unanswered > 0

    def _answer(self, text: str) -> None:
        self._unanswered -= 1
        self._send(text)
        if self._ended and not self._unanswered:
            self.close()

    def _send(self, text: str) -> None:
        passed = self.server.hooks.message(self, Direction.SENT, text)
        if passed is not None:
            self.send(encode_answer(passed))
