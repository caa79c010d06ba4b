"""The built-ins that need no robot."""

import math

import pytest

from tests.rows import each_row
from urproto.text import from_bytes, to_bytes
from urscript.errors import RuntimeFault
from urscript.values import Matrix, Pose, to_text

CALLS = [
    ("acos(1)", 0.0),
    ("asin(1)", math.pi / 2),
    ("atan(0)", 0.0),
    ("atan2(1, 0)", math.pi / 2),
    ("atan2(0, -1)", math.pi),
    ("cos(0)", 1.0),
    ("sin(0)", 0.0),
    ("tan(0)", 0.0),
    ("d2r(180)", math.pi),
    ("r2d(acos(-1))", 180.0),
    ("floor(2.7)", 2),
    ("floor(-2.1)", -3),
    ("ceil(2.1)", 3),
    ("floor(1e12)", 1e12),
    ("log(10, 1000)", 3.0),
    ("pow(2, 10)", 1024.0),
    ("pow(2, -1)", 0.5),
    ("pow(-2, 3)", -8.0),
    ("pow(10, 400)", math.inf),
    ("sqrt(9)", 3.0),
    ("norm(-3)", 3),
    ("norm(-1.5)", 1.5),
    ("norm([3, 4])", 5.0),
    ("norm(p[3,4,0,0,0,0])", 5.0),
    ("norm([])", 0.0),
    ("normalize([0, 2])", [0.0, 1.0]),
    ("binary_list_to_integer([True, False, True])", 5),
    ("binary_list_to_integer([])", 0),
    ("get_list_length(integer_to_binary_list(1))", 32),
    ("integer_to_binary_list(5)[2]", True),
    ("binary_list_to_integer(integer_to_binary_list(-7))", -7),
    ("size([1,2,3])", 3),
    ("size([[1,2,3],[4,5,6]])", [2, 3]),
    ("length([])", 0),
    ('length("abc")', 3),
    ("transpose([[1,2],[3,4]])", Matrix(((1, 3), (2, 4)))),
    ("transpose([1,2,3])", Matrix(((1,), (2,), (3,)))),
    ("transpose([[1],[2],[3]])", [1, 2, 3]),
    ("transpose(transpose([1,2]))", [1, 2]),
    ("inv([[2,0],[0,4]])", Matrix(((0.5, 0.0), (0.0, 0.25)))),
    ("inv(p[1,0,0,0,0,0])", Pose([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
    ("pose_trans(p[1,2,3,0,0,0], p[1,0,0,0,0,0])", Pose([2.0, 2.0, 3.0, 0.0, 0.0, 0.0])),
    ("pose_add(p[1,0,0,0,0,0], p[0,1,0,0,0,0])", Pose([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])),
    ("pose_sub(p[1,0,0,0,0,0], p[0,1,0,0,0,0])", Pose([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])),
    ("point_dist(p[1,0,0,0,0,0], p[1,3,4,1,0,0])", 5.0),
    ("pose_dist(p[1,0,0,0,0,0], p[1,3,4,0,0,0])", 5.0),
    ("interpolate_pose(p[0,0,0,0,0,0], p[1,0,0,0,0,0], 1.5)", Pose([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])),
    ("rpy2rotvec([0, 0, 1])", [0.0, 0.0, 1.0]),
    ("rotvec2rpy([0, 0, 1])", [0.0, 0.0, 1.0]),
    ("wrench_trans(p[0,0,0,0,0,0], [1,2,3,0,0,0])", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]),
    ('str_at("abc", 1)', "b"),
    ('str_cat("a", "b")', "ab"),
    ('str_empty("")', True),
    ('str_len("abc")', 3),
    ('str_find("banana", "na")', 2),
    ('str_find("banana", "na", 3)', 4),
    ('str_find("banana", "x")', -1),
    ('str_sub("abcdef", 2)', "cdef"),
    ('str_sub("abcdef", 2, 2)', "cd"),
    ('str_sub("abc", 3)', ""),
    ('str_sub("abc", 1, 99)', "bc"),
    ('str_sub("abc", index=1, len=1)', "b"),
    ('to_num("42")', 42),
    ('to_num(" -4.5")', -4.5),
    ('to_num("3.")', 3.0),
    ('to_num("-0.25")', -0.25),
    ('to_num("2147483647")', 2**31 - 1),
    ('to_num("1e3")', 1000.0),
    ('to_num("0x1F")', 31),
    ('to_num("INF")', math.inf),
    ('to_num("-inf")', -math.inf),
    ('to_num("-2147483648")', -(2**31)),
    ('to_num("9999999999.")', 9999999999.0),
    ('str_len("é")', 2),
    ('str_cat(str_at("é", 0), str_at("é", 1)) == "é"', True),
    # the text of values (Script Manual, str_cat and to_str)
    ('str_cat("a", 1)', "a1"),
    ('str_cat(1.5, "b")', "1.5b"),
    ("to_str(0.1)", "0.1"),
    ("to_str(2.0)", "2"),
    ("to_str(1/3)", "0.333333"),
    ("to_str(1e-9)", "0"),
    ("to_str(True)", "True"),
    ("to_str([True, False])", "[True, False]"),
    ("to_str(p[1,2,3,4,5,6])", "p[1, 2, 3, 4, 5, 6]"),
    ("to_str([1.5, 2])", "[1.5, 2]"),
    ("to_str([[1,2],[3,4]])", "[[1, 2], [3, 4]]"),
    ('to_str(struct(a=1, b="x"))', 'struct(a=1, b="x")'),
]


@each_row(("call", "value"), CALLS)
def test_call(result, call, value):
    found = result(call)
    assert type(found) is type(value)
    if isinstance(value, (float, list)):
        # a pose equals only a pose
        found, value = (list(found), list(value)) if isinstance(value, list) else (found, value)
        assert found == pytest.approx(value, abs=1e-12)
    else:
        assert found == value


REFUSED = [
    "acos(2)",
    "asin(-1.1)",
    "sqrt(-1)",
    "log(10, 0)",
    "pow(-1, 0.5)",
    "pow(0, -1)",
    "normalize([0,0])",
    'norm("a")',
    "inv([[1,1],[1,1]])",
    "inv([[1,2,3],[4,5,6]])",
    "binary_list_to_integer([1])",
    "pose_trans([0,0,0,0,0,0], p[0,0,0,0,0,0])",
    'str_at("abc", 3)',
    'str_at("abc", -1)',
    'str_sub("abc", 4)',
    'to_num("abc")',
    'to_num("")',
    'to_num("1x")',
    'to_num("\u0661")',
    'to_num("1_0")',
    'to_num("2147483648")',
    'to_num("-0x80000001")',
    'to_num("1e400")',
    "transpose([])",
    'transpose(["a"])',
    "make_list(3, 0, 2)",
    "make_list(-1, 0)",
    "rotvec2rpy([1,2])",
    "length(1)",
]


@each_row("call", REFUSED)
def test_refused(run, call):
    assert run(f"x = {call}").error is not None


def test_messages_print_like_a_controller():
    """Seen in a log of a real one: no blanks, six significant digits."""
    pose = Pose([0.605825, -0.720087, 0.233797, -0.0111368, -0.0111357, 1.57073])
    assert to_text(pose, message=True) == "p[0.605825,-0.720087,0.233797,-0.0111368,-0.0111357,1.57073]"
    assert to_text(1234567.0, message=True) == "1.23457e+06"


def test_bytes_and_text_are_reversible():
    data = bytes(range(256))
    assert to_bytes(from_bytes(data)) == data


def test_halves_of_a_character_become_one(result):
    """Strings that are the same bytes are equal, whatever they were made of."""
    assert result('"\udcc3" + "\udca9" == "é"') is True
    assert result('str_cat("\udcc3", "\udca9") == "é"') is True
    assert result('str_len("é" + "\udce9")') == 3


@each_row(("letter", "size"), [("x", 1), ("\u00fc", 2), ("\udcfc", 1)])
def test_a_text_has_up_to_1023_bytes_of_whatever_letters(letter, size):
    count, rest = divmod(1023 - len('[""]'), size)
    longest = letter * count + "x" * rest
    assert len(to_bytes(to_text([longest]))) == 1023
    with pytest.raises(RuntimeFault, match="maximum length"):
        to_text([longest + "x"])
