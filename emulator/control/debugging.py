"""Debugging a program of a robot that others use, too: it pauses at breakpoints, and time goes on."""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from emulator.builtins.host import ProgramHost, StepHook
from emulator.control.verbs import Verbs, Waiting, verb
from emulator.programs.stepping import Breakpoint, SteppedProgram, Stop, Wish, program_frames
from emulator.snapshot import Snapshot
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState
from urscript.runtime import ScriptThread

if TYPE_CHECKING:
    from emulator.controller import Controller

_ACTIONS: Final = ("threads", "stack", "globals", "evaluate", "set_variable", "source")
_MOST_PERIODS: Final = 1000


class LiveDebuggee(SteppedProgram):
    """The programs of a controller that start from now on, which stop where they are asked to.

    text: the program in the editor's file, and offset: the lines before it. Its breakpoints hold only in this program;
    those at functions hold in all.
    """

    def __init__(self, controller: "Controller", text: str, offset: int) -> None:
        super().__init__()
        self.controller = controller
        self._text, self._offset = text.rstrip(), offset
        self._of_file = False  # the program that runs
        self._stop: Stop | None = None
        self._told = False  # about the stop, which may come between two calls
        self._next: ScriptThread | None = None  # goes on with the statement at which it stopped
        self._over = False
        self._hook_before: StepHook | None = controller.programs.step_hook
        controller.programs.step_hook = self._statement
        self._unsubscribe = controller.subscribe(self._look)

    def end(self) -> None:
        """Let the program go on without stops."""
        if self._over:
            return
        self._over = True
        self._unsubscribe()
        programs = self.controller.programs
        if programs.step_hook == self._statement:
            programs.step_hook = self._hook_before
        self._resume()

    def go(self, mode: str, periods: int, thread: int = -1, depth: int = 0) -> Waiting[Stop]:
        """Go on, and wait for the next stop: at most for so many periods, after which it has no reason."""
        self.wish = Wish(mode, thread, depth)
        if self._told:
            self._resume()
        for _ in range(periods):
            if self._stop is None:
                self._stop = self.problem_stop()
            if self._stop is not None:
                self._told = True
                return self.said(self._stop)
            yield
        return self.said(Stop("", self.number, -1, 0))

    def source(self) -> str | None:
        """The text of the program; None if it is that of the editor's file, or if none runs."""
        return None if self.runtime is None or self._of_file else self.runtime.program.source

    def _resume(self) -> None:
        self._told = False
        if self._stop is not None:
            self._stop = None
            self.controller.programs.resume()

    def _statement(self, host: ProgramHost, line: int, column: int, thread: ScriptThread) -> bool:
        if self._hook_before is not None and self._hook_before(host, line, column, thread):
            return True
        if host.secondary or self._over:
            return False
        if self._stop is not None:
            if self.controller.programs.paused:
                return True  # every thread waits
            self._stop, self._told = None, False  # somebody else has resumed the program
        if host.runtime is not self.runtime:
            self.runtime, self._next = host.runtime, None
            self._of_file = host.runtime.program.source.rstrip() == self._text
            self.offset = self._offset if self._of_file else 0
        if thread is self._next:
            self._next = None
            self.number += 1
            return False
        frames = program_frames(sys._getframe(1))
        # Lines of other programs are not those of the editor's file.
        reason = self.reason(thread.id, line + self.offset if self._of_file else 0, frames)
        if not reason or not self.controller.programs.pause(f"debugger: {reason}"):
            self.number += 1
            return False
        self._stop = Stop(reason, self.number, thread.id, line + self.offset, len(frames))
        self._next = thread
        return True

    def _look(self, snapshot: Snapshot) -> None:
        self.look(snapshot, stopped=self.controller.safety.stopped)
        if snapshot.runtime_state == RuntimeState.STOPPED and self.runtime is not None:
            self.runtime = self._next = self._stop = None


class DebuggingVerbs(Verbs):
    """Verbs for `urscript dap`, which attaches to a running emulator."""

    _debuggee: LiveDebuggee | None = None

    @verb
    def debug(self, text: str, offset: int = 0) -> bool:
        """Begin to debug: programs that start from now on stop where ``debug_stops`` says.

        ``text``: the program in an editor's file, to whose lines breakpoints refer, with ``offset`` lines before it. A
        session that another editor has begun is over then. Returns whether a program runs already: that one cannot be
        stopped, start it again.
        """
        if self._debuggee is not None:
            self._debuggee.end()
        self._debuggee = LiveDebuggee(self.controller, text, offset)
        return self.controller.programs.busy

    @verb
    def debug_stops(self, lines: list[dict[str, Any]], functions: list[str], stop_on: list[str]) -> None:
        """Replace the stops of a debugger: lines (line, condition, hits, log), functions, ``exception`` and others."""
        try:
            self._session.set_breakpoints([Breakpoint(**one) for one in lines], functions, stop_on)
        except TypeError as error:
            raise BadArguments(f"{lines}: {error}") from error

    @verb
    def debug_go(self, mode: str, periods: int, thread: int = -1, depth: int = 0) -> dict[str, Any]:
        """Go on (continue, pause, over, in, out) until the program stops; without a reason if so many periods end."""
        if not 0 < periods <= _MOST_PERIODS:
            raise BadArguments(f"periods: 1 to {_MOST_PERIODS}, not {periods}")
        return self._wait(_as_dict(self._session.go(mode, periods, thread, depth)))

    @verb
    def debug_ask(self, question: str, **arguments: Any) -> Any:
        """Look at a program that stands still: threads, stack, globals, evaluate, set_variable or source."""
        if question not in _ACTIONS:
            raise BadArguments(f"{question!r} is none of {', '.join(_ACTIONS)}")
        answer: Callable[..., Any] = getattr(self._session, question)
        try:
            found = answer(**arguments)
        except (ValueError, TypeError, IndexError) as error:
            raise BadArguments(str(error)) from error
        return [frame._asdict() for frame in found] if question == "stack" else found

    @verb
    def debug_end(self) -> None:
        """End the session of a debugger: the program goes on without stops."""
        if self._debuggee is not None:
            self._debuggee.end()
            self._debuggee = None

    @property
    def _session(self) -> LiveDebuggee:
        if self._debuggee is None or self._debuggee.controller is not self.controller:
            raise NotPossible("no debugger is attached, or the robot was restarted since: call debug first")
        return self._debuggee


def _as_dict(steps: Waiting[Stop]) -> Waiting[dict[str, Any]]:
    return (yield from steps)._asdict()
