"""Text of any bytes: stored without loss, displayed safely, and parsed as protocols define it."""

import json
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.text import (
    from_bytes,
    from_readable,
    json_document,
    lines,
    lower,
    number,
    readable,
    readable_in,
    strip,
    to_bytes,
    whole_number,
    words,
)

any_text = st.binary().map(from_bytes) | st.text(st.characters())  # with lone surrogates from elsewhere


@given(st.binary())
def test_bytes_round_trip(data: bytes) -> None:
    assert to_bytes(from_bytes(data)) == data


@given(any_text)
def test_any_text_has_bytes_and_can_be_shown(text: str) -> None:
    assert to_bytes(from_bytes(to_bytes(text))) == to_bytes(text)
    readable(text).encode("utf-8")


@given(st.binary().filter(lambda data: b"\\x" not in data))
def test_displayed_text_can_be_read_back(data: bytes) -> None:
    assert to_bytes(from_readable(readable(from_bytes(data)))) == data


def test_invalid_utf_8_is_displayed_as_bytes() -> None:
    assert readable(from_bytes("größe".encode())) == "größe"
    assert readable(from_bytes("größe".encode("latin-1"))) == r"gr\xf6\xdfe"


@dataclass(frozen=True, slots=True)
class Record:
    text: str
    parts: tuple[str, ...]


def test_values_are_displayed_completely() -> None:
    odd = from_bytes(b"\xe9")
    value = {odd: [odd, (odd, 1)], "record": Record(odd, (odd, "a")), "n": None}
    shown = readable_in(value)
    assert shown == {r"\xe9": [r"\xe9", (r"\xe9", 1)], "record": Record(r"\xe9", (r"\xe9", "a")), "n": None}
    json.dumps(shown["\\xe9"], ensure_ascii=False).encode("utf-8")


def test_only_ascii_whitespace_and_line_ends_count() -> None:
    text = " a\x1cb\x85\u2003c\td\v "
    assert strip(text) == "a\x1cb\x85\u2003c\td"
    assert words(text) == ["a\x1cb\x85\u2003c", "d"]
    assert lines("a\x1cb\x85c\u2028d\r\ne\rf\n\ng\n") == ["a\x1cb\x85c\u2028d", "e", "f", "", "g"]
    assert lines("") == []
    assert lower("BRAKE \u212a \xc9") == "brake \u212a \xc9"


@each_row("text", ["²", "٣", "1_0", "", " ", "nan", "inf", "1e", "0x1", "1\x1c", "--1", "1,5"])
def test_text_that_is_not_a_number(text: str) -> None:
    with pytest.raises(ValueError, match="not a"):
        number(text)
    with pytest.raises(ValueError, match="not a whole number"):
        whole_number(text)


def test_numbers() -> None:
    assert [number(text) for text in ("1", " -.5 ", "+1.e3", "1E-2\r")] == [1.0, -0.5, 1000.0, 0.01]
    assert [whole_number(text) for text in ("1", " -12", "+007 ")] == [1, -12, 7]
    with pytest.raises(ValueError, match="too large"):
        number("1e309")
    with pytest.raises(ValueError, match="not a whole number"):
        whole_number("9" * 5000)


def test_invalid_or_deeply_nested_json_is_an_ordinary_error() -> None:
    assert json_document(b'{"a": [1, null]}') == {"a": [1, None]}
    for nonsense in ("[" * 5000, b"[" * 100_000, b"\xff", "{"):
        with pytest.raises(ValueError, match=r"."):
            json_document(nonsense)
