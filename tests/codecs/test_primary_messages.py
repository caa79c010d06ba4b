"""Robot messages: recorded bytes, and one row per kind for both directions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.modes import MessageSource, ReportDataType, ReportLevel, RequestedType, SafetyMode
from urproto.primary.framing import OtherMessage, PrimaryDecoder
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    ErrorCodeMessage,
    KeyMessage,
    PopupMessage,
    ProgramLabelMessage,
    ProgramThread,
    ProgramThreadsMessage,
    RequestValueMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
    UnknownMessage,
    VersionMessage,
    decode_robot_message,
)
from urproto.primary.program_state import GlobalVariableValues
from urproto.versions import PolyscopeVersion

V3_2 = PolyscopeVersion(3, 2)
V3_15 = PolyscopeVersion(3, 15, 8, 106339)
V5_22 = PolyscopeVersion(5, 22)

RECORDED = {
    "version_message_5.24": [
        VersionMessage(timestamp_us=0, major=5, minor=24, bugfix=0, build=0, build_date="04-10-2025, 00:25:33"),
    ],
    "safety_mode_5.24": [
        SafetyModeMessage(safety_mode=SafetyMode.PROTECTIVE_STOP, data_type=ReportDataType.NONE, data=1),
    ],
    "key_message_urcl": [
        KeyMessage(source=MessageSource.ROBOT_INTERFACE, title=PROGRAM_STARTED, text="textmsg"),
    ],
    "connect_3.10": [
        VersionMessage.of(PolyscopeVersion(3, 10), "03-05-2019, 06:39:00"),
        UnknownMessage(timestamp_us=NO_TIMESTAMP_US, message_kind=12, body=bytes.fromhex("000001fe0000010301")),
        OtherMessage,
    ],
    "connect_5.4": [
        VersionMessage.of(PolyscopeVersion(5, 4), "21-06-2019, 10:03:02"),
        UnknownMessage(timestamp_us=NO_TIMESTAMP_US, message_kind=12, body=bytes(8) + b"\1"),
    ],
    "key_stopped_5.4": [
        KeyMessage(timestamp_us=16634482000, title=PROGRAM_STOPPED, text="silly"),
        GlobalVariableValues(values=()),
        OtherMessage(5, bytes(4)),
    ],
    "syntax_error_5.4": [
        RuntimeExceptionMessage(timestamp_us=NO_TIMESTAMP_US, line=2, column=1, text="syntax_error_on_line:2:end:"),
    ],
    "compile_error_5.4": [
        RuntimeExceptionMessage(
            timestamp_us=NO_TIMESTAMP_US, line=2, column=2, text="compile_error_name_not_found:txtmsg:"
        ),
    ],
}

HEADER = "00000000000003e8"  # 1000 us
WRITTEN_OUT = [
    pytest.param(TextMessage(timestamp_us=1000, text="hello"), f"00000014 14 {HEADER} fd 00 68656c6c6f", id="text"),
    pytest.param(
        ProgramLabelMessage(timestamp_us=1000, label_id=3, text="ab"),
        f"00000015 14 {HEADER} fe 01 00000003 6162",
        id="program label",
    ),
    pytest.param(
        PopupMessage(
            timestamp_us=1000,
            request_id=2,
            requested_type=RequestedType.BOOLEAN,
            warning=True,
            blocking=True,
            title="T",
            text="x",
        ),
        f"0000001d 14 {HEADER} fe 02 00000002 00000000 01 00 01 01 54 78",
        id="popup",
    ),
    pytest.param(
        VersionMessage(timestamp_us=1000, major=5, minor=22, bugfix=1, build=7, build_date="d"),
        f"00000024 14 {HEADER} fe 03 09 5552436f6e74726f6c 05 16 00000001 00000007 64",
        id="version",
    ),
    pytest.param(
        ErrorCodeMessage(timestamp_us=1000, code=209, level=ReportLevel.WARNING, data=1, text="!"),
        f"00000024 14 {HEADER} fd 06 000000d1 00000000 00000002 00000000 00000001 21",
        id="error code",
    ),
    pytest.param(
        KeyMessage(timestamp_us=1000, code=-1, argument=2, title="T", text=""),
        f"00000019 14 {HEADER} fd 07 ffffffff 00000002 01 54",
        id="key",
    ),
    pytest.param(
        RequestValueMessage(timestamp_us=1000, request_id=1, requested_type=RequestedType.POSE, text="p?"),
        f"00000019 14 {HEADER} fe 09 00000001 00000004 703f",
        id="request value",
    ),
    pytest.param(
        ProgramThreadsMessage(timestamp_us=1000, threads=(ProgramThread(5, "Move", "t"),)),
        f"00000020 14 {HEADER} fe 0e 00000005 00000004 4d6f7665 00000001 74",
        id="program threads",
    ),
]


@each_row("name", RECORDED)
@each_row("step", [1, 7, 10_000])
def test_recorded_streams(golden, name, step):
    data = golden(name)
    decoder = PrimaryDecoder()
    messages = [message for at in range(0, len(data), step) for message in decoder.feed(data[at : at + step])]
    assert len(messages) == len(RECORDED[name])
    for message, expected in zip(messages, RECORDED[name], strict=True):
        assert isinstance(message, OtherMessage) if expected is OtherMessage else message == expected


@each_row("name", sorted(set(RECORDED) - {"connect_3.10", "key_stopped_5.4"}))
def test_recorded_messages_are_reencoded_to_the_same_bytes(golden, name):
    assert b"".join(message.encode(V5_22) for message in RECORDED[name]) == golden(name)


@each_row(("message", "wire"), WRITTEN_OUT)
def test_each_kind_decodes_from_and_encodes_to_its_bytes(message, wire):
    data = bytes.fromhex(wire)
    assert message.encode(V5_22) == data
    assert PrimaryDecoder().feed(data) == [message]


def test_old_popups_are_shorter():
    popup = PopupMessage(error=True, title="T", text="x")
    assert popup.encode(V3_2)[15:] == bytes.fromhex("00 01 01 54 78")
    assert PrimaryDecoder(V3_2).feed(popup.encode(V3_2)) == [popup]


def test_the_version_message_sets_the_version_of_later_messages():
    decoder = PrimaryDecoder()
    popup = PopupMessage(title="T", text="x")
    stream = VersionMessage.of(V3_2, "today").encode(V3_2) + popup.encode(V3_2)
    assert decoder.feed(stream)[1] == popup
    assert decoder.version == V3_2


def test_titles_are_cut_at_255_bytes():
    message = KeyMessage(title="x" * 300, text="y" * 300)
    assert PrimaryDecoder().feed(message.encode(V3_15)) == [KeyMessage(title="x" * 255, text="y" * 300)]


@each_row("text", ["", "grüß", "\udc80 not UTF-8", "two\nlines"])
def test_texts_round_trip(text):
    message = TextMessage(text=text)
    assert PrimaryDecoder().feed(message.encode(V3_15)) == [message]


def test_lone_surrogates_become_question_marks():
    assert PrimaryDecoder().feed(TextMessage(text="a\ud800b").encode(V3_15)) == [TextMessage(text="a?b")]


def test_error_label():
    assert ErrorCodeMessage(code=153, argument=2).label == "C153A2"


def test_values_out_of_range_are_refused():
    with pytest.raises(LocalProtocolError):
        ErrorCodeMessage(code=2**31).encode(V5_22)


def test_appended_bytes_of_newer_software_are_ignored():
    message = SafetyModeMessage(safety_mode=SafetyMode.NORMAL)
    assert decode_robot_message(message.encode(V5_22)[5:] + b"new", V5_22) == message


@each_row(("message", "wire"), WRITTEN_OUT)
def test_short_messages_are_kept_with_the_reason(message, wire):
    kind = bytes.fromhex(wire)[14]
    short = bytes.fromhex(f"00000010 14 {HEADER} fe") + bytes([kind, 1])
    (decoded,) = PrimaryDecoder().feed(short)
    if isinstance(message, TextMessage):
        assert decoded.text == "\1"
    else:
        assert isinstance(decoded, OtherMessage)
        assert "too early" in decoded.error


@given(st.binary(max_size=100), st.integers(0, 20), st.sampled_from([V3_2, V3_15, V5_22]))
def test_any_payload_decodes_or_is_a_protocol_error(body, kind, version):
    try:
        message = decode_robot_message(bytes(9) + bytes([kind]) + body, version)
    except RemoteProtocolError:
        return
    assert decode_robot_message(message.encode(version)[5:], version) == message
