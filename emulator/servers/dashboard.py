"""Dashboard server (TCP 29999)."""

from typing import Final

from emulator.commands.requests import DashboardLine
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from urproto.dashboard import DISCONNECTED, GREETING, LineDecoder, encode_line

_LAST_LINES: Final = 8  # of a client that has left without reading the answers: they are carried out (guess)


class DashboardServer(PortServer):
    """Answers each line with one line; a line waits until the previous one of its client is answered."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("dashboard", controller)

    def connect(self) -> Connection:
        return _DashboardConnection(self)


class _DashboardConnection(Connection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = LineDecoder()
        self._queue = CommandQueue(server.controller, self.read_on, client=self)
        # until the connection is closed: the text of the refusal asks to reconnect
        self._restricted = server.controller.snapshot.local_control

    def opened(self) -> None:
        self.send_message(GREETING, encode_line)

    def received(self, data: bytes) -> None:
        for line in self._decoder.feed(data):
            passed = self.server.hooks.message(self, Direction.RECEIVED, line)
            if passed is not None:
                self._queue.put(DashboardLine(passed, self._restricted), self._answer)
        if self._decoder.error is not None:
            raise self._decoder.error

    def at_end(self) -> bool:
        return not self._queue.idle

    def lost(self) -> None:
        self._queue.keep(_LAST_LINES)

    def _answer(self, reply: str | None) -> None:
        if reply is not None:
            self.send_message(reply, encode_line)
        if reply == DISCONNECTED:
            self._queue.clear()
            self.close()
        elif self.ended and self._queue.idle:
            self.close()
