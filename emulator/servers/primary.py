"""Primary and secondary client interface (TCP 30001 and 30002, read-only 30011 and 30012).

A client gets the version message at once, on e-Series with a short one of an undocumented
kind behind it, as captured; no state comes with it, for the sake of clients that take what
they read first for one message. Then it gets a robot state ten times a second, the first of
them full. Messages go to primary clients only, those of a control period before its state:
a client that is told about a stop must not see it in the state first. So does what is known about a running
program, before each of the ten states a second. A new safety mode is followed at once by a
state that shows it: the official client library waits for the state, and one from before
the stop would tell it that there is nothing to unlock.
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


class RealtimeServer(PortServer):
    """One packet every control period. Takes scripts unless it is read-only."""

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
# As captured from 5.4 (a simulator), 5.11 and 5.13 (vendor's forum, threads 21643 and 27359); that later ones send it
# too is a guess. A 3.10 arm sent other words in it, which mean nothing here, so that CB3 controllers send none.
_AFTER_VERSION: Final = UnknownMessage(timestamp_us=NO_TIMESTAMP_US, message_kind=12, body=bytes(8) + b"\1")
_HAS_AFTER_VERSION: Final = Availability.since(None, "5.4")
_BUILD_DATE: Final = "20-06-2022, 00:00:00"  # day of 3.15.8; other versions send the same, which is a guess


class PrimaryServer(PortServer):
    """``encode_state(snapshot, full)`` gives the robot state message, full or repeated.

    ``reporter`` tells about the running program; None tells nothing.
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
        self._fresh: list[Connection] = []  # had no state yet
        self._read_only = read_only
        self._greeting = VersionMessage.of(controller.version, _BUILD_DATE).encode(controller.version)
        if _HAS_AFTER_VERSION.covers(controller.version):
            self._greeting += _AFTER_VERSION.encode(controller.version)

    def connect(self) -> Connection:
        return _Greeted(self, read_only=self._read_only)

    def greet(self, connection: Connection) -> None:
        """Send what a new client gets at once."""
        self._fresh = [*(fresh for fresh in self._fresh if fresh in self.connections), connection]
        if self._reporter is not None and len(self.connections) == 1:
            self._reporter.first_listener()
        connection.send(self._greeting)

    def publish(self, snapshot: Snapshot) -> None:
        # First those whose turn did not come last time: they have waited longest.
        self.send_scheduler.next_period(snapshot.step)
        if self.hooks.on_state:
            snapshot = self.hooks.state(snapshot)
        shown = False
        if self._messages:
            for message in snapshot.messages:
                self._broadcast(message.encode(self.controller.version))
                # A state goes with each change of the safety mode, due or not: the official client's tests look at the
                # robot mode data as soon as they hear of the change. One that is due too is not sent twice.
                if isinstance(message, SafetyModeMessage):
                    self._broadcast_state(snapshot)
                    shown = True
        if self._state_is_due(snapshot.step):
            program = self._tell_of_program(self._reporter, snapshot) if self._reporter is not None else ()
            if not shown:
                self._broadcast_state(snapshot, *program)
                return
            for connection in tuple(self.connections):
                for package in program:
                    connection.send_state(package)

    def _tell_of_program(self, reporter: ProgramReporter, snapshot: Snapshot) -> tuple[bytes, ...]:
        """Names of its variables to those who need them; the package that all get before the state."""
        report = reporter.cycle(round(snapshot.timestamp * 1e6))
        if report is None:
            return ()
        for connection in tuple(self.connections):
            if report.names and (report.new or connection in self._fresh):
                connection.send(report.names)
        return (report.state,)

    def _broadcast(self, data: bytes) -> None:
        for connection in tuple(self.connections):
            connection.send(data)

    def _broadcast_state(self, snapshot: Snapshot, *before: bytes) -> None:
        """The state to all, with what comes before it."""
        fresh, self._fresh = self._fresh, []
        state = self._encode_state(snapshot, False)
        full_state = self._encode_state(snapshot, True) if fresh else b""
        for connection in tuple(self.connections):
            if connection not in fresh:
                self.send_scheduler.send(snapshot.step, connection, *before, state)
                continue
            self.send_scheduler.forget(connection)
            for package in (*before, full_state):
                connection.send(package)

    def _state_is_due(self, step: int) -> bool:
        """125 Hz is not a multiple of 10 Hz: states are 12 or 13 control periods apart."""
        frequency_hz = self.controller.version.series.frequency_hz
        return step * _STATES_PER_S // frequency_hz != (step - 1) * _STATES_PER_S // frequency_hz


class _Greeted(ScriptConnection):
    def opened(self) -> None:
        assert isinstance(self.server, PrimaryServer)
        self.server.greet(self)
