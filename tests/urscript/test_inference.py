"""Arithmetic that is compiled to Python's own behaves as the operators that look at every value."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from urproto.versions import PolyscopeVersion
from urscript import LibrarySet, Runtime, compile_script, compiler
from urscript.inference import Kinds
from urscript.library import LIBRARIES
from urscript.values import to_text

SET = LibrarySet(LIBRARIES)
VERSION = PolyscopeVersion.parse("5.22")


class _Host:
    period_s = 0.002

    def on_label(self, number, text, option, thread):
        raise AssertionError("these programs have no labels")


def _nothing_known(program, builtins):
    yield 1
    return Kinds(program, builtins, {})


def _outcome(text, *, inferred):
    compiler._cache.clear()
    with pytest.MonkeyPatch.context() as patch:
        if not inferred:
            patch.setattr(compiler, "infer_kinds", _nothing_known)
        program = compile_script(text, SET, VERSION)
    compiler._cache.clear()
    runtime = Runtime(program, _Host())
    for _ in range(200):
        runtime.step()
        if runtime.finished:
            break
    values = {name: (value.__class__.__name__, to_text(value, limit=10**6)) for name, value in runtime.globals.items()}
    return values, runtime.error is not None, runtime.error and runtime.error.line


def _both(text):
    found = _outcome(text, inferred=True)
    assert found == _outcome(text, inferred=False)
    return found


ATOMS = st.sampled_from(
    [
        "a",
        "b",
        "c",
        "v",
        "1",
        "-3",
        "2147483647",
        "0",
        "2.5",
        "-0.5",
        "1e300",
        "v[1]",
        "v[a]",
        "f(a)",
        "f(c)",
        "g(b, v)",
    ]
)
EXPRESSIONS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/%"), inner).map(lambda parts: f"({' '.join(parts)})"),
        inner.map(lambda text: f"(-{text})"),
        st.tuples(inner, inner, inner).map(lambda items: f"[{', '.join(items)}]"),
    ),
    max_leaves=6,
)
CONDITIONS = st.tuples(EXPRESSIONS, st.sampled_from(["<", "<=", "==", "!=", ">="]), EXPRESSIONS).map(" ".join)
STATEMENTS = st.one_of(
    st.tuples(st.sampled_from(["a", "b", "c", "v", "v[0]", "local d"]), EXPRESSIONS).map(" = ".join),
    st.tuples(CONDITIONS, st.sampled_from("abcv"), EXPRESSIONS).map(lambda p: f"if {p[0]}:\n{p[1]} = {p[2]}\nend"),
)
BLOCKS = st.lists(STATEMENTS, min_size=1, max_size=5).map("\n".join)


@given(BLOCKS, EXPRESSIONS, EXPRESSIONS, BLOCKS, st.booleans())
def test_inferred_programs_do_what_general_ones_do(block, first, second, loop, in_function):
    body = f"{block}\nwhile k < 4:\nk = k + 1\n{loop}\nend\n"
    names = "a = 1\nb = 2.0\nc = 3\nv = [1.0, 2, 3]\nk = 0\n"
    functions = f"def f(x):\nreturn x * 3\nend\ndef g(b, v, a=1, c=0.5):\na = {first}\nreturn {second}\nend\n"
    if in_function:
        text = f"def p():\n{functions}def h():\n{names}{body}return [a, b, c, k]\nend\nresult = h()\nend"
    else:
        text = f"def p():\n{functions}{names}{body}end"
    _both(text)


@pytest.mark.parametrize(
    ("body", "name", "value"),
    [
        ("x = 2147483647\nx = x + 1", "x", ("int", "-2147483648")),
        ("x = -2147483648\nx = x - 1", "x", ("int", "2147483647")),
        ("x = 65536\nx = x * x + 7", "x", ("int", "7")),
        ("k = -7\nx = k % 3", "x", ("int", "-1")),
        ("k = 0\nx = 1 / k", "x", ("float", "inf")),
        ("k = 7\nj = 2\nx = k / j", "x", ("float", "3.5")),
        ("def f(a):\nreturn a + a\nend\nx = f(2)\ny = f([1, 2])", "y", ("list", "[2, 4]")),
        ("q = [1.5, 2.5]\nq[0] = 2\nx = q[0] + q[1]", "x", ("float", "4.5")),
        ("def f(n):\nif n < 2:\nreturn 1\nend\nreturn n * f(n - 1)\nend\nx = f(13)", "x", ("int", "1932053504")),
    ],
)
def test_rules_hold_where_the_operands_are_known(body, name, value):
    values, failed, _ = _both(f"def p():\n{body}\nend")
    assert not failed
    assert values[name] == value


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ('q = [1, 2]\nq[0] = "s"\nx = q[0] * 3', 4),  # an element may be anything by then
        ("q = [1, 2]\nk = 2\nx = q[k]", 4),
        ("q = [1, 2]\nk = -1\nx = q[k]", 4),
        ('def f(a):\nreturn a + 1\nend\nx = f(1)\ny = f("s")', 3),
        ("def f(a):\nif a > 0:\nreturn 1\nend\nend\nx = f(0) + 1", 7),  # it returned nothing
        ("def g():\nreturn late + 1\nend\nx = g()\nlate = 1", 3),
    ],
)
def test_what_may_be_something_else_is_looked_at(body, line):
    _, failed, where = _both(f"def p():\n{body}\nend")
    assert failed
    assert where == line


def test_a_text_made_to_need_many_rounds_compiles_without_inference():
    chain = "".join(f"x{n} = x{n + 1}\n" for n in range(60))
    values, failed, _ = _both(f"def p():\nif False:\n{chain}end\nx60 = 1\nx = x60 + 2147483647\nend")
    assert not failed
    assert values["x"] == ("int", "-2147483648")
