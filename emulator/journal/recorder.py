"""Records everything that enters a controller, and what the controller made of it, so that a replay can be checked.

    recorder = Recorder(JournalWriter(open("run.journal", "wb")), header_of(config))
    recorder.attach(controller)

A checksum of where the arm is to be and is, and of the modes, is kept for each control period, and all values once a
second: a replay that differs names the first period, and what differs in the second after it.
"""

import logging
import platform
import struct
import zlib
from array import array
from base64 import b64encode
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, Final

from emulator.commands.requests import DashboardLine
from emulator.control.control import Control
from emulator.control.snapshots import state_at_rest
from emulator.controller import Controller
from emulator.journal.doors import RecordedDevice, RecordedModbus, RecordedSockets, plain_values
from emulator.journal.file import FORMAT, JournalWriter, MemorySink, Record, Sink
from emulator.journal.ring import Ring
from emulator.journal.values import JournalValueError, Numbers, encode
from emulator.machine import ControllerConfig
from emulator.mailbox import Command
from emulator.robot.kinds import ArmKind
from emulator.robotapi.server import RobotApiCall
from emulator.snapshot import Snapshot
from urproto.controlapi import NotPossible

_STATE: Final = struct.Struct("<18d3i")
_LOADING: Final = ("dashboard", "play_from", "save_program", "delete_program")  # verbs after which a file may be read

_ENCODED: Final = frozenset({"socket", "modbus", "tool", "file"})  # kinds whose contents are not JSON
_MAX_FILES: Final = 4 * 1024 * 1024  # bytes in the first record, which is written while the robot starts; guess
_MAX_ENTRIES: Final = 2000  # of the programs folder that are looked at; guess: a millisecond or two
_PROGRAM_FILES: Final = (".urp", ".urpx", ".script", ".installation", ".variables")
_PATHS: Final = ("arm", "calibration", "initial_positions", "programs", "safety", "world")  # options that may be files
_WORDS: Final = (*ArmKind, "factory")  # values of these options that name no files

_logger = logging.getLogger(__name__)


class Checksums:
    """Checksums of control periods, one after the other."""

    def __init__(self) -> None:
        self._seen: tuple[Any, ...] = ()
        self._sum = 0

    def of(self, controller: Controller) -> int:
        """The checksum of its last period; a period in which nothing changed costs little."""
        arm, modes = (
            controller.arm,
            (controller.power.report.robot_mode, controller.safety.mode, controller.programs.state),
        )
        values = arm.target_q, arm.target_qd, arm.measured_q, modes
        if values != self._seen:
            self._seen = values
            self._sum = zlib.crc32(_STATE.pack(*values[0], *values[1], *values[2], *map(int, modes)))
        return self._sum


class Recorder:
    """Records one run, also across restarts of its controller.

    periods: that are over. memory: where it is kept. checked: whether it has what a replay is compared with.
    """

    def __init__(
        self,
        writer: JournalWriter,
        header: Mapping[str, Any],
        memory: MemorySink | None = None,
        *,
        checked: bool = True,
    ) -> None:
        self._header = dict(header)
        begin = self._header.get("begin", {})
        self.periods: int = begin.get("periods", 0)
        self._verbs: int = begin.get("verbs", 0)
        self._faults: int = begin.get("faults", 0)  # that were injected
        self._begin = begin
        self._writer = writer
        self._memory = memory
        self._ring = memory if isinstance(memory, Ring) else None
        self._checked = checked
        self._numbers = Numbers()
        self._ticking = False
        self._held: list[Record] | None = None  # while a fault is injected: what that causes
        self._late: list[Record] = []  # of commands posted during a period, which apply to the next one
        self._sums = Checksums()
        self._checksums = array("L")
        self._ticked: Controller | None = None  # whose last period belongs to the journal
        self._second = 0
        self._waiting = 0  # verbs that are not over
        self._controller: Controller | None = None
        self._restarted = False
        self._sockets: RecordedSockets | None = None
        self._modbus: RecordedModbus | None = None
        self._programs_dir: Path | None = None
        self._seen: dict[Path, tuple[int, int]] = {}
        self._broken = False
        self._add([0, "run", self._header])
        self._attempt(self._writer.flush)

    def attach(self, controller: Controller) -> None:
        """Record a controller from its first period on; call it before anything is posted."""
        controller.recorder = self
        self._controller = controller
        self._second = round(1.0 / controller.period_s)
        self._programs_dir = controller.config.programs_dir
        self._seen = self._states_of_files()

    def rebooted(self, controller: Controller, boot_s: float, periods_off: int) -> None:
        """Continue with the controller after a restart."""
        self._write("reboot", boot_s, periods_off)
        self.periods += periods_off
        self._ticked = None
        self._restarted = True
        self.attach(controller)

    def wrap_backends(self, controller: Controller) -> None:
        """Record what its programs and its tool receive; call it when their connections are there."""
        self._look_outside()  # for the last time through the wrappers that are there
        programs, sockets, modbus = controller.programs, self._sockets, self._modbus
        opened = sockets.count if sockets else self._begin.get("sockets", 0)
        requested = modbus.count if modbus else self._begin.get("requests", 0)
        programs.socket_backend = self._sockets = RecordedSockets(programs.socket_backend, self._write, opened)
        programs.modbus.backend = self._modbus = RecordedModbus(programs.modbus.backend, self._write, requested)
        if (device := controller.tool_line.device) is not None:
            controller.tool_line.device = RecordedDevice(device, self._write)

    @property
    def journal(self) -> bytes:
        """The run so far, if it is kept in memory; empty if not, or if it is too long."""
        if self._memory is None:
            return b""
        self._end_second(None if self._ticking else self._last())
        if self._ticking:  # it failed: the replay is to get as far
            self._writer.add([self.periods + 1, "failed"])
        self._attempt(self._writer.drain)
        return self._memory.content

    def save(self, write: Callable[[bytes], None]) -> None:
        """Have the run so far written, if it is kept in memory: where the journal is written, after the last period."""
        if (memory := self._memory) is not None and not self._broken:
            self._end_second(self._last())
            self._writer.afterwards(lambda: write(memory.content))

    def close(self) -> None:
        self._end_second(None)
        self._attempt(self._writer.close)
        if self._ring is not None:
            self._ring.close()

    # the doors

    def posted(self, command: Command, client: str) -> None:
        if isinstance(command, RobotApiCall) or (isinstance(command, DashboardLine) and "load" in command.text.lower()):
            self._look_at_files()
        try:
            content = encode(command, self._numbers)
        except JournalValueError as error:
            _logger.error("%s", error)
            return
        if self._ticking:
            self._late.append([self.periods + 1, "post", content, client])
        else:
            self._write("post", content, client)

    def called(self, name: str, arguments: Mapping[str, Any], call: Callable[[], Any], client: str = "") -> Any:
        """Call a verb; returns its result, or its steps with an eye on whether somebody waits for their end."""
        if name in _LOADING:
            self._look_at_files()
        given = encode(dict(arguments), self._numbers)
        if name == "inject_fault":
            return self._injected(name, given, call, client)
        number, self._verbs = self._verbs, self._verbs + 1
        self._write("verb", name, given, client)
        result = call()
        return self._watched(number, result) if isinstance(result, Generator) else result

    def _injected(self, name: str, given: Any, call: Callable[[], int], client: str) -> int:
        """Inject a fault: one that is refused has no effect and no number, and is not recorded."""
        self._held = held = list[Record]()
        accepted = False
        try:
            self._faults = call()
            accepted = True
        finally:
            self._held = None
            if accepted:
                self._verbs += 1
                self._write("verb", name, given, client)
            for record in held:
                self._add(record)
        return self._faults

    def _watched(self, number: int, steps: Generator[None, None, Any]) -> Generator[None, None, Any]:
        self._waiting += 1
        try:
            return (yield from steps)
        except GeneratorExit:
            self._write("left", number)
            raise
        finally:
            self._waiting -= 1

    def _look_at_files(self) -> None:
        for path, state in self._states_of_files().items():
            if self._seen.get(path) != state:
                self._seen[path] = state
                self._attempt(partial(self._write_file, path))

    def _write_file(self, path: Path) -> None:
        assert self._programs_dir is not None
        name, content = path.relative_to(self._programs_dir).as_posix(), path.read_bytes()
        self._header["files"].setdefault("programs", {})[name] = b64encode(content).decode()
        self._write("file", name, content)

    def _states_of_files(self) -> dict[Path, tuple[int, int]]:
        """Time of the last change and size of the files in the programs folder."""
        if self._programs_dir is None:
            return {}
        states = {}
        for file in program_files(self._programs_dir):
            with suppress(OSError):  # removed in the meantime
                states[file] = (file.stat().st_mtime_ns, file.stat().st_size)
        return states

    # the periods

    def begin(self) -> None:
        self._look_outside()
        self._ticking = True

    def end(self, controller: Controller) -> None:
        self._ticking, self._ticked = False, controller
        self.periods += 1
        if self._sockets is not None:
            self._sockets.rest()
        for record in self._late:
            self._add(record)
        self._late.clear()
        if self._checked:
            self._checksums.append(self._sums.of(controller))
        if self.periods % self._second == 0:
            self._end_second(controller.published() if self._checked else None)
            if self._ring is not None and self._ring.due(self.periods / self._second):
                self._begin_anew(self._ring)

    def _begin_anew(self, ring: Ring) -> None:
        """Let the journal begin with this moment, if the robot can be described and nothing is under way."""
        controller, sockets, modbus = self._controller, self._sockets, self._modbus
        if controller is None or sockets is None or modbus is None or self._waiting or self._restarted:
            return
        if not (sockets.idle and modbus.idle) or controller.commands_waiting or controller.on_tick:
            return
        try:
            state = state_at_rest(controller)
        except NotPossible:
            return
        begin = {
            "periods": self.periods,
            "verbs": self._verbs,
            "faults": self._faults,
            "sockets": sockets.count,
            "requests": modbus.count,
            "rtde": encode([controller.rtde_inputs, controller.rtde_refreshed], self._numbers),
            "state": state,
        }
        self._broken, self._ticked = False, None
        self._writer.recover()
        self._writer.afterwards(ring.proposal({**self._header, "begin": begin}, self.periods / self._second))

    def _last(self) -> Snapshot | None:
        return None if self._ticked is None else self._ticked.published()

    def _look_outside(self) -> None:
        if self._sockets is not None:
            self._sockets.look()
        if self._modbus is not None:
            self._modbus.look()

    def _end_second(self, snapshot: Snapshot | None) -> None:
        values = None if snapshot is None else plain_values(snapshot)
        sums = struct.pack(f"!{len(self._checksums)}I", *self._checksums)
        self._add([self.periods, "state", b64encode(sums).decode(), values])
        del self._checksums[:]
        self._attempt(self._writer.flush)

    def _write(self, kind: str, *content: Any) -> None:
        encoded = (encode(part, self._numbers) for part in content) if kind in _ENCODED else content
        self._add([self.periods, kind, *encoded])

    def _add(self, record: Record) -> None:
        if self._held is not None:
            self._held.append(record)
        elif not self._broken:
            self._writer.add(record)

    def _attempt(self, work: Callable[[], object]) -> None:
        """A disk that is full must not end a control period: the journal ends."""
        if self._broken:
            return
        try:
            work()
        except OSError as error:
            self._broken = True
            level = logging.WARNING if self._memory is not None else logging.ERROR
            _logger.log(level, "the journal ends here: %s", error.strerror or error)


def record(control: Control, sink: Sink, *, header: Mapping[str, Any] | None = None, checked: bool = True) -> Recorder:
    """Record a robot whose time has not begun, from its first period on. Raises OSError.

    header: of the run that is executed again; of the robot's configuration by default.
    """
    controller = control.controller
    memory = sink if isinstance(sink, MemorySink) else None
    recorder = Recorder(JournalWriter(sink), header or header_of(controller.config), memory, checked=checked)
    recorder.attach(controller)
    recorder.wrap_backends(controller)
    return recorder


def product_version() -> str:
    return version("ur-emulator")


def header_of(config: ControllerConfig) -> dict[str, Any]:
    """The first record's content: from which options and files the controller is made again."""
    files = _Files()
    return {
        "format": FORMAT,
        "product": product_version(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "model": config.model.name,
        "wall_clock_s": config.wall_clock_s,
        "options": {name: files.option(name, value) for name, value in (config.options or {}).items()},
        "files": files.contents,
        "left_out": files.left_out,
        "problem": files.problem if config.options is not None else "it was not made from options",
    }


class _Files:
    """The files that options name.

    contents: of each option, relative path -> base64. left_out: files for which there was no room. problem: an option
    that a journal cannot contain.
    """

    def __init__(self) -> None:
        self.contents: dict[str, dict[str, str]] = {}
        self.left_out: list[str] = []
        self.problem = ""
        self._room = _MAX_FILES

    def option(self, name: str, value: Any) -> Any:
        """The value for the journal: of a file or folder, its name below the option's own folder."""
        if name in _PATHS and isinstance(value, Path | str) and str(value) not in _WORDS:
            path = Path(value)
            if path.is_dir():
                self._add(name, path, program_files(path))
                return {"folder": name}
            if path.is_file():
                beside = islice(path.parent.rglob("*"), _MAX_ENTRIES) if name == "world" else ()
                self._add(name, path.parent, (path, *beside))
                return {"folder": name, "file": path.name}
        if isinstance(value, tuple):
            return list(value)
        if not isinstance(value, bool | int | float | str | list | dict | None):
            self.problem = f"the journal cannot contain the option {name}, an object: give a file"
            return None
        return value

    def _add(self, option: str, folder: Path, files: Iterable[Path]) -> None:
        contents = self.contents.setdefault(option, {})
        for file in filter(Path.is_file, files):
            name, size = file.relative_to(folder).as_posix(), file.stat().st_size
            if size > self._room:
                self.left_out.append(name)
            elif name not in contents:
                self._room -= size
                contents[name] = b64encode(file.read_bytes()).decode()


def program_files(folder: Path) -> list[Path]:
    """The files of a programs folder that a controller may read; of a very large folder, some of them."""
    return [file for file in islice(folder.rglob("*"), _MAX_ENTRIES) if file.suffix in _PROGRAM_FILES]
