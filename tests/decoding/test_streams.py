"""Bytes of one direction: recorded ones, garbage, any split, any bytes."""

import struct
import tracemalloc

import pytest
from decoding_rig import decoded_lines, golden, session
from hypothesis import given
from hypothesis import strategies as st

from client.decoding.codecs import CODECS, Side
from client.decoding.session import Choice, DecodingSession, InputForm
from tests.budget import subset
from tests.rows import each_row
from urproto import modbus
from urproto.external_control import (
    ControlMode,
    ReverseMessage,
    ScriptCommand,
    ScriptCommandKind,
    TrajectoryAction,
    TrajectoryPoint,
)
from urproto.rtde import codec
from urproto.versions import PolyscopeVersion

PRIMARY = "# guessed to be primary (sender: robot?); override with --as and --from"
EVENTS = {
    "compile_error_5.4": [
        "RuntimeException: timestamp_us=none source=RT_MACHINE line=2 column=2 "
        'text="compile_error_name_not_found:txtmsg:"'
    ],
    "syntax_error_5.4": [
        'RuntimeException: timestamp_us=none source=RT_MACHINE line=2 column=1 text="syntax_error_on_line:2:end:"'
    ],
    "key_stopped_5.4": [
        'Key: timestamp_us=16634482000 source=RT_MACHINE code=0 argument=0 title="PROGRAM_XXX_STOPPED" text="silly"',
        "GlobalVariableValues: timestamp_us=none start_index=0",
        "modbus info (type 5): 00000000",
    ],
    "safety_mode_5.24": [
        "SafetyMode: timestamp_us=0 source=RT_MACHINE code=0 argument=0 safety_mode=PROTECTIVE_STOP "
        "data_type=NONE data=1"
    ],
    "connect_5.4": [
        'Version: timestamp_us=none source=ROBOT_INTERFACE project="URControl" major=5 minor=4 bugfix=0 build=0 '
        'build_date="21-06-2019, 10:03:02"',
        "message of unknown kind: timestamp_us=none source=ROBOT_INTERFACE message_kind=12 body=000000000000000001",
    ],
}
STATES = {  # contents according to their origin
    "robot_state_steady_5.x": ["q_actual=0.123212505", "pose_base_tcp=[0.317327001", "robot_mode=RUNNING"],
    "robot_state_full_5.24": ["target_speed_fraction=0.97", "kinematics=(checksum=[4294967295", "robot_type=UR5"],
    "robot_state_steady_cb3": ["mode=(timestamp_us=9640736000", "safety_mode=NORMAL"],
}
RTDE_REPLIES = (
    codec.ProtocolReply(True).encode(1)
    + codec.VersionReply(PolyscopeVersion(5, 22, 0, 1)).encode(2)
    + codec.SetupOutputsReply(("DOUBLE", "INT32"), 3).encode(2)
    + codec.StartReply(True).encode(2)
)
RTDE_DATA = codec.OutputData(struct.pack(">di", 41.5, 7), 3).encode(2)


@each_row("name", EVENTS)
@each_row("chunk", [0, 1, 7])
def test_recorded_messages(name, chunk):
    assert decoded_lines(golden(name), chunk) == [PRIMARY, *EVENTS[name]]


@each_row("name", STATES)
def test_recorded_states_are_one_line(name):
    lines = decoded_lines(golden(name))
    assert lines[0] == PRIMARY
    assert len(lines) == 2
    assert lines[1].startswith("state: ")
    assert all(part in lines[1] for part in STATES[name])


@pytest.mark.parametrize("chunk", [0, 1])
def test_hexadecimal_text_with_comments(chunk):
    text = b"# where it is from\n" + golden("safety_mode_5.24").hex(" ", 2).encode() + b"  # the end\n"
    assert session(text, chunk, form=InputForm.HEX) == ([PRIMARY, *EVENTS["safety_mode_5.24"]], 0)


def test_the_input_format_is_detected():
    raw = golden("safety_mode_5.24")
    assert session(raw) == session(raw.hex().encode()) == ([PRIMARY, *EVENTS["safety_mode_5.24"]], 0)


def test_invalid_hexadecimal_text_is_reported_with_its_line():
    lines, problems = session(b"00 01\nnothing\n", form=InputForm.HEX, codec=CODECS["modbus"])
    assert lines[0] == "! line 2 is not hexadecimal text: the rest is left out"
    assert problems == 2  # the two bytes before are not a complete message


def test_rtde_values_are_named_only_if_the_request_was_seen():
    lines = decoded_lines(RTDE_REPLIES + RTDE_DATA)
    assert lines[0] == "# guessed to be rtde (sender: robot?); override with --as and --from"
    assert lines[1:] == [
        "reply request_protocol_version: accepted=true",
        "reply get_urcontrol_version: 5.22.0.1",
        'reply setup_outputs: types=["DOUBLE", "INT32"] recipe_id=3',
        "reply start: accepted=true",
        "data 3: DOUBLE=41.5 INT32=7",
    ]


def test_rtde_inputs_without_a_reply_take_the_names_of_their_request():
    names = ("speed_slider_mask", "speed_slider_fraction")
    data = codec.InputData(1, struct.pack(">Id", 1, 0.5))
    lines = decoded_lines(codec.RequestProtocol(2).encode(1) + codec.SetupInputs(names).encode(2) + data.encode(2))
    assert lines[-1] == ("input 1: speed_slider_mask=1 speed_slider_fraction=0.5 (recipe guessed, no reply was seen)")


def test_rtde_data_without_a_setup_stays_raw():
    assert decoded_lines(RTDE_DATA)[1:] == ["data: 13 bytes 034044c0000000000000000007 (the set-up was not seen)"]


@each_row("chunk", [0, 1, 5])
def test_garbage_is_reported_with_its_position_and_skipped(chunk):
    lines, problems = session(
        RTDE_REPLIES + b"\xff\xee\xdd\xcc" + RTDE_DATA + RTDE_DATA, chunk, codec=CODECS["rtde"], form=InputForm.RAW
    )
    assert lines[4:] == [
        f"! offset {len(RTDE_REPLIES)}: 4 bytes are not valid RTDE data: no package has type 221",
        *["data 3: DOUBLE=41.5 INT32=7"] * 2,
    ]
    assert problems == 1


def test_a_stream_that_begins_mid_message():
    message = golden("safety_mode_5.24")
    lines = decoded_lines(golden("robot_state_steady_5.x")[300:] + message + message)
    assert lines[0] == PRIMARY
    assert lines[1].startswith("! offset 0: 416 bytes are not valid primary interface data: ")
    assert lines[2:] == EVENTS["safety_mode_5.24"] * 2


def test_a_stream_that_ends_mid_message():
    lines = decoded_lines(golden("safety_mode_5.24")[:20])
    assert lines[1:] == ["! offset 0: 20 bytes are not valid primary interface data: the stream ends 20 bytes into a "
                         "message of 32"]  # fmt: skip


def test_bytes_of_an_unknown_protocol():
    lines, problems = session(b"\xff" * 64)
    assert lines[0].startswith("# guessed to be bytes ")
    assert lines[1] == f"! offset 0: 64 bytes of no known protocol: {'ff' * 64}"
    assert problems == 1


@each_row(
    ("line", "name", "sender"),
    [
        (b"Connected: Universal Robots Dashboard Server\n", "dashboard", "robot"),
        (b"ack: 3: movej([0,0,0,0,0,0])\n", "interpreter", "robot"),
        (b"skipbuffer\n", "interpreter", "client"),
        (b"request_program\n", "script-sender", "robot"),
        (b"def p():\n", "text", "robot?"),
    ],
)
def test_text_protocols_are_distinguished(line, name, sender):
    assert decoded_lines(line)[0] == f"# guessed to be {name} (sender: {sender}); override with --as and --from"


def test_terminal_control_characters_are_escaped():
    assert decoded_lines(b"popup \x1b[2J\x07\xff\r\n", codec=CODECS["dashboard"]) == [r"popup \x1b[2J\x07\xff"]


def test_interpreter_mode():
    answers = b"ack: 1: stopj(2)\ndiscard: Syntax error: stopj(\nwhat\n"
    assert decoded_lines(answers, codec=CODECS["interpreter"]) == [
        "ack: 1: stopj(2)", "discarded, Syntax error: stopj(", '! not an answer of interpreter mode: "what"',
    ]  # fmt: skip
    assert decoded_lines(b"stopj(2)\nabort\n", codec=CODECS["interpreter"], side=Side.CLIENT) == [
        "statements: stopj(2)", "command abort",
    ]  # fmt: skip


def test_gripper_answers_without_line_ends():
    assert decoded_lines(b"ack", codec=CODECS["gripper"]) == ["ack"]


def test_external_control():
    reverse = ReverseMessage.setpoint(ControlMode.SERVOJ, [0.1, 0, 0, 0, 0, -1], 20).encode()
    reverse += ReverseMessage.trajectory(TrajectoryAction.START, 2).encode() + ReverseMessage.stop().encode()
    assert decoded_lines(reverse)[1:] == [
        "SERVOJ [0.1, 0, 0, 0, 0, -1] read_timeout_ms=20",
        "FORWARD START points=2 read_timeout_ms=200",
        "STOPPED read_timeout_ms=100",
    ]
    point = TrajectoryPoint.spline([1, 2, 3, 4, 5, 6], [0] * 6, 0.5).encode()
    assert decoded_lines(point)[1:] == [
        "CUBIC SPLINE target=[1, 2, 3, 4, 5, 6] second=[0, 0, 0, 0, 0, 0] third=[0, 0, 0, 0, 0, 0] duration_s=0.5"
    ]
    commands = ScriptCommand.set_payload(1.5, [0, 0, 0.1]).encode()
    commands += ScriptCommand(ScriptCommandKind.END_FORCE_MODE).encode()
    assert decoded_lines(commands, ports=(50004,)) == ["SET_PAYLOAD [1.5, 0, 0, 0.1]", "END_FORCE_MODE"]
    assert decoded_lines(b"\0\0\0\1", ports=(50003,), side=Side.ROBOT) == ["result: CANCELED"]


def test_modbus_with_only_one_direction():
    request = modbus.ModbusRequest(modbus.Function.READ_HOLDING_REGISTERS, 128, 2)
    request_frame = modbus.encode_frame(modbus.Frame(7, 255, modbus.encode_request(request)))
    answer = modbus.encode_frame(modbus.Frame(7, 255, modbus.encode_response(request, (3, 4))))
    refusal = modbus.encode_frame(modbus.Frame(8, 255, modbus.exception_response(3, 2)))
    assert decoded_lines(request_frame)[1:] == ["request 7 unit 255 read_holding_registers: 128..129"]
    assert decoded_lines(answer + refusal)[1:] == [
        "answer 7 unit 255 read_holding_registers: [3, 4] (the request was not seen)",
        "answer 8 unit 255 read_holding_registers: refused, exception ILLEGAL_DATA_ADDRESS",
    ]


CHOICES = st.sampled_from(sorted(CODECS)).map(CODECS.get) | st.none()
SIDES = st.sampled_from([*Side, None])
PIECES = st.lists(
    st.binary(max_size=60)
    | st.sampled_from([RTDE_REPLIES, RTDE_DATA, golden("connect_5.4"), golden("key_stopped_5.4"), b"power on\n"]),
    max_size=6,
).map(b"".join)


@given(PIECES, CHOICES, SIDES, st.integers(1, 50))
def test_any_bytes_in_any_split(data, codec_, side, chunk):
    whole = decoded_lines(data, codec=codec_, side=side)
    pieces = decoded_lines(data, chunk, codec=codec_, side=side)
    assert all(line.replace("\t", " ").isprintable() for line in (*whole, *pieces) if line)
    if codec_ is None or codec_.name in ("bytes", "gripper"):  # these report data that arrives together
        return
    if not any(line.startswith("!") for line in whole):  # the end of garbage depends on the data received by then
        assert pieces == whole


@given(st.binary(max_size=300))
def test_any_input_in_any_format(data):
    for form in InputForm:
        session(data, form=form)


@pytest.mark.parametrize(
    "name", subset(["primary", "rtde", "realtime", "modbus", "dashboard", "interpreter"], now=["primary", "dashboard"])
)
def test_an_endless_stream_of_garbage_uses_bounded_memory(name):
    one = DecodingSession(Choice(CODECS[name], form=InputForm.RAW))
    peaks = []
    for pieces in (15, 45):
        tracemalloc.start()
        for _ in range(pieces):
            for _line in one.feed(b"\x01\xff\xfe" * 400):
                pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0] + 20_000
