"""RTDE server (TCP 30004).

A client that does not read what it started is disconnected, as by a controller (issue 6 of the RTDE Python client:
after 11 s without reading, some old packages, then the end of the connection).
"""

import logging
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from emulator.commands.requests import RTDEInputs
from emulator.mailbox import Command
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.servers.rtde_session import Packer, RTDEHost, RTDESession, SessionState
from emulator.snapshot import Snapshot
from urproto.facts import rows
from urproto.rtde.codec import Package, Reply, RTDEDecoder, TextMessage

if TYPE_CHECKING:
    from emulator.controller import Controller


_logger = logging.getLogger(__name__)
_UNREAD_S: Final = rows("rtde.unread")[0].number  # of real time, with full buffers
_INPUTS_PER_PERIOD: Final = 16  # input packages of one client in a control period (guess; clients send one)


class RTDEServer(PortServer):
    """Applies input packages in the next control period; encodes each distinct output recipe once per period."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("rtde", controller)
        self.host = RTDEHost(controller.version, lambda: self.controller.snapshot)
        self.started: dict[_RTDEConnection, None] = {}  # clients that get output packages, in order

    def connect(self) -> Connection:
        return _RTDEConnection(self, self.host)

    def publish(self, snapshot: Snapshot) -> None:
        encoded: dict[Packer, bytes] = {}
        failures: list[Exception] = []
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        self.send_scheduler.next_period(snapshot.step)
        for connection in tuple(self.started):
            packer = connection.session.due()
            if packer is None:
                continue
            try:
                if packer not in encoded:
                    encoded[packer] = packer(snapshot)
                self.send_scheduler.send(snapshot.step, connection, encoded[packer])
            except Exception as error:  # the other clients still get their packages
                failures.append(error)
        if failures:
            raise failures[0]


class _RTDEConnection(Connection):
    server: RTDEServer

    def __init__(self, server: RTDEServer, host: RTDEHost) -> None:
        super().__init__(server)
        queue = self._queue = CommandQueue(server.controller, self.read_on, _INPUTS_PER_PERIOD, client=self)
        self.session = RTDESession(
            host, lambda values: queue.put(RTDEInputs(values)), lambda text: queue.put(_Note(text))
        )
        self._decoder = RTDEDecoder()
        self._full_since_s: float | None = None  # the client has not read since

    def send_state(self, data: bytes) -> None:
        super().send_state(data)
        if self.takes_state:
            self._full_since_s = None

    def skip_state(self) -> None:
        super().skip_state()
        now_s = time.monotonic()
        if self._full_since_s is None:
            self._full_since_s = now_s
        elif now_s - self._full_since_s > _UNREAD_S and self.is_open:
            _logger.warning(
                "rtde: %s has not read its data for %.0f s and is disconnected: receive as often as the recipe's "
                "frequency says, or pause",
                self.peer,
                now_s - self._full_since_s,
            )
            self.abort()

    def opened(self) -> None:
        for reply in self.session.greeting():
            self._reply(reply)

    def received(self, data: bytes) -> None:
        self.acknowledge()
        for package in self._decoder.feed(data):
            self._handle(package)
        if self._decoder.error is not None:
            raise self._decoder.error

    def lost(self) -> None:
        self.server.started.pop(self, None)
        self.session.close()

    def _handle(self, package: Package) -> None:
        request = self.session.read(package)
        if isinstance(request, TextMessage):
            self._reply(request)
            return
        passed = self.server.hooks.message(self, Direction.RECEIVED, request)
        if passed is not None:
            for reply in self.session.answer(passed):
                self._reply(reply)
            if self.session.state is SessionState.STARTED and self.is_open:
                self.server.started[self] = None
            else:
                self.server.started.pop(self, None)

    def _reply(self, reply: Reply) -> None:
        self.send_message(reply, lambda passed: passed.encode(self.session.protocol))


@dataclass(frozen=True, slots=True)
class _Note(Command):
    """A text message of a client, for the controller's log."""

    text: str

    def apply(self, controller: "Controller") -> None:
        controller.messages.note(self.text)
