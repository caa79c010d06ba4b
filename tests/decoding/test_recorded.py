"""Recorded output of a running emulator, decoded; and the two commands as a user calls them."""

import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO

import pytest
from decoding_rig import Conversation, ethernet, golden, ip_packet, pcap, session
from emulator_process import EmulatorProcess
from rich.console import Console
from typer.testing import CliRunner

from client.cli import app
from client.commands.robot import state_table
from client.decoding.session import InputForm
from client.rtde import unknown_fields
from urproto.rtde import codec

PATIENCE_S = 30.0
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="emulators need the loopback addresses of Linux")


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    process = EmulatorProcess(["--model", "ur5e", "--running"])
    process.start()
    yield process
    process.stop()
    process.dispose()


@contextmanager
def connected(emulator: EmulatorProcess, port: int) -> Iterator[socket.socket]:
    with socket.create_connection((emulator.host, port), PATIENCE_S) as connection:
        yield connection


def receive(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = connection.recv(65536)
        assert piece, f"closed after {len(data)} bytes"
        data += piece
    return data


@pytest.mark.parametrize(
    ("port", "name", "size", "line"),
    [
        (30001, "primary", 6000, "Version: "),
        (30002, "primary", 6000, "Version: "),
        (30003, "realtime", 6000, "state of 1220 bytes (since e-Series 5.10): timestamp="),
    ],
)
def test_broadcast_ports(emulator, port, name, size, line):
    with connected(emulator, port) as robot:
        data = receive(robot, size)
    lines, problems = session(data, 1000, form=InputForm.RAW)
    assert lines[0] == f"# guessed to be {name} (sender: robot?); override with --as and --from"
    assert lines[1].startswith(line)
    assert sum(text.startswith("state") for text in lines) > 1
    assert all("robot_mode=RUNNING" in text for text in lines if text.startswith("state"))
    assert [text for text in lines if text.startswith("!")][1:] == []  # the recording may end mid-message
    assert problems <= 1
    ports = (port,)
    assert session(data, form=InputForm.RAW, ports=ports)[0] == lines[1:]
    assert session(data[100:], form=InputForm.RAW, ports=ports)[0][-3:] == lines[-3:]  # resynchronised


def test_a_dashboard_conversation(emulator):
    conversation = Conversation().open()
    with connected(emulator, 29999) as robot:
        conversation.send(True, robot.recv(1000)).send(False, b"robotmode\n")
        robot.sendall(b"robotmode\n")
        conversation.send(True, robot.recv(1000))
    lines, problems = session(pcap([ethernet(ip_packet(sent, 29999)) for sent in conversation.segments]))
    assert [line.partition(" dashboard: ")[2] for line in lines[1:]] == [
        "Connected: Universal Robots Dashboard Server", "robotmode", "Robotmode: RUNNING",
    ]  # fmt: skip
    assert problems == 0


def test_an_rtde_conversation(emulator):
    outputs, inputs = ("timestamp", "safety_mode", "actual_q"), ("input_int_register_24",)
    requests = [
        codec.RequestProtocol(2).encode(1),
        codec.SetupOutputs(outputs, 100.0).encode(2),
        codec.SetupInputs(inputs).encode(2),
        codec.Start().encode(2),
    ]
    conversation = Conversation().open()
    with connected(emulator, 30004) as robot:
        for request in requests:
            robot.sendall(request)
            conversation.send(False, request).send(True, robot.recv(65536))
        write = codec.InputData(1, b"\0\0\0\x2a").encode(2)
        robot.sendall(write)
        conversation.send(False, write).send(True, receive(robot, 1000)[: 64 * 10])
    lines, problems = session(pcap([ethernet(ip_packet(sent, 30004)) for sent in conversation.segments]))
    texts = [line.partition(" rtde: ")[2] for line in lines[1:]]
    assert "input 1: input_int_register_24=42" in texts
    states = [text for text in texts if text.startswith("data 1: timestamp=")]
    assert len(states) >= 10
    assert all(" safety_mode=NORMAL actual_q=[" in text for text in states)
    assert problems == 0


# the commands


def test_decode_reads_files_and_standard_input(tmp_path):
    runner = CliRunner()
    file = tmp_path / "captured"
    file.write_bytes(golden("safety_mode_5.24"))
    from_file = runner.invoke(app, ["decode", str(file), "--as", "primary"])
    assert from_file.exit_code == 0
    assert from_file.stdout.startswith("SafetyMode: timestamp_us=0 ")
    piped = runner.invoke(app, ["decode", "-", "--port", "30001"], input=golden("safety_mode_5.24"))
    assert (piped.exit_code, piped.stdout) == (0, from_file.stdout)


def test_the_exit_status_of_decode_reports_unreadable_data():
    result = CliRunner().invoke(app, ["decode", "-", "--as", "rtde"], input=b"\xff" * 30)
    assert result.exit_code == 1
    assert result.stdout == "! offset 0: 30 bytes are not valid RTDE data: no package has type 255\n"


def test_decode_without_a_file():
    result = CliRunner().invoke(app, ["decode", "missing"])
    assert result.exit_code == 2
    assert "cannot read missing: No such file" in result.stderr


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from client.cli import main; main()", *arguments]


@contextmanager
def running(*arguments: str) -> Iterator["subprocess.Popen[bytes]"]:
    """The command with unbuffered pipes, so that select() shows whether a line is available."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(command(*arguments), stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def next_line(pipe) -> str:
    readable, _, _ = select.select([pipe], [], [], PATIENCE_S)
    assert readable, "nothing came"
    return pipe.readline().decode()


def test_decode_prints_while_reading_its_input():
    with running("decode", "-", "--as", "dashboard") as process:
        process.stdin.write(b"power on\nbrake")
        assert next_line(process.stdout) == "power on\n"
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=PATIENCE_S)
    assert out == b"brake\n"
    assert process.returncode == 0


def test_watch_prints_lines_and_reconnects(emulator, tmp_path):
    table = tmp_path / "states.csv"
    fields = ("timestamp", "robot_mode", "actual_q")
    with running("watch", *fields, "--robot-ip", emulator.host, "--rate", "50", "--csv", str(table)) as process:
        for _ in range(3):
            line = next_line(process.stdout)
            assert line.startswith("timestamp=")
            assert " robot_mode=RUNNING actual_q=[" in line
        emulator.stop()
        emulator.start()
        assert "closed the connection" in next_line(process.stderr)
        assert next_line(process.stderr) == "reconnected\n"
        assert next_line(process.stdout).startswith("timestamp=")
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    rows = table.read_text().splitlines()
    assert rows[0] == "timestamp,robot_mode," + ",".join(f"actual_q_{joint}" for joint in range(6))
    assert rows[1].split(",")[1] == "7"
    assert len(rows[1].split(",")) == 8


def test_watch_suggests_similar_names():
    result = CliRunner().invoke(app, ["watch", "actual_p"])
    assert result.exit_code == 2
    assert "actual_q" in result.stderr
    assert unknown_fields(["actual_q", "zzz"]) == (
        "no RTDE output is called 'zzz': docs/reference/supported.md lists them"
    )
    assert unknown_fields(["actual_q", "timestamp"]) is None


def test_watch_needs_a_robot():
    result = CliRunner().invoke(app, ["watch", "actual_q", "--robot-ip", "127.0.0.1", "--port-offset", "-29000"])
    assert result.exit_code == 1


def test_the_table_has_a_column_for_each_element_and_units():
    console = Console(width=100, record=True, file=StringIO())
    console.print(state_table({"actual_q": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), "robot_mode": 7}, "robot"))
    rows = [line.split() for line in console.export_text().splitlines()]
    assert ["│", "actual_q", "│", "0.1000", "│", "0.2000", "│", "0.3000", "│", "0.4000", "│", "0.5000", "│", "0.6000",
            "│", "rad", "│"] in rows  # fmt: skip
    assert any("RUNNING" in row for row in rows)
