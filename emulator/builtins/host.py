"""The interface of built-ins to the machine and to their program, with the rules of motion ownership."""

import logging
import math
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager
from random import Random
from typing import Final, Protocol, TypeAlias, TypeVar

from emulator.machine import Machine
from emulator.motion import Motion, MotionCommands, Move
from emulator.reporting.popups import Popup
from emulator.robot.arm import Arm
from emulator.services.modbus import ModbusSignals
from emulator.services.outputs import RunstateOutputs
from emulator.services.sockets import ScriptSocketBackend, SocketTable
from emulator.services.watchdog import MotionHistory, Watchdog, WatchdogAction, Watchdogs
from urproto.robots.model import Joints
from urproto.vectors import as_six
from urscript.errors import RuntimeFault
from urscript.interpreter import Locals
from urscript.meter import charge
from urscript.runtime import Runtime, ScriptThread

ResultT = TypeVar("ResultT")
Frames: TypeAlias = Generator[None, None, ResultT]
"""A built-in that takes physical time: every bare ``yield`` ends the frame of its thread."""

StepHook: TypeAlias = Callable[["ProgramHost", int, int, ScriptThread], bool]
"""Called with program, line, column (from 1) and thread of the next statement; True holds the thread for a period."""

_logger = logging.getLogger(__name__)

_TIMELESS_WORK: Final = 400  # of a command of the arm for no time, so that a loop of them cannot delay the robot
_ROUNDING: Final = 1e-6  # of a control period; 0.008 / 0.002 must be 4 periods, not 5


class InterpreterMode(Protocol):
    """Statements that clients send to the running program (`emulator.programs.interpreter`)."""

    @property
    def active(self) -> bool:
        """Whether the program is executing statements of clients."""

    def enter(self, scope: Locals, *, clear_queue: bool, clear_on_end: bool) -> None:
        """Start executing statements, in this scope."""

    def execute(self) -> Generator[bool | None, None, None]:
        """Execute the statements, one after the other, until the mode ends."""

    def end(self) -> None:
        """Leave the mode after this statement."""

    def leave(self) -> None:
        """Clean up after the call, even if its thread was killed."""

    def clear(self) -> None:
        """Remove the statements executed so far."""


class LabelBreaks(Protocol):
    """Labels at which the main program pauses (`emulator.programs.breakpoints`)."""

    armed: bool
    """Whether labels need checking at all."""

    def hold(self, number: int, option: str, thread: ScriptThread) -> bool:
        """Whether a thread at this label has to wait."""


class ProgramServices(Protocol):
    """State that outlives a program and that all programs of a controller share."""

    step_hook: StepHook | None
    """Called before each statement of programs submitted while it is set."""
    socket_backend: ScriptSocketBackend
    """Opens the sockets of scripts."""
    watchdogs: Watchdogs
    history: MotionHistory
    outputs: RunstateOutputs
    modbus: ModbusSignals
    flags: list[bool]
    pause_codes: set[tuple[int, int | None]]
    """pause_on_error_code: code and argument, None for any."""
    high_holding_torque: bool
    jerk_gain_scaling: float
    chance: Random
    """Of ``random()``."""
    motion_version: int

    @property
    def interpreter(self) -> InterpreterMode:
        """Interpreter mode."""

    @property
    def breakpoints(self) -> LabelBreaks:
        """Nodes at which the main program is paused."""


class _MotionControl:
    """Ownership of the arm by a thread of a program; see `ProgramHost.motion_control`."""

    def __init__(self, host: "ProgramHost") -> None:
        self._host = host

    def __enter__(self) -> MotionCommands:
        host = self._host
        if host.secondary:
            raise RuntimeFault(
                "Runtime is too much behind: a secondary program cannot control the robot, move in a main program"
            )
        runtime = host.runtime
        if runtime.motion_thread is not None and runtime.motion_thread is not runtime.current:
            raise RuntimeFault("Another thread is already controlling the robot")
        lost = host.motion.superposition.lost
        if lost is not None:
            raise RuntimeFault(f"the path offset, conveyor or frame tracking ended: {lost}")
        runtime.motion_thread = runtime.current
        return host.motion.commands

    def __exit__(self, *_: object) -> None:
        self._host.runtime.motion_thread = None


class ProgramHost:
    """One running program, as its built-ins see it.

    ``secondary``: a ``sec`` program, which may neither move nor take time. ``sockets``: the sockets
    the program opened, by name; a secondary program shares those of the main one. ``programs``: state
    that outlives the program. ``waiting_for``: a blocking popup that suspends the program. ``connecting``: whether a
    secondary program waits for the answer to its ``socket_open``.
    """

    def __init__(self, machine: Machine, programs: ProgramServices, *, name: str, secondary: bool = False) -> None:
        self.machine = machine
        self.programs = programs
        self.name = name
        self.secondary = secondary
        self.sockets = SocketTable()
        self.waiting_for: Popup | None = None
        self.connecting = False
        self.dialogues: list[Popup] = []
        self.label = ""  # the program label reached last
        self._motion_control = _MotionControl(self)
        self._runtime: Runtime | None = None
        self._noted: set[str] = set()
        self._rushing: tuple[ScriptThread | None, int] = (None, 0)  # who last commanded the arm for no time, and when

    def attach(self, runtime: Runtime) -> None:
        """Connect the host to the interpreter that runs its program."""
        self._runtime = runtime

    @property
    def runtime(self) -> Runtime:
        assert self._runtime is not None, "a host is attached before its program runs"
        return self._runtime

    @property
    def period_s(self) -> float:
        """Control period [s]."""
        return self.machine.period_s

    @property
    def motion(self) -> Motion:
        """The arm's motion generator, for reading. To command a movement, use ``motion_control``."""
        return self.machine.motion

    @property
    def arm(self) -> Arm:
        return self.machine.arm

    @property
    def target_q(self) -> Joints:
        """Target joint angles at the moment when the program continues [rad]."""
        return self.motion.program_q

    @property
    def actual_q(self) -> Joints:
        """Measured joint angles at the moment when the program continues [rad]."""
        measured, target, now = self.arm.measured_q, self.motion.program_q, self.motion.q
        return measured if target == now else as_six(q + a - b for q, a, b in zip(measured, target, now, strict=True))

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        """A thread reached a program label (``$ number "text"``); True holds it there."""
        self.label = text
        breakpoints = self.programs.breakpoints
        return breakpoints.armed and not self.secondary and breakpoints.hold(number, option, thread)

    def on_step(self, line: int, column: int, thread: ScriptThread) -> bool:
        """A thread of a program in single-step mode is about to execute a statement; True holds it."""
        hook = self.programs.step_hook
        return hook is not None and hook(self, line, column, thread)

    def frames(self, seconds: float) -> int:
        """Number of control periods that cover a time, at least 1. Raises RuntimeFault if the time is not finite."""
        periods = seconds / self.period_s
        if not math.isfinite(periods):
            raise RuntimeFault(f"{seconds:g} is not a time in seconds")
        return max(1, math.ceil(periods - _ROUNDING))

    def note_once(self, text: str) -> None:
        """Log a note about this program, once only: its cause may recur in every period."""
        if text not in self._noted:
            self._noted.add(text)
            _logger.warning("%s", text)
            self.machine.messages.note(text)

    def watch(self, variable: str, min_frequency_hz: float, action: WatchdogAction) -> None:
        """Take an action if an RTDE input is written less often than this from now on; 0 Hz disables the check."""
        interval = 1.0 / (min_frequency_hz * self.period_s) if min_frequency_hz else math.inf
        self.programs.watchdogs.set(Watchdog(variable, interval, action, self.machine.step_count))

    def motion_control(self) -> AbstractContextManager[MotionCommands]:
        """Own the arm inside the context, which is left even if the thread is killed, so nothing stays locked.

        Raises RuntimeFault if another thread owns the arm, if the program is secondary, or if a fault has ended a
        path offset or tracking: movements that rely on it would lead elsewhere.
        """
        return self._motion_control

    def check_main(self, name: str) -> None:
        """Raises RuntimeFault, naming the built-in, for a secondary program, which cannot control the robot."""
        if self.secondary:
            raise RuntimeFault(f"{name}: a secondary program cannot control the robot")

    def until_ready(self, move: Move) -> Frames[None]:
        """Wait until the program may continue after a movement, for at least one frame unless it is timeless.

        A movement that failed has caused a protective stop; a program that is resumed after it
        ends with an error at the movement.
        """
        if move.timeless:
            charge(_TIMELESS_WORK)
            self._rushing = (self.runtime.current, self.machine.step_count)
        else:
            thread = self.runtime.current
            assert thread is not None
            thread.awaited = move
            yield
        if move.failed is not None:
            raise RuntimeFault(f"the movement failed: {move.failed}")

    def rushes(self, thread: ScriptThread) -> bool:
        """Whether the thread has commanded the arm for no time in this control period."""
        return self._rushing == (thread, self.machine.step_count)

    def suspend(self, popup: Popup) -> Frames[None]:
        """Suspend the whole program, and the arm on its path, until a dialogue is closed.

        Other threads keep their share of the program's time while the arm slows down.
        """
        self.waiting_for = self.remember(popup)
        self.motion.pause()
        while self.waiting_for is not None:
            yield

    def remember(self, popup: Popup) -> Popup:
        """Keep track of a dialogue, to close it when the program ends."""
        self.dialogues = [*(earlier for earlier in self.dialogues if earlier.open), popup]
        return popup

    def withdraw_dialogues(self) -> None:
        """Close the program's dialogues when it has ended: nothing waits for their answers any more."""
        for popup in self.dialogues:
            self.machine.popups.withdraw(popup)
