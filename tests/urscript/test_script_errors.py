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
from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import CompileError, RuntimeFault, ScriptError
from urscript.arguments import BindingError
from urscript.builtins import LibrarySet
from urscript.files import ScriptFile
from urscript.interpreter import Locals, compile_statement
from urscript.library import LIBRARIES
from urscript.work import run_to_end

LIBRARY_SET = LibrarySet(LIBRARIES)
NEWEST = PolyscopeVersion.parse("5.22")

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


@each_row(("text", "line", "column", "wire"), COMPILE_ERRORS)
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
    ('def f():\n  a = str_sub("abc")\nend', 2, 7, "Type error: str_sub takes at least 2 arguments (1 given)"),
    ("def f():\n  assert(1 == 2)\nend", 2, 3, "assert: the condition is False"),
    ("def f():\n  movej()\nend", 2, 3, "Type error: movej takes at least 1 arguments (0 given)"),
    ("def f():\n  movej([0,0,0,0,0,0], w=1)\nend", 2, 3, "Type error: movej has no argument called 'w'"),
    ("def f():\n  movej([0,0,0,0,0,0], q=1)\nend", 2, 3, "more than one value for argument 'q'"),
    ('def f():\n  movej("home")\nend', 2, 3, "argument 'q' of movej expected type 'Pose or List of 6 numbers'"),
    ("def f():\n  movej([0,0,0,0,0])\nend", 2, 3, "expected type 'Pose or List of 6 numbers' but found 'List'"),
    ("def f():\n  a = [1,2]\n  b = a[2]\nend", 3, 8, "Index out of bounds: 2, the length is 2"),
    ("def f():\n  a = [1,2]\n  a[-1] = 0\nend", 3, 4, "Index out of bounds"),
    ("def f():\n  a = [1,2] + [1,2,3]\nend", 2, 13, "Lists of different lengths"),
    ('def f():\n  a = [1,2] * "s"\nend', 2, 13, "operator * cannot be used with 'List' and 'Const String'"),
    ('def f():\n  a = "s" * [1,2]\nend', 2, 11, "operator * cannot be used with 'Const String' and 'List'"),
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
    (
        "def f():\n  def g():\n    return late + 1\n  end\n  g()\n  late = 2\nend",
        3,
        12,
        "Variable 'late' is used before it has a value",
    ),
    # a variable without a value goes nowhere: not into texts, functions, results, other variables
    *(
        (
            f"def f():\n  def g(a):\n    {use}\n  end\n  g(1)\n  late = 2\nend",
            3,
            column,
            "Variable 'late' is used before it",
        )
        for use, column in [
            ("textmsg(late)", 13),
            ('textmsg("late ", late)', 22),
            ("x = to_str(late)", 16),
            ("local x = late", 15),
            ("global x = late", 16),
            ("return late", 12),
            ("g(late)", 7),
            ("x = struct(a=late)", 18),
            ("x = [late]", 10),
            ("x = p[late,0,0,0,0,0]", 11),
            ("a[0] = late", 12),
            ("kill late", 10),
        ]
    ),
    (
        "def f():\n  thread t():\n    textmsg(late)\n  end\n  run t()\n  sync()\n  late = 2\nend",
        3,
        13,
        "Variable 'late'",
    ),
    ('def f():\n  x = to_num("junk")\nend', 2, 7, '"junk" is not a number'),
    ('def f():\n  x = str_at("error", 100)\nend', 2, 7, "outside a string of 5 bytes"),
    ("def f():\n  x = sqrt(-1)\nend", 2, 7, "must be non-negative"),
    ("def f():\n  modbus_add_signal()\nend", 2, 3, "modbus_add_signal is not emulated: Modbus"),
    ("def f():\n  broken()\nend", 2, 3, "internal error: ZeroDivisionError('oops')"),
    ("def f():\n  s = struct(a=1)\n  x = s.b\nend", 3, 9, "has no member 'b'"),
    ("def f():\n  x = 1\n  x.go()\nend", 3, 5, "'Int' has no method 'go'"),
    ('def f():\n  s = struct(a=1)\n  s.a = "b"\nend', 3, 5, "exected type 'Int' but found 'Const String'"),
    ('def f():\n  l = [1]\n  l = struct(a="b")\nend', 3, 3, "exected type 'List' but found 'Struct'"),
    ("def f():\n  def g(n):\n    return g(n)\n  end\n  g(1)\nend", 3, 12, "levels deep"),
    ('def f():\n  x = "a"\n  while True:\n    x = x + x\n  end\nend', 4, 11, "maximum length (1023 Bytes)"),
    ("def f():\n  kill [1]\nend", 2, 3, "kill expects a thread handle"),
]


@each_row(("text", "line", "column", "message"), RUNTIME_ERRORS)
def test_program_stops_at_its_fault(run, text, line, column, message):
    done = run(text)
    assert done.error is not None
    assert message in done.error[2]
    assert done.error[:2] == (line, column)
    assert done.runtime.finished
    assert not done.runtime.threads


# text, line, column, problem
SYNTAX_PROBLEMS = [
    (f"a = [{'[1, 2], ' * 7000}3]", 1, 53340, "the list is longer than 40000 tokens"),
    (f"textmsg([{'1, ' * 1000}3])", 1, 3008, "longer than 2000 tokens: assign lists to variables first"),
    (f'textmsg("{"x" * 50_000}")', 1, 9, "this string is longer than 49998 characters"),
    ("a = [1, 2 3]", 1, 11, "expected ']' to close '['"),
    ("def f():\n  run t(1)\nend", 2, 9, "expected ')' because a thread takes no arguments"),
    ("def f():\n  run 1()\nend", 2, 7, "expected a name after run: the thread to start"),
    ("def f():\n  run t\nend", 3, 1, "a thread is started with brackets: run t()"),
    ("def f():\n  x = [1]\n  y = x[1,2,3]\nend", 3, 8, "an index takes one position, or two for a matrix"),
    ("def f():\n  x = struct(a=1)\n  y = x.1\nend", 3, 8, "expected a statement"),
    ("def f():\n  x = struct(a=1)\n  y = x.(1)\nend", 3, 9, "expected a name after '.'"),
    ("def f:\nend", 1, 6, "expected '(' after the name of the program"),
    ("def f()\n  sync()\nend", 2, 3, "expected ':' after ')'; line 1 ends without ':'"),
    ("def 1():\nend", 1, 5, "expected a name for the program"),
    ("def f():\n  f() = 1\nend", 2, 3, "this cannot be assigned to"),
    ('$ x "a"', 1, 3, "expected a number for the program label"),
    ('$ 1.5 "a"', 1, 3, "the number of a program label must be an integer of at most 9 digits"),
    ("$ 1 a", 1, 5, "expected a string for the program label"),
    (
        "def f():\n  if True:\n    sync()\n  else\n    sync()\n  end\nend",
        5,
        5,
        "expected ':' after else; line 4 ends without ':'",
    ),
    ("def f():\n  def (a):\n  end\nend", 2, 7, "expected a name after def"),
    (
        "def f():\n  def g(a)\n    return a\n  end\nend",
        3,
        5,
        "expected ':' after the parameters of g; line 2 ends without ':'",
    ),
    ("def f():\n  def g:\n  end\nend", 2, 8, "expected '(' after the name of the def"),
    ("def f():\n  def g(a b):\n  end\nend", 2, 11, "expected ')' to close the parameters"),
    ("def f():\n  def g(1):\n  end\nend", 2, 9, "expected a name for a parameter"),
]


@each_row(("text", "line", "column", "problem"), SYNTAX_PROBLEMS)
def test_syntax_error_says_what_is_missing(compiled, text, line, column, problem):
    with pytest.raises(CompileError) as caught:
        compiled(text)
    assert (caught.value.line, caught.value.column) == (line, column)
    assert caught.value.message.endswith(problem)


# text, line, column, message, version
FULL = "The list is full: its capacity is 1; make_list(length, value, capacity) sets it"

FAULTS = [
    ("def f():\n  x = struct(1)\nend", 2, 7, "Type error: struct takes members as name=value, each name once", "5.22"),
    (
        "def f():\n  x = struct(a=1, a=2)\nend",
        2,
        7,
        "Type error: struct takes members as name=value, each name once",
        "5.22",
    ),
    ("def f():\n  x = length(1)\nend", 2, 7, "Type error: length expected type 'List' but found 'Int'", "5.22"),
    (
        "def f():\n  x = make_list(3, 0, 2)\nend",
        2,
        7,
        "make_list: 0 <= length <= capacity <= 10000 is required, but length is 3 and capacity 2",
        "5.22",
    ),
    ("def f():\n  x = acos(2)\nend", 2, 7, "acos: the argument must be in -1..1, not 2", "5.22"),
    ("def f():\n  x = asin(-2)\nend", 2, 7, "asin: the argument must be in -1..1, not -2", "5.22"),
    ("def f():\n  x = log(2, 0)\nend", 2, 7, "log: the argument must be positive, not 0", "5.22"),
    ("def f():\n  x = log(1, 2)\nend", 2, 7, "log: the argument must be a positive base other than 1, not 1", "5.22"),
    (
        "def f():\n  x = pow(-1, 0.5)\nend",
        2,
        7,
        "pow: the argument must be non-negative for a fractional exponent, not -1",
        "5.22",
    ),
    (
        "def f():\n  x = pow(0, -1)\nend",
        2,
        7,
        "pow: the argument must be non-zero for a negative exponent, not 0",
        "5.22",
    ),
    ('def f():\n  x = norm("a")\nend', 2, 7, "Type error: norm expected numbers but found 'Const String'", "5.22"),
    (
        "def f():\n  x = normalize([0,0])\nend",
        2,
        7,
        "normalize: the argument must be a vector longer than 0, not 0",
        "5.22",
    ),
    (
        "def f():\n  x = binary_list_to_integer(make_list(33, True))\nend",
        2,
        7,
        "binary_list_to_integer: takes at most 32 booleans, not 33",
        "5.22",
    ),
    (
        "def f():\n  x = binary_list_to_integer([1])\nend",
        2,
        7,
        "Type error: binary_list_to_integer expected a list of booleans",
        "5.22",
    ),
    ("def f():\n  x = inv([[1,2]])\nend", 2, 7, "inv: the argument must be a square matrix", "5.22"),
    (
        "def f():\n  x = inv(p[0,0,0,0,0,1e308])\nend",
        2,
        7,
        "inv: a pose must be finite, with no number beyond 1e+12",
        "5.22",
    ),
    ("def f():\n  x = inv([[1,2],[2,4]])\nend", 2, 7, "inv: the matrix is singular", "5.22"),
    ("def f():\n  x = size(1)\nend", 2, 7, "Type error: size expected type 'List' but found 'Int'", "5.22"),
    ("def f():\n  x = rotvec2rpy([1])\nend", 2, 7, "Type error: rotvec2rpy expected a list of 3 numbers", "5.22"),
    (
        'def f():\n  x = str_find("a", "b", -1)\nend',
        2,
        7,
        "str_find: start_from must not be negative, it is -1",
        "5.22",
    ),
    ('def f():\n  x = str_sub("abc", 4)\nend', 2, 7, "str_sub: index 4 is outside a string of 3 bytes", "5.22"),
    ('def f():\n  x = str_sub("abc", 1, -1)\nend', 2, 7, "str_sub: the length must not be negative, it is -1", "5.22"),
    (
        "def f():\n  x = [1]\n  x.append(2)\nend",
        3,
        5,
        "The list is full: its capacity is 1; make_list(length, value, capacity) sets it",
        "5.22",
    ),
    ("def f():\n  x = [1]\n  x.insert(3, 1)\nend", 3, 5, "Index out of bounds: 3, the length is 1", "5.22"),
    ("def f():\n  x = [1]\n  x.remove(1)\nend", 3, 5, "Index out of bounds: 1, the length is 1", "5.22"),
    ("def f():\n  x = [1]\n  x.append()\nend", 3, 5, "Type error: append takes exactly 1 arguments (0 given)", "5.22"),
    ("def f():\n  x = []\n  y = x.pop()\nend", 3, 9, "Index out of bounds: -1, the length is 0", "5.22"),
    (
        "def f():\n  x = [1]\n  y = x[0.5]\nend",
        3,
        8,
        "Type error: an index must be a whole number, not 'Float'",
        "5.22",
    ),
    ('def f():\n  x = -"a"\nend', 2, 7, "Type error: operator - cannot be used with 'Const String'", "5.22"),
    ("def f():\n  x = +[1]\nend", 2, 7, "Type error: operator + cannot be used with 'List'", "5.22"),
    (
        'def f():\n  x = [1] + ["a"]\nend',
        2,
        11,
        "Type error: operator + cannot be used with 'Int' and 'Const String'; str_cat() joins any two values",
        "5.22",
    ),
    (
        'def f():\n  x = [[1,2],[3,4]] + "a"\nend',
        2,
        21,
        "Type error: operator + cannot be used with 'Matrix' and 'Const String'",
        "5.22",
    ),
    (
        "def f():\n  x = [[1,2],[3,4]] + [[1,2]]\nend",
        2,
        21,
        "Matrices of different shapes (2, 2) and (1, 2) with operator +",
        "5.22",
    ),
    (
        "def f():\n  x = [[1,2],[3,4]] * [1]\nend",
        2,
        21,
        "Matrix product: 2 columns on the left do not match 1 on the right",
        "5.22",
    ),
    ('def f():\n  x = p[1,2,3,4,5,"a"]\nend', 2, 7, "Type error: a pose holds numbers, not 'Const String'", "5.22"),
    (
        "def f():\n  def g():\n    return [late]\n  end\n  g()\n  late = 2\nend",
        3,
        13,
        "Variable 'late' is used before it has a value",
        "5.22",
    ),
    (
        'def f():\n  x = [1]\n  while True:\n    x = [x, "a"]\n  end\nend',
        4,
        9,
        "The value has more than 16 levels of lists and structs",
        "5.22",
    ),
    ("def f():\n  x = make_list(9000, 0)\n  y = [x, x]\nend", 3, 7, "The value has more than 10000 elements", "5.22"),
    ("def f():\n  x = 1\n  y = x[0]\nend", 3, 8, "Type error: 'Int' cannot be indexed", "5.22"),
    ("def f():\n  l = [1]\n  l.extend(1)\nend", 3, 5, "Type error: extend takes a list, not 'Int'", "5.22"),
    ("def f():\n  l = [1]\n  l.extend([2])\nend", 3, 5, FULL, "5.22"),
    ("def f():\n  l = [1]\n  k = l.slice(0, 2)\nend", 3, 9, "Index out of bounds: 0 to 2, the length is 1", "5.22"),
    (
        "def f():\n  m = [[1,2],[3,4]]\n  m.get_column(2)\nend",
        3,
        5,
        "Index out of bounds: 2, there are 2 columns",
        "5.22",
    ),
    ("def f():\n  x = [1]\n  y = x[0,0]\nend", 3, 8, "Type error: 'List' cannot be indexed by row and column", "5.22"),
    ("def f():\n  x = 1\n  y = x.a\nend", 3, 9, "Type error: 'Int' has no member 'a'", "5.22"),
    ("def f():\n  x = 1\n  x[0] = 1\nend", 3, 4, "Type error: 'Int' cannot be indexed", "5.22"),
    (
        'def f():\n  x = [[1,2],[3,4]]\n  x[0,1] = "a"\nend',
        3,
        4,
        "Type error: a matrix holds numbers, not 'Const String'",
        "5.22",
    ),
    (
        "def f():\n  def g():\n    x = late\n  end\n  x = [1]\n  g()\n  late = 2\nend",
        3,
        9,
        "Variable 'late' is used before it has a value",
        "5.22",
    ),
    (
        "def f():\n  thread t():\n    sleep(9)\n  end\n  while True:\n    run t()\n  end\nend",
        6,
        5,
        "More than 64 threads are running",
        "5.22",
    ),
    ("def f():\n  join [1]\nend", 2, 3, "Type error: join expects a thread handle", "5.22"),
    ("def f():\n  x = to_str(make_list(900, 0))\nend", 2, 7, "String exceeds maximum length (1023 Bytes).", "5.22"),
    (
        'def f():\n  x = str_cat(make_list(900, 0), "a")\nend',
        2,
        7,
        "String exceeds maximum length (1023 Bytes).",
        "5.22",
    ),
    (
        'def f():\n  x = ""\n  while True:\n    x = str_cat(x, "é")\n  end\nend',
        4,
        9,
        "String exceeds maximum length (1023 Bytes).",
        "5.22",
    ),
    ("def f():\n  x = [[1,2],[3,4]][2]\nend", 2, 20, "Index out of bounds: 2, the length is 2", "5.22"),
    ("def f():\n  x = [[1,2],[3,4]][0,2]\nend", 2, 20, "Index out of bounds: 2, the length is 2", "5.22"),
    ("def f():\n  x = p[0,0,0,0,0,0][6]\nend", 2, 21, "Index out of bounds: 6, the length is 6", "5.22"),
    (
        'def f():\n  x = p[0,0,0,0,0,0]\n  x[0] = "a"\nend',
        3,
        4,
        "Type error: a pose holds numbers, not 'Const String'",
        "5.22",
    ),
    ("def f():\n  x = not [1]\nend", 2, 11, "Type error: a condition expected type 'Bool' but found 'List'", "5.22"),
    (
        "def f():\n  x = [1] and True\nend",
        2,
        7,
        "Type error: a condition expected type 'Bool' but found 'List'",
        "5.22",
    ),
    (
        "def f():\n  def g():\n    if False:\n      local a = 1\n    end\n    return a\n  end\n  g()\nend",
        6,
        12,
        "Variable 'a' is used before it has a value",
        "5.22",
    ),
    (
        "def f():\n  if False:\n    a = 1\n  end\n  b = a\n  a = 2\nend",
        5,
        7,
        "Variable 'a' is used before it has a value",
        "5.22",
    ),
    (
        'def f():\n  x = "a"\n  y = x > 3\nend',
        3,
        9,
        "Type error: operator > cannot be used with 'Const String' and 'Int'",
        "5.22",
    ),
    (
        "def f():\n  x = [1]\n  y = 3 <= x\nend",
        3,
        9,
        "Type error: operator <= cannot be used with 'Int' and 'List'",
        "5.22",
    ),
    (
        'def f():\n  x = "a" > "b"\nend',
        2,
        11,
        "Type error: operator > cannot be used with 'Const String' and 'Const String'",
        "5.22",
    ),
    (
        'def f():\n  x = 1\n  y = x > "b"\nend',
        3,
        9,
        "Type error: operator > cannot be used with 'Int' and 'Const String'",
        "5.22",
    ),
    (
        'def f():\n  x = sqrt("a")\nend',
        2,
        7,
        "Type error: argument 'f' of sqrt expected type 'Num' but found 'Const String'",
        "5.22",
    ),
    (
        'def f():\n  x = str_at("a", 0.5)\nend',
        2,
        7,
        "Type error: argument 'index' of str_at expected type 'Int' but found 'Float'",
        "5.22",
    ),
    (
        "def f():\n  x = str_len(1)\nend",
        2,
        7,
        "Type error: argument 'str' of str_len expected type 'Const String' but found 'Int'",
        "5.22",
    ),
    (
        "def f():\n  x = pose_inv([1,2])\nend",
        2,
        7,
        "Type error: argument 'p_from' of pose_inv expected type 'Pose' but found 'List'",
        "5.22",
    ),
    (
        'def f():\n  x = transpose("a")\nend',
        2,
        7,
        "Type error: argument 'm' of transpose expected type 'Matrix' but found 'Const String'",
        "5.22",
    ),
    ("def f():\n  sleep(1/0)\nend", 2, 3, "argument 't' of sleep must be finite: it is inf", "5.22"),
    (
        "def f():\n  movej([0,0,0/0,0,0,0])\nend",
        2,
        3,
        "argument 'q' of movej must be finite, with no number beyond 1e+12: it is [0,0,nan,0,0,0]",
        "5.22",
    ),
    ('def f():\n  x = to_num("9999999999")\nend', 2, 7, 'to_num: "9999999999" is out of range', "5.22"),
    (
        'def f():\n  x = "a"\n  y = [1, x]\nend',
        3,
        7,
        "Type error: a list cannot hold a 'Const String' before PolyScope 5.15",
        "5.14",
    ),
    (
        'def f():\n  x = ["a"]\nend',
        2,
        7,
        "Type error: a list cannot hold a 'Const String' before PolyScope 5.15",
        "3.15.8",
    ),
    (
        "def f():\n  popup_missing = 1\n  x = integer_to_binary_list(True)\nend",
        3,
        7,
        "Type error: argument 'x' of integer_to_binary_list expected type 'Int' but found 'Bool'",
        "5.22",
    ),
    (
        "def f():\n  x = wrench_trans(p[0,0,0,0,0,0], [1])\nend",
        2,
        7,
        "Type error: argument 'w_from' of wrench_trans expected type 'List of 6 numbers' but found 'List'",
        "5.22",
    ),
    ("def f():\n  x = 5 % 0\nend", 2, 9, "Division by zero: the right operand of % is the integer 0", "5.22"),
    (
        "def f():\n  x = [1]\n  x.append(2)\nend",
        3,
        5,
        "Type error: 'List' has no method 'append' before PolyScope 5.15",
        "5.14",
    ),
    ("def f():\n  x = [1]\n  x = [1,2]\nend", 3, 3, "Resizing of 'List' is not supported", "5.14"),
]


@each_row(("text", "line", "column", "message", "version"), FAULTS)
def test_operators_and_built_ins_say_what_does_not_fit(run, text, line, column, message, version):
    assert run(text, version=version).error == (line, column, message)


# text, (line, column) of all that is wrong with it: nothing twice, nothing that only follows from it
FILES = [
    ("def f():\n  x = 1 +\n  y = nope\nend\n", [(3, 5)]),
    ("def f():\n  if x = 3:\n    foo bar\n  end\n  z = nope\nend\n", [(2, 8), (3, 9), (5, 7)]),
    ("def f():\n  movej([0,\n    0 0],\n    a=1)\n  y = nope\nend\n", [(3, 7), (5, 7)]),
    ("def f():\n  z = (2\n  y = z\nend\n", [(2, 9)]),
    ("def f():\n  def g(a=1, b):\n    return a + b + w\n  end\n  g(1, 2, 3)\nend\n", [(2, 14), (3, 20)]),
    ("def f():\n  while True\n    sync()\n  else:\n    nope()\n  end\nend\n", [(2, 13), (4, 3), (5, 5)]),
    ("def f():\n  if True:\n    x = nope\nend\n", [(3, 9), (4, 1)]),
    ("def f():\n  x = 1\n  end\n  y = x\n  movej(y)\nend\n", [(3, 3)]),
    ("def f():\n  if True:\n    x = nope\n  endif\n  y = nope\nend\n", [(3, 9), (4, 3), (5, 7)]),
    ("def f():\nx = 1\nend\ny = x\nmovej(y)\nend\n", [(6, 1)]),  # no indentation tells more
    ('def f():\n  textmsg("a)\n  y = 2\n  textmsg("b")\nend\n', [(2, 11)]),
    ("# comment\n\nx = nope()\ny = norm(1, other)\n", [(3, 5), (4, 5), (4, 13)]),
    ("def f(1):\n  break\n  thread t(b):\n    x = nope\n  end\nend\n", [(1, 7), (2, 3), (3, 12), (4, 9)]),
    ("def a():\n  x = nope\nend\ndef b():\n  y = (\nend\n", [(2, 7), (6, 1)]),
    ("if True:\n" * 80 + "end\n" * 80, [(62, 1)]),
    ("while True:\n" * 30 + "end\n" * 30, [(21, 1)]),
    ("x = 1\nif x > 1 sync() end\ny = nope\n", [(2, 10), (3, 5)]),
]


# text, whether it is that of a Script node and not programs one after the other
MEANINGS = [
    ("def f(a):\n  return a\nend\n", True),  # a program has no parameters
    ("def f():\n  sync()\nend\nf()\nnorm(1)\n", True),
    ("def f():\n  g()\nend\ndef g():\n  sync()\nend\n", True),
    ("thread t():\n  sync()\nend\nhandle = run t()\n", True),
    ("def f():\n  sync()\nend\nx = 1\nnorm(x)\n", True),
    ("def f():\n  sync()\nend\n", False),
    ("def f():\n  f()\nend\n", True),
    ('def f():\n  x = 1\nend\nsec g():\n  x = 2\nend\nstr_len("x f()")\n# f()\n', False),
    ("x = 1\ndef f():\n  return x\nend\nf()\n", False),  # one program as it stands
]


@each_row(("text", "is_node"), MEANINGS)
def test_what_a_file_is_meant_as(text, is_node):
    file = ScriptFile("my tools.script", text.encode())
    assert file.inlined == is_node
    assert not file.problems(LIBRARY_SET, NEWEST)
    if is_node:
        assert [unit.text for unit in file.units] == [f"def my_tools(): {text}\nend\n"]


def test_errors_in_the_text_of_a_script_node_are_where_they_are_in_the_file(compiled):
    text = "# tools\ndef f(a):\n  return nope\nend\nf(1)\nend\n"
    file = ScriptFile("f", text.encode())
    problems = file.problems(LIBRARY_SET, NEWEST)
    assert [(problem.line, problem.column) for problem in problems] == [(3, 10), (6, 1)]
    file = ScriptFile("f", b"def f(a): return b end\nf(1)\n")
    (unit,) = file.units
    with pytest.raises(CompileError) as caught:
        compiled(unit.text)
    assert [file.located(caught.value, unit).column] == [18]
    assert [problem.column for problem in file.problems(LIBRARY_SET, NEWEST)] == [18]


def test_lines_named_in_a_message_are_those_of_the_file():
    text = "# a comment\n\ndef f():\n  if True:\n    sync()\n  sync()\nend\n"
    (problem,) = ScriptFile("f", text.encode()).problems(LIBRARY_SET, NEWEST)
    assert problem.message.endswith("the 'if' on line 4 has no 'end', judging by the indentation of line 6")


@each_row(("text", "places"), FILES)
def test_everything_that_is_wrong_with_a_file_is_found_at_once(text, places):
    problems = ScriptFile("f", text.encode()).problems(LIBRARY_SET, NEWEST)
    assert [(problem.line, problem.column) for problem in problems] == places
    assert all(problem.source_line == text.split("\n")[problem.line - 1] for problem in problems)


def test_render_shows_line_and_caret(compiled):
    with pytest.raises(CompileError) as caught:
        compiled("def f():\n\tnorn([1])\nend")
    assert caught.value.render("demo.script").splitlines() == [
        "demo.script:2:2: function 'norn' is not defined; did you mean 'norm'?",
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


# statements for a program that runs

STATEMENT_ERRORS = [
    ("global fresh = 1", 1, 8, "cannot declare a new global such as 'fresh'"),
    ("if True: global fresh = 1 end", 1, 17, "cannot declare a new global such as 'fresh'"),
    ("return 5", 1, 1, "not inside a function"),
    ("missing()", 1, 1, "missing"),
]


@each_row(("text", "line", "column", "message"), STATEMENT_ERRORS)
def test_a_statement_that_does_not_fit_its_program_is_refused(compiled, text, line, column, message):
    with pytest.raises(CompileError, match=message) as caught:
        _compile_statement(compiled, text)
    assert (caught.value.line, caught.value.column) == (line, column)


def _compile_statement(compiled, text):
    program = compiled("def f():\n  known = 1\nend")
    run_to_end(compile_statement(text, program, program.functions, Locals(), 1))


def test_a_name_of_a_scope_that_has_no_value_yet_is_an_error():
    with pytest.raises(RuntimeFault, match="before it has a value"):
        Locals(["later"])["later"]


# every place in the language that can refuse a text or stop a program has a row above

_REPORTERS = frozenset(
    ["RuntimeFault", "BindingError", "fail", "give_up", "complain", "expect", "name_not_found", "_refuse", "_domain"]
)
# (file, function): why no program reaches it
_OUT_OF_REACH = {
    **dict.fromkeys(
        [("expressions.py", "another"), ("operators.py", "check_product_size"), ("parser.py", "_define")],
        "limits of size: test_bounds.py",
    ),
    ("recovery.py", "give_up"): "passes on what its callers say",
    ("builtins.py", "_refusing"): "errors of the hosts' functions: tests/builtins",
    ("builtins.py", "call"): "as _refusing",
    ("builtins.py", "steps"): "as _refusing",
    ("methods.py", "member"): "Handle.member: as call_method",
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
    for number, row in enumerate(COMPILE_ERRORS + SYNTAX_PROBLEMS):
        with pytest.raises(CompileError):
            compiled(f"{row[0]} # {number}")  # not from the cache
    for number, row in enumerate(RUNTIME_ERRORS):
        run(f"{row[0]} # {number}")
    for number, (text, _, _, _, version) in enumerate(FAULTS):
        run(f"{text} # {number}", version=version)
    for text, *_ in STATEMENT_ERRORS:
        with pytest.raises(CompileError):
            _compile_statement(compiled, text)
    with pytest.raises(RuntimeFault):
        Locals(["later"])["later"]
    for text, _ in FILES:
        ScriptFile("f", text.encode()).problems(LIBRARY_SET, NEWEST)
    missing = [
        f"{file}:{first} in {function}"
        for file, first, last, function in _sites()
        if not any((file, line) in reached for line in range(first, last + 1))
        and (Path(file).name, function) not in _OUT_OF_REACH
    ]
    assert not missing, "no row reaches " + "\n".join(missing)
