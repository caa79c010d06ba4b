"""``ur-emulator campaign`` on the command line."""

import subprocess
import sys
from pathlib import Path

import pytest
from campaign_rig import write

from emulator.campaign.command import duration
from tests.rows import each_row


def campaign(*words: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "emulator", "campaign", *words]
    root = Path(__file__).resolve().parents[2]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env={"PYTHONPATH": str(root)}, check=False
    )


@pytest.mark.long
def test_a_campaign_writes_its_files_prints_a_summary_and_exits_with_a_status(tmp_path: Path) -> None:
    write(tmp_path)
    shown = campaign("trial.yaml", "--dry-run", folder=tmp_path)
    assert shown.returncode == 0
    assert "12 runs" in shown.stdout
    assert "urscript run work.script --model ur3 " in shown.stdout
    assert not (tmp_path / "trial-results").exists()

    ran = campaign("trial.yaml", "--workers", "2", folder=tmp_path)
    assert ran.returncode == 1, ran.stderr  # some failed
    assert "trial-results/report.html" in ran.stdout
    files = {path.name for path in (tmp_path / "trial-results").iterdir()}
    assert files == {"journal.jsonl", "report.html", "results.parquet", "failed_runs"}

    again = campaign("trial.yaml", "--minimise", "0", folder=tmp_path)
    assert "12 of 12 runs are already done" in again.stdout
    assert again.stdout.splitlines()[-1] == ran.stdout.splitlines()[-1]


def test_errors_are_one_line(tmp_path: Path) -> None:
    write(tmp_path, "script: work.script\nmatrix: {model: [ur4]}")
    ended = campaign("trial.yaml", folder=tmp_path)
    assert ended.returncode == 2
    assert ended.stderr.startswith("ur-emulator: trial.yaml: unknown robot model 'ur4'")
    assert len(ended.stderr.splitlines()) == 1


@each_row(("seconds", "text"), [(5, "5 s"), (600, "10 min"), (7200, "2.0 h"), (1e6, "11.6 days")])
def test_durations_are_formatted_for_people(seconds: float, text: str) -> None:
    assert duration(seconds) == text
