"""Runs programs: one main program, secondary ones alongside it (`emulator.builtins.host`), and the change of programs.

A new main program ends the running one. The old one's sockets are closed immediately, and the
next program starts some control periods later: otherwise, a driver that handles its listening
socket before its connected ones would take the new connection for a second client. If several
programs are submitted in that gap, the last one runs.

A program that does not compile changes nothing: the running one continues. A long one is
compiled over several periods (`emulator.programs.compiling`), during which the running one
continues too; any stop of the main program then also drops the one being compiled.

Two rules for programs that a client sends surprise its users (issue 123 of the official client library, URSim 5.12,
two people): a program sent while another one is paused only ends that one, and starts when it is sent again; one sent
while the brakes are engaged is left paused before its first statement. A program that a safety stop has paused is
replaced instead: the library's own tests send one after "unlock protective stop", and it has to start within a second.
That a safety stop counts like engaged brakes until then, and that CB3 controllers do the same, are guesses.
"""

from collections.abc import Mapping
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Any, Final

from emulator.builtins.host import ProgramHost, StepHook
from emulator.lifecycle.runstate import RTDE_WATCHDOG, RunEvent, next_run_state
from emulator.machine import Machine
from emulator.programs.breakpoints import Breakpoints
from emulator.programs.compiling import CompiledTexts, Compiling, Submission
from emulator.programs.interpreter import Interpreter
from emulator.programs.loading import LoadedProgram, Player
from emulator.programs.overrun import watch
from emulator.programs.secondary import SecondaryPrograms
from emulator.programs.view import ProgramView
from emulator.services.outputs import RunstateOutputs
from emulator.services.sockets import NoNetwork, ScriptSocketBackend
from emulator.services.watchdog import MotionHistory, Watchdogs
from emulator.snapshot import Snapshot
from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import PROGRAM_PAUSED, PROGRAM_RESUMED, PROGRAM_STARTED, PROGRAM_STOPPED
from urproto.versions import Series
from urscript.compiler import CompiledProgram
from urscript.runtime import Runtime
from urscript.work import Steps

_SOCKET_GAP_S: Final = 0.012  # from closing sockets to the next program; the official driver needs more than 0.2 ms
# Duration of RESUMING. The durations of controllers are not public; drivers that react to the state receive it at
# least ten times a second, and must see it (guess).
_RESUMING_S: Final = 0.1
_READS_STATE: Final = "get_rtde_value"  # the only built-in that does
_PAUSED: Final = (RuntimeState.PAUSING, RuntimeState.PAUSED)
_RUNNING: Final = (RuntimeState.PLAYING, RuntimeState.RESUMING)
_FLAGS: Final = 32  # Script Manual, set_flag
_MAX_WARNINGS: Final = 100  # of one program, in the log
_NOT_READY: Final = "power the arm on, release its brakes, clear any stop"
# Script Manual, modbus_set_runstate_dependent_choice: these, and runtime exceptions, end a program unscheduled
_UNSCHEDULED_ENDS: Final = (SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT)


class Programs:
    """All programs of one controller.

    ``state``: the main program's run state. ``view``: the main program that runs or ran last.
    ``socket_backend``: opens the sockets of scripts. ``step_hook``: called before each statement
    of programs submitted while it is set; a thread for which it returns True waits a period and
    is checked again. ``breakpoints``: nodes at which the main program is paused.
    ``interpreter``: lines for the main program. ``history``, ``flags``, ``outputs``, ``modbus``
    and ``loaded`` outlive a program. ``start_held``, ``frames_held``: faults prevent programs
    from starting, or from continuing.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.state = RuntimeState.STOPPED
        self.view: ProgramView | None = None
        self.socket_backend: ScriptSocketBackend = NoNetwork()
        self.step_hook: StepHook | None = None
        self.breakpoints = Breakpoints(self.pause, lambda: self.paused)
        self.start_held = self.frames_held = False
        self.watchdogs = Watchdogs()
        self.history = MotionHistory(machine.period_s)
        self.outputs = RunstateOutputs(machine.signals, machine.registers.output, lambda: machine.power.report.powered)
        self.modbus = machine.modbus
        self.flags = [False] * _FLAGS
        self._replaceable = False  # whether a safety stop has paused the program, and not a client
        self.pause_codes: set[tuple[int, int | None]] = set()  # pause_on_error_code: code and argument, None for any
        self.high_holding_torque = True
        self.jerk_gain_scaling = 1.0
        self.chance = machine.chances.stream("random()")
        self.motion_version = 1  # guess: the value of motion_version_get() before it is set
        self._compiling = Compiling(machine.work)
        self.interpreter = Interpreter(machine.work, self._note, machine.motion.commands.abort)
        self._player = Player(machine, self, self._compiling.texts)
        self._main: Runtime | None = None
        self.host: ProgramHost | None = None
        self._ended = ""  # name of the program that is STOPPING
        self._next: CompiledProgram | None = None
        self._reads_state = False
        self._secondary = SecondaryPrograms(machine, self)
        self._not_before = 0  # step from which the next program may start
        self._resumed = 0  # step from which a program that is RESUMING plays

    # state

    @property
    def name(self) -> str:
        """Name of the running program, else of the loaded file, else empty."""
        if self.host is not None:
            return self.host.name
        return self.loaded.path.name if self.loaded else ""

    @property
    def loaded(self) -> LoadedProgram | None:
        """The program that ``play`` starts."""
        return self._player.loaded

    @property
    def loaded_ran(self) -> bool:
        """Whether the program of ``view`` is the loaded one."""
        return self.view is not None and self._player.made(self.view.program)

    @property
    def busy(self) -> bool:
        """Whether a program is running, paused, waiting or being compiled."""
        waiting = bool(self._next or self._secondary or self._compiling.waiting)
        return waiting or self.state is not RuntimeState.STOPPED

    @property
    def texts(self) -> CompiledTexts:
        return self._compiling.texts

    @property
    def texts_waiting(self) -> int:
        """Number of programs that are not compiled yet."""
        return len(self._compiling.waiting)

    @property
    def line(self) -> int:
        """Line of the main program being executed, 0 without a program."""
        return self._main.line if self._main else 0

    @property
    def variables(self) -> Mapping[str, Any]:
        return self._main.globals if self._main else {}

    @property
    def source(self) -> str | None:
        """Text of the main program that runs or ran last."""
        return self.view.program.source if self.view else None

    def pauses_on(self, code: int, argument: int) -> bool:
        """Whether the playing program is to be paused instead when this error would stop the arm."""
        if not self.pause_codes or self.state is not RuntimeState.PLAYING:
            return False
        return not self.pause_codes.isdisjoint(((code, None), (code, argument)))

    # requests of clients

    def submit(self, text: str, origin: str = "") -> Submission:
        """Run a text: a ``sec`` program alongside the main one, any other program in its place.

        The decision is immediate if the text is short or was compiled before, otherwise it takes
        some periods, in the order of submission. A text is not accepted if it does not compile, if
        the arm is not ready for a main program (a message gives the reason), or after a stop. origin: see `Submission`.
        """
        return self._compile(Submission(text, self._machine.version, self.step_hook is not None, origin=origin))

    def _compile(self, submission: Submission) -> Submission:
        self._machine.messages.trace("program: %s bytes to be compiled", len(submission.text))
        self._compiling.add(submission)
        self._decide()
        return submission

    def load_steps(self, path: Path) -> Steps[None]:
        """Load the program that ``play`` starts and end the running one, in pieces for a control loop.

        Raises ProgramLoadError or OSError; the program loaded before then remains.
        """
        before = self.loaded
        yield from self._player.load_steps(path)
        if before is None or before.path != path:
            self.breakpoints.set(())
        self.stop("another program was loaded")

    def load_default_steps(self, path: Path) -> Steps[None]:
        """Like `load_steps`, for a booting controller: a program that clients have loaded or started already stays."""
        return self._player.load_steps(path, by_default=True)

    def play(self, start_at: int = 0) -> Submission:
        """Resume the paused program or start the loaded one; not accepted if neither is possible.

        start_at: number of the node at which a program tree starts, 0 for the whole program.
        """
        if self.state in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            return self._answer(self.resume())
        if self.state in _RUNNING or self._next is not None:
            return self._answer(True)
        coming = [submission for submission in (*self._compiling.waiting, self._player.waiting) if submission]
        if mains := [submission for submission in coming if submission.main]:
            return mains[-1]
        submission = self._player.submission(stepped=self.step_hook is not None, start_at=start_at)
        if submission is None:
            return self._answer(False)
        return submission if submission is self._player.waiting else self._compile(submission)

    def _answer(self, accepted: bool) -> Submission:
        """A decided submission without a text, for requests that need no compiling."""
        return Submission("", self._machine.version, accepted=accepted)

    def pause(self, reason: str = "", *, for_safety: bool = False) -> bool:
        """Bring the arm to rest on its path and hold the program; returns False if none runs."""
        if not self._event(RunEvent.PAUSE):
            return False
        self._replaceable = for_safety
        self._machine.motion.pause()
        self._note(reason)
        self._machine.messages.key(PROGRAM_PAUSED, self.name)
        return True

    def resume(self) -> bool:
        """Continue after a pause; returns False if the program is not paused or the arm may not move."""
        if not self._machine.may_play or not self._event(RunEvent.RESUME):
            return False
        if self.host is None or self.host.waiting_for is None:
            self._machine.motion.resume()
        self._resumed = self._machine.step_count + ceil(_RESUMING_S / self._machine.period_s)
        self._machine.messages.key(PROGRAM_RESUMED, self.name)
        return True

    def stop(self, reason: str = "") -> bool:
        """End the main program, paused or not, and those about to start; returns False if there is none."""
        withdrawn = self._player.drop()
        dropped = self._compiling.drop_main()
        return self._stop_main(reason) or dropped or withdrawn

    def _stop_main(self, reason: str) -> bool:
        waiting, self._next = self._next, None
        if not self._event(RunEvent.STOP):
            return waiting is not None
        self._note(reason)
        self._end()
        return True

    def abandon(self) -> None:
        """Discard all programs, even if the running one is in an inconsistent state; used by the guard."""
        main, host = self._main, self.host
        self._ended, self._main, self.host, self._next = self.name, None, None, None
        self.state, self._not_before = RuntimeState.STOPPED, 0
        self._secondary.clear()
        self.watchdogs.clear()
        self.pause_codes.clear()
        for leave in (
            self._compiling.abandon,
            self._player.drop,
            self.interpreter.program_ended,
            *((main.stop,) if main is not None else ()),
            *((host.sockets.close_all, host.withdraw_dialogues) if host is not None else ()),
        ):
            with suppress(Exception):
                leave()

    # once a control period

    def step(self) -> None:
        """Run every program for one control period."""
        machine = self._machine
        # Data that programs query comes first: the state at the end of the last period, and answers of Modbus units.
        self.history.record(machine.arm.measured_q, machine.arm.tcp_force)
        self.modbus.step(machine.step_count)
        # A watchdog stops the old program, never one that starts in this period.
        self._feed_watchdogs()
        # Ends before starts: an accepted program ends the running one, which has settled when the arm is at rest; only
        # then can the next one start. A program that replaces another at rest therefore starts in the same period.
        if (answered := self._player.step()) is not None:
            self._compiling.add(answered)
        self._decide()
        # Interpreted lines use the rest of the work budget; the next one is for texts that arrive before the next step.
        self.interpreter.step()
        self._machine.work.new_period()
        self._settle()
        self._start_next()
        # Secondary programs run before the main one, which sees their changes in the same period.
        self._secondary.run(self.host)
        if self._frame_is_due():
            self._run_main()

    @property
    def may_read_state(self) -> bool:
        """Whether a program may read the state as published in the next period."""
        return bool(
            self._reads_state
            or self._next is not None
            or self._secondary
            or self._player.waiting
            or self._compiling.waiting
            or self.interpreter.active
        )

    @property
    def paused(self) -> bool:
        return self.state in _PAUSED

    def publish(self, snapshot: Snapshot) -> None:
        state = self.state
        snapshot.runtime_state = state
        snapshot.program_name = self.name
        snapshot.script_control_line = self.line
        snapshot.program_running = state in _RUNNING
        snapshot.program_paused = state in _PAUSED

    def _feed_watchdogs(self) -> None:
        if self.state is not RuntimeState.PLAYING or not self.watchdogs:
            return
        for watchdog in self.watchdogs.expired(self._machine.step_count, self._machine.rtde_refreshed):
            reason = f"RTDE watchdog: {watchdog.variable} was not written in time"
            if watchdog.action == "stop" and not self.pauses_on(RTDE_WATCHDOG.code, RTDE_WATCHDOG.argument):
                self._stop_main(reason)
                self._machine.protective_stop(RTDE_WATCHDOG)
            elif watchdog.action != "ignore":
                self.pause(reason)

    def _settle(self) -> None:
        """Complete a transition once the arm permits it."""
        motion = self._machine.motion
        if self.state is RuntimeState.RESUMING:
            if self._machine.step_count >= self._resumed:
                self._event(RunEvent.SETTLED)
                self.watchdogs.restart(self._machine.step_count)
        elif self.state is RuntimeState.PAUSING and not any(motion.qd):
            self._event(RunEvent.SETTLED)
        elif self.state is RuntimeState.STOPPING and (motion.idle or self._next is not None):
            self._event(RunEvent.SETTLED)
            self._machine.messages.key(PROGRAM_STOPPED, self._ended)

    def _start_next(self) -> None:
        program = self._next
        if program is None or self.start_held or self.state is not RuntimeState.STOPPED:
            return
        if self._machine.step_count < self._not_before:
            return
        self._next = None
        self._machine.freedrive_inputs.release()
        if self._machine.version.series is Series.E and self._player.made(program):
            # A vendor's engineer, of programs that the pendant plays (ROS driver, issues 512 and 643). Their preamble
            # sets the payload, which zeroes the sensor; a script that a client sends has no preamble (guess).
            self._machine.arm.zero_force()
        self._reads_state = _READS_STATE in program.builtins
        self.host = ProgramHost(self._machine, self, name=program.name)
        self._main = Runtime(program, self.host)
        self.host.attach(self._main)
        self.view = ProgramView(self.view.number + 1 if self.view else 1, self._main)
        self.interpreter.program_started(self._main)
        self.breakpoints.program_started()
        self._event(RunEvent.START)
        self._machine.speed.program_started()
        self._machine.motion.time.restart()
        self.outputs.program_started()
        self.modbus.program_started()
        self._machine.messages.key(PROGRAM_STARTED, program.name)
        if not self._machine.may_play:
            self.pause(f"{program.name} waits: {_NOT_READY}, then play")
            self._machine.motion.time.freeze()  # its first frame is that after the pause

    def _refuse(self, program: CompiledProgram) -> None:
        self._report(f"program {program.name} was not started: {_NOT_READY}")

    def _run_main(self) -> None:
        main, host = self._main, self.host
        assert main is not None
        assert host is not None
        if self.frames_held:
            return
        main.step()
        if main.error is not None:
            self._machine.messages.runtime_exception(main.error.line, main.error.column, main.error.message)
        if main.parked is not None:
            watch(main, main.parked, self._machine, rushes=host.rushes(main.parked))
        if main.finished and self._event(RunEvent.FINISH):
            self._end()

    def _frame_is_due(self) -> bool:
        """Whether the program's time has reached its next frame. A pause slows it down together with the arm."""
        motion = self._machine.motion
        if self.state is RuntimeState.PAUSING or (self.state in _RUNNING and self._suspended()):
            return motion.slowing and motion.time.frame()
        return self.state in _RUNNING and motion.time.frame()

    def _suspended(self) -> bool:
        """Whether a blocking popup holds the program; the arm waits on its path."""
        host = self.host
        if host is None or (popup := host.waiting_for) is None:
            return False
        if popup.open:
            return True
        host.waiting_for = None
        self._machine.motion.resume()
        return False

    # starting and ending programs

    def _decide(self) -> None:
        """Start, refuse or queue the submissions that are compiled by now."""
        while (submission := self._compiling.next()) is not None:
            program = self._compiled(submission)
            submission.accepted = program is not None and self._accept(program, submission)
            if submission.refusal and submission.origin:
                self._machine.messages.refused(submission.origin, submission.refusal)
            self._machine.messages.trace(
                "program: %s is %s",
                program.name if program else "a text",
                "accepted" if submission.accepted else "refused",
            )

    def _compiled(self, submission: Submission) -> CompiledProgram | None:
        program, error = submission.program, submission.error
        if submission.refusal:
            self._report(submission.refusal)
        if error is not None:
            self._machine.messages.compile_error(error.line, error.column, error.wire)
            self._note(error.render())
            submission.refusal = f"line {error.line}, column {error.column}: {error.message}"
        if program is None:
            return None
        shown, rest = program.warnings[:_MAX_WARNINGS], len(program.warnings) - _MAX_WARNINGS
        for warning in shown:
            self._note(f"{program.name}:{warning.line}:{warning.column}: {warning.message}")
        if rest > 0:
            self._note(f"{program.name}: {rest} more calls will fail when they are executed")
        return program

    def _accept(self, program: CompiledProgram, submission: Submission) -> bool:
        if program.kind == "secondary":
            self._secondary.add(program)
            return True
        if submission.of_file and not self._machine.may_play:
            self._refuse(program)
            submission.refusal = _NOT_READY
            return False
        if self.paused and not self._replaceable and not submission.of_file:
            self.stop(f"{program.name} was sent while it was paused")
            submission.refusal = "it ended a paused program: send it again to start it"
            self._note(f"{program.name} was not started: {submission.refusal}")
            return False
        if not self._machine.may_play:
            submission.refusal = f"it waits paused: {_NOT_READY}, then play"
        self._player.drop()
        self._stop_main("replaced by another program")
        self._next = program
        return True

    def _end(self) -> None:
        """Clean up everything of the main program."""
        machine, main, host = self._machine, self._main, self.host
        assert main is not None
        assert host is not None
        main.stop()
        self.interpreter.program_ended()
        self.breakpoints.program_stopped()
        if len(host.sockets):
            host.sockets.close_all()
            self._not_before = machine.step_count + host.frames(_SOCKET_GAP_S)
        host.withdraw_dialogues()
        self.watchdogs.clear()
        self.pause_codes.clear()
        machine.motion.program_stopped()
        unscheduled = main.error is not None or machine.safety.mode in _UNSCHEDULED_ENDS
        self.outputs.program_stopped(unscheduled=unscheduled)
        self.modbus.program_stopped(unscheduled=unscheduled)
        self._ended, self._main, self.host = host.name, None, None

    def _event(self, event: RunEvent) -> bool:
        """Apply an event to the run-state table; returns False if it changes nothing."""
        state = next_run_state(self.state, event)
        if state is self.state:
            return False
        self._machine.messages.trace("program: %s leads from %s to %s", event.name, self.state.name, state.name)
        self.state = state
        return True

    def _report(self, text: str) -> None:
        self._machine.messages.text(text)

    def _note(self, text: str) -> None:
        if text:
            self._machine.messages.note(text)
