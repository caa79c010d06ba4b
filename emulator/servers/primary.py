"""Primary, secondary and realtime client interfaces (TCP 30001 to 30003, read-only 30011 to 30013).

A client of the primary or secondary interface gets the version message immediately, followed by a short message of
an undocumented kind, as captured. No state is sent with it, because some clients take their first read for
one message. After that the client gets ten robot states per second, the first of them full, counted from its connection
and not from a clock of the controller: the last message of 692 programs of a real UR10e arrived 0 to 20 ms after a
multiple of 100 ms since the client had connected (pharmbio/robotlab, cellpainter/estimates.jsonl).

Only primary clients get messages, together with their next state and before it: a client must be informed of a stop by
its message before it sees it in a state. Information about a running program is also sent to primary clients only,
between the two.
"""

import logging
import struct
from collections.abc import Callable
from typing import Final

from emulator.commands.requests import RefusedScript, ScriptUnit
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.servers.program_state import ProgramReporter
from emulator.servers.send_scheduler import StateFeed
from emulator.snapshot import Snapshot
from urproto.facts import Situation, known, release_of
from urproto.primary.messages import NO_TIMESTAMP_US, UnknownMessage, VersionMessage
from urproto.realtime import realtime_packer
from urscript.splitter import ScriptSplitter, Unit

_logger = logging.getLogger(__name__)

_STATES_PER_S: Final = 10  # client interface manual
_PHASES: Final = 10
"""Clients that connect within the same hundredth of a second share their states, so that the cost of encoding them does
not grow with the number of clients."""

_AFTER_VERSION: Final = struct.Struct(">iiB")  # body of the undocumented message of kind 12


class ScriptConnection(Connection):
    """Passes on one unit of a script per control period, so that its effects are in place before the next one runs.

    Some connections are read-only until they are closed: those of a read-only port, and those that were opened while
    an e-Series arm was in local control (documentation of the official client library: switch, then reconnect).
    """

    def __init__(self, server: PortServer, *, read_only: bool) -> None:
        super().__init__(server)
        self._read_only = read_only or server.controller.snapshot.local_control
        self._splitter = ScriptSplitter()
        self._queue = CommandQueue(server.controller, self._queue_ready, client=self)

    def received(self, data: bytes) -> None:
        self._splitter.add(data)
        self._take_units()

    def at_end(self) -> bool:
        """A last unit without its line end is executed as well: clients close right after sending it (guess)."""
        self._splitter.add(b"\n")
        self._take_units()
        return False

    def _queue_ready(self, ready: bool) -> None:
        """Called when the queue is full or empty again; units that were received meanwhile are in the splitter."""
        if ready:
            self._take_units()
        self.read_on(ready and not self._queue.full)

    def _take_units(self) -> None:
        while not self._queue.full:
            unit = self._splitter.next()
            if unit is None and self.ended:
                unit = self._splitter.rest()
            if unit is None:
                return
            self._submit(unit)

    def _submit(self, unit: Unit) -> None:
        if unit.kind == "error" or not unit.complete:
            problem = "is too long" if unit.kind == "error" else "ends in the middle"
            _logger.warning(
                "%s: a script from %s %s and is ignored: %.60r", self.server.name, self.peer, problem, unit.text
            )
            return
        passed = self.server.hooks.message(self, Direction.RECEIVED, unit)
        if passed is not None:
            origin = f"a script from {self.peer} on port {self.server.port}"
            if self._read_only:
                self._queue.put(RefusedScript(passed.text, origin))
            else:
                self._queue.put(ScriptUnit(passed.text, passed.kind, origin))


class RealtimeServer(PortServer):
    """Sends one packet every control period. Accepts scripts unless it is read-only."""

    def __init__(self, name: str, controller: ServedController, *, read_only: bool) -> None:
        super().__init__(name, controller)
        self._read_only = read_only
        self._encode = realtime_packer(controller.version)
        self._feed = StateFeed()

    def connect(self) -> Connection:
        return ScriptConnection(self, read_only=self._read_only)

    def client_connected(self, connection: Connection) -> None:
        super().client_connected(connection)
        self._feed.up_to_date.append(connection)

    def client_disconnected(self, connection: Connection) -> None:
        super().client_disconnected(connection)
        self._feed.remove(connection)

    def publish(self, snapshot: Snapshot) -> None:
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        self.send_scheduler.publish(snapshot.step, self._feed, self._encode(snapshot))


EncodeState = Callable[[Snapshot, bool], bytes]


def greeting(situation: Situation) -> bytes:
    """What a new client gets first: the version message, and the undocumented message in versions that send it."""
    version = situation.version
    release = release_of(version)
    data = VersionMessage.of(version, release.message_date, release.control_build.integer).encode(version)
    twelve = known("message_twelve", situation)
    if twelve is None:
        return data
    body = _AFTER_VERSION.pack(*map(int, twelve.numbers))
    return data + UnknownMessage(timestamp_us=NO_TIMESTAMP_US, message_kind=12, body=body).encode(version)


class _PrimaryConnection(ScriptConnection):
    """A client, what it gets behind its next state, and the slot from which it gets states.

    The order is state, messages, values of variables. A capture shows the messages before the variables. The state
    before them is a guess from the official C++ library: its tests unlock a protective stop when the error code
    arrives, and take the robot for unlocked if the state that they have is from before the stop.
    """

    def __init__(self, server: PortServer, *, read_only: bool) -> None:
        super().__init__(server, read_only=read_only)
        self.messages: list[bytes] = []
        self.first_slot = 0
        self.without_state = True  # it has not received a state yet

    def opened(self) -> None:
        assert isinstance(self.server, PrimaryServer)
        self.server.greet(self)

    def send_state(self, data: bytes) -> None:
        super().send_state(data)
        self.send_messages()

    def skip_state(self) -> None:
        super().skip_state()
        self.send_messages()  # they are not superseded by later ones

    def send_messages(self) -> None:
        """Send what has come up since the last state."""
        if self.messages:
            messages, self.messages = self.messages, []
            self.send(b"".join(messages))


class _Phase:
    """The clients that get their states at the same moments."""

    def __init__(self, reporter: ProgramReporter | None) -> None:
        self.clients: list[_PrimaryConnection] = []
        self.reporter = reporter

    def add(self, client: _PrimaryConnection) -> None:
        if self.reporter is not None and not self.clients:
            self.reporter.first_client_connected()
        self.clients.append(client)


class PrimaryServer(PortServer):
    """The primary or the secondary interface.

    ``encode_state(snapshot, full)`` returns the robot state message, full or repeated. ``messages``: whether clients
    get messages. ``reporter`` creates a reporter of the running program; without it, no packages about it are sent.
    """

    def __init__(
        self,
        name: str,
        controller: ServedController,
        encode_state: EncodeState,
        *,
        messages: bool,
        read_only: bool,
        reporter: Callable[[], ProgramReporter] | None = None,
    ) -> None:
        super().__init__(name, controller)
        self._encode_state = encode_state
        self._messages = messages
        self._read_only = read_only
        self._phases = [_Phase(reporter() if reporter is not None else None) for _ in range(_PHASES)]
        self._slot = 0
        self._greeting = greeting(controller.situation)

    def connect(self) -> Connection:
        return _PrimaryConnection(self, read_only=self._read_only)

    def greet(self, connection: _PrimaryConnection) -> None:
        """Send a new client its version message; its first state follows after a tenth of a second."""
        self._slot = self._slot_of(self.controller.snapshot.step)
        connection.first_slot = self._slot + 1 + _PHASES
        self._phases[connection.first_slot % _PHASES].add(connection)
        connection.send(self._greeting)

    def client_disconnected(self, connection: Connection) -> None:
        super().client_disconnected(connection)
        for phase in self._phases:
            phase.clients = [client for client in phase.clients if client is not connection]

    def publish(self, snapshot: Snapshot) -> None:
        # First the clients that were not served in the last period: they have waited longest.
        self.send_scheduler.next_period(snapshot.step)
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        if self._messages and snapshot.messages:
            self._keep([message.encode(self.controller.version) for message in snapshot.messages])
        slot = self._slot_of(snapshot.step)
        if slot == self._slot:
            return
        self._slot = slot
        phase = self._phases[slot % _PHASES]
        if due := [client for client in phase.clients if client.first_slot <= slot]:
            self._serve(due, phase.reporter, snapshot)

    def _slot_of(self, step: int) -> int:
        """The number of hundredths of a second; in one of ten, the clients of a phase get their states.

        125 Hz is not a multiple of 10 Hz: there, the states of a client are 12 or 13 periods apart.
        """
        return step * _STATES_PER_S * _PHASES // self.controller.version.series.frequency_hz

    def _keep(self, messages: list[bytes]) -> None:
        for phase in self._phases:
            for client in phase.clients:
                client.messages += messages

    def _serve(self, clients: list[_PrimaryConnection], reporter: ProgramReporter | None, snapshot: Snapshot) -> None:
        """Send the clients the state, their messages, and the packages about the program."""
        report = reporter.cycle(round(snapshot.timestamp * 1e6)) if reporter is not None else None
        program = (report.state,) if report is not None else ()
        for client in clients:
            if report is not None and report.names and (report.new or client.without_state):
                client.messages.append(report.names)
            if client.without_state:
                client.without_state = False
                self.send_scheduler.remove(client)
                client.send(self._encode_state(snapshot, True))
                client.send_messages()
                for package in program:
                    client.send(package)
            else:
                self.send_scheduler.send(snapshot.step, client, self._encode_state(snapshot, False), *program)
