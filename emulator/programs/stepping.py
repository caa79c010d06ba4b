"""A program that is looked at before each of its statements: where it is to stop, and what its variables are then."""

import ast
import ctypes
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import CodeType, FrameType, GeneratorType
from typing import Any, Final, NamedTuple

from emulator.snapshot import Snapshot
from urproto.modes import SafetyMode
from urproto.primary.messages import PopupMessage, RuntimeExceptionMessage, TextMessage
from urscript.compiler import FILE_NAME
from urscript.pycode import script_line
from urscript.runtime import Runtime
from urscript.values import Pose, type_name

_VARIABLE: Final = "v_"
_FUNCTION: Final = "f_"
_BOXED: Final = "_locals"  # of a long function: a mapping in place of Python variables
# what an expression may consist of: those of URScript have the same meaning in Python
_NODES: Final = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Load, ast.List, ast.Subscript, ast.Call, ast.Compare),
    *(ast.BoolOp, ast.BinOp, ast.UnaryOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod),
    *(ast.unaryop, ast.boolop, ast.cmpop),
)
_ALLOWED: Final = {"abs": abs, "len": len, "min": min, "max": max, "round": round, "True": True, "False": False}
_PIECE: Final = re.compile(r"p\d+_")  # see `urscript.pieces.piece_name`
_ALL_STOPS: Final = frozenset({"exception", "protective stop"})


class Stop(NamedTuple):
    """Why the program stands still. number: of the statement that comes next. reason: "" if only a slice is over.

    depth: of the calls of functions, from 1.
    """

    reason: str
    number: int
    thread: int
    line: int
    depth: int = 1
    text: str = ""
    output: tuple[str, ...] = ()


class Frame(NamedTuple):
    """A function that is being executed."""

    name: str
    line: int
    variables: dict[str, str]


@dataclass(frozen=True)
class Breakpoint:
    """Where to stop. condition: only if this is true. hits: only from this time on. log: say this instead."""

    line: int
    condition: str = ""
    hits: int = 1
    log: str = ""


@dataclass
class Wish:
    """Until when the program is to go on. mode: continue, pause, in, over, out, or to (a number)."""

    mode: str = "continue"
    thread: int = -1
    depth: int = 0
    number: int = 0


class SteppedProgram:
    """The rules by which a program stops, and what it shows while it stands still.

    runtime: the program's run. offset: lines before the program in its file. number: of the statement that comes next.
    problem: the exception or safety stop since the last look, empty without one.
    """

    def __init__(self) -> None:
        self.runtime: Runtime | None = None
        self.offset = 0
        self.number = 0
        self.wish = Wish()
        self.problem = ""
        self._breakpoints: dict[int, Breakpoint] = {}
        self._functions: frozenset[str] = frozenset()
        self._stop_on = _ALL_STOPS
        self._hits: dict[int, int] = {}
        self._depths: dict[int, int] = {}  # of each thread's last statement
        self._output: list[str] = []
        self._safety = SafetyMode.NORMAL

    def set_breakpoints(self, lines: list[Breakpoint], functions: list[str], stop_on: list[str]) -> None:
        """Replace all breakpoints."""
        self._breakpoints = {one.line: one for one in lines}
        self._functions = frozenset(functions)
        self._stop_on = frozenset(stop_on)

    def threads(self) -> dict[int, str]:
        """The running threads: number and name."""
        return {} if self.runtime is None else {thread.id: thread.name for thread in self.runtime.threads}

    def stack(self, thread: int) -> list[Frame]:
        """The functions that a thread is executing, innermost first."""
        return [
            Frame(_name(frame.f_code), self._line(frame), {name: str(value) for name, value in _locals(frame).items()})
            for frame in self.frames_of(thread)
        ]

    def globals(self) -> dict[str, str]:
        """The program's global variables."""
        return {name: str(value) for name, value in self._global_values.items()}

    def evaluate(self, text: str, thread: int, frame: int) -> str:
        """The value of an expression in a frame. Raises ValueError."""
        return str(_value(text, self._names(thread, frame)))

    def set_variable(self, name: str, text: str, thread: int, frame: int, *, local: bool) -> str:
        """Give a variable, which a frame may use, another value of its type. Raises ValueError."""
        value = _value(text, self._names(thread, frame))
        if not local:
            runtime = self.runtime
            if runtime is None or name not in runtime.program.global_names:
                raise ValueError(f"{name} is not a global variable")
            value = _like(self._global_values.get(name), value, name)
            runtime.set_global(name, value)
            return str(value)
        holder = self.frames_of(thread)[frame]
        if name not in (known := _locals(holder)):
            raise ValueError(f"{name} is not a local variable with a value")
        value = _like(known[name], value, name)
        _set_local(holder, name, value)
        return str(value)

    # before each statement

    def reason(self, thread: int, line: int, frames: list[FrameType]) -> str:
        """Why to stop before this statement; "" to go on. frames: of the thread, innermost first."""
        depth, before = len(frames), self._depths.get(thread, 0)
        self._depths[thread] = depth
        wish = self.wish
        if wish.mode == "to":
            return "step" if self.number == wish.number else ""
        if (found := self._breakpoints.get(line)) is not None and self._holds(found, frames):
            return "breakpoint"
        if depth > before and self._functions and _name(frames[0].f_code) in self._functions:
            return "function breakpoint"
        if wish.mode == "pause" or (wish.mode == "in" and thread == wish.thread):
            return "pause" if wish.mode == "pause" else "step"
        stepping = wish.mode in ("over", "out") and thread == wish.thread
        return "step" if stepping and depth <= wish.depth - (wish.mode == "out") else ""

    def _holds(self, found: Breakpoint, frames: list[FrameType]) -> bool:
        names = {**self._global_values, **_locals(frames[0])}
        if found.condition:
            try:
                if not _value(found.condition, names):
                    return False
            except ValueError as error:
                self._output.append(f"the condition of line {found.line}: {error}")
        self._hits[found.line] = self._hits.get(found.line, 0) + 1
        if self._hits[found.line] < found.hits:
            return False
        if found.log:
            self._output.append(_interpolated(found.log, lambda text: str(_value(text, names))))
        return not found.log

    # after each control period

    def look(self, snapshot: Snapshot, *, stopped: bool) -> None:
        """Note what is told to the user, and problems. stopped: whether the safety system has stopped the arm."""
        for message in snapshot.messages:
            if isinstance(message, TextMessage):
                self._output.append(message.text)
            elif isinstance(message, PopupMessage):
                self._output.append(f"popup {message.title}: {message.text}")
            elif isinstance(message, RuntimeExceptionMessage):
                self.problem = f"runtime exception in line {message.line + self.offset}: {message.text}"
        if snapshot.safety_mode != self._safety:
            self._safety = SafetyMode(snapshot.safety_mode)
            if stopped:
                self.problem = self.problem or f"safety mode {self._safety.name}"

    def problem_stop(self) -> Stop | None:
        """The stop for a new problem, if there is one and it was asked for."""
        problem, self.problem = self.problem, ""
        reason = "exception" if "exception" in problem else "protective stop"
        if not problem or reason not in self._stop_on or self.wish.mode == "to":
            return None
        line = 0 if self.runtime is None else self.runtime.line + self.offset
        return Stop(reason, self.number, 0, line, text=problem)

    def said(self, stop: Stop) -> Stop:
        """The stop with what was said since the last one."""
        said, self._output = tuple(self._output), []
        return stop._replace(output=said)

    # looking at what stands still

    def _line(self, frame: FrameType) -> int:
        return script_line(frame.f_lineno) + self.offset

    def frames_of(self, number: int) -> list[FrameType]:
        """The frames of a thread that waits, innermost first."""
        threads = () if self.runtime is None else self.runtime.threads
        found: list[FrameType] = []
        for thread in threads:
            body: object = thread.body if thread.id == number else None
            while isinstance(body, GeneratorType):
                if body.gi_code.co_filename == FILE_NAME and body.gi_frame is not None:
                    found[: _is_piece(body.gi_frame)] = [body.gi_frame]
                body = body.gi_yieldfrom
        return found

    @property
    def _global_values(self) -> dict[str, Any]:
        return {} if self.runtime is None else dict(self.runtime.globals)

    def _names(self, thread: int, frame: int) -> dict[str, Any]:
        frames = self.frames_of(thread)
        return {**self._global_values, **(_locals(frames[frame]) if frame < len(frames) else {})}


def program_frames(frame: FrameType | None) -> list[FrameType]:
    """The frames of the program that lead to this one, innermost first."""
    found: list[FrameType] = []
    inside = False  # a piece of the function whose frame comes next
    while frame is not None:
        if frame.f_code.co_filename == FILE_NAME:
            found += [] if inside else [frame]
            inside = _is_piece(frame)
        frame = frame.f_back
    return found


def _is_piece(frame: FrameType) -> bool:
    """Whether it is a part of a long body: it stands for the function, which has called it."""
    return _PIECE.match(frame.f_code.co_name) is not None


def _locals(frame: FrameType) -> dict[str, Any]:
    values = frame.f_locals
    found = {name.removeprefix(_VARIABLE): value for name, value in values.items() if name.startswith(_VARIABLE)}
    return {**found, **values.get(_BOXED, {})}


def _set_local(frame: FrameType, name: str, value: Any) -> None:
    values = frame.f_locals
    if name in values.get(_BOXED, {}):
        values[_BOXED][name] = value
        return
    values[f"{_VARIABLE}{name}"] = value
    ctypes.pythonapi.PyFrame_LocalsToFast(ctypes.py_object(frame), ctypes.c_int(0))  # before 3.13, those are copies


def _value(text: str, names: Mapping[str, Any]) -> Any:
    """Raises ValueError for what is not an expression of variables, numbers, operators and simple functions."""
    try:
        tree = ast.parse(text.strip(), mode="eval")
        if wrong := next((node for node in ast.walk(tree) if not isinstance(node, _NODES)), None):
            raise ValueError(f"{type(wrong).__name__.lower()} is not possible here")
        return eval(compile(tree, "<expression>", "eval"), {"__builtins__": {}, **_ALLOWED, **names})
    except Exception as error:
        raise ValueError(f"{text}: {error}") from error


def _like(present: Any, value: Any, name: str) -> Any:
    """A value of the type that a variable has, which the compiled program may rely on. Raises ValueError."""
    if present.__class__ is float and value.__class__ is int:
        return float(value)
    if present.__class__ is Pose and value.__class__ is list and len(value) == len(present):
        return Pose(map(float, value))
    if value.__class__ is present.__class__ or present is None:
        return value
    raise ValueError(f"{name} is of type {type_name(present)}, and stays so: {type_name(value)} is another one")


def _name(code: CodeType) -> str:
    return _PIECE.sub("", code.co_name).removeprefix(_FUNCTION)


def _interpolated(text: str, value: Callable[[str], str]) -> str:
    """The text with ``{expression}`` replaced."""
    parts: list[str] = []
    while "{" in text:
        before, _, rest = text.partition("{")
        expression, _, text = rest.partition("}")
        try:
            parts += [before, value(expression)]
        except ValueError as error:
            parts += [before, str(error)]
    return "".join([*parts, text])
