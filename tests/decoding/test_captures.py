"""Capture files: formats, link layers, segments in any order, missing data."""

import random
import struct

from decoding_rig import ACK, BEGIN_S, PSH, Conversation, Sent, ethernet, golden, ip_packet, pcap, pcapng, session
from hypothesis import given
from hypothesis import strategies as st

from client.decoding.codecs import CODECS
from client.decoding.session import InputForm
from tests.rows import each_row
from urproto import modbus
from urproto.external_control import GREETING, ReverseMessage, TrajectoryResult
from urproto.rtde import codec
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import PolyscopeVersion

NAMES = ("timestamp", "actual_q", "robot_mode")
RECIPE = Recipe.of(NAMES, OUTPUT_FIELDS)
BEGINS = "# the capture begins 2023-11-14 22:13:20.000000 UTC"


def rtde_conversation() -> Conversation:
    one = Conversation().open()
    one.send(False, codec.RequestProtocol(2).encode(1)).send(True, codec.ProtocolReply(True).encode(1))
    one.send(False, codec.GetVersion().encode(2)).send(True, codec.VersionReply(PolyscopeVersion(5, 22)).encode(2))
    one.send(False, codec.SetupOutputs(NAMES, 125.0).encode(2), pieces=3)
    one.send(True, codec.SetupOutputsReply(RECIPE.types, 1).encode(2), pieces=2)
    one.send(False, codec.Start().encode(2)).send(True, codec.StartReply(True).encode(2))
    for step in range(3):
        data = codec.OutputData(RECIPE.pack((41.0 + step, (0.5,) * 6, 7)), 1).encode(2)
        one.send(True, data, pieces=2)
    return one.close()


RTDE_DECODED = [
    "request request_protocol_version: version=2",
    "reply request_protocol_version: accepted=true",
    "request get_urcontrol_version",
    "reply get_urcontrol_version: 5.22.0",
    'request setup_outputs: names=["timestamp", "actual_q", "robot_mode"] frequency_hz=125',
    'reply setup_outputs: types=["DOUBLE", "VECTOR6D", "INT32"] recipe_id=1',
    "request start",
    "reply start: accepted=true",
    *[f"data 1: timestamp={time} actual_q=[0.5, 0.5, 0.5, 0.5, 0.5, 0.5] robot_mode=RUNNING" for time in (41, 42, 43)],
]


def messages(lines: list[str]) -> list[str]:
    """The lines without times, ends and notes."""
    return [line.partition(": ")[2] for line in lines if " > " in line]


@each_row("order", ["<", ">"])
@each_row("write", [pcap, pcapng])
@each_row("chunk", [0, 1, 100])
def test_a_conversation(write, order, chunk):
    packets = [ethernet(ip_packet(sent, 30004)) for sent in rtde_conversation().segments]
    lines, problems = session(write(packets, order=order), chunk)
    assert lines[:2] == [
        BEGINS, "22:13:20.002000 10.0.0.2:45678 > 10.0.0.1:30004 rtde: request request_protocol_version: version=2",
    ]  # fmt: skip
    assert lines[2] == (
        "22:13:20.003000 10.0.0.1:30004 > 10.0.0.2:45678 rtde: reply request_protocol_version: accepted=true"
    )
    assert messages(lines) == RTDE_DECODED
    assert problems == 0


LINKS = {
    "VLAN": (1, lambda ip: bytes(12) + b"\x81\x00\x00\x05\x08\x00" + ip),
    "BSD loopback": (0, lambda ip: struct.pack("<I", 2) + ip),
    "OpenBSD loopback": (108, lambda ip: struct.pack(">I", 2) + ip),
    "Linux cooked": (113, lambda ip: bytes(14) + b"\x08\x00" + ip),
    "Linux cooked 2": (276, lambda ip: b"\x08\x00" + bytes(18) + ip),
    "raw IP": (101, lambda ip: ip),
    "raw IP of OpenBSD": (14, lambda ip: ip),
    "IPv4": (228, lambda ip: ip),
}


@each_row("name", LINKS)
def test_link_layers(name):
    link, wrap = LINKS[name]
    packets = [wrap(ip_packet(sent, 30004)) for sent in rtde_conversation().segments]
    assert messages(session(pcap(packets, link))[0]) == RTDE_DECODED


def test_ipv6():
    ends = {"robot": "fd00::1", "client": "fd00::2"}
    packets = [ethernet(ip_packet(sent, 30004, **ends)) for sent in rtde_conversation().segments]
    lines, _ = session(pcap(packets, nanoseconds=True))
    assert lines[1].startswith("22:13:20.002000 [fd00::2]:45678 > [fd00::1]:30004 rtde: ")
    assert messages(lines) == RTDE_DECODED


@given(st.randoms(use_true_random=False), st.booleans())
def test_segments_in_any_order_and_repeated(shuffler: random.Random, repeated: bool):
    segments = rtde_conversation().segments * (2 if repeated else 1)
    shuffler.shuffle(segments)
    lines, problems = session(pcap([ip_packet(sent, 30004) for sent in segments], 101))
    decoded = messages(lines)
    assert sorted(decoded) == sorted(RTDE_DECODED)
    assert [line for line in decoded if "request" in line] == [line for line in RTDE_DECODED if "request" in line]
    assert [line for line in decoded if "reply" in line] == [line for line in RTDE_DECODED if "reply" in line]
    assert decoded[-3:] == RTDE_DECODED[-3:]
    assert problems == 0


def test_missing_bytes_are_reported_and_the_stream_continues():
    segments = rtde_conversation().segments
    gone = next(index for index, sent in enumerate(segments) if sent.data[2:3] == b"U")
    lost = segments.pop(gone)
    lines, problems = session(pcap([ip_packet(sent, 30004) for sent in segments], 101))
    decoded = messages(lines)
    assert f"{len(lost.data)} bytes are not in the capture" in decoded
    assert decoded[-2:] == RTDE_DECODED[-2:]
    assert sum(line.startswith("! ") for line in lines) == problems > 0


def test_a_capture_that_begins_mid_connection():
    segments = [sent for sent in rtde_conversation().segments if sent.from_robot][1:]
    decoded = messages(session(pcap([ip_packet(sent, 30004) for sent in segments], 101))[0])
    assert decoded[-1] == "data 1: DOUBLE=43 VECTOR6D=[0.5, 0.5, 0.5, 0.5, 0.5, 0.5] INT32=7"


def test_reused_ports_are_a_new_connection():
    first = Conversation().open().send(False, b"power on\n").close().segments
    second = Conversation(500, 90000).open().send(False, b"power off\n").close().segments
    lines, problems = session(pcap([ip_packet(sent, 29999) for sent in first + second], 101))
    assert messages(lines) == ["power on", "power off"]
    assert problems == 0


def test_several_connections_with_different_protocols():
    packets = []
    read = modbus.ModbusRequest(modbus.Function.READ_COILS, 3, 2)
    conversations = {
        30001: Conversation().open().send(True, golden("safety_mode_5.24")),
        30020: Conversation().open().send(False, b"stopj(2)\n").send(True, b"ack: 1: stopj(2)\n"),
        502: Conversation().open().send(False, modbus.encode_frame(modbus.Frame(1, 0, modbus.encode_request(read))))
        .send(True, modbus.encode_frame(modbus.Frame(1, 0, modbus.encode_response(read, (1, 0))))),
        50001: Conversation().open().send(True, ReverseMessage.keep_alive(1000).encode()),
        50003: Conversation()
        .open()
        .send(False, GREETING + b"0123abcd\n" + TrajectoryResult.SUCCESS.to_bytes(4, "big")),
        63352: Conversation().open().send(False, b"SET GTO 1\n").send(True, b"ack"),
        443: Conversation().open().send(True, b"\x16\x03"),
    }  # fmt: skip
    for number, (port, conversation) in enumerate(conversations.items()):
        packets += [ip_packet(sent, port, 40000 + number) for sent in conversation.segments]
    lines, problems = session(pcap(packets, 101))
    assert messages(lines) == [
        "SafetyMode: timestamp_us=0 source=RT_MACHINE code=0 argument=0 safety_mode=PROTECTIVE_STOP "
        "data_type=NONE data=1",
        "statements: stopj(2)",
        "ack: 1: stopj(2)",
        "request 1 unit 0 read_coils: 3..4",
        "answer 1 unit 0 read_coils: 3..4 = [1, 0]",
        "IDLE read_timeout_ms=1000",
        'greeting: "0123abcd"',
        "result: SUCCESS",
        "SET GTO 1",
        "ack",
    ]
    assert lines[-1] == "# 3 TCP packets of other ports were left out (443); see --port"
    assert problems == 0


def test_other_ports_by_number_offset_and_content():
    packets = [ip_packet(sent, 40104) for sent in rtde_conversation().segments]
    assert messages(session(pcap(packets, 101), port_offset=10100)[0]) == RTDE_DECODED
    assert messages(session(pcap(packets, 101), ports=(40104,), codec=CODECS["rtde"])[0]) == RTDE_DECODED
    guessed = session(pcap(packets, 101), ports=(40104,))[0]
    assert [line for line in messages(guessed) if not line.startswith("#")] == RTDE_DECODED


def test_truncated_and_damaged_files():
    whole = pcap([ip_packet(sent, 29999) for sent in Conversation().open().send(True, b"a\n").segments], 101)
    assert session(whole[:-3])[0][-1] == "! the capture file ends 55 bytes into a packet"
    broken = whole + struct.pack("<IIII", BEGIN_S, 0, 1 << 30, 1 << 30) + bytes(100)
    lines, problems = session(broken)
    assert lines[-1] == (f"! the capture file cannot be read beyond offset {len(whole)}: a packet of 1073741824 bytes")
    assert messages(lines)[0] == "a"
    assert problems == 1
    assert session(b"no capture", form=InputForm.PCAP) == (["! this is not a pcap or pcapng file"], 1)
    assert session(pcap([b"x"], 105))[0][-1] == ("! 1 packets were left out: packets of link type 105 cannot be read")


SEGMENTS = st.builds(
    Sent, st.booleans(), st.integers(0, 31), st.integers(0, 2**32 - 1) | st.integers(0, 300),
    st.integers(0, 2**32 - 1) | st.integers(0, 300), st.binary(max_size=40),
)  # fmt: skip


@given(st.lists(st.tuples(SEGMENTS, st.sampled_from([30004, 30001, 29999, 502])), max_size=40))
def test_any_segments(segments):
    session(pcap([ip_packet(sent, port) for sent, port in segments], 101))


@given(st.lists(st.binary(max_size=80), max_size=5), st.sampled_from([0, 1, 12, 113, 276, 999]), st.booleans())
def test_any_packets(packets, link, new):
    session((pcapng if new else pcap)(packets, link))


@given(st.sampled_from(["<", ">"]), st.binary(max_size=200), st.integers(0, 150), st.booleans())
def test_any_damage_to_a_file(order, damage, place, new):
    file = (pcapng if new else pcap)([ip_packet(Sent(True, ACK | PSH, 5, 5, b"hello\n"), 29999)], 101, order)
    session(file[:place] + damage + file[place + len(damage) :], form=InputForm.PCAP)
