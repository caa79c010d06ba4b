"""Lines of interpreter mode. The forms are those of the Script Manual's chapter."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import RemoteProtocolError
from urproto.interpreter import (
    InterpreterAnswer,
    InterpreterCommand,
    Reason,
    StatementDecoder,
    TooLong,
    ack,
    discard,
    encode_answer,
    parse_answer,
    state,
)

VENDOR_HELPER = re.compile(r"(\w+):\W+(\d+)?")  # how the vendor's InterpreterHelper reads answers


def test_answers_match_the_manual() -> None:
    assert ack(1, "x = 1") == "ack: 1: x = 1"
    assert discard(Reason.SYNTAX, "x = ") == "discard: Syntax error: x = "
    assert state(7, "statelastexecuted") == "state: 7: statelastexecuted"


@each_row(
    ("text", "kind", "number"),
    [
        (ack(12, "sleep(1)"), "ack", "12"),
        (state(0, "statelastcleared"), "state", "0"),
        (discard(Reason.INVALID_STATE, "3"), "discard", None),
    ],
)
def test_the_vendors_helper_parses_our_answers(text: str, kind: str, number: str | None) -> None:
    match = VENDOR_HELPER.match(text)
    assert match is not None
    assert match.groups() == (kind, number)


@given(st.text(st.characters(exclude_characters="\n")), st.integers(0, 65535))
def test_answers_round_trip(line: str, number: int) -> None:
    assert parse_answer(ack(number, line)) == InterpreterAnswer(number, "", line)
    assert parse_answer(state(number, line)) == InterpreterAnswer(number, "", line)
    assert parse_answer(discard(Reason.COMPILE, line)) == InterpreterAnswer(None, "Compile error", line)


@each_row("text", ["", "ack", "ack: x: y", "nack: 1: y", "Connected: Universal Robots Dashboard Server"])
def test_other_text_is_not_an_answer(text: str) -> None:
    with pytest.raises(RemoteProtocolError, match="not an answer of interpreter mode"):
        parse_answer(text)


@each_row("line", ["abort", " SkipBuffer\t", "STATELASTEXECUTED"])
def test_commands(line: str) -> None:
    command = InterpreterCommand.of(line)
    assert command is not None
    assert command.value == line.strip().lower()


@each_row("line", ["abort()", "abort end_interpreter()", "", "skip buffer"])
def test_statements_are_not_commands(line: str) -> None:
    assert InterpreterCommand.of(line) is None


@given(st.binary(max_size=200), st.integers(1, 30))
def test_lines_do_not_depend_on_the_split(data: bytes, size: int) -> None:
    whole = StatementDecoder(max_line=20).feed(data)
    decoder = StatementDecoder(max_line=20)
    pieces = [line for at in range(0, len(data), size) for line in decoder.feed(data[at : at + size])]
    assert pieces == whole
    assert len(whole) == data.count(b"\n")
    for raw, line in zip(data.split(b"\n"), whole, strict=False):
        if isinstance(line, TooLong):
            assert len(raw) > 20
        else:
            assert encode_answer(line).rstrip(b"\n") == raw.removesuffix(b"\r")


def test_a_long_line_is_not_kept() -> None:
    decoder = StatementDecoder(max_line=100)
    assert decoder.feed(b"y" * 1_000_000) == []
    assert decoder.rest == 100
    assert decoder.feed(b"y\nx = 1\r\n") == [TooLong("y" * 60), "x = 1"]
