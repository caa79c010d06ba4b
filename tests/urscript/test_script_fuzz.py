"""Any text is a program or a CompileError, and any program runs or stops with a script error."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.budget import examples
from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import CompiledProgram, CompileError, LibrarySet, Runtime, compile_script
from urscript.library import LIBRARIES

SET = LibrarySet(LIBRARIES)
VERSION = PolyscopeVersion.parse("5.22")

ATOMS = [
    "def f():",
    "def g(a, b=1):",
    "thread t():",
    "end",
    "if x:",
    "elif True:",
    "else:",
    "while x < 3:",
    "while True:",
    "break",
    "continue",
    "return x",
    "halt",
    "run t()",
    "join h",
    "kill h",
    "enter_critical",
    "exit_critical",
    "x = 1",
    "x = x + 1",
    "global y = [1,2]",
    "local z = p[0,0,0,0,0,1]",
    "h = run t()",
    "y[0] = x",
    "g(x)",
    "f()",
    'x = str_cat("a", x)',
    "x = norm(y)",
    "x = y * 2 - 1",
    "m = [[1,2],[3,4]]",
    "x = m[1,0]",
    "sync()",
    "s = struct(a=x)",
    "x = s.a",
    "s.a = 2",
    "y = make_list(2, 0, 5)",
    "y.append(x)",
    "x = y.pop()",
    '$ 1 "label"',
    "# comment",
    "x = not x",
    "x = x and True",
    "(",
    ")",
    "[",
    "]",
    ",",
    ".",
    "=",
    '"',
    "-",
    "1",
    "x",
    "p[",
    "True",
    "None",
    "\n",
]


class Host:
    period_s = 0.002

    def on_label(self, number, text, option, thread):
        pass


def compile_or_error(text: str) -> CompiledProgram | CompileError:
    try:
        return compile_script(text, SET, VERSION)
    except CompileError as error:
        return error


def attempt(text: str, frames: int = 5) -> None:
    program = compile_or_error(text)
    if isinstance(program, CompileError):
        assert program.wire.startswith(("syntax_error_on_line:", "compile_error_name_not_found:"))
        assert program.line >= 1
        assert program.column >= 1
        assert "^" in program.render()
        return
    runtime = Runtime(program, Host())
    for _ in range(frames):
        runtime.step()
    if runtime.error is not None:
        assert "internal error" not in runtime.error.message
        assert runtime.error.line >= 1
    runtime.stop()
    assert not runtime.threads


@settings(max_examples=examples(50), deadline=None)
@given(st.text(max_size=120))
def test_any_text(text):
    attempt(text)


@settings(max_examples=examples(40), deadline=None)
@given(st.lists(st.sampled_from(ATOMS), max_size=25), st.booleans())
def test_any_sequence_of_fragments(atoms, wrapped):
    text = "\n".join(atoms)
    attempt(f"def prog():\n{text}\nend" if wrapped else text)


OPERATORS = st.sampled_from(["+", "-", "*", "/", "%", "==", "!=", "<", ">=", "and", "or", "xor"])
EXPRESSION = st.recursive(
    st.sampled_from(
        [
            "1",
            "-2",
            "0",
            "0.5",
            "2147483647",
            "True",
            "None",
            '"a"',
            "[1,2]",
            "[]",
            "p[1,2,3,0,0,0]",
            "[[1,2],[3,4]]",
            "struct(a=1)",
            "make_list(1, 2, 3)",
        ]
    ),
    lambda inner: st.one_of(
        st.tuples(inner, OPERATORS, inner).map(" ".join),
        inner.map("({})".format),
        inner.map("not ({})".format),
        inner.map("-({})".format),
        st.tuples(inner, inner).map(lambda pair: f"[{pair[0]}, {pair[1]}]"),
        st.tuples(inner, inner).map(lambda pair: f"({pair[0]})[{pair[1]}]"),
        st.tuples(st.sampled_from(["norm", "length", "size", "to_str", "floor", "inv", "sqrt"]), inner).map(
            lambda pair: f"{pair[0]}({pair[1]})"
        ),
        inner.map("({}).a".format),
    ),
    max_leaves=12,
)


@settings(max_examples=examples(40), deadline=None)
@given(EXPRESSION)
def test_any_expression_has_a_value_or_a_fault(expression):
    program = compile_script(f"x = {expression}", SET, VERSION)
    runtime = Runtime(program, Host())
    runtime.step()
    assert runtime.finished
    if runtime.error is not None:
        assert "internal error" not in runtime.error.message


@each_row("piece", ["(", "[", "-", "not ", "x.", "x[", "f(", "1+", "if x:", "def f():", "struct(a=", "p["])
def test_deep_nesting_is_refused_politely(piece):
    for count in (100, 1000, 20000):
        with pytest.raises(CompileError):
            compile_script("x = " + piece * count if piece[-1] != ":" else piece * count, SET, VERSION)


def test_a_long_program_compiles():
    body = "\n".join(f"x{i} = {i}\nif x{i} > 1:\n x{i} = x{i} + 1\nend" for i in range(2000))
    attempt(f"def prog():\n{body}\nend")


def test_a_long_chain_of_functions():
    defs = "\n".join(f"def f{i}():\n return f{i + 1}()\nend" for i in range(1500)) + "\ndef f1500():\nend"
    attempt(f"def prog():\n{defs}\nf0()\nend")


def test_a_long_elif_chain():
    chain = "\n".join(f"elif x == {i}:\n x = {i}" for i in range(400))
    attempt(f"def prog():\nx = 399\nif x == -1:\nx = 1\n{chain}\nend\nend")
