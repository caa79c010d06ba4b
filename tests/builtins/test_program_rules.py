"""Endless computations, and restrictions on secondary programs."""

import pytest

from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage


def errors(rig):
    return [(m.code, m.argument) for m in rig.messages if isinstance(m, ErrorCodeMessage)]


def test_an_endless_loop_causes_a_warning_and_then_stops_the_arm(rig):
    rig.start("n = 0\nwhile True:\n  n = n + 1\nend")
    rig.until(lambda: errors(rig) != [], 2.0)
    assert errors(rig) == [(218, 0)]
    assert rig.state is RuntimeState.PLAYING
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 12.0)
    assert errors(rig) == [(218, 0), (271, 1)]
    assert rig.controller.snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP


def test_an_endless_loop_ends_the_program_on_cb3(cb3):
    cb3.start("n = 0\nwhile True:\n  n = n + 1\nend")
    cb3.until(lambda: cb3.state is RuntimeState.STOPPED and bool(cb3.exceptions), 12.0)
    (exception,) = cb3.exceptions
    assert exception.line in (3, 4)
    assert "used too much time" in exception.text
    assert cb3.keys[-1] == ("PROGRAM_XXX_STOPPED", "prog")
    assert cb3.controller.snapshot.safety_mode is SafetyMode.NORMAL


def test_the_warning_names_the_busy_thread(rig):
    rig.start("thread busy():\n  while True:\n    x = 1\n  end\nend\nrun busy()\nsleep(1.5)\nhalt")
    rig.until(lambda: rig.state is RuntimeState.STOPPED and bool(rig.keys), 3.0)
    (warning,) = [m for m in rig.messages if isinstance(m, ErrorCodeMessage)]
    assert (warning.label, "busy" in warning.text) == ("C218A1", True)


@pytest.mark.parametrize("wait", ["sync()", "sleep(0.002)"])
def test_a_loop_that_occasionally_waits_is_not_an_endless_loop(rig, wait):
    rig.start(f"while True:\n  n = 0\n  while n < 3000:\n    n = n + 1\n  end\n  {wait}\nend")
    rig.seconds(12.0)
    assert rig.state is RuntimeState.PLAYING
    assert errors(rig) == []


@pytest.mark.long
def test_reading_from_a_peer_that_never_pauses_is_not_an_endless_loop(rig):
    """Some drivers send keep-alives without a pause; the official script reads them all."""
    rig.start('socket_open("10.0.0.1", 50001, "s")\nwhile True:\n  m = socket_read_binary_integer(8, "s", 0.5)\nend')
    rig.until(lambda: bool(rig.sockets.opened), 1.0)
    (driver,) = rig.sockets.opened
    for _ in range(round(10.5 / rig.period)):
        driver.feed(bytes(32 * max(0, 2000 - len(driver.inbox) // 32)))
        rig.tick()
        assert driver.inbox  # it never gets to wait
    assert rig.state is RuntimeState.PLAYING
    assert errors(rig) == []


def test_a_secondary_program_uses_the_sockets_of_the_main_program(rig):
    """The manual allows a secondary program a single socket_send, and no time to open a socket."""
    rig.start('socket_open("10.0.0.1", 50001, "link")\nwhile True:\n  sync()\nend')
    rig.tick(3)
    rig.submit('sec aside():\n  socket_send_string("hello", "link")\nend\n')
    rig.tick(3)
    (link,) = rig.sockets.opened
    assert bytes(link.sent) == b"hello"
    assert link.state == "open"


def test_a_secondary_program_without_a_main_program_closes_its_sockets(rig):
    rig.submit('sec aside():\n  socket_open("10.0.0.1", 50001)\n  socket_send_string("hello")\nend\n')
    rig.tick(3)
    (link,) = rig.sockets.opened
    assert (bytes(link.sent), link.state) == (b"hello", "closed")


@pytest.mark.parametrize(
    "statement",
    [
        "sync()",
        "while True:\n  x = 1\nend",
        "servoj([0,0,0,0,0,0])",
        'socket_read_string("none", timeout=1)',
        'x = request_boolean_from_primary_client("Really?")',
    ],
)
def test_a_secondary_program_that_takes_too_long_is_stopped(rig, statement):
    rig.sockets.listening.add(("10.0.0.1", 50001))
    rig.start('socket_open("10.0.0.1", 50001, "none")\nwhile True:\n  sync()\nend', name="main")
    rig.tick(3)
    body = "".join(f"  {line}\n" for line in statement.splitlines())
    rig.submit(f"sec aside():\n{body}end\n")
    rig.tick(3)
    assert rig.keys[-1][0] == "SECONDARY_PROGRAM_EXCEPTION_XXX"
    assert "Runtime is too much behind" in rig.keys[-1][1]
    assert rig.state is RuntimeState.PLAYING
    assert rig.controller.popups.shown == []


def test_a_thread_of_a_secondary_program_does_not_outlive_it(rig):
    rig.submit(
        "sec aside():\n  thread t():\n    sleep(0.1)\n    set_standard_digital_out(1, True)\n  end\n  run t()\nend\n"
    )
    rig.seconds(0.3)
    assert rig.controller.signals.digital_outputs == 0


def test_a_secondary_program_that_does_not_compile_is_a_runtime_exception(rig):
    rig.submit("sec aside():\n  no_such_thing()\nend\n")
    rig.tick(3)
    (exception,) = rig.exceptions
    assert (exception.line, exception.text) == (2, "compile_error_name_not_found:no_such_thing:")
    assert rig.keys == []


@pytest.mark.parametrize(
    "command",
    [
        "speedl([0, 0, 0.02, 0, 0, 0], 0.25, 0)",
        "speedl([0, 0, 0.02, 0, 0, 0], 0.25)",  # what ur_rtde sends for a time of 0
        "speedj([0.1, 0, 0, 0, 0, 0], 1, 0)",
        "speedj([0.1, 0, 0, 0, 0, 0], a=1)",
        "servoj([0, -1.5, 1.5, -1.6, -1.57, 0], t=0)",
    ],
)
def test_commands_for_no_time_in_a_loop_without_a_wait_stop_the_arm(rig, command):
    """Public reports of ur_rtde's speedL with a time of 0: C271A1 and a protective stop."""
    rig.start(f"thread moves():\n  while True:\n    {command}\n  end\nend\nh = run moves()\njoin h")
    rig.until(lambda: rig.controller.snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP, 2.0)
    assert errors(rig)[-1] == (271, 1)


@pytest.mark.parametrize("command", ["speedl([0, 0, 0.02, 0, 0, 0], 0.25, 0)", "speedj([0.1, 0, 0, 0, 0, 0], 1, 0)"])
def test_a_speed_for_no_time_is_held_while_the_program_waits(rig, command):
    rig.run(f"n = 0\nwhile n < 600:\n  {command}\n  n = n + 1\n  sync()\nend\nglobal qd = get_target_joint_speeds()")
    assert errors(rig) == []
    assert rig.q != pytest.approx((0.0, -1.5, 1.5, -1.6, -1.57, 0.0), abs=0.01)


def test_a_command_for_no_time_lets_the_program_continue_at_once(rig):
    took = rig.run("speedj([0.1, 0, 0, 0, 0, 0], 1, 0)\nspeedj([0.2, 0, 0, 0, 0, 0], 1, 0)\nset_digital_out(0, True)")
    assert took < 0.1
    rig.start("speedj([0.1, 0, 0, 0, 0, 0], 1, 0)\nn = 1\nsleep(1)")
    rig.until(lambda: rig.controller.programs.variables.get("n") == 1, 1.0)
    assert rig.controller.snapshot.target_qd[0] <= 1.0 * rig.period
