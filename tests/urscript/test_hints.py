"""What people write who come from other languages, and what they are told: a row for every hint.

The places are those that ``urscript check`` shows; what a controller reports, and where, is in test_script_errors.py.
"""

from pathlib import Path

import pytest

from client.driver.control_program import ControlProgram
from emulator.builtins import LIBRARIES
from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import CompileError, LibrarySet, compile_script, hints
from urscript.files import ScriptFile

ROOT = Path(__file__).resolve().parents[2]
NEWEST = PolyscopeVersion.parse("5.22")
LIBRARY_SET = LibrarySet(LIBRARIES)


def problems(text: str, version: PolyscopeVersion = NEWEST) -> list[tuple[int, int, str]]:
    found = ScriptFile("f", text.encode()).problems(LIBRARY_SET, version)
    return [(problem.line, problem.column, problem.message) for problem in found]


def inside(line: str) -> str:
    return f"def f():\n  a = 1\n  {line}\nend\n"


# a line in a program that knows `a`; column, what is said
LINES = [
    # signs
    ("a += 1", 5, "write name = name + value"),
    ("a -= 1", 5, "write name = name - value"),
    ("a *= 2", 5, "write name = name * value"),
    ("a++", 4, "write name = name + 1"),
    ("a--", 4, "write name = name + 1"),
    ("a := 1", 5, "write name = value"),
    ("a = 5 // 2", 10, "floor(a / b)"),
    ("// a comment", 4, "a comment begins with '#'"),
    ("/* a comment */", 4, "a comment begins with '#'"),
    ("b = a && True", 9, "write 'and'"),
    ("b = a || True", 9, "write 'or'"),
    ("b = a === 1", 11, "write '==' for equal"),
    ("b = a <> 1", 10, "write '==' for equal"),
    ("b = a ** 2", 10, "write pow(base, exponent)"),
    ("b = a ^ 2", 9, "write pow(base, exponent)"),
    ("a = 2;", 8, "statements end without ';'"),
    ("b = 'text'", 7, "straight double quotes"),
    ("b = `text`", 7, "straight double quotes"),
    ("textmsg(\u201ctext\u201d)", 11, "straight double quotes"),
    ("textmsg(\u2018text\u2019)", 11, "straight double quotes"),
    ("b = 5 \u2013 2", 9, "write the minus sign '-'"),
    ("b = 5 \u00d7 2", 9, "write '*'"),
    ("b = 90\u00b0", 9, "d2r(90)"),
    ("b = a ? 1 : 2", 9, "no conditional expression"),
    ("if a == 1 { sync() }", 13, "blocks begin with ':'"),
    # comparing and assigning
    ("a == 1", 5, "'==' compares, '=' assigns"),
    ("if a = 1: sync() end", 8, "'=' assigns, '==' compares"),
    ("while a = 1: sync() end", 11, "'=' assigns, '==' compares"),
    ("if a is 1: sync() end", 8, "'==' compares"),
    ("if a in [1]: sync() end", 8, "URScript has no 'in'"),
    ("if a then sync() end", 8, "a condition ends with ':'"),
    # statements of other languages
    ("for i in range(3): sync() end", 7, "count in a while loop"),
    ("for (i = 0; i < 3; i++)", 13, "count in a while loop"),
    ("switch a:", 10, "no 'switch'"),
    ("var b = 1", 7, "write name = value"),
    ("int b = 1", 7, "write name = value"),
    ("import math", 10, "no modules"),
    ('print "text"', 9, 'textmsg("text")'),
    ("If a == 1: sync() end", 6, "lower case"),
    ("try: sync()", 6, "no exceptions"),
    ("function g():", 12, "'def name(parameters):'"),
    # names
    ("b = true", 7, "variable 'true' is not defined; write True"),
    ("b = false", 7, "write False"),
    ("b = null", 7, "write None"),
    ("b = 180 / pi", 13, "d2r(180)"),
    ("print(a)", 3, "function 'print' is not defined; textmsg("),
    ("b = len([1])", 7, "length(list)"),
    ("b = abs(a)", 7, "norm(number)"),
    ("b = round(a)", 7, "floor(number + 0.5)"),
    ("b = str(a)", 7, "to_str(value)"),
    ("wait(1)", 3, "sleep(seconds)"),
    ("rq_close_and_wait()", 3, "it is defined by Robotiq's URCap in a preamble, which PolyScope adds to its own"),
    ("b = rq_is_object_detected()", 7, "or use sockets to talk to port 63352"),
    ("b = degrees(a)", 7, "r2d(angle)"),
    ("movJ([0, 0, 0, 0, 0, 0])", 3, "did you mean 'movej'?"),
    ("MoveL(p[0, 0, 0, 0, 0, 0])", 3, "did you mean 'movel'?"),
    ("b = 0x1F", 7, "write 31 for 0x1F"),
    ("set_flag(0x1F, True)", 12, "write 31 for 0x1F"),
    ("b = 5mm", 7, "the number 5 is followed by letters"),
    ("b, a = [1, 2]", 4, "one variable can be assigned at a time"),
    ("movej({q})", 9, "a template whose placeholders were not filled in"),
    ("run sync", 3, "a thread is started with brackets: run sync()"),
    ("sleep(1", 10, "line 3 ends without ')'"),
    ("b = [1, 2", 12, "line 3 ends without ']'"),
    ("if a == 1", 12, "line 3 ends without ':'"),
    ("b = sync", 7, "it is a function: sync() calls it"),
    ("b = a(0)", 7, "it is a variable: a[0] is its first element"),
    ("run sync()", 3, "thread 'sync' is not defined; it is a function: sync() calls it"),
]


@each_row(("line", "column", "hint"), LINES)
def test_a_habit_is_answered_with_what_to_write(line, column, hint):
    found = problems(inside(line))
    assert [message for *place, message in found if place == [3, column] and hint in message], found


# text; place and message of everything that is found
TOO_MANY = "syntax error: this 'end' closes the 'if' on line 2, unlike the indentation: there is one 'end' too many"
BLOCKS = [
    (
        "def f():\n  if True:\n    sync()\n  end if\n  sync()\nend\n",
        [(4, 7, "syntax error at 'if': a block ends with 'end' alone")],
    ),
    (
        "def f():\n  while True:\n    sync()\n  endwhile\nend\n",
        [(4, 3, "syntax error at 'endwhile': a block ends with 'end' alone")],
    ),
    (
        "def f():\n  if True:\n    sync()\n  else if False:\n    sync()\n  elseif False:\n    sync()\n  end\nend\n",
        [
            (4, 8, "syntax error at 'if': expected ':' after else; write 'elif'"),
            (
                6,
                10,
                "syntax error at 'False': expected '='; "
                "write 'elif condition:' for another branch and 'else:' for the last one",
            ),
        ],
    ),
    (
        "def f():\n  for i in range(3):\n    sync()\n  end\n  sync()\nend\n",  # the end of the for is none too many
        [(2, 7, "syntax error at 'i': expected '='; URScript has no 'for': count in a while loop")],
    ),
    (
        "def f():\n  while True:\n    if True:\n      sync()\n    sync()\n  end\nend\n",
        [(5, 5, "syntax error: the 'if' on line 3 has no 'end', judging by the indentation of line 5")],
    ),
    (
        "def f():\n  while True:\n    if True:\n      sync()\n  end\nend\n",
        [(5, 3, "syntax error: the 'if' on line 3 has no 'end', judging by the indentation of line 5")],
    ),
    (
        "def f():\n  def g(x):\n    return x\n  y = g(1)\nend\n",
        [(4, 3, "syntax error: the 'def' on line 2 has no 'end', judging by the indentation of line 4")],
    ),
    (
        "def f():\n  if True:\n    sync()\n    end\n    sync()\n  end\nend\n",
        [(4, 5, TOO_MANY)],
    ),
    (  # a line that is indented less is none of the end's business, if it is where it should be
        "def f():\n  if True:\n  sync()\n    sync()\n  end\n  while True:\n    sync()\n  sync()\nend\n",
        [(8, 3, "syntax error: the 'while' on line 6 has no 'end', judging by the indentation of line 8")],
    ),
    (
        "def f():\n  if True:\n    sync()\n  end\n    sync()\n  end\nend\n",
        [(4, 3, TOO_MANY)],
    ),
    (  # a misspelt header opens its block all the same
        "def f():\n  whle True:\n    sync()\n  end\n  de\n    sync()\n  end\n  if True:\n    sync()\n  ned\nend\n",
        [
            (2, 8, "syntax error at 'True': expected '='"),
            (6, 5, "syntax error at 'sync': expected '='"),
            (10, 3, "syntax error at 'ned': a block ends with 'end' alone"),
        ],
    ),
    (
        "def f():\nif True:\nsync()\nend\n",  # without indentation nothing tells which end is missing
        [(4, 4, "syntax error at end of text: expected 'end' to close the program")],
    ),
    (
        "def f():\n  thread t():\n    z = 1\n  end\n  t()\n  y = z\nend\n",
        [
            (5, 3, "function 't' is not defined; it is a thread: 'run t()' starts it"),
            (6, 7, "variable 'z' is not defined; it is local to 't': declare it there with 'global z = ...'"),
        ],
    ),
    (
        "def f():\n  def g():\n    sync()\n  end\n  run g()\nend\n",
        [(5, 3, "thread 'g' is not defined; it is a function: g() calls it")],
    ),
]


THREAD = "def f():\n  thread t():\n    sync()\n  end\n  run t()\n"


def test_a_preamble_without_its_end_is_one_error():
    """The names it calls may be defined in the rest of the program."""
    calls = "".join(f"  later_{number}()\n" for number in range(40))
    ((*_, message),) = problems(f"def driver():\n{calls}")
    assert message == "syntax error at end of text: expected 'end' to close the program"
    assert len(problems(f"def driver():\n{calls}end\n")) == 40


@pytest.mark.parametrize("word", ["join", "kill"])
def test_a_thread_is_waited_for_and_ended_by_its_handle(word):
    ((line, column, message),) = problems(f"{THREAD}  {word} t\nend\n")
    assert (line, column) == (6, 8)
    assert message.endswith("it is a thread: 'handle = run t()' starts it, and join and kill take the handle")


def test_a_function_returns_one_value():
    found = problems("def f():\n  def g():\n    return 1, 2\n  end\n  x = g()\nend\n")
    assert [place for *place_, message in found if "one value" in message for place in [tuple(place_)]] == [(2 + 1, 13)]


def test_several_lines_may_lack_a_comma():
    ((line, column, message),) = problems("def f():\n  movej([0, 0, 0, 0, 0, 0],\n    a=1\n    v=2)\nend\n")
    assert (line, column, message) == (3, 8, "syntax error: line 3 ends without ',' or ')'")


@each_row(
    "call",
    ['socket_send_string("a\\n")', 'socket_send_line(str_cat("a", "\\r"))', 'socket_send_string("a" + end_of_line)'],
)
def test_a_text_that_is_sent_has_no_escapes(call):
    text = f'def f():\n  end_of_line = "\\n"\n  {call}\nend\n'
    assert [message[:23] for *_, message in problems(text)] == ["URScript has no escapes"]
    assert not problems(text.replace("\\", ""))


def test_list_methods_are_explained_on_versions_without_them():
    text = "def f():\n  a = [1]\n  a.append(2)\n  b = a.length()\nend\n"
    old = problems(text, PolyscopeVersion.parse("5.12"))
    assert [line for line, *_ in old] == [3, 4]
    assert "before PolyScope 5.15; a list keeps its size there" in old[0][2]
    assert old[1][2].endswith("length(list) returns the number of elements")
    assert not problems(text)
    proxy = 'def f():\n  a = rpc_factory("xmlrpc", "http://127.0.0.1:1")\n  a.append(2)\nend\n'
    assert not problems(proxy, PolyscopeVersion.parse("5.12"))


@each_row(("text", "found"), BLOCKS)
def test_a_lost_end_is_found_where_it_is_missing(text, found):
    assert problems(text) == found


@each_row(
    ("text", "version", "hint"),
    [
        (
            "x = make_list(2, 0)\n",
            "5.11.1",
            "function 'make_list' is not defined; not available in PolyScope 5.11.1 (e-Series since 5.15 only)",
        ),
        ("x = struct(a=1)\n", "3.15.8", "not available in PolyScope 3.15.8 (e-Series since 5.14 only)"),
        ('x = str_len("a")\n', "3.4", "not available in PolyScope 3.4.0 (CB3 since 3.8, e-Series since 5.2)"),
    ],
)
def test_a_function_of_another_version_is_known_to_be_one(text, version, hint):
    assert hint in problems(text, PolyscopeVersion.parse(version))[0][2]


def test_a_controller_reports_where_it_noticed_and_the_check_where_it_is():
    text = "def f():\n  while True:\n    if True:\n      sync()\n    sync()\n  end\nend"
    with pytest.raises(CompileError) as caught:
        compile_script(text, LIBRARY_SET, NEWEST)
    error = caught.value
    assert (error.line, error.column, error.wire) == (7, 4, "syntax_error_on_line:7:end:")
    assert "the 'if' on line 3 has no 'end'" in error.message
    assert problems(text)[0][:2] == (5, 5)


# a line in a program where `a` is 1; column, what is said
WARNINGS = [
    ("movej([0, -1.57, 0, 0, 0])", 9, "expected type 'Pose or List of 6 numbers' but found a list of 5"),
    ('movej("home")', 9, "expected type 'Pose or List of 6 numbers' but found 'Const String'"),
    ("sleep(True)", 9, "expected type 'Num' but found 'Bool'"),
    ("movej([0, -90, 90, 0, 0, 0])", 9, "joint angles are in radians, but -90 looks like degrees"),
    ("servoj([0, 0, 0, 0, 0, 180])", 10, "joint angles are in radians, but 180 looks like degrees"),
    ("movej([0, 0, 0, 0, 0, 0], v=60)", 31, "movej takes its speed in rad/s, but v=60 looks like degrees per second"),
    ("movel(p[400, -200, 300, 0, 3.14, 0])", 9, "in metres, but 400 looks like millimetres"),
    ("set_tcp(p[0, 0, 150, 0, 0, 0])", 11, "in metres, but 150 looks like millimetres"),
    ("movel(p[0.4, 0, 0, 0, 180, 0])", 9, "a vector in radians, but 180 looks like degrees"),
    ("movel(p[0.4, 0, 0, 0, 3.1, 0], v=250)", 36, "its speed in m/s, but v=250 looks like millimetres per second"),
    ("b = [0, 90, 0, 0, 0, 0] movej(b)", 33, "joint angles are in radians, but 90 looks like degrees"),
    ('b = "text" + 3', 14, "str_cat() joins any two values"),
    ('b = a + "text"', 9, "str_cat() joins any two values"),
]


@each_row(("line", "column", "hint"), WARNINGS)
def test_a_call_that_cannot_be_meant_is_warned_of(line, column, hint):
    ((at, where, message),) = problems(inside(line))
    assert (at, where) == (3, column)
    assert hint in message
    compile_script(inside(line), LIBRARY_SET, NEWEST)


@each_row(
    "line",
    [
        "movej([0, -d2r(90), d2r(90), 0, 0, 6.3])",
        "movej(p[0.4, -0.2, 0.3, 0, 3.14, 0], v=3.1)",
        "movel(p[1.3, 0, 0, 0, 6.2, 0], a=10, v=3)",
        "b = p[400, 0, 0, 0, 0, 0] b[0] = b[0] / 1000 movel(b)",  # assigned to again
        "speedj([90, 0, 0, 0, 0, 0], 1, 1)",
        'b = "text" + to_str(3)',
        "set_gravity([0, 0, 9.82])",
    ],
)
def test_what_may_be_meant_is_not_warned_of(line):
    assert problems(inside(line)) == []


def test_words_of_other_languages_are_free_to_be_names():
    words = sorted({*hints.VARIABLES, *hints.FUNCTIONS, *hints.END_WORDS, *hints.FOREIGN_BLOCKS, "var", "int", "case"})
    functions = "".join(f"  def {word}(x):\n    return x\n  end\n" for word in words)
    uses = "".join(f"  {word} = {word}(1)\n  {word} = {word} + 1\n  {word}(2)\n" for word in words)
    assert problems(f"def f():\n{functions}{uses}end\n") == []


@each_row("path", sorted((ROOT / "examples").rglob("[!t]*.script")), ids=lambda path: path.name)
def test_examples_give_no_hint(path):
    assert ScriptFile.read(str(path)).problems(LIBRARY_SET, NEWEST) == []


@each_row("version", ["3.15.8", "5.9.4", "5.22"])
def test_our_control_program_gives_no_hint(version):
    polyscope = PolyscopeVersion.parse(version)
    text = ControlProgram(host="10.0.0.1").render(polyscope)
    assert ScriptFile("control.script", text.encode()).problems(LIBRARY_SET, polyscope) == []
