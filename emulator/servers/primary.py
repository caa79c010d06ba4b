"""Primary, secondary and realtime client interfaces (TCP 30001 to 30003, read-only 30011 to 30013).

A client of the primary or secondary interface gets the version message immediately, on e-Series followed by a short
message of an undocumented kind, as captured. No state is sent with it, because some clients take their first read for
one message. After that the client gets ten robot states per second, the first of them full.

Only primary clients get messages. Those of a control period are sent before its state: a client must be informed of a
stop by its message before it sees it in a state. Information about a running program is also sent to primary clients
only, before each of the ten states per second. A new safety mode is followed immediately by a state that shows it: the
official client library waits for the next state, and one from before the stop would tell it that there is nothing to
unlock.
"""

import logging
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
from urproto.primary.messages import NO_TIMESTAMP_US, SafetyModeMessage, UnknownMessage, VersionMessage
from urproto.realtime import realtime_packer
from urproto.versions import Availability
from urscript.splitter import ScriptSplitter, Unit

_logger = logging.getLogger(__name__)


class ScriptConnection(Connection):
    """Passes on one unit of a script per control period, so that its effects are in place before the next one runs.

    Some connections are read-only until they are closed: those of a read-only port, and those that were opened while
    an e-Series arm was in local control (documentation of the official client library: switch, then reconnect).
    """

    def __init__(self, server: PortServer, *, read_only: bool) -> None:
        super().__init__(server)
        self._read_only = read_only or server.controller.snapshot.local_control
        self._splitter = ScriptSplitter()
        self._queue = CommandQueue(server.controller, self._queue_ready)
        self._ended = False

    def received(self, data: bytes) -> None:
        self._splitter.add(data)
        self._take_units()

    def at_end(self) -> bool:
        """A last unit without its line end is executed as well: clients close right after sending it (guess)."""
        self._ended = True
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
            if unit is None and self._ended:
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

_STATES_PER_S: Final = 10  # client interface manual
# As captured from 5.4 (a simulator), 5.11 and 5.13 (vendor's forum, threads 21643 and 27359). It is a guess that later
# versions send it too. A 3.10 arm sent other content, which has no meaning here, so CB3 controllers do not send it.
_AFTER_VERSION: Final = UnknownMessage(timestamp_us=NO_TIMESTAMP_US, message_kind=12, body=bytes(8) + b"\1")
_HAS_AFTER_VERSION: Final = Availability.since(None, "5.4")
_BUILD_DATE: Final = "20-06-2022, 00:00:00"  # date of 3.15.8; all other versions send the same (guess)


class PrimaryServer(PortServer):
    """The primary or the secondary interface.

    ``encode_state(snapshot, full)`` returns the robot state message, full or repeated. ``messages``: whether clients
    get messages. ``reporter`` provides the packages about the running program; None sends none.
    """

    def __init__(
        self,
        name: str,
        controller: ServedController,
        encode_state: EncodeState,
        *,
        messages: bool,
        read_only: bool,
        reporter: ProgramReporter | None = None,
    ) -> None:
        super().__init__(name, controller)
        self._encode_state = encode_state
        self._reporter = reporter
        self._messages = messages
        self._without_state: list[Connection] = []  # clients that have not received a state yet
        self._read_only = read_only
        self._greeting = VersionMessage.of(controller.version, _BUILD_DATE).encode(controller.version)
        if _HAS_AFTER_VERSION.covers(controller.version):
            self._greeting += _AFTER_VERSION.encode(controller.version)

    def connect(self) -> Connection:
        return _PrimaryConnection(self, read_only=self._read_only)

    def greet(self, connection: Connection) -> None:
        """Send a new client its version message."""
        self._without_state = [*(other for other in self._without_state if other in self.connections), connection]
        if self._reporter is not None and len(self.connections) == 1:
            self._reporter.first_client_connected()
        connection.send(self._greeting)

    def publish(self, snapshot: Snapshot) -> None:
        # First the clients that were not served in the last period: they have waited longest.
        self.send_scheduler.next_period(snapshot.step)
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        state_sent = False
        if self._messages:
            for message in snapshot.messages:
                self._broadcast(message.encode(self.controller.version))
                # Each change of the safety mode is followed by a state, due or not: the official client's tests check
                # the robot mode data as soon as they receive the change. A state that is due as well is not sent twice.
                if isinstance(message, SafetyModeMessage):
                    self._broadcast_state(snapshot)
                    state_sent = True
        if self._state_is_due(snapshot.step):
            program = self._report_program(self._reporter, snapshot) if self._reporter is not None else ()
            if not state_sent:
                self._broadcast_state(snapshot, *program)
                return
            for connection in tuple(self.connections):
                for package in program:
                    connection.send_state(package)

    def _report_program(self, reporter: ProgramReporter, snapshot: Snapshot) -> tuple[bytes, ...]:
        """Send the names of its variables to the clients that lack them; return the package for all clients."""
        report = reporter.cycle(round(snapshot.timestamp * 1e6))
        if report is None:
            return ()
        for connection in tuple(self.connections):
            if report.names and (report.new or connection in self._without_state):
                connection.send(report.names)
        return (report.state,)

    def _broadcast(self, data: bytes) -> None:
        for connection in tuple(self.connections):
            connection.send(data)

    def _broadcast_state(self, snapshot: Snapshot, *before: bytes) -> None:
        """Send the state to all clients, after the packages in ``before``."""
        new, self._without_state = self._without_state, []
        state = self._encode_state(snapshot, False)
        full_state = self._encode_state(snapshot, True) if new else b""
        for connection in tuple(self.connections):
            if connection not in new:
                self.send_scheduler.send(snapshot.step, connection, *before, state)
                continue
            self.send_scheduler.remove(connection)
            for package in (*before, full_state):
                connection.send(package)

    def _state_is_due(self, step: int) -> bool:
        """Whether a state is due. 125 Hz is not a multiple of 10 Hz: there, states are 12 or 13 periods apart."""
        frequency_hz = self.controller.version.series.frequency_hz
        return step * _STATES_PER_S // frequency_hz != (step - 1) * _STATES_PER_S // frequency_hz


class _PrimaryConnection(ScriptConnection):
    def opened(self) -> None:
        assert isinstance(self.server, PrimaryServer)
        self.server.greet(self)
