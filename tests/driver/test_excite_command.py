"""ur-client excite moves an arm, and identify finds that arm in what was recorded."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulator_process import EmulatorProcess
from typer.testing import CliRunner, Result

from client.cli import app
from client.commands import record
from client.errors import ClientError
from client.identification.identify import identify
from client.recording import read
from urproto.robots import load_model
from urproto.robots.measured import drivetrain_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="emulators need the loopback addresses of Linux")


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    process = EmulatorProcess(["--model", "ur10", "--running", "--arm", "dynamic", "--speed", "3"])
    process.start()
    yield process
    process.stop()
    process.dispose()


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


@pytest.mark.long
def test_what_it_records_is_enough_to_identify_the_arm(emulator, tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    result = call("excite", "--duration", "12", "--angle", "0.3", "-o", str(file), "--robot-ip", emulator.host)
    assert result.exit_code == 0, result.output or result.exception
    recording, drives = read(file), drivetrain_of(load_model("ur10"))
    assert abs(recording["actual_q"] - recording["actual_q"][0]).max() < 0.32
    found = identify(recording, load_model("ur10"))
    assert found.drives.rotor_kg_m2 == pytest.approx(drives.rotor_kg_m2, rel=1e-3)
    assert found.errors["rotor_kg_m2"].count(None) == 0


def test_a_real_arm_does_not_move_unasked(emulator, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(record, "is_loopback", lambda address: False)
    result = call("excite", "-o", str(tmp_path / "run.npz"), "--robot-ip", emulator.host)
    assert isinstance(result.exception, ClientError)
    assert "Is the path clear?" in str(result.exception)
    assert not (tmp_path / "run.npz").exists()
