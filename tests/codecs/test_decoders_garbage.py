"""Any bytes, in any split: messages or a RemoteProtocolError, the same ones, in bounded memory."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.budget import examples
from tests.rows import each_row
from urproto.dashboard import LineDecoder
from urproto.errors import RemoteProtocolError
from urproto.modbus import FrameDecoder
from urproto.primary.framing import MAX_MESSAGE_SIZE, PrimaryDecoder
from urproto.realtime import RealtimeDecoder
from urproto.rtde.codec import RTDEDecoder

DECODERS = [RTDEDecoder, PrimaryDecoder, RealtimeDecoder, LineDecoder, FrameDecoder]


def framed(header: str) -> st.SearchStrategy[bytes]:
    """Chunks with a valid size in front, so that the garbage passes the framing."""

    def build(kind: int, body: bytes) -> bytes:
        values = {"h": (len(body) + 3, kind), "i": (len(body) + 5, kind)}[header[1].lower()]
        return struct.pack(header, *values) + body

    return st.builds(build, st.sampled_from([16, 20, 25, *b"VvMUOISP"]), st.binary(max_size=60))


GARBAGE = st.one_of(
    st.binary(max_size=300),
    st.lists(st.one_of(framed(">HB"), framed(">iB"), st.binary(max_size=8)), max_size=6).map(b"".join),
)


def drain(decoder, chunks):
    """All messages, and whether the stream ended in an error."""
    messages = []
    try:
        for chunk in chunks:
            messages += decoder.feed(chunk)
        messages += decoder.feed(b"")
    except RemoteProtocolError:
        return messages, True
    return messages, False


@pytest.mark.parametrize("kind", DECODERS)
@settings(max_examples=examples(20), deadline=None)
@given(data=GARBAGE)
def test_results_do_not_depend_on_the_split(kind, data):
    whole = drain(kind(), [data])
    bytewise = drain(kind(), [bytes([byte]) for byte in data])
    assert repr(whole) == repr(bytewise)  # repr, in which NaN equals itself


@each_row("kind", DECODERS)
def test_memory_is_bounded(kind):
    """Feed the start of the longest message that each decoder waits for, then far more than that."""
    decoder = kind()
    sizes = {
        RTDEDecoder: struct.pack(">H", 65535),
        PrimaryDecoder: struct.pack(">i", MAX_MESSAGE_SIZE),
        RealtimeDecoder: struct.pack(">i", 65536),
        FrameDecoder: struct.pack(">HHH", 1, 0, 254),
    }
    chunk = sizes.get(kind, b"") + b"x" * 50_000
    longest = 0
    for _ in range(60):
        try:
            decoder.feed(chunk)
        except RemoteProtocolError:
            break
        longest = max(longest, len(decoder._buffer))
    assert longest <= MAX_MESSAGE_SIZE + len(chunk)
