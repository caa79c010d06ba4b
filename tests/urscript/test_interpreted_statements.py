"""Statements compiled for a running program, without a controller."""

from collections.abc import Callable, Generator

import pytest

from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import CompileError, Library, LibrarySet, Runtime, ScriptThread, compile_script
from urscript.interpreter import CompiledStatement, Locals, compile_statement
from urscript.library import LIBRARIES
from urscript.values import Any_, Num, to_text
from urscript.work import run_to_end

MODE = Library("mode", host=True)


class Host:
    """Its programs lend their scope and execute what is put in line."""

    period_s = 0.002

    def __init__(self) -> None:
        self.log: list[str] = []
        self.scope: Locals | None = None
        self.line: list[Callable[[], Generator[bool | None, None, object]]] = []
        self.over = False

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        raise AssertionError("no program here has labels")


@MODE.builtin()
def textmsg(host: Host, s1: Any_, s2: Any_ = "") -> None:
    """Record a message."""
    host.log.append(to_text(s1, message=True) + to_text(s2, message=True))


@MODE.builtin()
def sleep(host: Host, t: Num) -> Generator[None, None, None]:
    """Wait whole frames."""
    for _ in range(round(t / host.period_s)):
        yield


@MODE.builtin(takes_scope=True)
def lend(host: Host, scope: Locals) -> Generator[bool | None, None, None]:
    """Interpret until it is over."""
    host.scope = scope
    while not host.over:
        if host.line:
            yield from host.line.pop(0)()
        else:
            yield None


SET = LibrarySet([*LIBRARIES, MODE])
NEWEST = PolyscopeVersion.parse("5.22")


class Session:
    """A program that lends its scope."""

    def __init__(self, text: str) -> None:
        self.host = Host()
        self.program = compile_script(text, SET, NEWEST)
        self.runtime = Runtime(self.program, self.host)
        self.functions = dict(self.program.functions)
        self.serial = 0
        self.runtime.step()

    @property
    def scope(self) -> Locals:
        assert self.host.scope is not None
        return self.host.scope

    def compile(self, text: str) -> CompiledStatement:
        self.serial += 1
        return run_to_end(compile_statement(text, self.program, self.functions, self.scope, self.serial))

    def run(self, text: str, frames: int = 5) -> None:
        statement = self.compile(text)
        self.functions.update(statement.functions)
        self.scope.declare(statement.names)
        body = self.runtime.link(statement)
        self.host.line.append(lambda: self.runtime.interpret(body, self.scope))
        for _ in range(frames):
            self.runtime.step()


def test_what_a_statement_brings() -> None:
    session = Session("global g = 1\ndef f(a):\n return a\nend\nlend()")
    statement = session.compile("x = f(g)")
    assert (statement.names, statement.calls, dict(statement.functions)) == ({"x"}, {"f"}, {})
    statement = session.compile("local y = 2 g = 3 def h(): return sin(1) end textmsg(y)")
    assert statement.names == {"y"}
    assert list(statement.functions) == ["h"]
    assert statement.calls == {"textmsg"}
    assert set(statement.builtins) == {"sin", "textmsg"}


def test_compiling_changes_nothing() -> None:
    session = Session("lend()")
    session.compile("x = 1 def f(): return 1 end")
    with pytest.raises(CompileError, match="'x' is not defined"):
        session.compile("textmsg(x)")
    with pytest.raises(CompileError, match="'f' is not defined"):
        session.compile("f()")


@each_row(
    ("text", "place"),
    [("global new = 1", (1, 8)), ("if True: while False: global new = 1 end end", (1, 30)), ("\n  x = y", (1, 7))],
)
def test_errors_have_a_place(text: str, place: tuple[int, int]) -> None:
    with pytest.raises(CompileError) as caught:
        Session("lend()").compile(text)
    assert (caught.value.line, caught.value.column) == place


def test_deep_nesting_is_an_error() -> None:
    for text in ("x = " + "(" * 400 + "1" + ")" * 400, "if True: " * 90 + "end " * 90):
        with pytest.raises(CompileError):
            Session("lend()").compile(text)


def test_every_way_to_change_a_variable_of_the_lending_function() -> None:
    session = Session(
        "def p():\ndef f(n):\n l = make_list(1, 0, 5)\n s = struct(a=1)\n lend()\n textmsg(n, l)\n textmsg(s.a)\n"
        " n = n + 1\n textmsg(n)\nend\nf(1)\nend"
    )
    session.run("n = 5 l[0] = 4 l.append(6) s.a = 7")
    session.run("last = l.pop() l[0] = last + n")
    session.host.over = True
    session.runtime.step()
    assert session.runtime.error is None
    assert session.host.log == ["5[11]", "7", "6"]


def test_lending_functions_may_recurse_and_have_defaults() -> None:
    session = Session(
        "def p():\ndef f(n, m=4):\n if n > 0:\n  return f(n - 1)\n end\n lend()\n return n + m\nend\ntextmsg(f(3))\nend"
    )
    assert session.scope.own == {"n", "m"}
    session.run("m = m * 10")
    session.host.over = True
    session.runtime.step()
    assert session.host.log == ["40"]


def test_the_line_is_that_of_the_call() -> None:
    session = Session("x = 1\nlend()")
    session.run("\n\n\nsleep(1)")
    assert session.runtime.line == 2
    session.run("sleep(1) y = [1] y[5] = 2", frames=1500)
    assert session.runtime.error is not None
    assert (session.runtime.error.line, session.runtime.error.column) == (2, 1)
