"""Modbus/TCP server (TCP 502)."""

from functools import partial

from emulator.commands.requests import ModbusCall
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from urproto.modbus import Frame, FrameDecoder, encode_frame

_REQUESTS_PER_PERIOD = 16  # of one connection (guess); a client may send several without waiting for the answers


class ModbusServer(PortServer):
    """Answers each request in the next control period. The robot answers to every unit number."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("modbus", controller)

    def connect(self) -> Connection:
        return _ModbusConnection(self)


class _ModbusConnection(Connection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = FrameDecoder()
        self._queue = CommandQueue(server.controller, self.read_on, _REQUESTS_PER_PERIOD, client=self)

    def received(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            passed = self.server.hooks.message(self, Direction.RECEIVED, frame)
            if passed is not None:
                self._queue.put(ModbusCall(passed.pdu), partial(self._answer, passed))
        if self._decoder.error is not None:
            raise self._decoder.error

    def at_end(self) -> bool:
        return not self._queue.idle

    def _answer(self, request: Frame, pdu: bytes) -> None:
        self.send_message(Frame(request.transaction, request.unit, pdu), encode_frame)
        if self.ended and self._queue.idle:
            self.close()
