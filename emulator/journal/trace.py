"""The trace of a recorded run: it is executed again, and what it does is taken down in each period."""

import re
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any, Final

from emulator.commands.requests import DashboardLine, InterpreterLine, RefusedScript, RTDEInputs, ScriptUnit
from emulator.controller import Controller
from emulator.journal.file import DAMAGE, JournalError, Record, read_journal
from emulator.journal.replay import Replay
from emulator.journal.values import Numbers, decode
from emulator.mailbox import Command
from emulator.robotapi.server import RobotApiCall
from emulator.snapshot import Snapshot
from emulator.world.file import describe_object
from urproto.trace.model import Trace

_LANES: Final[Mapping[type[Command], str]] = {
    DashboardLine: "Dashboard",
    ScriptUnit: "Scripts",
    RefusedScript: "Scripts",
    InterpreterLine: "Interpreter",
    RTDEInputs: "RTDE inputs",
    RobotApiCall: "Robot API",
}
_OTHER_LANE: Final = "Other clients"
_ERROR: Final = re.compile(r"(C\d+A\d+|runtime exception|compile error) ")  # beginnings of lines of the log
_STREAM_S: Final = 0.02  # setpoints of a stream are reported together, this far apart
_MAX_TEXT: Final = 200  # characters of an entry; its detail has more
_MAX_DETAIL: Final = 4000
_MAX_ARGUMENT: Final = 60
_MAX_CLIENTS: Final = 6  # of a port that have lanes: clients that connect for each message would fill the page
_FAULTS: Final = ("inject_fault", "clear_fault", "clear_faults")  # verbs


def lane_of(command: Command) -> str:
    """Where commands of a class are shown, by the interface on which they arrive."""
    return _LANES.get(type(command), _OTHER_LANE)


def trace_of(source: Path, begin_s: float = 0.0, end_s: float = inf) -> tuple[Trace, str]:
    """The trace of a journal between two times, and where its replay differs, "" if nowhere.

    Times are uptimes of the robot [s], as if it had never been switched off. Raises JournalError, OSError.
    """
    with Replay(source) as replay:
        controller = replay.controller
        start_s = controller.time_s - replay.periods * controller.period_s
        tracer = Tracer(controller, source.name, replay.header["product"], begin_s, end_s)

        def period(_: Snapshot) -> bool:
            return tracer.period(replay.controller, start_s + replay.periods * replay.controller.period_s)

        replay.run(period)
        trace = tracer.trace
        difference = str(replay.difference or "")
        if replay.difference is not None:
            trace.event("Log", tracer.time_s, f"the replay differs from here on: {difference}", "error")
    messages = _Messages(trace, replay.controller.period_s)
    for record in read_journal(source):
        time_s = start_s + (record[0] + 1) * replay.controller.period_s  # of the period in which it arrives
        if begin_s <= time_s <= min(end_s, tracer.time_s):
            messages.add(time_s, record)
    messages.flush()
    trace.finish()
    return trace, difference


class Tracer:
    """Takes down each period of a run between two times. time_s: of the last period.

    product: the version of this emulator that the run was recorded by.
    """

    def __init__(
        self, controller: Controller, title: str, product: str, begin_s: float = 0.0, end_s: float = inf
    ) -> None:
        self._begin_s, self._end_s = begin_s, end_s
        self._lanes: set[str] = set()
        self._logged = ""
        self.time_s = controller.time_s
        about = f"{controller.model.title}, PolyScope {controller.version}"
        self.trace = Trace(title, f"{about}, ur-emulator {product}", controller.model)

    def period(self, controller: Controller, time_s: float) -> bool:
        """Take down the period that ended at this time; returns whether it was the last one of interest."""
        trace = self.trace
        self.time_s = time_s
        if time_s < self._begin_s:
            return False
        sampled = trace.add(time_s, controller.snapshot.values())
        self._log(controller)
        self._lines(controller)
        world = controller.world
        if sampled and world is not None:
            poses = world.poses()
            for name, obj in world.objects.items():
                trace.place(name, describe_object(obj), poses.get(name, obj.pose))
        return time_s >= self._end_s

    def _log(self, controller: Controller) -> None:
        history = controller.messages.history
        new = []
        for line in reversed(history):
            if line is self._logged:
                break
            new.append(line)
        if new:
            self._logged = new[0]
        for line in reversed(new):
            text = line.partition(" ")[2]
            error = _ERROR.match(text)
            self.trace.event(
                "Faults" if error else "Log", self.time_s, text[:_MAX_TEXT], "error" if error else "", text
            )

    def _lines(self, controller: Controller) -> None:
        view = controller.programs.view
        lines: dict[str, int] = {}
        for name, line in view.lines if view is not None and view.running else ():
            lane, count = f"Thread {name}" if name else "Program line", 1
            while lane in lines:
                count += 1
                lane = f"Thread {name} {count}"
            lines[lane] = line
        for lane in (*lines, *(self._lanes - lines.keys())):
            self.trace.line(lane, self.time_s, view.program.source if view else "", lines.get(lane, 0))
        self._lanes = set(lines)


class _Stream:
    """Changes of a client's RTDE inputs. time_s: when they were last reported."""

    def __init__(self) -> None:
        self.time_s = -inf
        self._inputs: dict[str, Any] = {}  # the last value of each
        self._changed: dict[str, Any] = {}  # values that are not reported yet

    def add(self, time_s: float, values: Mapping[str, Any]) -> str:
        """Take values; returns what is to be reported now, if anything is."""
        changed = {name: value for name, value in values.items() if self._inputs.get(name) != value}
        self._inputs |= changed
        self._changed |= changed
        streamed = all(isinstance(value, float | tuple) for value in changed.values())
        if not self._changed or (streamed and time_s < self.time_s + _STREAM_S):
            return ""
        self.time_s = time_s
        return self.take()

    def take(self) -> str:
        """What is not reported yet."""
        text = ", ".join(f"{name} = {value}" for name, value in self._changed.items())
        self._changed.clear()
        return text


class _Messages:
    """Takes down what clients have sent, by the records of a journal."""

    def __init__(self, trace: Trace, period_s: float) -> None:
        self._trace = trace
        self._period_s = period_s
        self._numbers = Numbers()
        self._clients: dict[str, list[str]] = {}  # of each port, those that have lanes
        self._streams: dict[str, _Stream] = {}  # of RTDE inputs, by lane

    def add(self, time_s: float, record: Record) -> None:
        """Take a record down. Raises JournalError."""
        _, kind, *content = record
        if (take := getattr(self, f"_take_{kind}", None)) is not None:
            try:
                take(time_s, *content)
            except DAMAGE as error:
                raise JournalError(f"the journal has a damaged record of the kind {kind}: {error}") from error

    def _event(self, lane: str, time_s: float, text: str, level: str = "") -> None:
        first = text.strip().partition("\n")[0][:_MAX_TEXT]
        self._trace.event(lane, time_s, first, level, text[:_MAX_DETAIL])

    def _lane(self, port: str, client: str) -> str:
        """The lane of a client; later ones share one."""
        if not client:
            return port
        known = self._clients.setdefault(port, [])
        if client not in known and len(known) < _MAX_CLIENTS:
            known.append(client)
        return f"{port} {client}" if client in known else f"{port}, further clients"

    def _take_post(self, time_s: float, content: Any, client: str = "") -> None:
        command = decode(content, self._numbers)
        lane = self._lane(lane_of(command), client)
        if isinstance(command, RTDEInputs):
            if text := self._streams.setdefault(lane, _Stream()).add(time_s, command.values):
                self._event(lane, time_s, text)
        elif isinstance(command, RobotApiCall):
            self._event(lane, time_s, f"{command.operation.endpoint.method} {command.operation.endpoint.path}")
        else:
            self._event(lane, time_s, getattr(command, "text", "") or repr(command))

    def flush(self) -> None:
        """Report the rest of each stream."""
        for lane, stream in self._streams.items():
            if text := stream.take():
                self._event(lane, stream.time_s, text)

    def _take_verb(self, time_s: float, name: str, arguments: Any, client: str = "") -> None:
        given = decode(arguments, self._numbers)
        shown = (f"{key}={value!r:.{_MAX_ARGUMENT}}" for key, value in given.items())
        detail = "\n".join(value for value in given.values() if isinstance(value, str) and "\n" in value)
        api = self._lane("Control API", client.rpartition(":")[0])  # of whose clients each call is a connection
        lane, level = ("Faults", "warning") if name in _FAULTS else (api, "")
        self._trace.event(lane, time_s, f"{name}({', '.join(shown)})"[:_MAX_TEXT], level, detail[:_MAX_DETAIL])

    def _take_socket(self, time_s: float, number: int, state: str, failure: str, data: Any) -> None:
        received = decode(data, self._numbers)
        text = f"socket {number} {state}{f': {failure}' if failure else ''}"
        text += f", received {received!r}" if received else ""
        self._event("Script sockets", time_s, text, "warning" if failure else "")

    def _take_unsent(self, time_s: float, number: int, send: int) -> None:
        self._event("Script sockets", time_s, f"socket {number} did not take what was sent", "warning")

    def _take_modbus(self, time_s: float, number: int, values: Any, device_error: int, connection_error: int) -> None:
        problem = f"device error {device_error}" if device_error else f"connection error {connection_error}"
        failed = bool(device_error or connection_error)
        text = f"request {number}: {problem if failed else decode(values, self._numbers)}"
        self._event("Modbus units", time_s, text, "warning" if failed else "")

    def _take_tool(self, time_s: float, data: Any) -> None:
        self._event("Tool line", time_s, f"received {decode(data, self._numbers)!r}")

    def _take_file(self, time_s: float, name: str, content: Any) -> None:
        self._event("Other clients", time_s, f"the file {name} has changed")

    def _take_reboot(self, time_s: float, boot_s: float, periods_off: int) -> None:
        self._event("Faults", time_s, f"off for {periods_off * self._period_s:.3f} s, then on again", "warning")
