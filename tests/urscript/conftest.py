"""A bench to run scripts on: the pure libraries and a few robot-like built-ins that record their calls."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field

import pytest

from urproto.versions import PolyscopeVersion
from urscript import CompiledProgram, Library, LibrarySet, Runtime, ScriptThread, compile_script
from urscript.library import LIBRARIES
from urscript.values import Any_, Num, PoseOrJoints, Str, to_text

ROBOT = Library("robot", host=True, physical=True)


@dataclass
class Bench:
    """The host of the test programs."""

    period_s: float = 0.002
    log: list[str] = field(default_factory=list)
    labels: list[tuple[int, str, str]] = field(default_factory=list)

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        self.labels.append((number, text, thread.name))
        return False


@ROBOT.builtin()
def textmsg(host: Bench, s1: Any_, s2: Any_ = "") -> None:
    """Record a message."""
    host.log.append(to_text(s1, message=True) + to_text(s2, message=True))


@ROBOT.builtin()
def sleep(host: Bench, t: Num) -> Generator[None, None, None]:
    """Wait whole frames, at least one."""
    for _ in range(max(1, round(t / host.period_s))):
        yield


@ROBOT.builtin()
def movej(
    host: Bench, q: PoseOrJoints, a: Num = 1.4, v: Num = 1.05, t: Num = 0, r: Num = 0
) -> Generator[None, None, None]:
    """Record a move that takes two frames; a kill in between is recorded too."""
    host.log.append(f"movej {to_text(q)} a={a} v={v} t={t} r={r}")
    try:
        yield
        yield
    except GeneratorExit:
        host.log.append("movej killed")
        raise


@ROBOT.builtin(aliases={"t": ("t", "t_min")})
def speedl(host: Bench, xd: Any_, a: Num = 1.2, t: Num | None = None) -> Generator[None, None, None]:
    """Has two names for one parameter."""
    host.log.append(f"speedl a={a} t={t}")
    yield


@ROBOT.builtin(cb3=None, e="5.10")
def newer(host: Bench, name: Str, lambda_: Num = 1) -> str:
    """Only newer versions have it; its keyword is a Python keyword."""
    return f"{name}{to_text(lambda_)}"


@ROBOT.builtin()
def broken(host: Bench) -> None:
    """Has a bug."""
    raise ZeroDivisionError("oops")


ROBOT.refuse("modbus_add_signal", note="Modbus is not emulated yet")

LIBRARY_SET = LibrarySet([*LIBRARIES, ROBOT])
NEWEST = PolyscopeVersion.parse("5.22")


@dataclass
class Run:
    """What a finished or stopped run left behind."""

    runtime: Runtime
    bench: Bench
    frames: int

    @property
    def globals(self) -> dict[str, object]:
        return dict(self.runtime.globals)

    @property
    def error(self) -> tuple[int, int, str] | None:
        error = self.runtime.error
        return None if error is None else (error.line, error.column, error.message)


@pytest.fixture
def compiled() -> Callable[..., CompiledProgram]:
    """compiled(text, version="5.22") -> program."""

    def build(text: str, version: str = "5.22") -> CompiledProgram:
        return compile_script(text, LIBRARY_SET, PolyscopeVersion.parse(version))

    return build


@pytest.fixture
def run(compiled: Callable[..., CompiledProgram]) -> Callable[..., Run]:
    """run(text, frames=200, version="5.22") -> Run after at most that many frames."""

    def go(text: str, frames: int = 200, version: str = "5.22") -> Run:
        bench = Bench()
        runtime = Runtime(compiled(text, version), bench)
        used = 0
        while not runtime.finished and used < frames:
            runtime.step()
            used += 1
        return Run(runtime, bench, used)

    return go


@pytest.fixture
def result(run: Callable[..., Run]) -> Callable[..., object]:
    """result("expression") -> its value; fails when the program does not end well."""

    def evaluate(expression: str, before: str = "", version: str = "5.22") -> object:
        done = run(f"def f():\n{before}\nresult = {expression}\nend", version=version)
        assert done.error is None, done.error
        assert done.runtime.finished
        return done.globals["result"]

    return evaluate
