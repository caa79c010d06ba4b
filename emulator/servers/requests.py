"""Ports that answer requests: dashboard (TCP 29999), interpreter mode (30020), Modbus (502), gripper (63352).

The port of interpreter mode is always open; without a running program every line is discarded. A line is passed to the
controller without waiting for the answers to the lines before it, because commands such as ``abort`` must not wait for
the statements that they are to end.
"""

import logging
from functools import partial
from typing import Final

from emulator.commands.requests import DashboardLine, GripperCall, InterpreterLine, ModbusCall
from emulator.devices.gripper_requests import GripperSession
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot
from urproto import dashboard
from urproto.interpreter import Reason, StatementDecoder, TooLong, discard, encode_answer
from urproto.modbus import Frame, FrameDecoder, encode_frame
from urproto.robotiq import Request, RequestDecoder

_LAST_LINES: Final = 8  # of a client that has left without reading the answers: they are carried out (guess)
_LINES_PER_PERIOD: Final = 64  # of one connection in a control period (guess)
_REQUESTS_PER_PERIOD: Final = 16  # of one connection (guess); a client may send several without waiting for the answers

_logger = logging.getLogger(__name__)


class _AnsweringConnection(Connection):
    """Stays open until all requests are answered, also when the client has closed its side."""

    def __init__(self, server: PortServer, requests_per_period: int = 1) -> None:
        super().__init__(server)
        self._queue = CommandQueue(server.controller, self.read_on, requests_per_period, client=self)

    def at_end(self) -> bool:
        return not self._queue.idle

    def _answered(self) -> None:
        if self.ended and self._queue.idle:
            self.close()


class DashboardServer(PortServer):
    """Answers each line with one line; a line waits until the previous one of its client is answered."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("dashboard", controller)

    def connect(self) -> Connection:
        return _DashboardConnection(self)


class _DashboardConnection(_AnsweringConnection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = dashboard.LineDecoder()
        # until the connection is closed: the text of the refusal asks to reconnect
        self._restricted = server.controller.snapshot.local_control

    def opened(self) -> None:
        self.send_message(dashboard.GREETING, dashboard.encode_line)

    def received(self, data: bytes) -> None:
        for line in self._decoder.feed(data):
            passed = self.server.hooks.message(self, Direction.RECEIVED, line)
            if passed is not None:
                self._queue.put(DashboardLine(passed, self._restricted), self._answer)
        if self._decoder.error is not None:
            raise self._decoder.error

    def lost(self) -> None:
        self._queue.keep(_LAST_LINES)

    def _answer(self, reply: str | None) -> None:
        if reply is not None:
            self.send_message(reply, dashboard.encode_line)
        if reply == dashboard.DISCONNECTED:
            self._queue.clear()
            self.close()
        else:
            self._answered()


class ModbusServer(PortServer):
    """Answers each request in the next control period. The robot answers to every unit number."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("modbus", controller)

    def connect(self) -> Connection:
        return _ModbusConnection(self, _REQUESTS_PER_PERIOD)


class _ModbusConnection(_AnsweringConnection):
    def __init__(self, server: PortServer, requests_per_period: int) -> None:
        super().__init__(server, requests_per_period)
        self._decoder = FrameDecoder()

    def received(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            passed = self.server.hooks.message(self, Direction.RECEIVED, frame)
            if passed is not None:
                self._queue.put(ModbusCall(passed.pdu), partial(self._answer, passed))
        if self._decoder.error is not None:
            raise self._decoder.error

    def _answer(self, request: Frame, pdu: bytes) -> None:
        self.send_message(Frame(request.transaction, request.unit, pdu), encode_frame)
        self._answered()


class GripperServer(PortServer):
    """The software that the gripper's manufacturer installs on the controller: values and acknowledgements out."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("gripper", controller)

    def connect(self) -> Connection:
        return _GripperConnection(self)

    def publish(self, snapshot: Snapshot) -> None:
        """Call at the end of a control period: a request without a line end is then taken as complete."""
        for connection in self.connections:
            if isinstance(connection, _GripperConnection):
                connection.flush()


class _GripperConnection(_AnsweringConnection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = RequestDecoder()
        self._session = GripperSession()

    def received(self, data: bytes) -> None:
        self._call(self._decoder.feed(data))

    def flush(self) -> None:
        self._call(self._decoder.flush())

    def at_end(self) -> bool:
        self.flush()
        return super().at_end()

    def _call(self, requests: list[Request]) -> None:
        hooks = self.server.hooks
        passed = [hooks.message(self, Direction.RECEIVED, request) for request in requests]
        kept = tuple(request for request in passed if request is not None)
        if kept:
            self._queue.put(GripperCall(kept, self._session), self._answer)

    def _answer(self, answer: bytes) -> None:
        self.send_message(answer, bytes)
        self._answered()


class InterpreterServer(PortServer):
    """Puts the lines of all clients into one queue; an answer goes to the client that sent the line."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("interpreter", controller)

    def connect(self) -> Connection:
        return _InterpreterConnection(self, _LINES_PER_PERIOD)


class _InterpreterConnection(_AnsweringConnection):
    def __init__(self, server: PortServer, requests_per_period: int) -> None:
        super().__init__(server, requests_per_period)
        self._decoder = StatementDecoder()
        self._unanswered = 0  # lines: their commands are answered long before

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
