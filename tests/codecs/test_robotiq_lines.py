"""Requests to the gripper: two dialects, any split, any bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import RemoteProtocolError
from urproto.robotiq import Get, InvalidRequest, RequestDecoder, Set, encode_value


@each_row(
    ("line", "request_"),
    [
        ("GET POS", Get("POS")),
        ("SET ACT 1", Set((("ACT", 1),))),
        ("SET POS 255 SPE 100 FOR 50 GTO 1", Set((("POS", 255), ("SPE", 100), ("FOR", 50), ("GTO", 1)))),
        ("SET POS 128.0", Set((("POS", 128),))),
        ("SET POS 1e999", InvalidRequest("SET POS 1e999")),
        ("SET POS 1_0", InvalidRequest("SET POS 1_0")),
        ("SET POS nan", InvalidRequest("SET POS nan")),
        ("SET POS ٣", InvalidRequest("SET POS ٣")),
        ("SET POS 1\x1c2", InvalidRequest("SET POS 1\x1c2")),
        ("SET POS 1\x1fSPE 2", InvalidRequest("SET POS 1\x1fSPE 2")),
        ("SET\x1dPOS 1", InvalidRequest("SET\x1dPOS 1")),
        ("GET\u2003POS", InvalidRequest("GET\u2003POS")),
        ("\x1eGET POS", InvalidRequest("\x1eGET POS")),
        ("SET POS 1.5", InvalidRequest("SET POS 1.5")),
        ("SET POS", InvalidRequest("SET POS")),
        ("SET", InvalidRequest("SET")),
        ("GET", InvalidRequest("GET")),
        ("GET POS OBJ", InvalidRequest("GET POS OBJ")),
        ("get POS", InvalidRequest("get POS")),
    ],
)
@each_row("end", ["\n", "\r\n"])
@each_row("chunk", [1, 100])
def test_lines(line: str, request_: object, end: str, chunk: int) -> None:
    decoder = RequestDecoder()
    data = f"\n{line}{end}".encode()
    got = [request for at in range(0, len(data), chunk) for request in decoder.feed(data[at : at + chunk])]
    assert got == [request_]
    assert decoder.flush() == []


def test_a_get_without_a_line_end() -> None:
    decoder = RequestDecoder()
    assert decoder.feed(b"GET STA") == []
    assert decoder.flush() == [Get("STA", named=False)]
    assert decoder.feed(b"\n") == [], "the late line end is not a request"
    for unfinished in (b"GET ST", b"SET ACT 1", b"\xff"):
        decoder = RequestDecoder()
        assert decoder.feed(unfinished) == []
        assert decoder.flush() == [], "may go on"


def test_a_program_that_writes_in_pieces() -> None:
    """As the maker's: a string, a byte, a string, ... and the line end at last."""
    decoder = RequestDecoder()
    for piece in (b"SET POS", b" ", b"200", b" ", b"SPE", b" ", b"10"):
        assert decoder.feed(piece) == decoder.flush() == []
    assert decoder.feed(b"\n") == [Set((("POS", 200), ("SPE", 10)))]


def test_answers() -> None:
    assert encode_value(Get("POS"), "3") == b"POS 3\n"
    assert encode_value(Get("FLT", named=False), "07") == b"07"


def test_an_unterminated_line_is_not_a_request() -> None:
    with pytest.raises(RemoteProtocolError, match="longer than 1024"):
        RequestDecoder().feed(b"x" * 1025)


@given(st.lists(st.binary(max_size=20) | st.sampled_from([b"GET ", b"SET ", b"POS", b" 1", b"\n"]), max_size=20))
def test_any_bytes(pieces: list[bytes]) -> None:
    whole, split = RequestDecoder(), RequestDecoder()
    assert whole.feed(b"".join(pieces)) == [request for piece in pieces for request in split.feed(piece)]
    assert whole.flush() == split.flush()
