"""``ur-emulator-check``: available and missing ports, and other packages with the names of ours."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from emulator.check import app
from tests.budget import subset
from tests.rows import each_row
from urproto.testing import launch
from urproto.testing.process import EmulatorProcess, claim_address

Check = Callable[..., tuple[int, str]]


@pytest.fixture(scope="module")
def robot() -> Iterator[EmulatorProcess]:
    with EmulatorProcess(["--model", "ur5e", "--running"]) as robot:
        yield robot


def check(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, words)
    return result.exit_code, result.output


def lines_of(output: str, mark: str) -> set[str]:
    """Names of the servers with this mark."""
    return {line[7:27].strip() for line in output.splitlines() if line[:7].strip() == mark}


def test_a_healthy_robot(robot: EmulatorProcess) -> None:
    status, output = check(robot.host, "--run-script")
    assert (status, lines_of(output, "ok")) == (0, {*robot.ports, "script", "rtde stream"}), output
    assert "Robotmode: RUNNING" in output
    assert "PolyScope 5." in output


@pytest.mark.long
def test_an_older_robot_without_newer_ports_is_healthy() -> None:
    with EmulatorProcess(["--model", "ur3", "--polyscope", "3.5", "--no-control"]) as robot:
        status, output = check(robot.host, "--require", "rtde")
        assert (status, lines_of(output, "-")) == (0, {"robot api", "interpreter", "control"}), output
        status, output = check(robot.host, "--require", "interpreter", "-q")
        assert (status, lines_of(output, "FAILED")) == (1, {"interpreter"}), output
        assert "connection refused" in output


def test_no_robot() -> None:
    address = claim_address()
    status, output = check(address.host)
    address.release()
    assert (status, len(output.splitlines())) == (3, 1)
    assert f"no port of a robot is reachable on {address.host}: connection refused" in output


def test_a_silent_server_and_an_unexpected_server(robot: EmulatorProcess, tmp_path: Path) -> None:
    silent = socket.create_server((robot.host, 0))
    ports = {**robot.ports, "rtde": silent.getsockname()[1], "dashboard": robot.ports["modbus"]}
    (file := tmp_path / "ports.json").write_text(json.dumps(ports))
    status, output = check(robot.host, "--ports-file", str(file), "--timeout", "2", "-q")
    silent.close()
    assert (status, lines_of(output, "FAILED")) == (1, {"rtde", "dashboard"}), output
    assert "that means: drivers cannot exchange data" in output
    assert "no answer in time" in output


@pytest.mark.long
def test_the_check_waits_for_a_starting_robot() -> None:
    robot = EmulatorProcess(["--model", "ur3"])
    try:
        robot.start(wait=False)
        assert check(robot.host, "--wait", "60")[0] == 0
    finally:
        robot.dispose()


@each_row(
    ("words", "complaint"),
    [(["--require", "wheels"], "wheels"), (["--ports-file", "/nowhere"], "/nowhere"), (["--fly"], "--fly")],
)
def test_invalid_arguments(words: list[str], complaint: str) -> None:
    status, output = check("127.0.0.1", *words)
    assert status == 2
    assert complaint in output


class TestInstall:
    """Each in a separate process, as in the command."""

    COMMAND = (
        sys.executable,
        "-c",
        "import sys; sys.path.remove(''); from urproto.testing.launch import check; check()",
        "--install",
    )

    def run(self, folder: Path, *search: Path) -> tuple[int, str]:
        path = os.pathsep.join(map(str, (*search, launch.ROOT)))
        done = subprocess.run(
            self.COMMAND, cwd=folder, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
        )
        return done.returncode, done.stdout + done.stderr

    def test_no_conflicting_modules(self, tmp_path: Path) -> None:
        (tmp_path / "emulator").mkdir()  # no package, and ours is on the path
        status, output = self.run(tmp_path)
        assert status == 0, output
        assert str(launch.ROOT) in output

    @pytest.mark.parametrize(
        "name", subset(["client.py", "emulator/__init__.py", "urscript/__init__.py"], now=["client.py"])
    )
    def test_a_module_in_the_current_folder(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
        status, output = self.run(tmp_path)
        assert status == 1
        assert f"python started in {tmp_path} imports {tmp_path / name} instead of ours" in output
        assert "remedy: rename it" in output

    def test_a_module_on_the_pythonpath(self, tmp_path: Path) -> None:
        (other := tmp_path / "src" / "emulator").mkdir(parents=True)
        (other / "__init__.py").write_text("raise ImportError('the decoy was imported')\n")
        status, output = self.run(tmp_path, tmp_path / "src")
        assert status == 1
        assert "remove that folder from PYTHONPATH" in output

    def test_another_distribution_with_the_same_files(self, tmp_path: Path) -> None:
        (metadata := tmp_path / "site" / "clients-1.0.dist-info").mkdir(parents=True)
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: clients\nVersion: 1.0\n")
        (metadata / "top_level.txt").write_text("client\n")
        status, output = self.run(tmp_path, tmp_path / "site")
        assert status == 1
        assert "the distribution clients also installs a package of this name" in output
        assert "pip uninstall clients" in output
