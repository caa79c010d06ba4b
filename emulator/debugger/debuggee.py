"""A program that is being debugged: it runs on a robot in virtual time, and stands still within a period when it stops.

Each statement of the main program has a number, in the order of their execution. The run is deterministic, so a number
always means the same statement of the same moment.
"""

import ast
import ctypes
import re
import sys
from array import array
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import CodeType, FrameType, GeneratorType
from typing import Any, Final, NamedTuple

from emulator.branches import Server
from emulator.builtins.host import ProgramHost
from emulator.peers.connection import Peers
from emulator.snapshot import Snapshot
from emulator.virtual import VirtualRobot
from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import PopupMessage, RuntimeExceptionMessage, TextMessage
from urscript.compiler import FILE_NAME
from urscript.files import ScriptFile
from urscript.pycode import script_line
from urscript.runtime import Runtime, ScriptThread
from urscript.values import Pose, type_name

_SHOWN: Final = (
    *("actual_q", "actual_TCP_pose", "robot_mode", "safety_mode"),
    *("actual_digital_input_bits", "actual_digital_output_bits"),
)
_ANY: Final = -1  # thread
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
class _Wish:
    """Until when the program is to go on. mode: continue, in, over, out, or to (a number)."""

    mode: str = "continue"
    thread: int = -1
    depth: int = 0
    number: int = 0


class Debuggee:
    """One run of a file of programs. server: set by the process in which it is. Raises ValueError, OSError."""

    def __init__(self, robot: VirtualRobot, file: ScriptFile, peers: Peers | None = None) -> None:
        self.server: Server | None = None
        self._robot = robot
        self._file = file
        if peers is not None:
            robot.connect(peers)
        self._breakpoints: dict[int, Breakpoint] = {}
        self._functions: frozenset[str] = frozenset()
        self._stop_on: frozenset[str] = frozenset({"exception", "protective stop"})
        self._hits: dict[int, int] = {}
        self._output: list[str] = []
        self._wish = _Wish()
        self._left = 0
        self._number = 0
        self._threads, self._depths, self._lines = array("i"), array("i"), array("i")  # of all statements so far
        self._runtime: Runtime | None = None
        self._thread: ScriptThread | None = None  # that executed a statement last
        self._frames: list[FrameType] = []
        self._safety = SafetyMode.NORMAL
        self._problem = ""
        main = [unit for unit in file.units if not unit.secondary]
        self._offset = main[0].lines_before if main else 0
        robot.controller.programs.step_hook = self._statement
        robot.controller.subscribe(self._look)

    # what the adapter calls

    def begin(self) -> None:
        """Submit the programs, which start as time goes on."""
        for unit in self._file.units:
            self._robot.controller.programs.submit(unit.text)

    def go(self, mode: str, periods: int, thread: int = -1, depth: int = 0, number: int = 0) -> Stop:
        """Go on: at most for a number of control periods, after which the stop has no reason."""
        self._want(mode, periods, thread, depth, number)
        while self._left > 0:
            self._left -= 1
            self._robot.step(1)
            if self._problem:
                problem, self._problem = self._problem, ""
                reason = "exception" if "exception" in problem else "protective stop"
                if reason in self._stop_on and self._wish.mode != "to":
                    line = 0 if self._runtime is None else self._runtime.line + self._offset
                    self._pause(Stop(reason, self._number, 0, line, text=problem))
            if not self._robot.controller.programs.busy:
                return self._said(
                    Stop("ended", self._number, _ANY, 0, text="" if self._number else self._robot.log(1)[0])
                )
        return self._said(Stop("", self._number, _ANY, 0))

    def set_breakpoints(self, lines: list[Breakpoint], functions: list[str], stop_on: list[str]) -> None:
        """Replace all breakpoints."""
        self._breakpoints = {one.line: one for one in lines}
        self._functions = frozenset(functions)
        self._stop_on = frozenset(stop_on)

    def threads(self) -> dict[int, str]:
        """The running threads: number and name."""
        return {} if self._runtime is None else {thread.id: thread.name for thread in self._runtime.threads}

    def stack(self, thread: int) -> list[Frame]:
        """The functions that a thread is executing, innermost first."""
        return [
            Frame(_name(frame.f_code), self._line(frame), {name: str(value) for name, value in _locals(frame).items()})
            for frame in self._frames_of(thread)
        ]

    def globals(self) -> dict[str, str]:
        return {} if self._runtime is None else {name: str(value) for name, value in self._runtime.globals.items()}

    def robot_state(self) -> dict[str, str]:
        """Where the robot is: time [s], joint angles [rad], pose [m, rad], modes, I/O."""
        state = self._robot.state(_SHOWN)
        return {"time_s": f"{self._robot.controller.time_s:.3f}"} | {name: str(value) for name, value in state.items()}

    def evaluate(self, text: str, thread: int, frame: int) -> str:
        """The value of an expression in a frame. Raises ValueError."""
        return str(self._value(text, self._names(thread, frame)))

    def set_variable(self, name: str, text: str, thread: int, frame: int, *, local: bool) -> str:
        """Give a variable, which a frame may use, another value of its type. Raises ValueError."""
        value = self._value(text, self._names(thread, frame))
        if not local:
            runtime = self._runtime
            if runtime is None or name not in runtime.program.global_names:
                raise ValueError(f"{name} is not a global variable")
            value = _like(self._global_values.get(name), value, name)
            runtime.set_global(name, value)
            return str(value)
        holder = self._frames_of(thread)[frame]
        if name not in (known := _locals(holder)):
            raise ValueError(f"{name} is not a local variable with a value")
        value = _like(known[name], value, name)
        _set_local(holder, name, value)
        return str(value)

    def statement(self, number: int) -> Stop:
        """A statement so far, by its number."""
        return Stop("", number, self._threads[number], self._lines[number], self._depths[number])

    def earlier(self, stop: Stop, lines: Collection[int]) -> Stop | None:
        """The last statement before a stop that is on one of these lines; without any, the one before of its thread,
        which is not within a function that it has called.
        """
        for number in range(min(stop.number, len(self._lines)) - 1, -1, -1):
            if lines:
                found = self._lines[number] in lines
            else:
                found = stop.thread in (self._threads[number], _ANY) and self._depths[number] <= stop.depth
            if found:
                return self.statement(number)
        return None

    @property
    def checksum(self) -> str:
        """A digest of all values of the robot and of the program's variables, to compare moments."""
        return repr((self._robot.state(), self.globals(), self._number))

    # within a control period

    def _statement(self, host: ProgramHost, line: int, column: int, thread: ScriptThread) -> bool:
        """A thread is about to execute a statement."""
        if host.secondary:
            return False
        self._runtime, self._thread = host.runtime, thread
        frames = _program_frames(sys._getframe(1))
        place, depth = line + self._offset, len(frames)
        self._threads.append(thread.id)
        self._depths.append(depth)
        self._lines.append(place)
        if reason := self._reason(thread.id, depth, place, frames):
            self._frames = frames
            self._pause(Stop(reason, self._number, thread.id, place, depth))
            self._frames = []
        self._number += 1
        return False

    def _reason(self, thread: int, depth: int, line: int, frames: list[FrameType]) -> str:
        wish = self._wish
        if wish.mode == "to":
            return "step" if self._number == wish.number else ""
        if (found := self._breakpoints.get(line)) is not None and self._holds(found, frames):
            return "breakpoint"
        if self._functions and _name(frames[0].f_code) in self._functions and self._entered(thread, depth):
            return "function breakpoint"
        if wish.mode == "pause" or (wish.mode == "in" and thread == wish.thread):
            return "pause" if wish.mode == "pause" else "step"
        stepping = wish.mode in ("over", "out") and thread == wish.thread
        return "step" if stepping and depth <= wish.depth - (wish.mode == "out") else ""

    def _entered(self, thread: int, depth: int) -> bool:
        """Whether the function is only just entered: the thread's last statement was in its caller."""
        before = next((n for n in range(self._number - 1, -1, -1) if self._threads[n] == thread), None)
        return before is None or self._depths[before] < depth

    def _holds(self, found: Breakpoint, frames: list[FrameType]) -> bool:
        if found.condition:
            try:
                if not self._value(found.condition, {**self._global_values, **_locals(frames[0])}):
                    return False
            except ValueError as error:
                self._output.append(f"the condition of line {found.line}: {error}")
        self._hits[found.line] = self._hits.get(found.line, 0) + 1
        if self._hits[found.line] < found.hits:
            return False
        if found.log:
            names = {**self._global_values, **_locals(frames[0])}
            self._output.append(_interpolated(found.log, lambda text: str(self._value(text, names))))
        return not found.log

    def _pause(self, stop: Stop) -> None:
        assert self.server is not None, "it is in a process of its own"
        values, named = self.server.pause("go", self._said(stop))
        self._want(*values, **named)

    def _want(self, mode: str, periods: int, thread: int = -1, depth: int = 0, number: int = 0) -> None:
        self._wish, self._left = _Wish(mode, thread, depth, number), periods

    def _said(self, stop: Stop) -> Stop:
        said, self._output = tuple(self._output), []
        return stop._replace(output=said)

    def _look(self, snapshot: Snapshot) -> None:
        for message in snapshot.messages:
            if isinstance(message, TextMessage):
                self._output.append(message.text)
            elif isinstance(message, PopupMessage):
                self._output.append(f"popup {message.title}: {message.text}")
            elif isinstance(message, RuntimeExceptionMessage):
                self._problem = f"runtime exception in line {message.line + self._offset}: {message.text}"
        if snapshot.safety_mode != self._safety:
            self._safety = SafetyMode(snapshot.safety_mode)
            if self._robot.controller.safety.stopped:
                self._problem = self._problem or f"safety mode {self._safety.name}"
        if snapshot.runtime_state == RuntimeState.STOPPED:
            self._thread = None

    # looking at what stands still

    def _line(self, frame: FrameType) -> int:
        return script_line(frame.f_lineno) + self._offset

    def _frames_of(self, number: int) -> list[FrameType]:
        if self._thread is not None and number == self._thread.id and self._frames:
            return self._frames
        threads = () if self._runtime is None else self._runtime.threads
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
        return {} if self._runtime is None else dict(self._runtime.globals)

    def _names(self, thread: int, frame: int) -> dict[str, Any]:
        frames = self._frames_of(thread)
        return {**self._global_values, **(_locals(frames[frame]) if frame < len(frames) else {})}

    def _value(self, text: str, names: Mapping[str, Any]) -> Any:
        """Raises ValueError for what is not an expression of variables, numbers, operators and simple functions."""
        try:
            tree = ast.parse(text.strip(), mode="eval")
            if wrong := next((node for node in ast.walk(tree) if not isinstance(node, _NODES)), None):
                raise ValueError(f"{type(wrong).__name__.lower()} is not possible here")
            return eval(compile(tree, "<expression>", "eval"), {"__builtins__": {}, **_ALLOWED, **names})
        except Exception as error:
            raise ValueError(f"{text}: {error}") from error


def _is_piece(frame: FrameType) -> bool:
    """Whether it is a part of a long body: it stands for the function, which has called it."""
    return _PIECE.match(frame.f_code.co_name) is not None


def _program_frames(frame: FrameType | None) -> list[FrameType]:
    """The frames of the program that lead to this one, innermost first."""
    found: list[FrameType] = []
    inside = False  # a piece of the function whose frame comes next
    while frame is not None:
        if frame.f_code.co_filename == FILE_NAME:
            found += [] if inside else [frame]
            inside = _is_piece(frame)
        frame = frame.f_back
    return found


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
