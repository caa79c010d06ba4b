"""The wire formats of External Control.

The expected words are written manually after the write functions and the control program of
Universal_Robots_Client_Library 2.14; the script commands from 100 and their answers, which are our extension, after
client/driver/control_program.script.
"""

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.external_control import (
    Answer,
    ControlMode,
    FreedriveAction,
    MotionType,
    Query,
    ReplyDecoder,
    ReverseMessage,
    ScriptCommand,
    ScriptCommandKind,
    SplineType,
    TrajectoryAction,
    TrajectoryPoint,
    TrajectoryResult,
    to_words,
)

Q = (0.1, -1.57, 1.2, 0.0, 3.141593, -0.5)


def test_words_are_rounded_to_the_nearest_millionth_on_both_sides_of_zero() -> None:
    assert to_words([0.0000006, -0.0000006, 0.0000004, -0.0000004]) == (1, -1, 0, 0)
    assert to_words([0.29, -0.29, 1.1, 2147.0]) == (290000, -290000, 1100000, 2147000000)


Q_WORDS = [100000, -1570000, 1200000, 0, 3141593, -500000]
# millionths, rounded down, and the remaining billionths of one: 2**-21 is 0.476837158203125 millionths
PRECISE = (0.5, -0.25, 2**-21, -(2**-21), 0.0, 3.0)
PRECISE_WORDS = [500000, 0, -250000, 0, 0, 476837158, -1, 523162841, 0, 0, 3000000, 0]


def _words(data):
    return list(struct.unpack(f">{len(data) // 4}i", data))


REVERSE = [
    (ReverseMessage.setpoint(ControlMode.SERVOJ, Q, 20), [20, *Q_WORDS, 1]),
    (ReverseMessage.setpoint(ControlMode.TORQUE, Q, 8), [8, *Q_WORDS, 8]),
    (ReverseMessage.keep_alive(1000), [1000, 0, 0, 0, 0, 0, 0, 0]),
    (ReverseMessage.stop(), [100, 0, 0, 0, 0, 0, 0, -2]),
    (ReverseMessage.trajectory(TrajectoryAction.START, 5), [200, 1, 5, 0, 0, 0, 0, 3]),
    (ReverseMessage.trajectory(TrajectoryAction.CANCEL, 7, 0), [0, -1, 7, 0, 0, 0, 0, 3]),
    (ReverseMessage.freedrive(FreedriveAction.STOP), [200, -1, 0, 0, 0, 0, 0, 6]),
]

POINTS = [
    (
        TrajectoryPoint(MotionType.MOVEJ, Q, parameters=(1.05, 1.4, 0, 0, 0, 0), duration_s=2.5, blend_radius_m=0.01),
        [*Q_WORDS, *[0] * 6, 1050000, 1400000, 0, 0, 0, 0, 2500000, 10000, 0],
    ),
    (
        TrajectoryPoint(MotionType.MOVEJ_POSE, Q, Q, (1.0, 1.0, 1.0, 0, 0, 0)),
        [*Q_WORDS, *Q_WORDS, 1000000, 1000000, 1000000, 0, 0, 0, 0, 0, 6],
    ),
    (
        TrajectoryPoint(MotionType.MOVEC, Q, Q, (0.25, 1.2, 1.0, 0, 0, 0), blend_radius_m=0.02),
        [*Q_WORDS, *Q_WORDS, 250000, 1200000, 1000000, 0, 0, 0, 0, 20000, 3],
    ),
    (TrajectoryPoint.spline(Q, Q, 0.5), [*Q_WORDS, *Q_WORDS, *[0] * 6, 500000, 1, 51]),
    (TrajectoryPoint.spline(Q, Q, 0.5, Q), [*Q_WORDS, *Q_WORDS, *Q_WORDS, 500000, 2, 51]),
]

COMMANDS = [
    (ScriptCommand(ScriptCommandKind.ZERO_FTSENSOR), [0]),
    (ScriptCommand.set_payload(1.5, (0, 0, 0.05)), [1, 1500000, 0, 0, 50000]),
    (ScriptCommand.set_tool_voltage(24), [2, 24000000]),
    (
        ScriptCommand.start_force_mode(Q, (0, 0, 1, 0, 0, 0), (0, 0, -10, 0, 0, 0), 2, (0.1,) * 6),
        [3, *Q_WORDS, 0, 0, 1000000, 0, 0, 0, 0, 0, -10000000, 0, 0, 0, 2000000, *[100000] * 6, 25000, 500000],
    ),
    (ScriptCommand(ScriptCommandKind.END_TOOL_CONTACT), [6]),
    (ScriptCommand.set_friction_compensation(True), [7, 1]),
    (
        ScriptCommand.ft_rtde_input_enable(True, 0.5, (0, 0, 0.1), (0, 0, 0.2)),
        [8, 1, 500000, 0, 0, 100000, 0, 0, 200000],
    ),
    (ScriptCommand.set_gravity((0, 0, 9.82)), [9, 0, 0, 9820000]),
    (ScriptCommand.set_tcp_offset(Q), [10, *Q_WORDS]),
    (ScriptCommand.set_friction_scales((0.5,) * 6, (2.0,) * 6), [11, *[500000] * 6, *[1000000] * 6]),
    (
        ScriptCommand.set_target_payload(1.0, (0, 0, 0.1), (0.1,) * 6, 0.25),
        [12, 1000000, 0, 0, 100000, *[100000] * 6, 250000],
    ),
    (ScriptCommand.argument(0, PRECISE), [100, 0, *PRECISE_WORDS]),
    (ScriptCommand.argument(2, PRECISE), [100, 2, *PRECISE_WORDS]),
    (ScriptCommand.query(Query.INVERSE_KIN, 7), [101, 1, 7, 0]),
    (ScriptCommand.query(Query.JOINT_POSITIONS_HISTORY, 0, 8), [101, 12, 0, 8]),
    (ScriptCommand.set_stream_parameters(0.03, 2000, 40, 4), [102, 30000, 2000000000, 40000000, 4000000]),
    (ScriptCommand.set_freedrive_axes((0, 0, 1, 0, 0, 1), Q), [103, 0, 0, 1, 0, 0, 1, *Q_WORDS]),
    (ScriptCommand.start_contact_detection((0, 0, -1, 0, 0, 0)), [104, 0, 0, -1000000, 0, 0, 0]),
    (ScriptCommand(ScriptCommandKind.STOP_CONTACT_DETECTION), [105]),
    (ScriptCommand.set_force_mode_parameters(0.025, 0.5), [106, 25000, 500000]),
]

ANSWERS = [
    (Answer(()), [-1]),
    (Answer((1.0,)), [-2, 1000000, 0]),
    (Answer(PRECISE), [-7, *PRECISE_WORDS]),
]


@each_row(("message", "words"), REVERSE)
def test_reverse_messages(message, words):
    assert _words(message.encode()) == words
    assert ReverseMessage.decode(message.encode()) == message


@each_row(("point", "words"), POINTS)
def test_trajectory_points(point, words):
    assert _words(point.encode()) == words
    assert TrajectoryPoint.decode(point.encode()) == point


@each_row(("command", "words"), COMMANDS)
def test_script_commands(command, words):
    assert _words(command.encode()) == words + [0] * (28 - len(words))
    decoded = ScriptCommand.decode(command.encode())
    assert decoded.kind is command.kind
    assert decoded.words[: len(command.words)] == command.words


@each_row(("message", "words"), ANSWERS)
def test_answers(message, words):
    assert _words(message.encode()) == words
    (received,) = ReplyDecoder().feed(message.encode())
    assert received.values == pytest.approx(message.values, abs=1e-15)


def test_an_answer_is_at_most_a_6_by_6_matrix():
    largest = Answer(tuple(float(number) for number in range(36))).encode()
    assert ReplyDecoder().feed(largest) == [Answer(tuple(float(number) for number in range(36)))]
    with pytest.raises(RemoteProtocolError, match="an answer of 37 values is too long"):
        ReplyDecoder().feed(struct.pack(">i", -1 - 37))


def test_the_payload_of_a_keep_alive_may_be_anything():
    data = struct.pack(">8i", 20, *[-1234567] * 6, 0)
    assert ReverseMessage.decode(data).mode is ControlMode.IDLE


def test_results_in_any_split():
    data = struct.pack(">3i", 0, 1, 2)
    decoder = ReplyDecoder()
    results = [result for byte in data for result in decoder.feed(bytes([byte]))]
    assert results == [TrajectoryResult.SUCCESS, TrajectoryResult.CANCELED, TrajectoryResult.FAILURE]


@given(st.lists(st.binary(max_size=100), max_size=5))
def test_any_bytes_are_messages_or_a_protocol_error(chunks):
    decoder = ReplyDecoder()
    with suppress(RemoteProtocolError):
        for chunk in chunks:
            decoder.feed(chunk)
    data = b"".join(chunks)
    for kind in (ReverseMessage, TrajectoryPoint, ScriptCommand):
        with suppress(RemoteProtocolError):
            kind.decode(data[: kind.SIZE].ljust(kind.SIZE, b"\0"))


@each_row(
    "make",
    [
        lambda: ReverseMessage.setpoint(ControlMode.SERVOJ, (1, 2, 3), 20),
        lambda: ReverseMessage.setpoint(ControlMode.SERVOJ, (float("nan"),) * 6, 20),
        lambda: TrajectoryPoint(MotionType.MOVEL, Q, duration_s=2148.0).encode(),
        lambda: TrajectoryPoint(MotionType.MOVEL, Q, spline_type=SplineType.CUBIC).encode(),
        lambda: ScriptCommand.set_gravity((0, 9.82)),
        lambda: ScriptCommand.set_tool_voltage(5),
    ],
)
def test_unsendable_values_are_an_error_of_the_caller(make):
    with pytest.raises(LocalProtocolError):
        make()
