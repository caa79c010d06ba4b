"""Expressions, values, scopes and control flow. Rules and their sources: docs/reference/urscript_rules.md."""

import math

from tests.rows import each_row
from urscript.values import Matrix, Pose, Struct

EXPRESSIONS = [
    # numbers; division is real division (the official control script divides ints by 1000000)
    ("7 / 2", 3.5),
    ("100000 / 1000000", 0.1),
    ("6 / 3", 2.0),
    ("2 + 3 * 4", 14),
    ("2147483647", 2147483647),
    ("2147483647 - 1 + 1", 2147483647),
    ("2147483647 + 1", -2147483648),
    ("-2147483648 - 1", 2147483647),
    ("-(-2147483647 - 1)", -2147483648),
    ("-(-2147483648)", -2147483648),
    ("pow(0, 0.5)", 0.0),
    (f'str_len(str_cat("{"a" * 1000}", "{"b" * 23}"))', 1023),
    ("65536 * 65536", 0),
    ("4294967296", 4294967296.0),
    ("-7 % 3", -1),
    ("7 % -3", 1),
    ("-7.5 % 2", -1.5),
    ("5 % 2.5", 0.0),
    ("7 * 0.5 % 5.0 == 3.5", True),
    ("1e-3", 0.001),
    (".5 + 3.", 3.5),
    ("1.0E-10", 1e-10),
    ("1 / 0", math.inf),
    ("-1 / 0", -math.inf),
    ("-2 - -2", 0),
    ("+3", 3),
    # logic
    ("not 42 >= 87", True),
    ("!True", False),
    ("True and not False or False", True),
    ("True xor True", False),
    ("( False) xor(True)", True),
    ("1 and 0.0", False),
    ('"" or "x"', True),
    ('False and str_at("", 5) == ""', False),  # only right when evaluation stops early
    ("1 == 1.0", True),
    ("1 != 2", True),
    ('"abc" == "abc"', True),
    ('"abc" == 1', False),
    ("None == None", True),
    ("[3,97] == [3,97]", True),
    ("[3,97] != [0,0,0]", True),
    ("p[0,0,0,0,0,0] == p[0,0,0,0,0,0]", True),
    ("[0,0,0,0,0,0] == p[0,0,0,0,0,0]", False),
    ("3 <= 3", True),
    ("norm([3,4]) > norm(1)", True),
    # strings: no escapes, raw newlines
    ('"a" + "b"', "ab"),
    ('"\\"', "\\"),
    ('"a\nb"', "a\nb"),
    # lists and matrices, element by element
    ("[1,2] + [3,4]", [4, 6]),
    ("[1,2] * 2", [2, 4]),
    ("-3 * [1,2]", [-3, -6]),
    ("[1,2] / 2", [0.5, 1.0]),
    ("[10,20] / [2,5]", [5.0, 4.0]),
    ("1 - [1,2]", [0, -1]),
    ("-[1,2]", [-1, -2]),
    ("[5,7] % 4", [1, 3]),
    ("[]", []),
    ("[[1,2],[3,4]][1,0]", 3),
    ("[[1,2],[3,4]][1]", [3, 4]),
    ("[[1,2],[3,4]] * [1,1]", [3, 7]),
    ("[[1,2],[3,4]] * [[0,1],[1,0]] == [[2,1],[4,3]]", True),
    ("[[1,2],[3,4]] * 2 - 1 == [[1,3],[5,7]]", True),
    ("[[1,2],[3,4]] + [[1,1],[1,1]] == [[2,3],[4,5]]", True),
    ("[p[0,0,0,0,0,0], p[1,0,0,0,0,0]][1][0]", 1.0),
    ("p[1,2,3,4,5,6][2]", 3.0),
    ("pose_inv (p[1,2,3,0,0,0]) [2]", -3.0),
    ("[1,2,3][1.0]", 2),
    ("(1, 2, 3)", [1, 2, 3]),  # python-urx writes lists in round brackets
    ("struct(a=1, b=[2]).b[0]", 2),
]


@each_row(("expression", "value"), EXPRESSIONS)
def test_expression(result, expression, value):
    found = result(expression)
    assert found == value
    assert type(found) is type(value)


def test_floats_without_a_number(result):
    assert math.isnan(result("0 / 0"))
    assert math.isnan(result("1.5 % 0"))


def test_value_types(result):
    assert type(result("p[1,2,3,4,5,6]")) is Pose
    assert str(result("p[-0.0,2,3,4,5,6][0]")) == "-0.0"
    assert result("[[1,2],[3,4]]") == Matrix(((1, 2), (3, 4)))
    assert result("struct(a=1)") == Struct({"a": 1})


PROGRAMS = {
    "assignment copies": (
        "a = [1,2]\nb = a\nb[0] = 9\ns = struct(l=a)\ns.l[1] = 7",
        {"a": [1, 2], "b": [9, 2], "s": Struct({"l": [1, 7]})},
    ),
    "arguments are copies": (
        "def f(x):\n x[0] = 5\n return x\nend\na = [1]\nb = f(a)",
        {"a": [1], "b": [5]},
    ),
    "elements of poses and matrices": (
        "q = p[0,0,0,0,0,0]\nq[2] = 1\nm = [[1,2],[3,4]]\nm[1,0] = 9\nm[0][1] = 8",
        {"q": Pose([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), "m": Matrix(((1, 8), (9, 4)))},
    ),
    "a variable called p": (
        "p = [5,6]\nx = p[0] + p[1]\ny = p[0,0,0,0,0,1]\np[0] = 7\nz = p [0]",
        {"p": [7, 6], "x": 11, "y": Pose([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "z": 7},
    ),
    "int and float are one type": ("a = 1\na = a / 2\na = 3", {"a": 3}),
    "none fits every variable": ("a = None\na = 1\na = None", {"a": None}),
    "numbers and strings as conditions": (
        'a = 0\nif 0.5:\n a = a + 1\nend\nif "":\n a = a + 10\nend\nif "x":\n a = a + 100\nend',
        {"a": 101},
    ),
    "if elif else": (
        "x = 2\nif x == 1:\n y = 1\nelif x == 2:\n y = 2\nelif x == 2:\n y = 3\nelse:\n y = 4\nend",
        {"x": 2, "y": 2},
    ),
    "empty blocks": ("x = 1\nif x == 1:\nelse:\nend\nwhile False:\nend", {"x": 1}),
    "break and continue": (
        "i = 0\nn = 0\nwhile True:\n i = i + 1\n if i > 9:\n break\n end\n"
        " if i % 2 == 0:\n continue\n end\n n = n + i\nend",
        {"i": 10, "n": 25},
    ),
    "return without a value": (
        "def f(x):\n if x:\n return\n end\n global hit = True\nend\nf(True)\na = f(False)",
        {"hit": True, "a": None},
    ),
    "defaults and keywords": (
        "c = 10\ndef f(a, b=2, d=c + 1):\n return a * 100 + b * 10 + d\nend\n"
        "w = f(1)\nx = f(1, d=0)\ny = f(b=3, a=2, d=1)\nz = f(1, 1, 1)",
        {"c": 10, "w": 131, "x": 120, "y": 231, "z": 111},
    ),
    "functions may be called before they stand": (
        "def f():\n return g() + 1\nend\ndef g():\n return 1\nend\na = f()",
        {"a": 2},
    ),
    "functions nested in functions": (
        "def f():\n def g():\n return 5\n end\n return g()\nend\na = f()",
        {"a": 5},
    ),
    "a def inside a loop": (
        "i = 0\nwhile i < 3:\n def f():\n i = i + 1\n end\n f()\nend",
        {"i": 3},
    ),
    "recursion": (
        "def fac(n):\n if n < 2:\n return 1\n end\n return n * fac(n - 1)\nend\na = fac(10)",
        {"a": 3628800},
    ),
    "mutual recursion": (
        "def even(n):\n if n == 0:\n return True\n end\n return odd(n - 1)\nend\n"
        "def odd(n):\n if n == 0:\n return False\n end\n return even(n - 1)\nend\na = even(40)",
        {"a": True},
    ),
    # Script Manual chapter 8: an inner function's assignment binds to the global, never to the outer function
    "scopes": (
        "global a = 1\ndef outer():\n local a = 5\n def inner():\n a = 2\n end\n inner()\n return a\nend\nb = outer()",
        {"a": 2, "b": 5},
    ),
    "local on the first level is global": (
        "local a = 1\ndef f():\n a = a + 1\nend\nf()",
        {"a": 2},
    ),
    "a global declared in a function": (
        "def f():\n global made = 3\nend\ndef g():\n made = made + 1\nend\nf()\ng()",
        {"made": 4},
    ),
    "a name only assigned in a function is local to it": (
        "def f():\n tmp = 1\n return tmp\nend\ndef g():\n tmp = 2\n f()\n return tmp\nend\na = g()",
        {"a": 2},
    ),
    "a parameter hides a global": (
        "x = 1\ndef f(x):\n x = x + 10\n return x\nend\na = f(5)",
        {"x": 1, "a": 15},
    ),
    "locals may change their type": (
        "def f():\n v = [1]\n v = p[0,0,0,0,0,0]\n v = 3\n return v\nend\na = f()",
        {"a": 3},
    ),
    "variables named like built-ins": (
        "def f():\n local length = 3\n local time = length([1,2])\n return length + time\nend\n"
        "a = f()\nnorm = norm(-1)",
        {"a": 5, "norm": 1},
    ),
    "python's words are names": (
        "class = 1\nlambda = class + 1\nimport = 3\n__builtins__ = 4\nNone_ = 5",
        {"class": 1, "lambda": 2, "import": 3, "__builtins__": 4, "None_": 5},
    ),
    # the beginning of ur_rtde's control script, as it comes over the wire
    "a value on the next line and a statement behind it": (
        "global a = # offset\n0    global b = # other\n1    global c = 2",
        {"a": 0, "b": 1, "c": 2},
    ),
    "no separator between statements": (
        'a = get_list_length([1])textmsg("x\ny")b = 2 if (b == 2): c = 3 end d = [1,\n2]',
        {"a": 1, "b": 2, "c": 3, "d": [1, 2]},
    ),
    "an operator at the end of a line continues it": (
        "a = (1 == 1) and\n  (2 == 2)\nif a == False or\n a == True or\n a == False:\n b = 1\nend",
        {"a": True, "b": 1},
    ),
    "a bracket on a new line begins nothing new": ('a = [1,2]\nb = a\n$ 1 "x"', {"a": [1, 2], "b": [1, 2]}),
    "lists that grow": (
        "l = make_list(1, 0, 3)\nl.append(5)\nl.insert(0, 7)\na = l.pop()\nb = l.remove(0)\nc = l.length()\n"
        "d = l.capacity()\ne = l.to_string()\nl.clear()",
        {"l": [], "a": 5, "b": 7, "c": 1, "d": 3, "e": "[0]"},
    ),
    "more methods of lists": (
        "l = make_list(2, 1, 5)\nl.extend([2,3])\na = l.excess_capacity()\nb = l.slice(1, 3)\nc = l.length()",
        {"l": [1, 1, 2, 3], "a": 1, "b": [1, 2], "c": 4},
    ),
    "methods of structs and matrices": (
        "s = struct(m=1, n=2)\na = s.length()\nb = s[1]\nm = [[1,2],[3,4]]\nc = m.get_column(1)\nd = m.get_row(1)\n"
        "e = m.shape()\nf = m.to_string() == to_str(m)",
        {"a": 2, "b": 2, "c": [2, 4], "d": [3, 4], "e": [2, 2], "f": True},
    ),
    "a list takes the members of a struct": (
        'l = [0.0, 0.0]\nl = struct(m1 = 1.5, m2 = 2)\nt = ["a"]\nt = struct(m = "b")',
        {"l": [1.5, 2], "t": ["b"]},
    ),
    "list methods reach into structs and leave copies alone": (
        "s = struct(l=make_list(0, 0, 2))\nt = s\ns.l.append(1)\na = t.l.length()\nb = s.l.length()",
        {"a": 0, "b": 1},
    ),
    "a list takes any length since 5.15": ("a = [1]\na = [1,2]\na = []", {"a": []}),
    "tabs, carriage returns and umlauts": ('\ta = 1\t\r\n b = "größe" # ≟ comment\r\n', {"a": 1, "b": "größe"}),
}


@each_row("name", PROGRAMS)
def test_program(run, name):
    text, expected = PROGRAMS[name]
    done = run(f"def prog():\n{text}\nend")
    assert done.error is None
    assert done.runtime.finished
    assert {key: done.globals[key] for key in expected} == expected


def test_lists_keep_their_length_before_5_15(run):
    for version in ("5.14.6", "3.15.8"):
        done = run("def f():\n a = [1]\n a = [2]\n a = [1,2]\nend", version=version)
        assert done.error == (4, 2, "Resizing of 'List' is not supported")
        assert "no method" in run("def f():\n a = [1]\n b = a.length()\nend", version=version).error[2]


def test_statements_outside_a_def_are_a_program(run, compiled):
    done = run("x = 1\nx = x + 1")
    assert done.globals == {"x": 2}
    assert compiled("x = 1").kind == "statement"
    assert compiled("sec s():\nend").kind == "secondary"
    assert (compiled("\n def name():\nend").kind, compiled("def name():\nend").name) == ("program", "name")


def test_globals_appear_once_they_have_a_value(run):
    done = run("def f():\n  a = 1\n  sync()\n  b = 2\nend", frames=1)
    assert done.globals == {"a": 1}


def test_labels(run, compiled):
    text = 'def f():\n  $ 1 "BeforeStart"\n  thread t():\n    $ 3 "日本" "noBreak"\n  end\n  run t()\n  sync()\nend'
    done = run(text)
    assert done.bench.labels == [(1, "BeforeStart", "f"), (3, "日本", "t")]
    assert [(label.number, label.option) for label in compiled(text).labels] == [(1, ""), (3, "noBreak")]


def test_keyword_arguments_of_built_ins(run):
    done = run(
        "def f():\n movej([0,0,0,0,0,0], v=2, t=1)\n speedl([1], t_min=0.5)\n speedl([1], 2, t=0.5)\n"
        ' a = newer(lambda=3, name="n")\nend'
    )
    assert done.error is None
    assert done.bench.log == [
        "movej [0, 0, 0, 0, 0, 0] a=1.4 v=2 t=1 r=0",
        "speedl a=1.2 t=0.5",
        "speedl a=2 t=0.5",
    ]
    assert done.globals == {"a": "n3"}


def test_a_function_of_the_program_wins_over_a_built_in(run):
    done = run("def f():\n def norm(x):\n return 7\n end\n a = norm(1)\nend")
    assert done.globals == {"a": 7}


def test_a_program_is_compiled_once(compiled):
    assert compiled("x = 1") is compiled("x = 1")
    assert compiled("x = 1") is not compiled("x = 1", "5.12")
