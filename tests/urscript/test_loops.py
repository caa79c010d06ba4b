"""Loops compiled with what is known of their variables do what loops do of which nothing is known.

Neither wraps and tests that range analysis leaves out nor batches of passes change a value, an error, its line, or the
frame in which anything happens.
"""

import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.budget import examples
from urscript import compile_statements

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not add the folder

from comparing import run, run_in_general


def _one_pass_at_a_time(text):
    """What a program does when its loops are not executed in batches."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compile_statements, "in_batches", lambda condition, body, *_: body)
        return run(text)


NUMBERS = st.sampled_from(["0", "1", "2", "3", "7", "-1", "-2", "40", "65536", "2147483647", "-2147483648"])
NAMES = st.sampled_from(["i", "j", "k", "x"])
LISTS = st.sampled_from("abc")
INTS = st.recursive(
    st.one_of(
        NUMBERS,
        NAMES,
        NAMES,
        LISTS.map("length({})".format),
        st.just("str_len(s)"),
        st.tuples(LISTS, NAMES).map(lambda parts: f"{parts[0]}[{parts[1]}]"),
    ),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*%"), inner).map(lambda parts: f"({' '.join(parts)})"),
        inner.map("(-{})".format),
        inner.map("square({})".format),
        st.tuples(LISTS, inner).map(lambda parts: f"{parts[0]}[{parts[1]}]"),
    ),
    max_leaves=3,
)
CONDITIONS = st.recursive(
    st.one_of(
        st.tuples(NAMES, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), INTS).map(" ".join),
        st.tuples(INTS, st.sampled_from(["<", ">=", ">"]), NAMES).map(" ".join),
        st.tuples(NAMES, LISTS).map(lambda parts: f"{parts[0]} < length({parts[1]})"),
        st.tuples(NAMES, LISTS).map(lambda parts: f"0 <= {parts[0]} and {parts[0]} < length({parts[1]})"),
        st.just('str_at(s, k) == "a"'),
        st.just("k < str_len(s)"),
        st.just("True"),
    ),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(lambda parts: f"({' '.join(parts)})"),
        inner.map("(not {})".format),
    ),
    max_leaves=3,
)
SIMPLE = st.one_of(
    st.tuples(NAMES, INTS).map(" = ".join),
    st.tuples(NAMES, NAMES, st.sampled_from(["+ 1", "- 1", "+ 2", "% 3", "* 2"])).map(
        lambda p: f"{p[0]} = {p[1]} {p[2]}"
    ),
    st.tuples(LISTS, INTS, INTS).map(lambda parts: f"{parts[0]}[{parts[1]}] = {parts[2]}"),
    st.tuples(LISTS, st.sampled_from(["a", "b", "[1, 2]", "make_list(3, 5)", "make_list(k, 0)", "a + 1"])).map(
        " = ".join
    ),
    INTS.map("s = str_cat(s, {})".format),
    st.just("total = total + k"),
)
EXITS = st.tuples(CONDITIONS, st.sampled_from(["break", "continue", "return 5", "return k"])).map(
    lambda parts: f"if {parts[0]}:\n{parts[1]}\nend"
)


def _several(inner):
    return st.lists(inner, min_size=1, max_size=3).map("\n".join)


def _larger(inner):
    block = _several(inner)
    leaving = _several(st.one_of(inner, EXITS))
    return st.one_of(
        st.tuples(CONDITIONS, block).map(lambda p: f"if {p[0]}:\n{p[1]}\nend"),
        st.tuples(CONDITIONS, block, CONDITIONS, block, block).map(
            lambda p: f"if {p[0]}:\n{p[1]}\nelif {p[2]}:\n{p[3]}\nelse:\n{p[4]}\nend"
        ),
        st.tuples(CONDITIONS, leaving).map(
            lambda p: f"while {p[0]}:\nspent = spent + 1\nif spent > 60:\nreturn 9\nend\n{p[1]}\nend"
        ),
        st.tuples(CONDITIONS, leaving).map(lambda p: f"while {p[0]} and spent < 60:\nspent = spent + 1\n{p[1]}\nend"),
        st.tuples(NAMES, NUMBERS, leaving).map(
            lambda p: (
                f"{p[0]} = 0\nwhile {p[0]} < 5 and spent < 60:\nspent = spent + 1\n{p[2]}\n{p[0]} = {p[0]} + 1\nend"
            )
        ),
    )


BODIES = _several(st.recursive(SIMPLE, _larger, max_leaves=6))


def _program(body, start="0"):
    square = "def square(n):\nreturn n * n\nend\ndef counted():\ntotal = total + 1\nreturn total\nend\n"
    names = f'local i = 0\nlocal j = 3\nlocal k = {start}\nlocal s = "banana"\n'
    names += "local a = [1, 2, 3]\nlocal b = make_list(4, 1)\nlocal c = [7, 8]\n"
    ends = "".join(f"global end_{name} = {name}\n" for name in "ijkacs") + "global end_b = b[0] + length(b)\n"
    function = f"def h(x):\n{names}{body}\n{ends}end\n"
    return f"def p():\nspent = 0\ntotal = 0\n{square}{function}result = h(2)\nend"


def _agreed(text):
    """What a program does, which is the same with and without knowledge of its variables."""
    found, general = run(text), run_in_general(text)
    assert found[1:] == general[1:]
    return found


@settings(max_examples=examples(300))
@given(BODIES, st.sampled_from(["0", "-1", "2147483646"]))
def test_loops_do_what_loops_do_of_which_nothing_is_known(body, start):
    _agreed(_program(body, start))


@settings(max_examples=examples(100))
@given(BODIES, st.sampled_from(["0", "-1"]))
def test_batches_of_passes_change_nothing(body, start):
    text = _program(body, start).replace("60", "20000")
    assert run(text) == _one_pass_at_a_time(text)


@pytest.mark.parametrize(
    ("body", "position"),
    [
        ("return a[3]", 3),
        ("return a[i - 1]", -1),
        ("return a[(0 - 4) % 3]", -1),
        ("i = 3\nreturn a[i % 4]", 3),
        ("while k < length(a):\nk = k + 1\nj = a[k]\nend\nreturn j", 3),
        ("k = 1\nwhile k < length(a):\na = [1]\nj = a[k]\nend\nreturn j", 1),
        ("while k < length(a):\nk = k - 1\nj = a[k]\nend\nreturn j", -1),
        ("while i < 3:\nj = a[2]\na = [1, 2]\ni = i + 1\nend\nreturn j", 2),
        ("if k < length(a):\nwhile i < 4:\nj = a[k]\nk = k + 1\ni = i + 1\nend\nend\nreturn j", 3),
        ("k = 5\nif j > 0:\nj = 1\nelif k < length(a):\nj = 2\nend\nreturn a[k]", 5),
        ("while i < 4:\nj = a[k]\ni = i + 1\nif i == 2:\nk = 9\ncontinue\nend\nk = 0\nend\nreturn j", 9),
        ("while i < 4:\ni = i + 1\nif i > 2:\nk = 9\nbreak\nend\nend\nreturn a[k]", 9),
        ("while i < 4:\ni = i + 1\nif i > 2:\nk = 0 - 1\nbreak\nend\nend\nreturn a[k]", -1),
        ("while i < 4:\nj = 0\nwhile j < 2:\nk = k + a[j]\nj = j + 1\nend\ni = i + 1\nend\nreturn a[j + k]", 14),
        ("k = 5\nif k < length(a) or i == 0:\nreturn a[k]\nend", 5),
        ("k = 5\nif not (k >= length(a) and i == 1):\nreturn a[k]\nend", 5),
        ("k = 5\nif k < length(a) and i == 0:\nj = 0\nend\nreturn a[k]", 5),
        ("k = 5\nt = k < length(a) and i == 0\nreturn a[k]", 5),
        ("k = 2\nwhile i < 4:\nj = a[k]\nk = k - 1\ni = i + 1\nend\nreturn j", -1),
        ("while k <= length(a):\nj = a[k]\nk = k + 1\nend\nreturn j", 3),
        ("while not k > length(a):\nj = a[k]\nk = k + 1\nend\nreturn j", 3),
        ("a.pop()\nreturn a[2]", 2),
        ("a = make_list(j, 0)\nreturn a[j]", 3),
        ("a = a + 1\nreturn a[j]", 3),
        ("while k < 4:\na[k] = 0\nk = k + 1\nend\nreturn a[0]", 3),
        ("k = 2147483647\nif k > 0:\nreturn a[k + 1]\nend", -2147483648),
        ("k = 65536\nreturn a[k * k - 1]", -1),
        ("while k < 4:\nk = k + 1\nend\nreturn a[k]", 4),
    ],
)
def test_positions_beyond_a_list_are_refused(body, position):
    _, _, error = _agreed(_program(body))
    assert error is not None
    assert error[1].startswith(f"Index out of bounds: {position}, ")


@pytest.mark.parametrize(
    ("body", "result"),
    [
        ("while i < 6:\ni = i + 1\nif i % 2 == 0:\ncontinue\nend\nj = j + i\nend\nreturn [i, j]", "[6, 12]"),
        ("while True:\ni = i + 1\nif i % 2 == 0:\ncontinue\nend\nif i > 6:\nbreak\nend\nend\nreturn i", "7"),
        ("while i < 9:\nif i == 4:\nreturn [i, j]\nend\ni = i + 1\nend\nreturn 0", "[4, 3]"),
        ("b = a\nb[0] = 9\nreturn [a[0], b[0]]", "[1, 9]"),
        ("b = a\nwhile i < 3:\nb[i] = 0\ni = i + 1\nend\nreturn [a[0], a[2], b[0], b[2]]", "[1, 3, 0, 0]"),
        ("c = [1, 2]\nb = c\nc[0] = 9\nreturn [b[0], c[0]]", "[1, 9]"),
        ("kept = c\nc[1] = 9\nreturn [kept[1], c[1]]", "[8, 9]"),
        ("while i < 3:\nc = [5, 6]\nkept = c\nc[0] = i\ni = i + 1\nend\nreturn kept[0] + c[0]", "7"),
        ("c[0] = first(c)\nreturn [c[0], held[0]]", "[7, 7]"),
        ("c[0] = 1 + first(c)\nreturn [c[0], held[0]]", "[8, 7]"),
    ],
)
def test_what_a_loop_or_an_element_ends_up_as(body, result):
    text = _program(body).replace("def h(", "def first(q):\nglobal held = q\nreturn q[0]\nend\ndef h(")
    _, values, error = _agreed(text)
    assert error is None
    assert values["result"][1] == result


@pytest.mark.parametrize(
    "body",
    [
        "while k < 9000:\nk = k + 1\nend\nreturn k",
        "while k < 9000:\nj = (j + square(k % 9)) % 101\nk = k + 1\nend\nreturn j",
        "while True:\nk = k + 1\nif k % 3 == 0:\ncontinue\nend\nif k > 9000:\nbreak\nend\nend\nreturn k",
        "while i < 300:\nj = 0\nwhile j < i:\nj = j + 1\nend\ni = i + 1\nend\nreturn j",
        "b = make_list(160, 0)\nwhile k < 9000:\nc = b\nc[k % 160] = k\nb = c\nk = k + 1\nend\nreturn k",
        "while square(k) < 20000000:\nk = k + 1\nend\nreturn k",
        "while counted() < 9000:\nk = k + 1\nend\nreturn k",
        "while k < 9000:\nk = k + 1\nif k == 7777:\nreturn k\nend\nend",
    ],
)
def test_long_loops_take_the_frames_their_passes_take(body):
    text = _program(body.replace("k = k + 1", "k = k + 1\ntotal = total + 1"))
    found = run(text)
    assert 5 < len(found[0]) < 300
    assert found == _one_pass_at_a_time(text)


@pytest.mark.parametrize("depth", [17, 18, 19, 20])
def test_loops_are_nested_as_deeply_as_the_parser_allows(depth):
    loops = "".join(f"while k < {n + 1}:\nk = k + 1\n" for n in range(depth)) + "end\n" * depth
    _, values, error = _agreed(f"def p():\ndef h(k):\n{loops}return k\nend\nresult = h(0)\nend")
    assert error is None
    assert values["result"] == ("int", str(depth))
