"""Broken programs and what is said about them: the table is the specification.

The wire texts marked "seen" are from real controllers: the official client library's test, and the
notes of a laboratory that drives robots by script.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import urscript
from urscript import CompileError, RuntimeFault, ScriptError
from urscript.arguments import BindingError

# text, line, column, wire text
COMPILE_ERRORS = [
    # seen: an unknown function, with line and column
    ("def illegal_fun():\n  calldoesntexist()\nend", 2, 3, "compile_error_name_not_found:calldoesntexist:"),
    # seen: an unbalanced parenthesis is noticed at the end
    (
        'def unbalanced_parens():\n    textmsg("log ", get_list_length([1])\nend',
        3,
        1,
        "syntax_error_on_line:3:end:",
    ),
    # seen: the line is quoted with its indentation, blank lines before the def do not count
    (
        "\n\ndef f():\n    a = 1\n    b = (2\n    movej([0.5, -1, -2, 0, 0, -0], a=0.25, v=1.0)\nend",
        4,
        5,
        "syntax_error_on_line:4:    movej([0.5, -1, -2, 0, 0, -0], a=0.25, v=1.0):",
    ),
    ("# comment\n\ndef f():\n  nope()\nend", 2, 3, "compile_error_name_not_found:nope:"),
    ("def f():\n  if False:\n    undefined_fn()\n  end\nend", 3, 5, "compile_error_name_not_found:undefined_fn:"),
    ("def f():\n  x = y + 1\nend", 2, 7, "compile_error_name_not_found:y:"),
    ("def f():\n  def g():\n    z = late()\n  end\n  first()\nend", 3, 9, "compile_error_name_not_found:late:"),
    ("def f():\n  x[0] = 1\nend", 2, 3, "compile_error_name_not_found:x:"),
    ("digital_out[2]=True", 1, 1, "compile_error_name_not_found:digital_out:"),
    ("def f():\n  def g():\n    local a = 1\n  end\n  b = a\nend", 5, 7, "compile_error_name_not_found:a:"),
    ("def f():\n  def g():\n    return 1\n  end\n  run g()\nend", 5, 3, "compile_error_name_not_found:g:"),
    ("def f():\n  thread t():\n    sync()\n  end\n  t()\nend", 5, 3, "compile_error_name_not_found:t:"),
    ("def f():\n  x = 1 +\nend", 3, 1, "syntax_error_on_line:3:end:"),
    ("def f():\n  while True\n    sync()\n  end\nend", 3, 5, "syntax_error_on_line:3:    sync():"),
    ("def f():\n  sync()\n", 2, 9, "syntax_error_on_line:2:  sync():"),
    ("def f():\n  sync()\nend\nend", 4, 1, "syntax_error_on_line:4:end:"),
    ("def f():\n  break\nend", 2, 3, "syntax_error_on_line:2:  break:"),
    ("def f():\n  while True:\n    def g():\n      continue\n    end\n  end\nend", 4, 7, None),
    ("def f(a):\n  sync()\nend", 1, 7, "syntax_error_on_line:1:def f(a)::"),
    ("def f():\n  thread t(a):\n  end\nend", 2, 12, None),
    ("def f():\n  sec g():\n  end\nend", 2, 3, "syntax_error_on_line:2:  sec g()::"),
    ("def f():\n  x = p[1,2,3]\nend", 2, 8, None),
    ("def f():\n  x = 'text'\nend", 2, 7, "syntax_error_on_line:2:  x = 'text':"),
    ('def f():\n  x = "text\nend', 2, 7, 'syntax_error_on_line:2:  x = "text:'),
    ("def f():\n  x += 1\nend", 2, 5, None),
    ("def f():\n  x = 1;\nend", 2, 8, None),
    ("def f():\n  a = b = 1\nend", 2, 9, None),
    ("def f():\n  movej(q=[0], 1)\nend", 2, 16, None),
    ("def f():\n  def g(a=1, b):\n  end\nend", 2, 14, None),
    ("def f():\n  def g(a, a):\n  end\nend", 2, 12, None),
    ("def f():\n  global x\nend", 3, 1, "syntax_error_on_line:3:end:"),
    ("def f():\n  1 = 2\nend", 2, 3, None),
    ("def f():\n  [1][0] = 2\nend", 2, 3, None),
    ("def f():\n  foo bar\nend", 2, 7, None),
    ("textmsg(unquoted words)", 1, 18, "syntax_error_on_line:1:textmsg(unquoted words):"),
    ("set robotmode run", 1, 5, "syntax_error_on_line:1:set robotmode run:"),
    ("run program", 1, 12, "syntax_error_on_line:1:run program:"),
    ("x = " + "(" * 200 + "1" + ")" * 200, 1, None, None),
    ("x = " + "+".join(["1"] * 1000), 1, None, None),
    ("if True:\n" * 80 + "end\n" * 80, 62, None, None),
    ("while True:\n" * 30 + "sync()\n" + "end\n" * 30, 21, 1, None),  # Python allows 20 loops in each other
]


@pytest.mark.parametrize(("text", "line", "column", "wire"), COMPILE_ERRORS)
def test_broken_program_is_refused_at_its_place(compiled, text, line, column, wire):
    with pytest.raises(CompileError) as caught:
        compiled(text)
    error = caught.value
    assert line is None or error.line == line
    assert column is None or error.column == column
    assert wire is None or error.wire == wire


# text, line, column, part of the message
RUNTIME_ERRORS = [
    # seen: the type of a variable is that of its first value (the spelling is the controller's)
    (
        'def f():\n  x = 1\n  x = "a"\nend',
        3,
        3,
        "Type error: left-hand side of the expression exected type 'Int' but found 'Const String'",
    ),
    ("def f():\n  x = [1]\n  x = p[0,0,0,0,0,0]\nend", 3, 3, "exected type 'List' but found 'Pose'"),
    ("def f():\n  x = True\n  x = 1\nend", 3, 3, "exected type 'Bool' but found 'Int'"),
    # seen, cut short: "Type error: str_sub takes exact..."
    ('def f():\n  a = str_len("a", 1, 2)\nend', 2, 7, "Type error: str_len takes exactly 1 arguments (3 given)"),
    ("def f():\n  movej()\nend", 2, 3, "Type error: movej takes at least 1 arguments (0 given)"),
    ("def f():\n  movej([0,0,0,0,0,0], w=1)\nend", 2, 3, "Type error: movej has no argument called 'w'"),
    ("def f():\n  movej([0,0,0,0,0,0], q=1)\nend", 2, 3, "more than one value for argument 'q'"),
    ('def f():\n  movej("home")\nend', 2, 3, "argument 'q' of movej expected type 'Pose or List of 6 numbers'"),
    ("def f():\n  movej([0,0,0,0,0])\nend", 2, 3, "expected type 'Pose or List of 6 numbers' but found 'List'"),
    ("def f():\n  a = [1,2]\n  b = a[2]\nend", 3, 8, "Index out of bounds: 2, the length is 2"),
    ("def f():\n  a = [1,2]\n  a[-1] = 0\nend", 3, 4, "Index out of bounds"),
    ("def f():\n  a = [1,2] + [1,2,3]\nend", 2, 13, "Lists of different lengths"),
    ('def f():\n  a = "a" + 1\nend', 2, 11, "operator + cannot be used with 'Const String' and 'Int'"),
    ("def f():\n  a = p[0,0,0,0,0,0] + p[0,0,0,0,0,0]\nend", 2, 22, "operator + cannot be used with 'Pose' and 'Pose'"),
    ("def f():\n  a = True + 1\nend", 2, 12, "operator + cannot be used with 'Bool' and 'Int'"),
    ("def f():\n  a = [1] < [2]\nend", 2, 11, "operator < cannot be used with 'List' and 'List'"),
    ('def f():\n  a = "x"\n  b = a < 3\nend', 3, 9, "Type error"),
    ("def f():\n  if [1]:\n  end\nend", 2, 6, "a condition expected type 'Bool' but found 'List'"),
    ("def f():\n  x = 5 % 0\nend", 2, 9, "Division by zero"),
    (
        "def f():\n  def g():\n    if False:\n      local a = 1\n    end\n    return a\n  end\n  g()\nend",
        6,
        12,
        "before",
    ),
    ("def f():\n  def g():\n    return late + 1\n  end\n  g()\n  late = 2\nend", 3, 17, "variable without a value"),
    ('def f():\n  x = to_num("junk")\nend', 2, 7, '"junk" is not a number'),
    ('def f():\n  x = str_at("error", 100)\nend', 2, 7, "outside a string of 5 bytes"),
    ("def f():\n  x = sqrt(-1)\nend", 2, 7, "must be non-negative"),
    ("def f():\n  modbus_add_signal()\nend", 2, 3, "modbus_add_signal is not emulated: Modbus"),
    ("def f():\n  broken()\nend", 2, 3, "internal error: ZeroDivisionError('oops')"),
    ("def f():\n  s = struct(a=1)\n  x = s.b\nend", 3, 9, "has no member 'b'"),
    ("def f():\n  x = 1\n  x.go()\nend", 3, 5, "'Int' has no method 'go'"),
    ("def f():\n  def g(n):\n    return g(n)\n  end\n  g(1)\nend", 3, 12, "levels deep"),
    ('def f():\n  x = "a"\n  while True:\n    x = x + x\n  end\nend', 4, 11, "maximum length (1023 Bytes)"),
    ("def f():\n  kill [1]\nend", 2, 3, "kill expects a thread handle"),
]


@pytest.mark.parametrize(("text", "line", "column", "message"), RUNTIME_ERRORS)
def test_program_stops_at_its_fault(run, text, line, column, message):
    done = run(text)
    assert done.error is not None
    assert message in done.error[2]
    assert done.error[:2] == (line, column)
    assert done.runtime.finished
    assert not done.runtime.threads


def test_render_shows_line_and_caret(compiled):
    with pytest.raises(CompileError) as caught:
        compiled("def f():\n\tnorn([1])\nend")
    assert caught.value.render("demo.script").splitlines() == [
        "demo.script:2:2: function 'norn' is not known; did you mean 'norm'?",
        "  2 | \tnorn([1])",
        "    | \t^",
    ]


def test_fault_in_a_thread_names_the_thread(run):
    done = run("def f():\n  thread t():\n    x = [1][3]\n  end\n  run t()\n  while True:\n    sync()\n  end\nend")
    assert done.runtime.error is not None
    assert done.runtime.error.thread == "t"
    assert (done.runtime.error.line, done.runtime.error.column) == (3, 12)


def test_dead_code_may_call_with_wrong_arguments(run, compiled):
    text = "def f():\n  if False:\n    norm(1, 2)\n  end\n  x = 1\nend"
    assert run(text).globals == {"x": 1}
    warning = compiled(text).warnings[0]
    assert (warning.line, warning.column) == (3, 5)


def test_names_follow_the_version(compiled):
    text = 'newer("x", lambda=2)'
    compiled(text, "5.10")
    for version in ("5.9.4", "3.15.8"):
        with pytest.raises(CompileError, match="newer"):
            compiled(text, version)


# every place in the language that can refuse a text or stop a program has a row above

_REPORTERS = frozenset(
    ["RuntimeFault", "BindingError", "fail", "give_up", "complain", "expect", "name_not_found", "_refuse", "_domain"]
)
# (file, function): why no program reaches it
_OUT_OF_REACH = {
    ("recovery.py", "give_up"): "passes on what its callers say",
    ("methods.py", "call_method"): "Handle.call_method: handles come from hosts, which override it",
}


def _sites() -> Iterator[tuple[str, int, int, str]]:
    """File, first and last line, and function of every call that reports an error of a script."""
    root = Path(urscript.__file__).parent
    for path in sorted(root.rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and _called(node) in _REPORTERS:
                    yield str(path), node.lineno, node.end_lineno or node.lineno, function.name


def _called(node: ast.Call) -> str:
    return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")


@pytest.fixture
def reached(monkeypatch) -> set[tuple[str, int]]:
    """File and line of all code that is on the way to the making of an error."""
    lines: set[tuple[str, int]] = set()

    def record(make):
        def made(self, *arguments, **keywords):
            frame = sys._getframe(1)
            while frame is not None:
                lines.add((frame.f_code.co_filename, frame.f_lineno))
                frame = frame.f_back
            make(self, *arguments, **keywords)

        return made

    monkeypatch.setattr(ScriptError, "__init__", record(ScriptError.__init__))
    for kind in (RuntimeFault, BindingError):
        monkeypatch.setattr(kind, "__init__", record(Exception.__init__), raising=False)
    return lines


def test_every_place_that_reports_an_error_has_a_row(reached, compiled, run):
    for number, row in enumerate(COMPILE_ERRORS):
        with pytest.raises(CompileError):
            compiled(f"{row[0]} # {number}")  # not from the cache
    for number, row in enumerate(RUNTIME_ERRORS):
        run(f"{row[0]} # {number}", version=row[4] if len(row) > 4 else "5.22")
    missing = [
        f"{file}:{first} in {function}"
        for file, first, last, function in _sites()
        if not any((file, line) in reached for line in range(first, last + 1))
        and (Path(file).name, function) not in _OUT_OF_REACH
    ]
    assert not missing, "no row reaches " + "\n".join(missing)
