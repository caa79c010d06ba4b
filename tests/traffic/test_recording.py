"""Recordings are read back by us and by independent readers; damaged and foreign files."""

import os
import shutil
import socket
import subprocess
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import dpkt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from traffic_rig import BEGIN_NS, CLIENT, ROBOT, VirtualTime, ends
from typer.testing import CliRunner

from client.cli import app
from client.decoding.packets import SocketAddress
from client.errors import FileError
from client.traffic.recording import TrafficRecorder, TrafficRecording
from tests.rows import each_row

PIECES = st.lists(st.tuples(st.integers(0, 2), st.booleans(), st.binary(min_size=1, max_size=300)), max_size=30)
PORTS = (30004, 29999, 50001)


def write(path: Path, pieces: list[tuple[int, bool, bytes]], *, end: bool = True) -> None:
    """Three concurrent connections, 1 ms between messages."""
    clock = VirtualTime()
    recorder = TrafficRecorder(path, ["robot: UR3"], now_ns=clock)
    recorded = [recorder.connection(*ends(port)) for port in PORTS]
    for number, from_client, data in pieces:
        clock.ns += 1_000_000
        recorded[number].data(from_client, data)
    if end:
        for one in recorded:
            one.end(True)
            one.end(False)
    recorder.close()


@given(PIECES, st.booleans())
def test_every_byte_is_read_back_in_order_with_its_time(pieces, end):
    with TemporaryDirectory() as folder:
        write(Path(folder, "file"), pieces, end=end)
        recording = TrafficRecording.read(Path(folder, "file"))
    assert recording.comments == ["robot: UR3"]
    assert recording.problems == []
    for number, port in enumerate(PORTS):
        expected = [
            (BEGIN_NS + (index + 1) * 1_000_000, not from_client, data)
            for index, (one, from_client, data) in enumerate(pieces)
            if one == number
        ]
        (conversation,) = recording.on_port(port)
        found = [(piece.time_ns, piece.from_server, piece.data) for piece in conversation.pieces if piece.data]
        assert found == expected


def tcp_segments(path: Path) -> list[tuple[float, dpkt.ip.IP]]:
    """TCP segments of the file, read by dpkt."""
    with path.open("rb") as file:
        return [(time, dpkt.ethernet.Ethernet(frame).data) for time, frame in dpkt.pcapng.Reader(file)]


def test_another_reader_finds_the_same_streams_and_valid_checksums(tmp_path):
    write(
        tmp_path / "file", [(0, True, b"hello"), (0, False, b"x" * 100_000), (1, True, b"power on\n"), (0, True, b"!")]
    )
    sent: dict[tuple[str, int], bytes] = {}
    for time, ip in tcp_segments(tmp_path / "file"):
        assert time == pytest.approx(BEGIN_NS / 1e9, abs=1)
        tcp, summed = ip.data, ip.sum
        ip.sum = 0
        assert dpkt.in_cksum(ip.pack_hdr()) == summed
        pseudo = dpkt.struct.pack(">4s4sxBH", ip.src, ip.dst, ip.p, len(tcp))
        assert dpkt.in_cksum(pseudo + bytes(tcp)) == 0
        key = (socket.inet_ntoa(ip.src), tcp.sport, tcp.dport)
        sent[key] = sent.get(key, b"") + tcp.data
    assert sent[CLIENT, 45678, 30004] == b"hello!"
    assert sent[ROBOT, 30004, 45678] == b"x" * 100_000
    assert sent[CLIENT, 45678, 29999] == b"power on\n"


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_wireshark_reports_no_errors(tmp_path):
    write(tmp_path / "file", [(0, True, b"hello"), (0, False, b"x" * 100_000), (1, True, b"power on\n")])
    checks = ("-o", "tcp.check_checksum:TRUE", "-o", "ip.check_checksum:TRUE", "-Y", "_ws.expert.severity >= 0x600000")
    found = subprocess.run(["tshark", "-r", tmp_path / "file", *checks], capture_output=True, text=True, timeout=100)
    assert (found.returncode, found.stdout) == (0, "")


@each_row("client", ["fd00::2", "10.0.0.2", "fe80::1%eth0"])
def test_ipv4_and_ipv6_addresses(tmp_path, client):
    recorder = TrafficRecorder(tmp_path / "file")
    recorder.connection(SocketAddress(client, 5000), SocketAddress("fd00::1", 29999)).data(True, b"power on\n")
    recorder.close()
    assert TrafficRecording.read(tmp_path / "file").conversations[0].sent(from_server=False) == b"power on\n"


def test_a_reused_client_port_is_a_new_connection(tmp_path):
    recorder = TrafficRecorder(tmp_path / "file")
    for text, broken_off in ((b"first\n", False), (b"second\n", True), (b"third\n", False)):
        one = recorder.connection(*ends(29999))
        one.data(True, text)
        if broken_off:
            one.reset(False)
        else:
            one.end(True)
            one.end(False)
    recorder.close()
    sent = [one.sent(from_server=False) for one in TrafficRecording.read(tmp_path / "file").conversations]
    assert sent == [b"first\n", b"second\n", b"third\n"]


def test_flushed_data_survives_without_close(tmp_path):
    recorder = TrafficRecorder(tmp_path / "file")
    recorder.connection(*ends(29999)).data(True, b"power on\n")
    recorder.flush()
    recording = TrafficRecording.read(recorder.place)
    assert recording.conversations[0].sent(from_server=False) == b"power on\n"
    assert recording.problems == []
    recorder.close()


def test_a_full_disk_is_reported_once_and_leaves_complete_packets(tmp_path, monkeypatch):
    reported: list[str] = []
    recorder = TrafficRecorder(tmp_path / "file", problem=reported.append)
    one = recorder.connection(*ends(29999))
    one.data(True, b"power on\n")
    recorder.flush()
    monkeypatch.setattr(os, "write", half_then_full(os.write))
    one.data(True, b"brake release\n")
    recorder.flush()
    one.data(True, b"play\n")
    recorder.close()
    assert len(reported) == 1
    assert reported[0].startswith(f"{tmp_path / 'file.unfinished'} can no longer be written")
    assert reported[0].endswith("No space left on device")
    recording = TrafficRecording.read(tmp_path / "file.unfinished")
    assert recording.conversations[0].sent(from_server=False) == b"power on\n"
    assert recording.problems == []


def half_then_full(write):
    def send_half(file: int, data: bytes) -> int:
        if len(data) < 40:
            raise OSError(28, os.strerror(28))
        return write(file, bytes(data[: len(data) // 2]))

    return send_half


@given(st.binary(max_size=300), st.integers(0, 600))
def test_any_damage_is_reported_or_skipped(damage, place):
    with TemporaryDirectory() as folder:
        path = Path(folder, "file")
        write(path, [(0, True, b"hello"), (1, False, b"welcome\n")])
        data = path.read_bytes()
        path.write_bytes(data[:place] + damage + data[place + len(damage) :])
        with suppress(FileError):
            TrafficRecording.read(path)


@pytest.mark.parametrize("command", ["replay-traffic", "compare"])
def test_garbage_is_a_one_line_error(tmp_path, command):
    path = tmp_path / "garbage"
    path.write_bytes(b"\x00\xff garbage \n" * 20)
    arguments = [command, str(path), *([str(path)] if command == "compare" else [])]
    error = CliRunner().invoke(app, arguments).exception
    assert isinstance(error, FileError)
    assert str(error) == f"{path}: is not a pcap or pcapng file: record one with ur-client proxy --record"


def test_an_empty_recording(tmp_path):
    TrafficRecorder(tmp_path / "file").close()
    with pytest.raises(FileError, match="contains no connection to a port of a robot"):
        TrafficRecording.read(tmp_path / "file")
    with pytest.raises(FileError, match="cannot be read: No such file"):
        TrafficRecording.read(tmp_path / "missing")
    with pytest.raises(FileError, match="cannot be written: No such file"):
        TrafficRecorder(tmp_path / "missing" / "file")
