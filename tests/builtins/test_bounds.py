"""Limits on the resources that a program can accumulate."""

from collections.abc import Callable, Iterator

import pytest

from emulator.builtins import LIBRARIES
from tests.builtins.conftest import Rig
from tests.rows import each_row
from urscript.builtins import Builtin, Library

ROW = "[" + ",".join(["1.5"] * 60) + "]"
SQUARE = "[" + ",".join([ROW] * 60) + "]"


def test_open_dialogues_are_limited_and_the_oldest_closes_first(rig: Rig) -> None:
    rig.run("n = 0\nwhile n < 130:\npopup(n)\nn = n + 1\nend")
    assert [popup.text for popup in rig.controller.popups.shown] == [str(n) for n in range(30, 130)]


def test_closed_dialogues_are_forgotten(rig: Rig) -> None:
    rig.start('while True:\npopup("go on?", blocking=True)\nend')
    for _ in range(5):
        rig.until(lambda: bool(rig.controller.popups.shown))
        rig.controller.popups.close_all()
    rig.until(lambda: bool(rig.controller.popups.shown))
    host = rig.controller.programs.host
    assert host is not None
    assert len(host.dialogues) == 1


def test_the_number_of_open_sockets_is_limited(rig: Rig) -> None:
    rig.start(
        "n = 0\nopened = True\nwhile opened:\n"
        'opened = socket_open("10.0.0.1", 50001, str_cat("s", n))\nn = n + 1\nend\n'
        'again = socket_open("10.0.0.1", 50001, "s3")\nsync()\nsync()'
    )
    rig.until(lambda: "again" in rig.controller.programs.variables)
    assert rig.controller.programs.variables["n"] == 65
    assert rig.controller.programs.variables["again"] is True


@pytest.mark.parametrize("operation", ["m * m", "inv(m)"])
def test_matrix_operations_have_a_maximum_size(rig: Rig, operation: str) -> None:
    assert "at most 100000 multiplications" in rig.fault(f"m = {SQUARE}\nx = {operation}")


def test_logging_a_long_list_repeatedly_does_not_overrun_the_frame(rig: Rig) -> None:
    rig.start("a = make_list(10000, 1.25, 10000)\nwhile True:\ntextmsg(a)\nend")
    rig.until(lambda: bool(rig.texts))
    before = len(rig.texts)
    rig.seconds(0.2)
    assert 1 <= len(rig.texts) - before <= 100
    assert all(len(text) <= 4000 for text in rig.texts)


@pytest.mark.parametrize(
    ("call", "most"),
    [("get_inverse_kin(p[0.3, 0.1, 0.3, 0, 3.14, 0])", 30), ("get_jacobian()", 30), ("get_mass_matrix()", 15)],
)
def test_kinematics_calls_in_a_loop_are_charged_their_cost(rig: Rig, call: str, most: int) -> None:
    rig.start(f"n = 0\nwhile True:\na = {call}\nn = n + 1\nend")
    rig.until(lambda: bool(rig.controller.programs.variables))
    before = rig.controller.programs.variables["n"]
    rig.tick(10)
    assert 10 <= rig.controller.programs.variables["n"] - before <= 10 * most


@pytest.mark.parametrize("seconds", ["1e12", "1e300"])
def test_a_long_move_is_not_limited(rig: Rig, seconds: str) -> None:
    rig.start(f"movel(p[0.3, 0.1, 0.3, 0, 3.14, 0], t={seconds})")
    rig.seconds(0.5)
    assert not rig.exceptions
    assert rig.controller.programs.name == "prog"


_ABSURD = ["1/0", "0/0", "1e300"]


@each_row("number", _ABSURD)
@each_row(
    "call",
    [
        "get_forward_kin([{},0,0,0,0,0])",
        "get_inverse_kin(p[0.3,0.1,0.3,0,0,0], [{},0,0,0,0,0])",
        "get_jacobian([{},0,0,0,0,0])",
        "movec(p[{},0,0,0,0,0], p[0.3,0.1,0.3,0,0,0])",
        "movel(p[{},0,0,0,0,0])",
        "movep(p[0,0,0,{},0,0])",
        "servoc(p[{},0,0,0,0,0])",
        "speedj([{},0,0,0,0,0], 1, 1)",
        "servoj([{},0,0,0,0,0])",
        "set_tcp(p[0,0,{},0,0,0])",
        "set_payload({})",
        "set_payload_mass({})",
        "set_payload_cog([0,{},0])",
        "set_payload(1, [0,0,{}])",
    ],
)
def test_non_finite_arguments_stop_the_program_with_a_message(rig, call, number):
    fault = rig.fault(call.format(number))
    assert "internal error" not in fault
    assert "must be" in fault


@each_row(
    ("call", "words"),
    [
        ("set_payload_cog([0, 11, 0])", "must be within 10 m of the flange"),
        ("set_gravity([0, 0, -2147483648])", "must be at most 100 m/s2 long"),
        ("movep(get_actual_tcp_pose(), a=1e-320)", "must be greater than 0"),
    ],
)
def test_arguments_beyond_the_limits_of_an_arm_are_refused(rig: Rig, call: str, words: str) -> None:
    assert words in rig.fault(call)


_LARGE = "1e308"
_ODD: dict[str, tuple[str, ...]] = {  # rarely considered values, by the type of a parameter
    "Num": (_LARGE, f"-{_LARGE}", "0"),
    "Int": (_LARGE, "2147483647", "-1"),
    "Const String": ('"\udce9\x85"', '""'),
    "Pose": (f"p[{', '.join([_LARGE] * 6)}]", "p[0,0,0,1e12,1e12,1e12]"),
    "List": (f"[{', '.join([_LARGE] * 6)}]", f"[{', '.join(['1e12'] * 6)}]", "[]", '["\udce9"]'),
    "any": (_LARGE, '"\udce9"', f"p[0,0,0,0,0,{_LARGE}]"),
}
_USUAL = {
    "Num": "1.0",
    "Int": "1",
    "Bool": "True",
    "Const String": '"a"',
    "Pose": "p[0.1,0.2,0.3,0,0,0]",
    "List": "[1,2,3,4,5,6]",
    "Matrix": "[[1,2],[3,4]]",
}


def _calls(builtin: Builtin) -> Iterator[str]:
    """Calls with one odd argument each."""
    titles = ["List" if "List" in p.kind.title else p.kind.title for p in builtin.parameters]
    usual = [_USUAL.get(title, "1") for title in titles]
    for index, title in enumerate(titles):
        for odd in _ODD.get(title, ()):
            yield f"{builtin.name}({', '.join([*usual[:index], odd, *usual[index + 1 :]])})"


@each_row("library", LIBRARIES, ids=lambda library: library.chapter)
def test_no_builtin_fails_internally_on_an_odd_argument(make_rig: Callable[..., Rig], library: Library) -> None:
    rig = make_rig("ur3e", None)
    for builtin in library.builtins.values():
        for call in () if builtin.name == "powerdown" else _calls(builtin):
            before = len(rig.exceptions)
            rig.start(call)
            rig.tick(6)
            assert not [m.text for m in rig.exceptions[before:] if "internal error" in m.text], call
            controller = rig.controller
            assert controller.guard.problem is None, call
            if controller.programs.busy or controller.safety.stopped:
                rig = make_rig("ur3e", None)


def test_an_excessive_sleep_time_is_refused(rig: Rig) -> None:
    assert rig.fault("sleep(1e308)") == "1e+308 is not a time in seconds"
