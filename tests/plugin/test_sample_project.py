"""examples/ci as run by users, on an arm of each series."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests_of_users import PLUGIN

PROJECT = Path(__file__).parents[2] / "examples" / "ci"
PATIENCE_S = 280.0


@pytest.mark.page
@pytest.mark.real_client
@pytest.mark.timeout(PATIENCE_S + 20)
@pytest.mark.parametrize(
    "options",
    [
        ["--ur-model", "ur3"],
        pytest.param(["--ur-model", "ur10e", "--ur-polyscope", "5.12"], marks=pytest.mark.long),
    ],
)
def test_the_sample_project_passes(options: list[str]) -> None:
    command = [sys.executable, "-m", "pytest", *PLUGIN, "-p", "no:cacheprovider", "-n", "2", *options]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout
