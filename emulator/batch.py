"""Runs a file of URScript programs to its end: submits the programs, reports messages, and determines the result.

    batch = Batch(controller, file, print_line=print)
    while not batch.done:
        batch.tick()

It needs no operator: blocking popups are closed (the controller's ``popup_auto_close_s``), and the run ends if a
program waits for anything else.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from emulator.builtins.host import ProgramHost
from emulator.control.modes import SignalVerbs
from emulator.control.verbs import ServedRobot
from emulator.controller import Controller
from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import (
    ErrorCodeMessage,
    KeyMessage,
    PopupMessage,
    RequestValueMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)
from urscript.errors import ScriptError
from urscript.files import FileUnit, ScriptFile
from urscript.runtime import ScriptThread

_SECONDARY_FAILED: Final = "SECONDARY_PROGRAM_EXCEPTION_XXX"


@dataclass(frozen=True, slots=True)
class Stimulus:
    """A verb that acts on the signals or registers of the controller at a time [s] of the run."""

    at_s: float
    verb: str
    arguments: Mapping[str, Any]

    def apply(self, controller: Controller) -> None:
        """Do it now."""
        call = getattr(SignalVerbs(ServedRobot(controller)), self.verb)
        act(controller, self.verb, self.arguments, partial(call, **self.arguments))


def act(controller: Controller, verb: str, arguments: Mapping[str, Any], call: Callable[[], Any]) -> None:
    """Do what a verb does; what records the controller records it as that."""
    if (recorder := controller.recorder) is None:
        call()
    else:
        recorder.called(verb, arguments, call, "")


class Batch:
    """One run. The programs of the file must compile for the controller's version.

    print_line: called with every line of the report. trace: also report every executed statement.
    timeout_s: maximum robot time [s]. answers: answers to the questions of the programs, in order, as an operator would
    type them. stimuli: actions on the controller during the run.

    ``done``: whether the run is over. ``failure``: why the run failed; empty if it succeeded.
    ``error``: the error that ended a program, with its position in the file. ``time_s``: robot time since the beginning
    [s].
    """

    def __init__(
        self,
        controller: Controller,
        file: ScriptFile,
        print_line: Callable[[str], None],
        *,
        trace: bool = False,
        timeout_s: float | None = None,
        answers: Sequence[str] = (),
        stimuli: Sequence[Stimulus] = (),
    ) -> None:
        self.done = False
        self.failure = ""
        self._controller = controller
        self._file = file
        self._print_line = print_line
        self.timeout_s = timeout_s
        self.error: ScriptError | None = None
        self._began_s = controller.time_s
        self._answers = deque(answers)
        self._stimuli = deque(sorted(stimuli, key=lambda stimulus: stimulus.at_s))
        self._waiting = deque(file.units)
        self._main: FileUnit | None = None  # the one submitted last
        self._secondary: FileUnit | None = None  # as above
        self._reporters: dict[type, Callable[[Any], None]] = {
            TextMessage: lambda message: self._report(message.text),
            PopupMessage: self._popup,
            RequestValueMessage: self._question,
            KeyMessage: self._key,
            RuntimeExceptionMessage: self._exception,
            SafetyModeMessage: self._safety_mode,
            ErrorCodeMessage: lambda message: self._report(f"{message.label} {message.text}"),
        }
        self._host: ProgramHost | None = None  # of the main program that runs, or ran last
        self._last_note = ""
        controller.messages.on_note = self._note
        if trace:
            self._lines = file.text.split("\n")
            controller.programs.step_hook = self._step

    @property
    def time_s(self) -> float:
        return self._controller.time_s - self._began_s

    def tick(self) -> None:
        """Run one control period. Does nothing once the run is over."""
        if self.done:
            return
        while self._stimuli and self._stimuli[0].at_s <= self.time_s:
            self._stimuli.popleft().apply(self._controller)
        self._submit()
        self._controller.tick()
        for message in self._controller.new_messages:
            self._reporters.get(message.__class__, lambda _: None)(message)
        self._observe()
        self._judge()

    def stop(self, failure: str) -> None:
        """End the run now, as failed."""
        self.failure = self.failure or failure
        self._controller.programs.stop()
        self.done = True

    def _submit(self) -> None:
        """Submit the next program: a main program once the one before has ended, a secondary program immediately."""
        programs = self._controller.programs
        if self._waiting and (self._waiting[0].secondary or not programs.busy):
            unit = self._waiting.popleft()
            if unit.secondary:
                self._secondary = unit
            else:
                self._main = unit
            act(self._controller, "send_script", {"text": unit.text}, lambda: programs.submit(unit.text))

    def _observe(self) -> None:
        """A main program that a watchdog, a stop or anything else has ended before its end is a failure."""
        before, self._host = self._host, self._controller.programs.host or self._host
        if before is None or self._controller.programs.host is before or self._controller.shutdown_requested:
            return
        if before.runtime.interrupted:
            reason = f": {self._last_note}" if self._last_note else ""
            self.failure = self.failure or f"the program was stopped before its end{reason}"

    def _judge(self) -> None:
        programs = self._controller.programs
        if self.failure:
            self.stop(self.failure)
        elif programs.state is RuntimeState.PAUSED:
            self.stop("the program was paused, and no operator is there to resume it")
        elif not (programs.busy or self._waiting):
            self.done = True
        elif self.timeout_s is not None and self.time_s >= self.timeout_s:
            self.stop(f"not finished within {self.timeout_s:g} s")

    # report

    def _note(self, text: str) -> None:
        self._last_note = text
        self._report(text)

    def _report(self, text: str) -> None:
        self._print_line(f"[{self.time_s:9.3f} s] {text}")

    def _popup(self, message: PopupMessage) -> None:
        kind = "error" if message.error else "warning" if message.warning else "popup"
        continued = " (continued)" if message.blocking else ""
        self._report(f"{kind} {message.title}: {message.text}{continued}")

    def _question(self, message: RequestValueMessage) -> None:
        if not self._answers:
            self._report(f"question: {message.text}")
            self.failure = "the program asks the operator for a value: give one with --answer"
            return
        answer = self._answers.popleft()
        self._report(f"question: {message.text} (answered {answer})")
        try:
            self._controller.popups.answer_typed(answer)
        except ValueError as error:
            self.failure = f"the answer {answer!r} was refused: {error}"

    def _key(self, message: KeyMessage) -> None:
        if message.title == _SECONDARY_FAILED:
            self._report(f"secondary program: {message.text}")
            self.failure = "a secondary program failed"

    def _exception(self, message: RuntimeExceptionMessage) -> None:
        error = ScriptError(message.text, message.line, message.column)
        if self._main is not None:
            error = self._file.located(error, self._main)
        self.error = error
        self._report("runtime exception")
        self._print_line(error.render(self._file.name))
        self.failure = f"runtime exception: line {error.line}: {error.message}"

    def _safety_mode(self, message: SafetyModeMessage) -> None:
        mode = SafetyMode(message.safety_mode)
        self._report(f"safety mode {mode.name}")
        if self._controller.safety.stopped:
            self.failure = f"the arm was stopped: {mode.name.lower().replace('_', ' ')}"

    def _step(self, host: ProgramHost, line: int, _column: int, thread: ScriptThread) -> bool:
        unit = self._secondary if host.secondary else self._main
        assert unit is not None, "only submitted programs run"
        line += unit.lines_before
        self._report(f"{thread.name}:{line}: {self._lines[line - 1].strip()}")
        return False
