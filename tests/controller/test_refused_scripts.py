"""Whoever started the emulator learns that a script was refused, and why: one line of its log at the default level."""

import logging

import pytest

from emulator.commands.requests import RefusedScript, ScriptUnit
from emulator.reporting.messages import RefusalLog

WRONG = "def wrong():\n  x = 1\n  foo(x)\nend\n"
RIGHT = "def right():\n  sleep(0.1)\nend\n"
ORIGIN = "a script from 192.0.2.7:4711 on port 30002"


@pytest.fixture
def lines(caplog):
    """The texts logged at the default level so far."""
    caplog.set_level(logging.WARNING)
    return lambda: [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def send(rig, text, times=1):
    for _ in range(times):
        rig.controller.post(ScriptUnit(text, "block", ORIGIN))
        rig.seconds(0.1)


def test_a_script_that_does_not_compile_is_one_line_with_its_position_and_sender(make, lines):
    send(make("ur5e", running=True), WRONG)
    [line] = lines()
    assert line.startswith(f"{ORIGIN} was not started: line 3, column 3: ")
    assert "foo" in line


def test_a_function_of_another_version_is_named_with_its_versions(make, lines):
    send(make("ur5e", running=True, version="5.4.0"), "def new():\n  direct_torque([0, 0, 0, 0, 0, 0])\nend\n")
    [line] = lines()
    assert "5.23" in line


def test_an_arm_that_is_not_ready_is_a_reason(make, lines):
    send(make("ur5e", running=False), RIGHT)
    ready = "power the arm on, release its brakes, clear any stop"
    assert lines() == [f"{ORIGIN} was not started: it waits paused: {ready}, then play"]


def test_a_paused_program_is_a_reason(make, lines):
    rig = make("ur5e", running=True)
    rig.script("def waits():\n  sleep(9)\nend\n")
    rig.seconds(0.3)
    rig.request("pause")
    send(rig, RIGHT)
    assert lines() == [f"{ORIGIN} was not started: it ended a paused program: send it again to start it"]


def test_a_read_only_connection_is_a_reason(make, lines):
    rig = make("ur5e", running=True)
    rig.controller.post(RefusedScript(RIGHT, ORIGIN))
    rig.tick()
    [line] = lines()
    assert line.startswith(f"{ORIGIN} was not started: its connection is read-only")


def test_repeats_are_counted_instead(make, lines):
    rig = make("ur5e", running=True)
    send(rig, WRONG, 4)
    assert len(lines()) == 1
    rig.seconds(60.0)
    send(rig, WRONG)
    assert lines()[1].endswith(" (3 more since the last such line)")


def test_accepted_scripts_and_text_commands_are_not_logged(make, lines):
    rig = make("ur5e", running=True)
    send(rig, RIGHT)
    rig.controller.post(ScriptUnit("set speed 0.5", "line", ORIGIN))
    rig.seconds(0.5)
    assert lines() == []


def test_a_client_cannot_flood_the_log_with_ever_new_reasons(lines):
    log = RefusalLog(lambda: 0.0)
    for number in range(1000):
        log.report(ORIGIN, f"line {number}, column 1: syntax error")
    assert len(lines()) == 21


def test_a_hostile_script_is_shown_on_one_printable_line(make, lines):
    send(make("ur5e", running=True), "def wrong():\n  x = \udcab\x1b[2J\r(\nend\n")
    RefusalLog(lambda: 0.0).report("the loaded program \udcab", "1\n2\x1b" + "x" * 10_000)
    assert len(lines()) == 2
    for line in lines():
        assert line.isprintable()
        assert len(line) < 600
        line.encode()
