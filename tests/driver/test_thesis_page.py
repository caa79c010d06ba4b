"""What docs/thesis.md tells a student to type is typed, in its order, against an emulator."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulator_process import EmulatorProcess
from typer.testing import CliRunner

from client.cli import app
from client.recording import read
from urproto.modes import SafetyMode

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "thesis.md").read_text()
CONTROLLER = "scaled_joint_trajectory_controller"
DEADLINE_S = 120.0
SPEED = 1.5  # robot seconds a second: the page is to be tried in a minute
# Programs and not functions, so that what goes on in the background can be ended; the doctor may find something here.
PROGRAMS = {
    "ur-client": """#!/bin/bash
run=(PYTHON -c 'from client.cli import main; main()' "$@")
if [ "$1" = doctor ]; then "${run[@]}" || test $? = 1; else exec "${run[@]}"; fi
""",
    "ur-emulator": """#!/bin/bash
exec PYTHON -m emulator "$@"
""",
}
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="emulators need the loopback addresses of Linux")


def fences(language: str) -> list[str]:
    """The page's blocks of code of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def by_hand() -> Iterator[list[str]]:
    """Commands that somebody types while something else goes on, or on another machine."""
    for block in fences("shell"):
        yield from (shlex.split(line) for line in block.replace("\\\n", " ").splitlines())


@pytest.fixture
def emulator() -> Iterator[EmulatorProcess]:
    """The one of the page, on an address of its own."""
    (arguments,) = (command[1:] for command in by_hand() if command[0] == "ur-emulator")
    with EmulatorProcess(arguments) as process:
        yield process


@pytest.mark.page
@pytest.mark.timeout(4 * DEADLINE_S)
def test_a_student_gets_along(emulator: EmulatorProcess, tmp_path: Path) -> None:
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "bin").mkdir()
    for name, text in PROGRAMS.items():
        (program := tmp_path / "bin" / name).write_text(text.replace("PYTHON", shlex.quote(sys.executable)))
        program.chmod(0o755)
    for block in fences("sh"):
        # the stop has to come while the arm moves, however slow this machine is
        emulator.control.set_speed(1.0 if "protective_stop" in block else SPEED)
        run(["bash", "-euo", "pipefail", "-c", without_address(block)], emulator.host, tmp_path)
    recordings = {name: read(tmp_path / f"{name}.mcap") for name in ("full", "slow", "stop", "shared")}
    for recording in recordings.values():
        assert recording.tracking(CONTROLLER).largest_path_deviation < 0.02
    assert recordings["slow"].time_s[-1] > 2.0 / 0.3
    assert SafetyMode.PROTECTIVE_STOP in recordings["stop"]["safety_mode"]
    assert recordings["stop"]["actual_q"][-1] == pytest.approx((0.8, -1.2, -0.6, -1.57, 0.4, 0.0), abs=0.01)
    for name in ("full.png", "slow.html", "stop.png", "full.csv", "my_robot_calibration.yaml", "my_robot.urdf"):
        assert (tmp_path / name).stat().st_size > 500, name
    (example,) = fences("python")
    assert '"192.168.1.10"' in example
    run([sys.executable, "-c", example.replace("192.168.1.10", emulator.host)], emulator.host, tmp_path)
    assert (tmp_path / "home.pdf").exists()


def without_address(block: str) -> str:
    """The block for whatever address the environment says."""
    return block.replace("export UR_ROBOT_IP=127.0.0.1\n", "")


def run(command: list[str], host: str, folder: Path) -> None:
    path = f"{folder / 'bin'}:{os.environ['PATH']}"
    environment = os.environ | {"UR_ROBOT_IP": host, "PYTHONPATH": str(ROOT), "PATH": path}
    done = subprocess.run(
        command, cwd=folder, env=environment, timeout=DEADLINE_S, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"


def test_what_is_typed_meanwhile_exists() -> None:
    commands = [command[1:] for command in by_hand() if command[0] == "ur-client"]
    assert len(commands) >= 4
    for command in commands:
        result = CliRunner().invoke(app, [*command, "--help"])  # options that are not there come before help
        assert result.exit_code == 0, result.output
