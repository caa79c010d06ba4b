"""Executes a recorded run again, in virtual time, and compares it with what was recorded."""

import json
import platform
import struct
import tempfile
import weakref
from base64 import b64decode
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from emulator.config import ConfigError, controller_config
from emulator.control.control import Control
from emulator.control.snapshots import restore_state
from emulator.control.timing import ManualPace
from emulator.control.verbs import ServedRobot
from emulator.controller import Controller
from emulator.faults.fault import rebooted
from emulator.faults.injector import FaultInjector
from emulator.journal.doors import ReplayedDevice, ReplayedModbus, ReplayedSockets, plain_values
from emulator.journal.file import DAMAGE, FORMAT, JournalError, MemorySink, Record, Sink, read_journal
from emulator.journal.recorder import Checksums, Recorder, product_version, record
from emulator.journal.values import JournalValueError, Numbers, decode
from emulator.machine import ControllerConfig
from emulator.snapshot import Snapshot
from urproto.compat import Self
from urproto.controlapi import BadArguments, NotPossible
from urproto.durable import write_file

_MOST_NAMED: Final = 5  # values that differ
_GAP_S: Final = 2.0  # between records, of which there is one each second at least


@dataclass(frozen=True)
class Difference:
    """Where a replay first differs. period: counted from the start of the run. values: name, recorded, replayed; of
    the end of the second.
    """

    period: int
    time_s: float
    values: tuple[tuple[str, Any, Any], ...]

    def __str__(self) -> str:
        telling = sorted(self.values, key=lambda value: isinstance(value[1], list))  # modes first
        named = "; ".join(f"{name} is {new}, recorded {old}" for name, old, new in telling[:_MOST_NAMED])
        return f"period {self.period} ({self.time_s:.3f} s of robot time) differs{': ' if named else ''}{named}"


class Replay:
    """A run that is executed again; use it with ``with``. controller: as it is now. header: what the run was made from.

    again: records the new run while it is executed, with what its own replays are compared with if it is ``checked``,
    so that it can go on. Raises JournalError for a journal that cannot be replayed, and whatever `read_journal` raises.
    """

    def __init__(self, source: Path | bytes, *, again: Sink | None = None, checked: bool = True) -> None:
        self._records = read_journal(source)
        first = next(self._records, None)
        header = first[2] if first is not None and first[1] == "run" and len(first) > 2 else None
        if not isinstance(header, dict):
            raise JournalError("the journal has no beginning")
        if (found := header.get("format")) != FORMAT:
            raise JournalError(
                f"the journal has format {found}, and this version of ur-emulator reads {FORMAT}: replay it with the "
                f"version that wrote it, {header.get('product')}"
            )
        self.header: dict[str, Any] = header
        if problem := self.header.get("problem"):
            raise JournalError(f"the run cannot be replayed: {problem}")
        with ExitStack() as kept:
            self._folder = Path(kept.enter_context(tempfile.TemporaryDirectory(prefix="ur-emulator-replay-")))
            try:
                self.config = self._config()
                self.controller = Controller(self.config)
                self.faults = FaultInjector(self.controller, machine=_NoPower())
                self._begin(self.header.get("begin", {}))
            except (*DAMAGE, BadArguments, NotPossible, JournalValueError) as error:
                raise JournalError(f"the beginning of the journal is damaged: {error}") from error
            self._kept = kept.pop_all()
        self.difference: Difference | None = None
        self.checked = 0  # periods that were compared with the recorded ones
        self._checksums, self._sums = Checksums(), list[int]()
        self._steps: dict[int, Generator[None, None, Any]] = {}
        self._device = ReplayedDevice(lambda: self.periods)
        self._robot = ServedRobot(self.controller)
        self._control = Control(self._robot, ManualPace(), self.faults)
        self._connect()
        self.recorder: Recorder | None = None
        if again is not None:
            self.recorder = record(self._control, again, header=self.header, checked=checked)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._kept.close()

    def run(self, until: Callable[[Snapshot], bool] | None = None) -> None:
        """Execute the run to its end, to its first difference, or until a condition is true after a period.

        Raises JournalError for a record that cannot be executed.
        """
        for entry in self._records:
            if (entry[0] - self.periods) * self.controller.period_s > _GAP_S:
                raise JournalError(f"the journal has nothing between period {self.periods} and period {entry[0]}")
            while self.periods < entry[0]:
                self._tick()
                if until is not None and until(self.controller.snapshot):
                    return
            self._apply(entry)
            if self.difference is not None:
                return

    def leave(self, owner: object) -> Controller:
        """The controller as it is now, to go on with: the connections of its programs are closed.

        Its files stay as long as the owner, also after this context.
        """
        self._sockets.close_all()
        self._modbus.close_all()
        for steps in self._steps.values():
            steps.close()
        self._steps.clear()
        weakref.finalize(owner, self._kept.close)
        self._kept = ExitStack()
        return self.controller

    # the run's beginning

    def _config(self) -> ControllerConfig:
        for option, files in self.header["files"].items():
            for name, content in files.items():
                self._write_file(f"{option}/{name}", b64decode(content))
        options = dict(self.header["options"])
        for name, value in options.items():
            if isinstance(value, dict) and "folder" in value:
                self._path(name).mkdir(exist_ok=True)
                options[name] = self._path(f"{name}/{value.get('file', '')}")
        options["wall_clock_s"] = self.header["wall_clock_s"]
        try:
            return controller_config(self.header["model"], **options)
        except (ConfigError, TypeError) as error:
            raise JournalError(f"this version of ur-emulator cannot make the robot of the run: {error}") from error

    def _begin(self, begin: Mapping[str, Any]) -> None:
        """Begin with the start of the robot, or later, with a state of it."""
        self._numbers = Numbers()
        self.periods: int = begin.get("periods", 0)
        self._verbs: int = begin.get("verbs", 0)
        self._sockets, self._modbus = ReplayedSockets(begin.get("sockets", 0)), ReplayedModbus(begin.get("requests", 0))
        self.faults.skip(begin.get("faults", 0))
        if begin:
            self.controller.rtde_inputs, self.controller.rtde_refreshed = decode(begin["rtde"], self._numbers)
            restore_state(self.controller, begin["state"])

    def _path(self, name: str) -> Path:
        """Where a file of the run is."""
        folder = self._folder.resolve()
        path = (folder / name).resolve()
        if not path.is_relative_to(folder):
            raise JournalError(f"the journal names a file outside of its folder: {name}")
        return path

    def _write_file(self, name: str, content: bytes) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content)

    def _connect(self) -> None:
        self.controller.programs.socket_backend = self._sockets
        self.controller.programs.modbus.backend = self._modbus
        self.controller.tool_line.device = self._device

    # its periods

    def _tick(self) -> None:
        self.controller.tick()
        self.periods += 1
        self._sums.append(self._checksums.of(self.controller))
        for number, steps in list(self._steps.items()):
            self._continue(number, steps)

    def _continue(self, number: int, steps: Generator[None, None, Any]) -> None:
        self._steps[number] = steps
        try:
            next(steps)
        except (StopIteration, BadArguments, NotPossible):
            del self._steps[number]

    def _apply(self, entry: Record) -> None:
        _, kind, *content = entry
        apply = getattr(self, f"_apply_{kind}", None)
        if apply is None:
            raise JournalError(f"the journal has records of an unknown kind, {kind!r}")
        try:
            apply(*content)
        except JournalValueError as error:
            raise JournalError(str(error)) from error
        except DAMAGE as error:
            raise JournalError(f"the journal has a damaged record of the kind {kind}: {error}") from error

    def _apply_post(self, content: Any, client: str = "") -> None:
        self.controller.post(decode(content, self._numbers))

    def _apply_verb(self, name: str, arguments: Any, client: str = "") -> None:
        number, self._verbs = self._verbs, self._verbs + 1
        given = decode(arguments, self._numbers)
        try:
            result = vars(self._control)[name](**given)  # which has nothing else that can be called
        except NotPossible:
            if name == "inject_fault":
                self.faults.skip()  # of ports: what it did to messages is in the journal
            return
        except BadArguments:
            return
        if isinstance(result, Generator):
            self._continue(number, result)

    def _apply_failed(self) -> None:
        """The period before this record failed in the recorded run; here, it has just been executed."""

    def _apply_left(self, number: int) -> None:
        if (steps := self._steps.pop(number, None)) is not None:
            steps.close()

    def _apply_socket(self, number: int, state: Any, failure: str, data: Any) -> None:
        self._sockets.expect(number, state, failure, decode(data, self._numbers))

    def _apply_unsent(self, number: int, send: int) -> None:
        self._sockets.refuse(number, send)

    def _apply_modbus(self, number: int, values: Any, device_error: int, connection_error: int) -> None:
        self._modbus.expect(number, decode(values, self._numbers), device_error, connection_error)

    def _apply_tool(self, data: Any) -> None:
        self._device.expect(self.periods, decode(data, self._numbers))

    def _apply_file(self, name: str, content: Any) -> None:
        self._write_file(f"programs/{name}", decode(content, self._numbers))

    def _apply_reboot(self, boot_s: float, periods_off: int) -> None:
        self.controller.programs.stop("the controller was off")
        self.faults.controller_gone()
        for _ in range(periods_off):
            self.faults.step()
        self.controller = rebooted(self.controller, boot_s, periods_off * self.controller.period_s)
        self._robot.controller = self.controller
        self._connect()
        if self.recorder is not None:
            self.recorder.rebooted(self.controller, boot_s, periods_off)
            self.recorder.wrap_backends(self.controller)
        self.faults.controller_back(self.controller)
        self.periods += periods_off

    def _apply_state(self, sums: str, values: dict[str, Any] | None) -> None:
        data = b64decode(sums)
        recorded = struct.unpack(f"!{len(data) // 4}I", data)
        replayed, self._sums = self._sums[-len(recorded) :] if recorded else [], []
        self.checked += len(recorded)
        period_s = self.controller.period_s
        pairs = enumerate(zip(recorded, replayed, strict=False))
        bad = next((place for place, (old, new) in pairs if old != new), None)
        now = json.loads(json.dumps(plain_values(self.controller.snapshot)))
        different = tuple(
            (name, old, now.get(name)) for name, old in (values or {}).items() if repr(old) != repr(now.get(name))
        )
        if bad is not None or different:
            first = self.periods - len(recorded) + 1 + (bad if bad is not None else len(recorded) - 1)
            time_s = self.controller.time_s - (self.periods - first) * period_s
            self.difference = Difference(first, time_s, different)

    @property
    def advice(self) -> str:
        """What may be the cause of a difference."""
        if self.header["product"] != product_version():
            return (
                f"the run is of version {self.header['product']}, this is {product_version()}: a change of behaviour "
                "between them (see CHANGELOG.md)"
            )
        if self.header["machine"] != (here := platform.machine()):
            return f"the run is of a {self.header['machine']} machine, this is {here}: their arithmetic may differ"
        if "begin" in self.header:
            return "the journal begins with the state of a robot at rest, which lacks something of this run"
        if left_out := self.header["left_out"]:
            return f"{len(left_out)} files did not fit into the journal, such as {left_out[0]}"
        return "something entered the robot that the journal does not have: please report it with the journal"


def executed(journal: bytes, until: Callable[[Replay], bool] | None = None, *, checked: bool = True) -> Replay:
    """A run that has been executed again, to its end or until a condition is true, and can go on, recorded anew.

    Raises BadArguments for what is no journal, NotPossible for a run that is another one here.
    """
    try:
        replay = Replay(journal, again=MemorySink(), checked=checked)
        with ExitStack() as failing:
            failing.enter_context(replay)
            replay.run(None if until is None else lambda _: until(replay))
            if replay.difference is not None:
                raise NotPossible(f"the run cannot be repeated: {replay.difference}; {replay.advice}")
            failing.pop_all()
    except JournalError as error:
        raise BadArguments(str(error)) from error
    return replay


class _NoPower:
    """Faults that switch the controller off: when it was on again is in the journal."""

    def switch_off(self, *, silent: bool) -> None: ...

    def switch_on(self, boot_s: float) -> None: ...
