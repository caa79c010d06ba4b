"""The server of the software that the gripper's manufacturer installs on the controller (TCP 63352)."""

from emulator.commands.requests import GripperCall
from emulator.devices.gripper_requests import GripperSession
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot
from urproto.robotiq import Request, RequestDecoder


class GripperServer(PortServer):
    """Requests in, values and acknowledgements out."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("gripper", controller)

    def connect(self) -> Connection:
        return _GripperConnection(self)

    def publish(self, snapshot: Snapshot) -> None:
        """Call at the end of a control period: a request without a line end is then taken as complete."""
        for connection in self.connections:
            if isinstance(connection, _GripperConnection):
                connection.flush()


class _GripperConnection(Connection):
    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._decoder = RequestDecoder()
        self._session = GripperSession()
        self._queue = CommandQueue(server.controller, self.read_on, client=self)

    def received(self, data: bytes) -> None:
        self._call(self._decoder.feed(data))

    def flush(self) -> None:
        self._call(self._decoder.flush())

    def at_end(self) -> bool:
        self.flush()
        return not self._queue.idle

    def _call(self, requests: list[Request]) -> None:
        hooks = self.server.hooks
        passed = [hooks.message(self, Direction.RECEIVED, request) for request in requests]
        kept = tuple(request for request in passed if request is not None)
        if kept:
            self._queue.put(GripperCall(kept, self._session), self._answer)

    def _answer(self, answer: bytes) -> None:
        self.send_message(answer, bytes)
        if self.ended and self._queue.idle:
            self.close()
