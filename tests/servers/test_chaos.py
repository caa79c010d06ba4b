"""A short version of `make chaos` with the same limits."""

import subprocess
import sys
from pathlib import Path

import pytest

CHAOS = Path(__file__).resolve().parents[2] / "benchmarks" / "chaos.py"
SCENARIOS = (
    "flood", "drivers", "hostile", "descriptors", "disk", "memory", "clock", "slow", "clients", "soak", "mixed",
)  # fmt: skip
HERE = ("descriptors", "disk", "memory", "soak")
"""Those whose bars hold on a busy machine too; the others measure time, and belong to `make chaos`."""

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="limits and stops processes by means of Linux"),
    pytest.mark.timeout(300),
]


@pytest.mark.long
@pytest.mark.parametrize("scenario", HERE)
def test_chaos(scenario: str) -> None:
    done = subprocess.run([sys.executable, str(CHAOS), "--quick", scenario], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_scenario_is_included() -> None:
    done = subprocess.run([sys.executable, str(CHAOS), "--help"], capture_output=True, text=True, check=True)
    assert ", ".join(SCENARIOS) in " ".join(done.stdout.split())
