"""Interpreter mode: lines sent to a running program become part of it and are executed in the scope of a call.

One interpreter serves all programs, one after the other. In each control period, it interprets
received lines, within the work budget of all compiling; ``interpreter_mode()`` executes them.
"""

import re
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeAlias, TypeVar

from emulator.workshare import Job, WorkShare
from urproto.interpreter import LAST_ID, InterpreterCommand, Reason, ack, discard, state
from urscript.analysis import FunctionPlan
from urscript.errors import CompileError
from urscript.interpreter import CompiledStatement, Locals, compile_statement
from urscript.runtime import Runtime

MAX_STATEMENTS: Final = 1000
"""Maximum of interpreted lines between clears, and of waiting ones (guess; the vendor's helper clears after 500)."""

CodeT = TypeVar("CodeT")
Answer: TypeAlias = Callable[[str], None]

_NOTE_LENGTH: Final = 300  # maximum length of clients' texts in the log
_HOLDING: Final = frozenset(["clear_interpreter", "end_interpreter"])
_ALWAYS_ACCEPTED: Final = re.compile(r"\s*(clear|end)_interpreter\s*\(\s*\)\s*")


@dataclass(frozen=True, slots=True)
class Received:
    """A received line and the recipient of its answer."""

    line: str
    answer: Answer


@dataclass(frozen=True, slots=True, eq=False)
class Interpreted(Generic[CodeT]):
    """A line that has become part of the program."""

    id: int
    line: str
    code: CodeT
    holds: bool  # later lines wait until it has been executed


class StatementQueue(Generic[CodeT]):
    """The lines of one program. Ids are 0 as long as there is none."""

    def __init__(self) -> None:
        self.last_interpreted = 0
        self.last_executed = 0  # or being executed
        self.last_cleared = 0
        self.executing: Interpreted[CodeT] | None = None
        self.kept: list[Interpreted[CodeT]] = []  # part of the program, oldest first
        self._waiting: deque[Received] = deque()
        self._ready: deque[Interpreted[CodeT]] = deque()
        self._holder: Interpreted[CodeT] | None = None

    @property
    def unexecuted(self) -> int:
        """Lines that `skip` would skip."""
        return len(self._waiting) + len(self._ready)

    @property
    def full(self) -> bool:
        """Whether no more lines can be interpreted before a clear."""
        return len(self.kept) >= MAX_STATEMENTS

    @property
    def next_received(self) -> Received | None:
        """The line to interpret next; None if there is none, or while lines have to wait."""
        return self._waiting[0] if self._waiting and self._holder is None else None

    def receive(self, line: str, answer: Answer) -> None:
        """Queue a line; answer immediately if too many are waiting."""
        if len(self._waiting) >= MAX_STATEMENTS:
            answer(discard(Reason.TOO_MANY, line))
        else:
            self._waiting.append(Received(line, answer))

    def accept(self, code: CodeT, *, holds: bool) -> None:
        """The next received line is interpreted."""
        received = self._waiting.popleft()
        self.last_interpreted = self.last_interpreted % LAST_ID + 1
        statement = Interpreted(self.last_interpreted, received.line, code, holds)
        self.kept.append(statement)
        self._ready.append(statement)
        if holds:
            self._holder = statement
        received.answer(ack(statement.id, received.line))

    def refuse(self, reason: Reason) -> None:
        """The next received line is not accepted."""
        received = self._waiting.popleft()
        received.answer(discard(reason, received.line))

    def start(self) -> Interpreted[CodeT] | None:
        """The statement to be executed now, if any."""
        if not self._ready:
            return None
        self.executing = self._ready.popleft()
        self.last_executed = self.executing.id
        return self.executing

    def finish(self) -> None:
        """The started statement is complete."""
        if self.executing is not None and self.executing is self._holder:
            self._holder = None
        self.executing = None

    def skip(self) -> None:
        """Drop all lines not being executed; interpreted lines stay part of the program."""
        self._ready.clear()
        if self._holder is not self.executing:
            self._holder = None
        self.discard_received(Reason.CLEANED_UP)

    def discard_received(self, reason: Reason) -> None:
        """Refuse all lines that are not interpreted."""
        while self._waiting:
            self.refuse(reason)

    def clear(self) -> list[Interpreted[CodeT]]:
        """Remove the interpreted lines, up to the statement being executed, and return them, newest first."""
        number = self.kept.index(self.executing) + 1 if self.executing in self.kept else len(self.kept)
        cleared, self.kept = self.kept[:number], self.kept[number:]
        if cleared:
            self.last_cleared = cleared[-1].id
        return cleared[::-1]

    def end(self) -> None:
        """Interpreter mode is over: lines already interpreted are not executed any more."""
        self._ready.clear()
        self._holder = self.executing = None


@dataclass(frozen=True, slots=True)
class _Linked:
    compiled: CompiledStatement
    body: Callable[[Locals], Generator[bool | None, None, Any]]
    scope: Locals


_Statement: TypeAlias = Interpreted[_Linked]


@dataclass(slots=True)
class _Mode:
    """A call of interpreter_mode()."""

    scope: Locals
    clear_on_end: bool
    ending: bool = False


class Interpreter:
    """Connects the lines of the interpreter port to the program that executes them.

    ``note`` writes to the log; ``abort`` ends a movement of the arm.
    """

    def __init__(self, share: WorkShare, note: Callable[[str], None], abort: Callable[[], None]) -> None:
        self.queue: StatementQueue[_Linked] = StatementQueue()
        self._share = share
        self._note = note
        self._abort = abort
        self._runtime: Runtime | None = None
        self._functions: dict[str, FunctionPlan] = {}  # callable functions
        self._mode: _Mode | None = None
        self._job: Job[CompiledStatement] | None = None  # compiles the next line
        self._serial = 0

    @property
    def active(self) -> bool:
        return self._mode is not None

    # the program

    def program_started(self, runtime: Runtime) -> None:
        """Direct lines to this program from now on; ids restart."""
        self.queue = StatementQueue()
        self._runtime = runtime
        self._functions = dict(runtime.program.functions)

    def program_ended(self) -> None:
        """Answer all waiting clients."""
        self._runtime = self._mode = self._job = None
        self.queue.discard_received(Reason.INVALID_STATE)

    # the port

    def receive(self, line: str, answer: Answer) -> None:
        """Process a line from a client. Commands are answered immediately, statements once they are interpreted."""
        command = InterpreterCommand.of(line)
        if self._runtime is None:
            answer(discard(Reason.INVALID_STATE, line))
        elif command is None:
            self.queue.receive(line, answer)
        else:
            answer(self._carry_out(command, line))

    def _carry_out(self, command: InterpreterCommand, line: str) -> str:
        queue = self.queue
        match command:
            case InterpreterCommand.ABORT:
                self._abort()
            case InterpreterCommand.SKIPBUFFER:
                self._job = None
                queue.skip()
            case InterpreterCommand.STATE_LAST_EXECUTED:
                return state(queue.last_executed, line)
            case InterpreterCommand.STATE_LAST_INTERPRETED:
                return state(queue.last_interpreted, line)
            case InterpreterCommand.STATE_LAST_CLEARED:
                return state(queue.last_cleared, line)
            case InterpreterCommand.STATE_UNEXECUTED:
                return state(queue.unexecuted, line)
        return ack(0, line)  # the manual says to ignore the number, but the vendor's helper requires one

    # once a control period

    def step(self) -> None:
        """Interpret received lines, as far as this period's work budget permits."""
        if self._mode is None:
            return
        while (received := self.queue.next_received) is not None:
            if self.queue.full and _ALWAYS_ACCEPTED.fullmatch(received.line) is None:
                self.queue.refuse(Reason.TOO_MANY)
            elif not self._interpret(received.line, self._mode.scope):
                return

    def _interpret(self, line: str, scope: Locals) -> bool:
        """Continue with the next line; returns False if it needs another period."""
        runtime = self._runtime
        assert runtime is not None, "interpreter mode is part of a program"
        if self._job is None:
            self._serial += 1
            self._job = Job(compile_statement(line, runtime.program, self._functions, scope, self._serial))
        try:
            if not self._share.work(self._job):
                return False
        except CompileError as error:
            self._note(_short(f"interpreter mode, {error}: {line}"))
            self._job = None
            self.queue.refuse(Reason.SYNTAX if error.wire.startswith("syntax_error") else Reason.COMPILE)
            return True
        compiled, self._job = self._job.result, None
        assert compiled is not None, "the job is done"
        self._functions.update(compiled.functions)
        scope.declare(compiled.names)
        self.queue.accept(_Linked(compiled, runtime.link(compiled), scope), holds=bool(compiled.calls & _HOLDING))
        return True

    # the built-ins

    def enter(self, scope: Locals, *, clear_queue: bool, clear_on_end: bool) -> None:
        if clear_queue:
            self.queue.discard_received(Reason.CLEANED_UP)
        self._mode = _Mode(scope, clear_on_end)

    def execute(self) -> Generator[bool | None, None, None]:
        mode, runtime, queue = self._mode, self._runtime, self.queue
        assert mode is not None, "entered before"
        assert runtime is not None, "interpreter mode is part of a program"
        while not mode.ending:
            statement = queue.start()
            if statement is None:
                yield None
                continue
            try:
                yield from runtime.interpret(statement.code.body, mode.scope)
            except Exception:
                self._note(_short(f"the program ends in interpreted statement {statement.id}: {statement.line}"))
                raise
            queue.finish()

    def end(self) -> None:
        """end_interpreter() was called: the statement being executed is the last one."""
        if self._mode is not None:
            self._mode.ending = True

    def leave(self) -> None:
        mode, self._mode, self._job = self._mode, None, None
        self.queue.end()
        if mode is not None and mode.clear_on_end:
            self.clear()

    def clear(self) -> None:
        """Remove interpreted lines from the program, and end the threads they started."""
        runtime = self._runtime
        if runtime is None:
            return
        self._job = None
        runtime.end_interpreted_threads()
        for statement in self.queue.clear():
            runtime.unlink(statement.code.compiled)
            statement.code.scope.remove(statement.code.compiled.names)
        self._functions = dict(runtime.program.functions)
        for statement in self.queue.kept:
            self._functions.update(statement.code.compiled.functions)
            statement.code.scope.declare(statement.code.compiled.names)


def _short(note: str) -> str:
    return note if len(note) <= _NOTE_LENGTH else f"{note[:_NOTE_LENGTH]}..."
