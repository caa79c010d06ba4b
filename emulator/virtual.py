"""A robot in this process, in virtual time, with the options given by a test, which can return to any moment."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final, TypeVar

from emulator.branches import Branch, Copied, can_branch
from emulator.config import controller_config
from emulator.control.control import Control
from emulator.control.snapshots import journal_document
from emulator.control.timing import ManualPace
from emulator.control.verbs import ControlledRobot, ServedRobot, Waiting
from emulator.controller import Controller
from emulator.faults.catalogue import describe, parse_fault
from emulator.faults.fault import publish_no_controller, rebooted
from emulator.faults.injector import FaultInjector
from emulator.journal.file import MemorySink
from emulator.journal.recorder import record
from emulator.journal.replay import Replay, executed
from emulator.machine import ControllerConfig
from emulator.options import CONTROLLER_OPTIONS, ROBOT_OPTIONS
from emulator.peers.connection import Peers
from emulator.services.sockets import NoNetwork
from urproto.compat import Self
from urproto.controlapi import BadArguments, NotPossible

_IRRELEVANT: Final = {*ROBOT_OPTIONS, "log_level"} - {*CONTROLLER_OPTIONS}  # without ports and real time
_RENAMED: Final = {"model", "version", "programs_dir", "gripper_object_mm"}  # fields of a configuration
_T = TypeVar("_T")


class _VirtualMachine(ControlledRobot):
    """A controller without ports, whose time advances only while a verb waits."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__(Controller(config))
        self.faults = FaultInjector(self.controller, machine=self)
        self._power_requested = True
        self._periods_off = 0
        self._boot_s = 0.0

    def switch_off(self, *, silent: bool) -> None:
        """Switch the controller off after this period, for a fault."""
        self._power_requested = False

    def switch_on(self, boot_s: float) -> None:
        self._power_requested, self._boot_s = True, boot_s

    @property
    def is_off(self) -> bool:
        """Whether a fault keeps the controller off."""
        return self._periods_off > 0

    def become(self, replay: Replay, owner: object) -> None:
        """Go on from where a replay ends."""
        self.controller = replay.leave(owner)
        self.faults.take_over(replay.faults)
        self._power_requested, self._periods_off = True, 0

    def _period(self) -> None:
        """One control period, with or without a controller."""
        if self._periods_off:
            self._periods_off += 1
            self.faults.step()
            if self._power_requested:
                self._reboot()
            return
        self.controller.tick()
        if not self._power_requested:
            self._periods_off = 1
            self.faults.controller_gone()
            self.controller.programs.stop("the controller was shut down")
            publish_no_controller(self.controller)

    def _reboot(self) -> None:
        before, periods, self._periods_off = self.controller, self._periods_off, 0
        self.controller = rebooted(before, self._boot_s, periods * before.period_s)
        self.controller.programs.socket_backend = before.programs.socket_backend
        if (recorder := before.recorder) is not None:
            recorder.rebooted(self.controller, self._boot_s, periods)
        self.faults.controller_back(self.controller)

    def wait(self, steps: Waiting[_T]) -> _T:
        while True:
            try:
                next(steps)
            except StopIteration as done:
                result: _T = done.value
                return result
            self._period()


class VirtualRobot(Control):
    """A controller without ports in virtual time, which ``step``, ``run_until`` and other waiting verbs advance.

    robot = virtual_robot("ur3")
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")

    Its run is recorded, if it was made from options. So it can return to any moment of it, also in a program and in
    motion: by executing the run again, 30 to 50 times as fast as in real time. It then has a new ``controller``, its
    programs folder is a copy, and nobody is at the other end of its programs' sockets. What is done to the
    ``controller`` other than by verbs and ``post`` is not in the run. `branch` has none of these limits, and takes
    milliseconds.
    """

    def __init__(self, config: ControllerConfig, *, recorded: bool = True, checked: bool = False) -> None:
        self._machine = _VirtualMachine(config)
        super().__init__(self._machine, ManualPace(), self._machine.faults)
        self._machine.go_on_from = self._go_on_from
        if recorded and config.options is not None:
            record(self, MemorySink(), checked=checked)

    @property
    def journal(self) -> bytes:
        """The run so far, for ``ur-emulator replay``. Raises NotPossible for a robot that is not recorded."""
        recorder = self.controller.recorder
        if recorder is None or not (journal := recorder.journal):
            raise NotPossible("the robot's run is not recorded, or was too long: make it with virtual_robot()")
        if self._machine.is_off:
            raise NotPossible("the controller is switched off: advance time until it is on again")
        return journal

    def connect(self, peers: Peers) -> None:
        """Let peers answer the programs: on sockets, and as Modbus units."""
        peers.attach(self.controller, NoNetwork())
        if (recorder := self.controller.recorder) is not None:
            recorder.wrap_backends(self.controller)

    def served(self) -> Control:
        """The verbs of this robot for a caller that lets time pass by itself: those that wait return their steps."""
        return Control(ServedRobot(self.controller), ManualPace(), self._machine.faults)

    def checkpoint(self) -> dict[str, Any]:
        """A document for ``restore`` of this moment, with the run so far: of a robot at rest, more than ``save``."""
        return journal_document(self.controller, self.journal)

    def step_back(self, periods: int = 1) -> float:
        """Return to the moment a number of control periods ago, and return its uptime [s]. Raises NotPossible."""
        journal, recorder = self.journal, self.controller.recorder
        past = recorder.periods if recorder is not None else 0
        if not 1 <= periods < past:
            raise BadArguments(f"the run is {past} periods old: it cannot go {periods} back")
        self._machine.wait(self._go_on_from(journal, past - periods))
        return self.controller.time_s

    def branch(self) -> "VirtualRobot | Branch":
        """Another robot that goes on from this moment, as this one does. Use it with ``with``, or close it.

        It is in a process of its own, a copy of this one, where the system can make such copies.
        """
        if can_branch():
            return Branch(Copied.of(self))
        other = VirtualRobot(self.controller.config)
        other.restore(self.checkpoint())
        return other

    def close(self) -> None:
        """Do nothing: nothing of it is outside this process. For callers that have a `Branch`, or this."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def _go_on_from(self, journal: bytes, periods: int | None = None) -> Waiting[None]:
        """Go on from a moment of a run: its end, or after a number of periods. Raises NotPossible, BadArguments."""
        until = None if periods is None else lambda replay: replay.periods >= periods
        with executed(journal, until, checked=False) as replay:
            if periods not in (None, replay.periods):
                raise NotPossible("the controller was switched off at that moment, or the run begins later")
            self._machine.become(replay, self)
        yield from ()


def replayed_robot(journal: bytes, *, checked: bool = False) -> VirtualRobot:
    """A robot that goes on from the end of a recorded run; checked as of `virtual_robot`.

    Raises BadArguments for what is no journal, NotPossible for a run that is another one here.
    """
    with executed(journal, checked=checked) as replay:
        robot = VirtualRobot(replay.config, recorded=False)
        robot._machine.become(replay, robot)
    return robot


def virtual_robot(
    model: str | None = None,
    *,
    fault: str | Sequence[str] = (),
    recorded: bool = True,
    checked: bool = False,
    **options: Any,
) -> VirtualRobot:
    """A robot with the options of ``ur-emulator``; those for ports and speed are ignored.

    fault: one or several, as on the command line; they use the robot's seed unless they have their own. recorded:
    whether it can return to earlier moments; checked: whether replays of its journal are compared in each period, which
    takes 5 us in each. Raises ValueError for an invalid value, TypeError for an unknown option,
    NotPossible for a fault that affects ports.
    """
    known = {*CONTROLLER_OPTIONS} - {"model"}
    known |= {field.name for field in fields(ControllerConfig)} - _RENAMED
    given = {name: value for name, value in options.items() if name not in _IRRELEVANT and value is not None}
    for option in given:
        if option not in known:
            names = ", ".join(sorted(known))
            raise TypeError(f"a robot in virtual time has no option {option!r}: choose from {names}")
    robot = VirtualRobot(controller_config(model, **given), recorded=recorded, checked=checked)
    for text in [fault] if isinstance(fault, str) else fault:
        chosen = parse_fault(text)
        robot.inject_fault(chosen.kind, **{"seed": given.get("seed", 0), **describe(chosen)})
    return robot
