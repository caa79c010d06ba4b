"""The command line, in a separate process if that matters."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from emulator.cli import app
from tests.rows import each_row
from urproto.compat import module_command
from urproto.controlapi import RemoteControl

DEADLINE_S = 30  # under load by other tests


def emulator_command(*arguments: str) -> list[str]:
    """Like the console script: without the current folder on the module path."""
    return [*module_command("emulator"), *arguments]


@contextmanager
def running(command: list[str], folder: Path) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def read_until(process: "subprocess.Popen[str]", text: str) -> str:
    """Standard output up to the line that contains the text."""
    assert process.stdout is not None
    seen = ""
    while text not in seen:
        readable, _, _ = select.select([process.stdout], [], [], DEADLINE_S)
        line = process.stdout.readline() if readable else ""
        assert line, f"{text!r} did not come: {seen}"
        seen += line
    return seen


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ready_then_stopped(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "client.py").write_text("raise ImportError('a decoy')")
    (tmp_path / "emulator").mkdir()
    (tmp_path / "emulator" / "__init__.py").write_text("raise ImportError('a decoy')")
    command = emulator_command("--model", "ur3", "--ephemeral-ports", "--ports-file", "ports.json", "--running")
    with running(command, tmp_path) as process:
        screen = read_until(process, "Ready: every port on 127.0.0.1 answers")
        ports = json.loads((tmp_path / "ports.json").read_text())
        assert len(ports) == 11
        assert all(str(port) in screen for port in ports.values())
        assert "UR3 with PolyScope 3.15.8" in screen
        with socket.create_connection(("127.0.0.1", ports["dashboard"])) as client:
            client.settimeout(DEADLINE_S)
            lines = client.makefile("rw")
            assert "Dashboard" in lines.readline()
            lines.write("robotmode\n")
            lines.flush()
            assert lines.readline() == "Robotmode: RUNNING\n"
            process.send_signal(number)
            out, error = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert out.splitlines()[-1] == "Stopped."
    assert error == ""


def test_faults_begin_once_it_is_ready(tmp_path: Path) -> None:
    faults = ("--fault", "refuse_connections,port=dashboard", "--fault", "stale_data,after=1000")
    command = emulator_command("--ephemeral-ports", "--ports-file", "ports.json", *faults)
    with running(command, tmp_path) as process:
        read_until(process, "Ready: every port on 127.0.0.1 answers")
        ports = json.loads((tmp_path / "ports.json").read_text())
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", ports["dashboard"]))
        with closing(RemoteControl("127.0.0.1", ports["control"])) as robot:
            assert [fault["state"] for fault in robot.faults()] == ["in force", "waiting"]
            robot.clear_faults()
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, error) == (0, "")


def test_a_fault_not_possible_on_this_robot(tmp_path: Path) -> None:
    command = emulator_command("--ephemeral-ports", "--fault", "stall,port=gripper")
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 2
    assert "fault stall: this robot has no port 'gripper'" in done.stderr.replace("\n", " ")


def test_network_access_of_scripts_can_be_disabled(tmp_path: Path) -> None:
    command = emulator_command(
        "--ephemeral-ports", "--ports-file", "ports.json", "--running", "--script-network", "none"
    )
    with running(command, tmp_path) as process, socket.create_server(("127.0.0.1", 0)) as driver:
        read_until(process, "Ready: every port on 127.0.0.1 answers")
        ports = json.loads((tmp_path / "ports.json").read_text())
        with socket.create_connection(("127.0.0.1", ports["primary"]), timeout=DEADLINE_S) as client:
            port = driver.getsockname()[1]
            client.sendall(f'def prog():\n textmsg("opened ", socket_open("127.0.0.1", {port}))\nend\n'.encode())
            output = b""
            while b"opened " not in output[:-10]:
                received = client.recv(4096)
                assert received
                output += received
        assert b"opened False" in output


def test_python_m_next_to_a_decoy_client_module(tmp_path: Path) -> None:
    (tmp_path / "client.py").write_text("raise ImportError('a decoy')")
    command = [sys.executable, "-m", "emulator", "--ephemeral-ports", "--exit-when-ready"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Ready:" in done.stdout


def test_the_mounted_tool_is_shown(tmp_path: Path) -> None:
    command = emulator_command(
        "--model",
        "ur5e",
        "--ephemeral-ports",
        "--exit-when-ready",
        "--tool-device",
        "pty",
        "--gripper",
        "robotiq-2f-85",
    )
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Robotiq 2F-85: text commands" in done.stdout
    assert "the tool's serial line, to /dev/" in done.stdout


def test_a_port_in_use(tmp_path: Path) -> None:
    host = f"127.78.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    with socket.create_server((host, 30104)):
        command = emulator_command("--host", host, "--port-offset", "100")
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 2
    assert done.stdout == ""
    expected = f"ur-emulator: cannot listen on {host} port 30104 (rtde): another program uses it\n"
    assert done.stderr == expected


@each_row(
    ("arguments", "problem"),
    [
        (["--model", "ur4"], "unknown robot model 'ur4': choose one of"),
        (["--polyscope", "new"], "'new' is not a PolyScope version"),
        (["--model", "ur3", "--polyscope", "5.22"], "UR3 (CB3) requires PolyScope"),
        (["--initial-positions", "missing.yaml"], "cannot read missing.yaml: No such file"),
        (["--safety", "missing.yaml"], "cannot read missing.yaml: No such file"),
        (["--programs", "missing"], "--programs: missing is not a folder"),
        (["--speed", "0"], "the speed must be a positive number"),
        (["--gripper", "hand"], "unknown gripper 'hand': choose one of robotiq-2f-85, robotiq-2f-140"),
        (["--gripper-object", "30"], "--gripper-object has no effect without a gripper: add --gripper"),
        (["--tool-device", "echo"], "UR3 has no serial line at its tool: leave out --tool-device"),
        (
            ["--model", "ur5e", "--ephemeral-ports", "--tool-device", "/dev/none"],
            "cannot open the tool device /dev/none: No such file or directory",
        ),
        (["--speed", "nan"], "the speed must be a positive number"),
        (["--port-offset", "-1"], "the port offset must be from 0 to"),
        (["--fault", "explosion"], "fault: unknown fault 'explosion': choose one of drop_connection"),
        (["--fault", "delay"], "fault: delay: Object missing required field `delay_s`"),
    ],
)
def test_errors_are_one_clear_line(arguments: list[str], problem: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"ur-emulator: {problem}")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_unknown_options_are_usage_errors() -> None:
    assert CliRunner().invoke(app, ["--no-such-option"]).exit_code == 2
    assert CliRunner().invoke(app, ["--log-level", "loud"]).exit_code == 2
    assert CliRunner().invoke(app, ["--script-network", "local"]).exit_code == 2


def test_help_and_version() -> None:
    runner = CliRunner()
    text = runner.invoke(app, ["--help"]).stdout
    for option in ("--model", "--polyscope", "--host", "--port-offset", "--programs", "--initial-positions"):
        assert option in text
    assert runner.invoke(app, ["--version"]).stdout.startswith("ur-emulator 0.")
