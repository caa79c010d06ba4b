"""Run a program: frames, threads, critical sections.

How it works
------------
Every thread is a Python generator. `Runtime.step` is one frame (one control period): each thread
is resumed once and runs until it yields.

* A bare ``yield`` (motion, sleep, sync, a blocking read, join) means that the thread used its physical time. It
  continues in the next frame.
* ``yield True`` means that the thread's budget is empty: it was *parked* and continues in the next frame. The budget
  counts work, not time, so a program runs the same on every machine, and a busy loop never delays the controller.
  Threads share a frame's budget, and the unused part of one thread goes to the next. A thread that overdraws its budget
  (one operation on a long list) sits out frames until the debt is paid back.

Threads run in the order they were started, the program body last; a thread started in a frame
runs in that frame. The manual does not specify the order. The vendor's own RTDE example copies input registers in a
thread and acts on them in the body; if the body ran first, it would act on the values of the previous command.

Between two yields nothing else runs, so ``enter_critical`` matters only for parking: a thread parked inside a critical
section keeps all others from running until it leaves the section or uses physical time. While it waits in motion, sync,
sleep, a read or join, the others run (Script Manual 9.2; PolyScope's programs and the official control script depend on
it). A thread that finishes or is killed leaves its critical sections.

A thread handle is an int, so ``thread = 0`` is the handle of no thread: killing or joining it does nothing. Killing a
thread also kills its children.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import suppress
from types import CellType, CodeType, FrameType, FunctionType, GeneratorType, TracebackType
from typing import Any, Final, NoReturn, Protocol, cast

from urscript import operators
from urscript.analysis import MAX_CALL_DEPTH
from urscript.builtins import OMITTED, Builtin
from urscript.compile_statements import STATEMENT
from urscript.compiler import FILE_NAME, CompiledProgram
from urscript.errors import RuntimeFault, ScriptRuntimeError
from urscript.interpreter import STATEMENT_FILE, CompiledStatement, Locals
from urscript.meter import METER, charge
from urscript.methods import call_method, member, refuse_list_methods
from urscript.pieces import piece_name
from urscript.pycode import instruction_position, script_line
from urscript.values import TYPE_NAMES, Pose, Value

# Python's messages for errors that compiled code raises itself.
_VARIABLE: Final = re.compile(r".*'v_(\w+)'")
_COMPARISON: Final = re.compile(r"'([<>]=?)' not supported between instances of '(\w+)' and '(\w+)'")
_TYPE_NAMES: Final = {python.__name__: name for python, name in TYPE_NAMES.items()}
WORK_PER_SECOND = 4_000_000
"""Work that all threads together may do per second of controller time [meter units of about 50 ns]: 0.4 ms of a 2 ms
frame.

A guess at the speed of a controller's interpreter, chosen so that a frame leaves time for the rest of the tick.
"""

MIN_SHARE = 100
"""Minimum budget of a thread in a frame [meter units], so that every thread advances."""

MAX_THREADS = 64
"""Maximum number of running threads. A guess: the real limit is not known."""

_THREAD_WORK = 150  # to start or kill a thread [meter units]


def error_position(trace: TracebackType | None) -> tuple[int, int, bool]:
    """Line, column, and whether the error was raised by compiled code itself rather than by a function it called.

    For an error in an interpreted statement, the position is that of the interpreter_mode() call. A thread of
    interpreted code has no position in the program, so its errors have the line of the statement.
    """
    places = {FILE_NAME: (0, 0), STATEMENT_FILE: (0, 0)}
    inside = False
    while trace is not None:
        code = trace.tb_frame.f_code
        inside = code.co_filename in places
        if inside:
            places[code.co_filename] = instruction_position(code, trace.tb_lasti)
        trace = trace.tb_next
    line, column = places[FILE_NAME] if places[FILE_NAME][0] else places[STATEMENT_FILE]
    return line, column, inside


def message_of(error: Exception, inside: bool) -> str:
    if isinstance(error, RuntimeFault):
        return str(error)
    if isinstance(error, RecursionError):
        return "Function calls are nested too deeply"
    if inside and isinstance(error, NameError):
        variable = _VARIABLE.search(str(error))
        return f"Variable '{variable[1]}' is used before it has a value" if variable else str(error)
    if inside and isinstance(error, TypeError):
        comparison = _COMPARISON.match(str(error))
        names = [_TYPE_NAMES.get(name, name) for name in comparison.group(2, 3)] if comparison else ["?", "?"]
        sign = comparison[1] if comparison else "<"
        return f"Type error: operator {sign} cannot be used with '{names[0]}' and '{names[1]}'"
    return f"internal error: {error!r}"


ThreadBody = Generator[bool | None, None, Value]


class Host(Protocol):
    """What the runtime itself needs from the host of a program. Built-ins need more: see their library."""

    @property
    def period_s(self) -> float:
        """Length of a frame [s]."""

    def on_label(self, number: int, text: str, option: str, thread: "ScriptThread") -> bool:
        """A thread reached the program label ``$ number "text" "option"``. Return True to hold it for a frame."""


class StepHost(Host, Protocol):
    """What programs compiled with ``stepped`` need in addition: a hook for a tracer or debugger."""

    def on_step(self, line: int, column: int, thread: "ScriptThread") -> bool:
        """The thread is about to execute the statement at this position. Return True to hold it for a frame."""


class _Halt(BaseException):
    """``halt``: the program ends. Not an Exception, so that no built-in catches it accidentally."""


class _Killed(BaseException):
    """The running thread killed itself or one of its ancestors."""


class Awaited(Protocol):
    """What a thread waits for."""

    @property
    def over(self) -> bool:
        """Whether the thread continues."""


class ScriptThread:
    """One thread of a running program; handle 0 is the program body."""

    __slots__ = (
        "awaited",
        "balance",
        "body",
        "critical",
        "id",
        "interpreted",
        "label",
        "name",
        "parent",
        "parked_frames",
    )

    def __init__(self, handle: int, name: str, parent: int | None, body: ThreadBody) -> None:
        self.id = handle
        self.name = name
        self.parent = parent
        self.body = body
        self.critical = 0  # nested critical sections it is in
        self.balance = 0  # overdrawn budget, never positive
        self.parked_frames = 0  # consecutive frames that ended because the budget was empty
        self.awaited: Awaited | None = None  # until that is over, the thread has nothing to do
        self.label: tuple[int, str] | None = None  # number and text of the program label reached last
        self.interpreted = False  # started by an interpreted statement, or by a thread that was

    @property
    def position(self) -> tuple[int, int]:
        """Line and column (from 1) that the thread is executing; line 0 before it has started."""
        frame = self._innermost()
        return (0, 0) if frame is None else instruction_position(frame.f_code, frame.f_lasti)

    @property
    def line(self) -> int:
        """Line (from 1) that the thread is executing. Without the column, which is slow: this is read every period."""
        frame = self._innermost()
        return 0 if frame is None else script_line(frame.f_lineno)

    @property
    def stack(self) -> list[tuple[str, int]]:
        """Python name and line (from 1) of each function of the program that is being executed, outermost first."""
        found: list[tuple[str, int]] = []
        body: object = self.body
        while isinstance(body, GeneratorType):
            if body.gi_code.co_filename == FILE_NAME and body.gi_frame is not None:
                found.append((body.gi_code.co_name, script_line(body.gi_frame.f_lineno)))
            body = body.gi_yieldfrom
        return found

    def _innermost(self) -> FrameType | None:
        """The frame of the program's innermost function, else that of an interpreted statement; None before the
        start."""
        of_program: FrameType | None = None
        of_statement: FrameType | None = None
        body: object = self.body
        while isinstance(body, GeneratorType):
            if (file := body.gi_code.co_filename) == FILE_NAME:
                of_program = body.gi_frame or of_program
            elif file == STATEMENT_FILE:
                of_statement = body.gi_frame or of_statement
            body = body.gi_yieldfrom
        frame = of_program or of_statement
        return frame if frame is not None and frame.f_lasti >= 0 else None


class Runtime:
    """One run of a program.

    interrupted: it was stopped from outside before its end.
    motion_thread: set by the host; the thread that owns the motion of the robot, if any.
    parked: of the threads parked in the last frame, the one parked longest, if any.
    """

    def __init__(self, program: CompiledProgram, host: Host) -> None:
        self.program = program
        self.host = host
        self.finished = False
        self.halted = False
        self.interrupted = False
        self.error: ScriptRuntimeError | None = None
        self.current: ScriptThread | None = None
        self.motion_thread: ScriptThread | None = None
        self.parked: ScriptThread | None = None
        self._budget = round(WORK_PER_SECOND * host.period_s)
        self._threads: dict[int, ScriptThread] = {}
        self._waiting: deque[ScriptThread] = deque()  # not yet resumed in this frame
        self._holder: ScriptThread | None = None  # parked inside a critical section
        self._next_handle = 0
        self._in_statement = False
        self._line: int | None = None  # of `_line_of`, while no thread runs
        self._line_of: ScriptThread | None = None
        self._cells = {f"v_{name}": CellType() for name in program.global_names}
        self._namespace = self._make_namespace()
        self._add(program.code)
        self._start(self._namespace["main"], program.name or "main", None)

    # for the host

    @property
    def threads(self) -> tuple[ScriptThread, ...]:
        """The running threads, oldest first."""
        return tuple(self._threads.values())

    @property
    def globals(self) -> Mapping[str, Value]:
        """The global variables that have a value, in order of appearance in the program."""
        return self._values(self.program.global_names)

    def values(self, start: int, stop: int) -> list[Value]:
        """Values of global variables by their index in the program's ``global_names``; None without a value."""
        names = self.program.global_names[start:stop]
        return list(map(self._values(names).get, names))

    def _values(self, names: Iterable[str]) -> dict[str, Value]:
        """The variables that have a value."""
        values = {}
        for name in names:
            with suppress(ValueError):  # of an empty cell
                values[name] = self._cells[f"v_{name}"].cell_contents
        return values

    def set_global(self, name: str, value: Value) -> None:
        """Give a global variable another value; for debuggers."""
        self._cells[f"v_{name}"].cell_contents = value

    @property
    def line(self) -> int:
        """Line of the thread that owns the motion, else of the program body; 0 when finished."""
        if self._line is None or self._line_of is not self.motion_thread:
            self._line, self._line_of = self._current_line(), self.motion_thread
        return self._line

    def _current_line(self) -> int:
        owner = self.motion_thread
        if owner is None or owner.id not in self._threads:
            owner = self._threads.get(0)
        return owner.line if owner is not None else 0

    def step(self) -> None:
        """Run one frame. Does nothing once the program is finished; never raises errors of the program."""
        if self.finished:
            return
        self.parked = None
        budget = self._budget
        self._waiting = waiting = deque(self._threads.values())
        if len(waiting) > 1:
            order = sorted(waiting, key=lambda thread: (thread is not self._holder, thread.id == 0))
            self._waiting = waiting = deque(order)
        while waiting:
            thread = waiting.popleft()
            if (awaited := thread.awaited) is not None:
                if not awaited.over:
                    thread.balance = thread.parked_frames = 0
                    if self._holder is thread:
                        self._holder = None
                    continue
                thread.awaited = None
            share = max(budget // (len(waiting) + 1), MIN_SHARE)
            budget -= share - self._resume(thread, share)
            if self.finished:
                return
            if thread.parked_frames and thread.critical and thread.id in self._threads:
                self._holder = thread
                return
            if self._holder is thread:
                self._holder = None

    def stop(self) -> None:
        """End the program: close every thread where it is."""
        self.interrupted = not self.finished
        self._finish()

    # statements for the running program

    def link(self, statement: CompiledStatement) -> Callable[[Locals], ThreadBody]:
        """Add the functions of a statement to the program; returns the function that executes the statement."""
        namespace = self._namespace
        for name, builtin in statement.builtins.items():
            if f"b_{name}" not in namespace:
                namespace.update(self._bound(name, builtin))
        self._add(statement.code)
        body: Callable[[Locals, list[Any]], ThreadBody] = namespace.pop(STATEMENT)
        pieces = self._take_pieces(STATEMENT)
        return lambda scope: body(scope, pieces)

    def unlink(self, statement: CompiledStatement) -> None:
        """Remove the functions of a linked statement; calls in progress continue."""
        for plan in statement.functions.values():
            self._namespace.pop(plan.symbol, None)
            self._take_pieces(plan.symbol)

    def _take_pieces(self, symbol: str) -> list[Any]:
        """Remove the pieces of a function; while it is executed, it refers to them itself."""
        pieces: list[Any] = []
        while (piece := self._namespace.pop(piece_name(symbol, len(pieces)), None)) is not None:
            pieces.append(piece)
        return pieces

    def interpret(self, body: Callable[[Locals], ThreadBody], scope: Locals) -> ThreadBody:
        """Execute a linked statement in the running thread."""
        self._in_statement = True
        try:
            yield from body(scope)
        finally:
            self._in_statement = False
        return None

    @property
    def interpreting(self) -> bool:
        """True while the running thread executes an interpreted statement."""
        return self._in_statement and self.current is not None and self.current.id == 0

    def end_interpreted_threads(self) -> None:
        """End every thread that an interpreted statement started; must not be called from one of them."""
        for thread in list(self._threads.values()):
            if thread.interpreted:
                self._close(thread)

    # one thread

    def _resume(self, thread: ScriptThread, share: int) -> int:
        """Run a thread until it yields; returns the unused part of its share."""
        self._line = None
        METER.left = share + thread.balance
        if METER.left > 0:
            self.current = thread
            try:
                if thread.body.send(None):
                    self._park(thread)
                else:
                    thread.parked_frames = 0
            except StopIteration:
                self._ended(thread)
            except _Killed:
                self._remove(thread)
            except _Halt:
                self.halted = True
                self._remove(thread)
                self._finish()
            except Exception as error:
                self.error = self._describe(error, thread)
                self._remove(thread)
                self._finish()
            finally:
                self.current = None
            if self.finished:
                self._close_all()
        thread.balance = min(0, METER.left)
        return max(0, METER.left)

    def _park(self, thread: ScriptThread) -> None:
        thread.parked_frames += 1
        if self.parked is None or thread.parked_frames > self.parked.parked_frames:
            self.parked = thread

    def _ended(self, thread: ScriptThread) -> None:
        self._remove(thread)
        if thread.id == 0:
            self._finish()

    def _remove(self, thread: ScriptThread) -> None:
        self._line = None
        self._threads.pop(thread.id, None)
        if self._holder is thread:
            self._holder = None
        if thread in self._waiting:
            self._waiting.remove(thread)

    def _finish(self) -> None:
        self.finished = True
        if self.current is None:
            self._close_all()

    def _close_all(self) -> None:
        for thread in list(self._threads.values()):
            self._close(thread)

    def _close(self, thread: ScriptThread) -> None:
        self._remove(thread)
        try:
            thread.body.close()
        except Exception as error:
            # Clean-up code of a built-in failed, but the program is ending anyway.
            self.error = self.error or self._describe(error, thread)

    def _describe(self, error: Exception, thread: ScriptThread) -> ScriptRuntimeError:
        """The error as reported to the user: at the innermost line of the program."""
        line, column, inside = error_position(error.__traceback__)
        source = self.program.source
        described = ScriptRuntimeError(message_of(error, inside), line, column, source, thread.name)
        described.__cause__ = error
        return described

    # called by compiled code

    def _make_namespace(self) -> dict[str, Any]:
        program = self.program
        namespace: dict[str, Any] = {
            **_HELPERS,
            "_method": call_method if program.list_methods else refuse_list_methods,
            "_list": operators.list_literal if program.list_methods else operators.list_without_texts,
            "_run": self._start_child,
            "_kill": self._kill,
            "_join": self._join,
            "_label": self._label,
            "_step": self._step,
            "_enter_critical": self._enter_critical,
            "_exit_critical": self._exit_critical,
            "_locals": Locals(),
        }
        for name, builtin in program.builtins.items():
            namespace.update(self._bound(name, builtin))
        return namespace

    def _add(self, functions: Iterable[CodeType]) -> None:
        """Add compiled functions to the program."""
        namespace, cells = self._namespace, self._cells
        for code in functions:
            closure = tuple(map(cells.__getitem__, code.co_freevars))
            namespace[code.co_name] = FunctionType(code, namespace, code.co_name, (METER,), closure)

    def _bound(self, name: str, builtin: Builtin) -> dict[str, Any]:
        """A built-in under its names in compiled code: with and without the test of its arguments."""
        bound = {f"b_{name}": builtin.bind(self.host)}
        if builtin.plain:
            bound[f"u_{name}"] = builtin.unchecked(self.host)
        return bound

    def _start(self, body: Callable[[], ThreadBody], name: str, parent: int | None) -> int:
        if len(self._threads) >= MAX_THREADS:
            raise RuntimeFault(f"More than {MAX_THREADS} threads are running")
        handle = self._next_handle
        self._next_handle += 1
        thread = ScriptThread(handle, name, parent, body())
        self._threads[handle] = thread
        self._waiting.append(thread)
        return handle

    def _start_child(self, body: Callable[[], ThreadBody], name: str) -> int:
        charge(_THREAD_WORK)
        current = self.current
        handle = self._start(body, name, current.id if current is not None else None)
        if current is not None:
            self._threads[handle].interpreted = current.interpreted or self.interpreting
        return handle

    def _kill(self, handle: Value) -> None:
        if handle.__class__ is not int:
            raise RuntimeFault("Type error: kill expects a thread handle")
        if handle not in self._threads or handle == 0:
            return
        charge(_THREAD_WORK)
        doomed = self._family(handle)
        for thread in doomed:
            if thread is not self.current:
                self._close(thread)
        if self.current in doomed:
            raise _Killed

    def _family(self, handle: int) -> list[ScriptThread]:
        """A thread and its descendants; a child always has a higher handle than its parent."""
        family = {handle}
        for thread in self._threads.values():
            if thread.parent in family:
                family.add(thread.id)
        return [thread for thread in self._threads.values() if thread.id in family]

    def _join(self, handle: Value) -> Generator[None, None, None]:
        if handle.__class__ is not int:
            raise RuntimeFault("Type error: join expects a thread handle")
        while handle != 0 and handle in self._threads:
            yield

    def _label(self, number: int, text: str, option: str) -> bool:
        if self.current is None:
            return False
        self.current.label = (number, text)
        return self.host.on_label(number, text, option, self.current)

    def _step(self, line: int, column: int) -> Generator[None, None, None]:
        assert self.current is not None, "only running threads take steps"
        while cast(StepHost, self.host).on_step(line, column, self.current):
            yield

    def _enter_critical(self) -> None:
        if self.current is not None:
            self.current.critical += 1

    def _exit_critical(self) -> None:
        if self.current is not None and self.current.critical:
            self.current.critical -= 1


def _too_deep() -> NoReturn:
    raise RuntimeFault(f"Function calls are nested more than {MAX_CALL_DEPTH} levels deep")


_HELPERS: dict[str, Any] = {
    "__builtins__": {},
    "_meter": METER,
    "_omitted": OMITTED,
    "_Halt": _Halt,
    "_Locals": Locals,
    "_too_deep": _too_deep,
    "_fault": operators.fault,
    "_truth": operators.truth,
    "_add": operators.add,
    "_sub": operators.sub,
    "_mul": operators.mul,
    "_div": operators.div,
    "_mod": operators.mod,
    "_floor": math.floor,
    "_ceil": math.ceil,
    "_wrap": operators.wrap,
    "_neg": operators.neg,
    "_pos": operators.pos,
    "_eq": operators.eq,
    "_ne": operators.ne,
    "_lt": operators.lt,
    "_le": operators.le,
    "_gt": operators.gt,
    "_ge": operators.ge,
    "_pose": operators.pose_literal,
    "_new_pose": Pose,
    "_numbers": operators.number_list,
    "_struct": operators.make_struct,
    "_index": operators.index,
    "_cell": operators.cell,
    "_member": member,
    "_set_item": operators.set_item,
    "_references": operators.references,
    "_IndexError": IndexError,
    "_NameError": NameError,
    "_len": len,
    "_List": list,
    "_set_path": operators.set_path,
    "_retype": operators.retype,
    "_retype_fixed": operators.retype_fixed,
}
