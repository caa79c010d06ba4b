"""Dashboard lines and the meaning of replies. Reply texts: captures and manuals, see the module."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.dashboard import (
    LineDecoder,
    ProgramState,
    encode_line,
    failed,
    not_understood,
    parse_boolean,
    parse_loaded_program,
    parse_polyscope_version,
    parse_program_state,
    parse_robot_mode,
    parse_safety_mode,
    parse_safety_status,
)
from urproto.errors import RemoteProtocolError
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import PolyscopeVersion


@each_row("step", [1, 3, 100])
def test_lines_in_any_split(step):
    stream = b"power on\r\n\nplay\nset name=\xc3\xa9 \xff\nhalf"
    decoder = LineDecoder()
    lines = [line for at in range(0, len(stream), step) for line in decoder.feed(stream[at : at + step])]
    assert lines == ["power on", "", "play", "set name=é \udcff"]
    assert decoder.feed(b" a line\n") == ["half a line"]


def test_line_length_is_limited():
    decoder = LineDecoder(max_line=10)
    assert decoder.feed(b"0123456789\n") == ["0123456789"]
    assert decoder.feed(b"ok\n0123456789a") == ["ok"]
    assert decoder.error is not None
    with pytest.raises(RemoteProtocolError, match="10 bytes"):
        decoder.feed(b"\nmore\n")


@pytest.mark.parametrize("step", [1, 100])
def test_the_limit_does_not_depend_on_the_split(step):
    stream = b"0123456789ab\nlate\n"
    decoder = LineDecoder(max_line=10)
    lines = []
    with contextlib.suppress(RemoteProtocolError):
        for at in range(0, len(stream), step):
            lines += decoder.feed(stream[at : at + step])
    assert lines == []
    assert decoder.error is not None


def test_an_answer_is_one_line():
    assert encode_line("two\nlines") == b"two lines\n"
    assert encode_line("grüß \ud800") == "grüß ?\n".encode()


@each_row(
    ("parse", "reply", "value"),
    [
        (parse_robot_mode, "Robotmode: POWER_OFF", RobotMode.POWER_OFF),
        (parse_safety_mode, "Safetymode: PROTECTIVE_STOP", SafetyMode.PROTECTIVE_STOP),
        (parse_safety_status, "Safetystatus: NORMAL", SafetyStatus.NORMAL),
        (parse_program_state, "STOPPED null", (ProgramState.STOPPED, None)),
        (parse_program_state, "STOPPED <unnamed>", (ProgramState.STOPPED, None)),
        (parse_program_state, "PLAYING my program.urp", (ProgramState.PLAYING, "my program.urp")),
        (parse_loaded_program, "Loaded program: /programs/x.urp", "/programs/x.urp"),
        (parse_loaded_program, "No program loaded", None),
        (parse_loaded_program, "Loaded program: /programs/<unnamed>.urp", None),  # UR10e, 5.11.9
        (parse_loaded_program, "Loaded program: /programs/<未命名>.urp", None),  # UR30, 5.21, pendant in Chinese
        (parse_boolean, "Program running: false", False),
        (parse_boolean, "Robot running: True", True),
        (parse_boolean, "true", True),
        (
            parse_polyscope_version,
            "URSoftware 3.15.8.106339 (Jun 20 2022)",
            PolyscopeVersion(3, 15, 8, 106339),
        ),
    ],
)
def test_replies(parse, reply, value):
    assert parse(reply) == value


@each_row(
    ("parse", "reply"),
    [
        (parse_robot_mode, "Robotmode: DANCING"),
        (parse_robot_mode, "could not understand: 'robotmode'"),
        (parse_safety_mode, ""),
        (parse_safety_status, "Safetymode: NORMAL"),
        (parse_program_state, "RUNNING x.urp"),
        (parse_loaded_program, "File not found: x"),
        (parse_boolean, "maybe"),
        (parse_polyscope_version, "URSoftware"),
    ],
)
def test_unexpected_replies_are_protocol_errors(parse, reply):
    with pytest.raises(RemoteProtocolError):
        parse(reply)


def test_refusals():
    assert failed("play") == "Failed to execute: play"
    assert not_understood("dance") == "could not understand: 'dance'"


@given(st.text(max_size=50))
def test_any_reply_parses_or_is_a_protocol_error(reply):
    for parse in (parse_robot_mode, parse_program_state, parse_loaded_program, parse_boolean, parse_polyscope_version):
        with contextlib.suppress(RemoteProtocolError):
            parse(reply)
