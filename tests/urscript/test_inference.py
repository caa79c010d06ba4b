"""Code compiled to plain Python behaves as the operators and built-ins that look at every value."""

import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urscript import Runtime, compile_script, operators
from urscript.inference import (
    ANYTHING,
    BOOL,
    BOOLS,
    FLOAT,
    FLOATS,
    INT,
    INTS,
    NUMBER,
    OTHER,
    STRING,
    VECTOR,
    arithmetic,
    element_kind,
)

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not add the folder

from comparing import SET, VERSION, Host, run, run_in_general


def _both(text):
    """The variables of a program, and the line of its error, with and without what is known of its variables."""
    (_, values, error), (_, general, error_in_general) = run(text), run_in_general(text)
    lines = [found and found[0] for found in (error, error_in_general)]
    assert (values, lines[0]) == (general, lines[1])
    return values, lines[0]


@each_row(
    ("operator", "left", "right", "kind"),
    [
        ("+", INT, INT, INT),
        ("+", INT, FLOAT, FLOAT),
        ("/", INT, INT, FLOAT),
        ("*", NUMBER, INT, NUMBER),
        ("+", STRING, STRING, STRING),
        ("-", STRING, STRING, ANYTHING),
        ("+", INTS, INT, INTS),
        ("*", FLOATS, INT, FLOATS),
        ("/", INTS, INTS, FLOATS),
        ("+", VECTOR | INTS, INT, VECTOR),
        ("+", VECTOR, FLOATS, VECTOR),
        ("+", VECTOR | INT, INT, ANYTHING),
        ("+", BOOLS, INT, ANYTHING),
        ("+", 0, INT, 0),
        ("+", FLOAT, 0, 0),
    ],
)
def test_kinds_of_arithmetic(operator, left, right, kind):
    assert arithmetic(operator, left, right) == kind


@each_row(
    ("kind", "element"),
    [(INTS, INT), (FLOATS, FLOAT), (BOOLS, BOOL), (VECTOR, NUMBER), (INTS | VECTOR, NUMBER), (OTHER, ANYTHING), (0, 0)],
)
def test_kinds_of_elements(kind, element):
    assert element_kind(kind) == element


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
        "s",
        "t",
        '"xy"',
        '""',
        "True",
        "str_cat(s, a)",
        "to_str(c)",
        "str_len(s)",
        "str_at(s, a)",
        'str_find(s, "y")',
        "str_sub(s, a)",
        "sin(a)",
        "sqrt(b)",
        "pow(a, b)",
        "floor(c)",
        "length(v)",
        "get_list_length(s)",
        "make_list(3, c)",
        "make_list(2, t)",
        "k",
        "(k + 1)",
        "u",
        "u[k]",
        "u[k - 1]",
        "v[a % 3]",
        "w[0]",
        "cos(1e308)",
    ]
)
EXPRESSIONS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/%"), inner).map(lambda parts: f"({' '.join(parts)})"),
        inner.map(lambda text: f"(-{text})"),
        st.tuples(inner, inner, inner).map(lambda items: f"[{', '.join(items)}]"),
        st.tuples(inner, st.sampled_from(["and", "or", "xor", "<", "=="]), inner).map(lambda p: f"({' '.join(p)})"),
        inner.map(lambda text: f"(not {text})"),
    ),
    max_leaves=6,
)
CONDITIONS = st.one_of(
    st.tuples(EXPRESSIONS, st.sampled_from(["<", "<=", "==", "!=", ">="]), EXPRESSIONS).map(" ".join), EXPRESSIONS
)
STATEMENTS = st.one_of(
    st.tuples(
        st.sampled_from(["a", "b", "c", "s", "t", "v", "v[0]", "w", "w[a]", "u[a]", "u[k + 1]", "u", "k", "local d"]),
        EXPRESSIONS,
    ).map(" = ".join),
    st.just("w = v"),
    st.tuples(CONDITIONS, st.sampled_from("abcstv"), EXPRESSIONS).map(lambda p: f"if {p[0]}:\n{p[1]} = {p[2]}\nend"),
)
BLOCKS = st.lists(STATEMENTS, min_size=1, max_size=5).map("\n".join)


COUNTERS = st.tuples(
    st.sampled_from([0, -3, 2147483645]),
    st.sampled_from(["k < 4", "4 >= k", "k < 2147483647", "k < c", "a > k and k < c", "k <= b", "True"]),
    st.sampled_from(["k = k + 1", "k = k + 2", "k = k - 1", "if t:\nk = k + 1\nend\nk = k + 1"]),
)


@given(BLOCKS, EXPRESSIONS, EXPRESSIONS, BLOCKS, st.booleans(), COUNTERS)
def test_inferred_programs_do_what_general_ones_do(block, first, second, loop, in_function, counter):
    start, condition, step = counter
    body = f"{block}\nwhile {condition} and n < 6:\nn = n + 1\n{step}\n{loop}\nend\n"
    names = 'a = 1\nb = 2.0\nc = 3\ns = "say"\nt = False\nv = [1.0, 2, 3]\nw = [True, False]\n'
    names += f"u = [1, 2, 3]\nk = {start}\nn = 0\n"
    parameters = 'b, v, a=1, c=0.5, s="d", t=True, u=[1, 2], k=1, w=[True]'
    functions = f"def f(x):\nreturn x * 3\nend\ndef g({parameters}):\na = {first}\nreturn {second}\nend\n"
    if in_function:
        values = "str_cat(str_cat(str_cat(a, b), str_cat(u, k)), str_cat(str_cat(v, w), t))"
        text = f"def p():\n{functions}def h():\n{names}{body}return {values}\nend\nresult = h()\nend"
    else:
        text = f"def p():\n{functions}{names}{body}end"
    _both(text)


@each_row(
    ("body", "name", "value"),
    [
        ("x = 2147483647\nx = x + 1", "x", ("int", "-2147483648")),
        ("x = -2147483648\nx = x - 1", "x", ("int", "2147483647")),
        ("x = 65536\nx = x * x + 7", "x", ("int", "7")),
        ("k = -7\nx = k % 3", "x", ("int", "-1")),
        ("k = 0\nx = 1 / k", "x", ("float", "inf")),
        ("k = 7\nj = 2\nx = k / j", "x", ("float", "3.5")),
        ("def f(a):\nreturn a + a\nend\nx = f(2)\ny = f([1, 2])", "y", ("list", "[2, 4]")),
        ("q = [1, 2, 3]\nk = 4\nx = q[k % 3] + q[k - 3]", "x", ("int", "4")),
        ("q = [1.5, 2.5]\nq[0] = 2\nx = q[0] + q[1]", "x", ("float", "4.5")),
        ("t = 1 < 2\nx = 0\nif t:\nx = 1\nend", "x", ("int", "1")),
        ("n = 0\nx = 1\nif n:\nx = 2\nend", "x", ("int", "1")),
        ("n = 0.5\nx = (n and True)", "x", ("bool", "True")),
        ('s = ""\nx = not s', "x", ("bool", "True")),
        ('s = "a"\ns = s + "b"\nx = str_len(s)', "x", ("int", "2")),
        ("x = floor(2.5) + 1", "x", ("int", "3")),
        ("a = -2.5\nx = floor(a) + ceil(a)", "x", ("int", "-5")),
        ("a = 3e9\nx = floor(a)", "x", ("float", "3000000000")),
        ("a = -1e309\nx = ceil(a)", "x", ("float", "-inf")),
        ('x = to_num("7") + to_num("0.5")', "x", ("float", "7.5")),
        ("x = cos(1e309)", "x", ("float", "nan")),
        ("a = 7\nb = -2\nx = a % b", "x", ("int", "1")),
        ("a = 7\nb = 4\nx = a % b", "x", ("int", "3")),
        ("v = make_list(2, 0.5)\nv[1] = 2\nx = v[0] + v[1]", "x", ("float", "2.5")),
        ('x = str_sub("abc", 1)', "x", ("str", "bc")),
        ("def f(n):\nif n < 2:\nreturn 1\nend\nreturn n * f(n - 1)\nend\nx = f(13)", "x", ("int", "1932053504")),
    ],
)
def test_rules_hold_where_the_operands_are_known(body, name, value):
    values, error_line = _both(f"def p():\n{body}\nend")
    assert error_line is None
    assert values[name] == value


@each_row(
    ("start", "condition", "steps", "value"),
    [
        (2147483645, "k < 2147483647", ["k = k + 1"], 2147483647),
        (2147483645, "k < 2147483647", ["k = k + 1", "k = k + 1"], 2147483647),
        (2147483646, "k < 2147483647", ["k = k + 1", "k = k + 1"], -2147483644),
        (2147483646, "k > 0", ["k = k + 1"], -2147483648),
        (2147483646, "k < 2147483647.5", ["k = k + 1"], -2147483647),
        (2147483645, "k <= 2147483646", ["k = k + 2"], 2147483647),
        (2147483646, "k <= 2147483646", ["k = k + 2"], -2147483644),
        (-2147483647, "-2147483648 < k", ["k = k - 1"], -2147483648),
        (-2147483647, "k >= -2147483648", ["k = k - 1"], 2147483646),
        (0, "k < 2147483647", ["k = k + 2147483646"], 2147483642),
    ],
)
def test_counters_wrap_unless_their_loop_bounds_them(start, condition, steps, value):
    loop = f"while {condition} and n < 3:\n{chr(10).join(steps)}\nn = n + 1\nend"
    values, error_line = _both(
        f"def p():\ndef f():\nlocal k = {start}\nlocal n = 0\n{loop}\nreturn k\nend\nx = f()\nend"
    )
    assert error_line is None
    assert values["x"] == ("int", str(value))


@each_row(
    ("body", "line"),
    [
        ('q = [1, 2]\nq[0] = "s"\nx = q[0] * 3', 4),  # an element may be anything by then
        ("q = [1, 2]\nk = 2\nx = q[k]", 4),
        ("q = [1, 2]\nk = -1\nx = q[k]", 4),
        ('def f(a):\nreturn a + 1\nend\nx = f(1)\ny = f("s")', 3),
        ('s = "a"\ns = 1\nx = str_len(s)', 3),
        ('s = "a"\nx = s + 1', 3),
        ('x = str_at("abc", 1.5)', 2),
        ("x = sqrt(0 - 2)", 2),
        ("if [1]:\nx = 1\nend", 2),
        ("def g():\nreturn sin(late)\nend\nx = g()\nlate = 1", 3),
        ("def g():\nif late:\nreturn 1\nend\nreturn 2\nend\nx = g()\nlate = True", 3),
        ("def f(a):\nif a > 0:\nreturn 1\nend\nend\nx = f(0) + 1", 7),  # it returned nothing
        ("def g():\nreturn late + 1\nend\nx = g()\nlate = 1", 3),
    ],
)
def test_what_may_be_something_else_is_looked_at(body, line):
    _, error_line = _both(f"def p():\n{body}\nend")
    assert error_line == line


def test_a_text_made_to_need_many_rounds_compiles_without_inference():
    chain = "".join(f"x{n} = x{n + 1}\n" for n in range(60))
    values, error_line = _both(f"def p():\nif False:\n{chain}end\nx60 = 1\nx = x60 + 2147483647\nend")
    assert error_line is None
    assert values["x"] == ("int", "-2147483648")


# Nobody sees that an element is written in place: whoever else has the list keeps what it was.


@each_row(
    ("body", "expected"),
    [
        ("a = [1, 2]\nb = a\na[0] = 9\na[1] = 8", {"a": "[9, 8]", "b": "[1, 2]"}),
        ("def f(q):\nq[0] = 9\nq[1] = 8\nreturn q\nend\na = [1, 2]\nb = f(a)", {"a": "[1, 2]", "b": "[9, 8]"}),
        ("def f():\na[0] = 9\na[1] = 8\nend\na = [1, 2]\nb = a\nf()", {"a": "[9, 8]", "b": "[1, 2]"}),
        ("def f():\nlocal q = [1, 2]\nlocal p = q\nq[0] = 9\nreturn p\nend\na = f()", {"a": "[1, 2]"}),
        ("def f(q=[1, 2]):\nq[0] = q[0] + 1\nreturn q\nend\na = f()\nb = f()", {"a": "[2, 2]", "b": "[2, 2]"}),
        ("k = 0\nwhile k < 3:\na = [1, 2]\na[0] = a[0] + 1\nk = k + 1\nend", {"a": "[2, 2]"}),
        ("a = make_list(2, [1, 2])\na[0] = 3\nb = a[1]\na[1] = 4", {"a": "[3, 4]", "b": "[1, 2]"}),
        ("a = make_list(2, 0, 5)\nb = a\na[0] = 1\na.append(7)\na[2] = 8", {"a": "[1, 0, 8]", "b": "[0, 0]"}),
        ("s = struct(l=[1, 2])\na = s.l\na[0] = 9\nb = s.l", {"a": "[9, 2]", "b": "[1, 2]"}),
        ("s = struct(l=[1, 2])\nb = s.l\ns.l[0] = 9\na = s.l", {"a": "[9, 2]", "b": "[1, 2]"}),
        ("a = [1, 2]\nb = [a, 3]\na[0] = 9", {"a": "[9, 2]", "b": "[[1, 2], 3]"}),
    ],
)
def test_a_written_element_reaches_nobody_else(body, expected):
    values, error_line = _both(f"def p():\n{body}\nend")
    assert error_line is None
    assert {name: values[name][1] for name in expected} == expected


LOOP = "k = 0\nwhile k < 50:\na[k] = k\nk = k + 1\nend\n"


@pytest.mark.parametrize(
    "body",
    [
        f"a = make_list(50, 0)\n{LOOP}",
        f"def f():\nlocal a = make_list(50, 0)\n{LOOP}return a\nend\na = f()",
        f"def f():\na = make_list(50, 0)\n{LOOP}return a\nend\ndef g():\nreturn f()\nend\na = g()",
        f"thread t():\n{LOOP}end\na = make_list(50, 0)\nh = run t()\njoin h",
    ],
)
def test_a_list_that_one_variable_has_is_not_copied_at_each_write(body, monkeypatch):
    copies, copy = [], operators._copied

    def counting(value):
        copies.append(value)
        return copy(value)

    monkeypatch.setattr(operators, "_copied", counting)
    _, values, error = run(f"def p():\n{body}\nend")
    assert error is None
    assert values["a"][1] == str(list(range(50)))
    assert len(copies) <= 1  # when the first element is written after an assignment that kept a reference


def test_what_a_host_keeps_stays_as_it_was():
    program = Runtime(compile_script("def p():\na = [1, 2]\nsync()\na[0] = 9\nend", SET, VERSION), Host())
    program.step()
    kept = program.globals["a"]
    program.step()
    assert program.finished
    assert (kept, program.globals["a"]) == ([1, 2], [9, 2])


def _program(body, start="0"):
    square = "def square(n):\nreturn n * n\nend\ndef counted():\ntotal = total + 1\nreturn total\nend\n"
    names = f'local i = 0\nlocal j = 3\nlocal k = {start}\nlocal s = "banana"\n'
    names += "local a = [1, 2, 3]\nlocal b = make_list(4, 1)\nlocal c = [7, 8]\n"
    ends = "".join(f"global end_{name} = {name}\n" for name in "ijkacs") + "global end_b = b[0] + length(b)\n"
    function = f"def h(x):\n{names}{body}\n{ends}end\n"
    return f"def p():\nspent = 0\ntotal = 0\n{square}{function}result = h(2)\nend"


@each_row(
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
    values, error_line = _both(text)
    assert error_line is None
    assert values["result"][1] == result


@each_row("depth", [17, 18, 19, 20])
def test_loops_are_nested_as_deeply_as_the_parser_allows(depth):
    loops = "".join(f"while k < {n + 1}:\nk = k + 1\n" for n in range(depth)) + "end\n" * depth
    values, error_line = _both(f"def p():\ndef h(k):\n{loops}return k\nend\nresult = h(0)\nend")
    assert error_line is None
    assert values["result"] == ("int", str(depth))
