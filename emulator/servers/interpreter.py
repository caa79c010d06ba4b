"""Interpreter mode (TCP 30020): lines of statements in, one answer per line out.

The port is always open; without a running program every line is discarded. A line is passed to the controller without
waiting for the answers to the lines before it, because commands such as ``abort`` must not wait for the statements
that they are to end.
"""

import logging

from emulator.commands.requests import InterpreterLine
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from urproto.interpreter import Reason, StatementDecoder, TooLong, discard, encode_answer

_LINES_PER_PERIOD = 64  # of one connection in a control period (guess)

_logger = logging.getLogger(__name__)


class InterpreterServer(PortServer):
    """Puts the lines of all clients into one queue; an answer goes to the client that sent the line."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("interpreter", controller)

    def connect(self) -> Connection:
        return _InterpreterConnection(self)


class _InterpreterConnection(Connection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = StatementDecoder()
        self._queue = CommandQueue(server.controller, self.read_on, _LINES_PER_PERIOD, client=self)
        self._unanswered = 0

    def received(self, data: bytes) -> None:
        for line in self._decoder.feed(data):
            if isinstance(line, TooLong):
                self.send_message(discard(Reason.TOO_LONG, line.start), encode_answer)
                continue
            passed = self.server.hooks.message(self, Direction.RECEIVED, line)
            if passed is not None:
                self._unanswered += 1
                self._queue.put(InterpreterLine(passed, self._answer))

    def at_end(self) -> bool:
        """Statements need a line end (Script Manual); those that have one are answered before the connection closes."""
        if self._decoder.rest:
            _logger.warning("%s: the last line from %s has no line end and is ignored", self.server.name, self.peer)
        return self._unanswered > 0

    def _answer(self, text: str) -> None:
        self._unanswered -= 1
        self.send_message(text, encode_answer)
        if self.ended and not self._unanswered:
            self.close()
