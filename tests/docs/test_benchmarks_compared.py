"""Two pages of benchmarks are compared figure by figure; only slower results are reported."""

import subprocess
import sys
from pathlib import Path

from tests.rows import each_row

COMPARE = Path(__file__).resolve().parents[2] / "benchmarks" / "compare.py"
PAGE = """# Benchmarks

## Virtual time

Medians.

| arm | doing | ticks/s | a tick takes |
| --- | --- | --- | --- |
| ur3 | at rest | 57,298 | 17 us |
| ur3 | movel | 9,000 | 0.99 ms |

## Control period

| arm | rate | clients | what | p50 | missed |
| --- | --- | --- | --- | --- | --- |
| ur3 | 125 Hz | 0 | emulator | 0.19 ms | 0 of 2501 |
| ur3 | 125 Hz | 5 | emulator | 0.10 ms | 0 of 2501 |
"""


@each_row(
    ("old", "new", "expected_lines"),
    [
        ("57,298", "57,000", []),
        ("0 of 2501", "3 of 2501", []),
        ("57,298", "40,000", ["worse  x0.70  Virtual time | ur3, at rest | ticks/s: 57,298 -> 40,000"]),
        ("57,298", "114,596", ["better x2.00  Virtual time | ur3, at rest | ticks/s: 57,298 -> 114,596"]),
        ("17 us", "34 us", ["worse  x2.00  Virtual time | ur3, at rest | a tick takes: 17 us -> 34 us"]),
        ("0.99 ms", "1980 us", ["worse  x2.00  Virtual time | ur3, movel | a tick takes: 0.99 ms -> 1980 us"]),
        ("0.10 ms", "0.11 ms", []),
        ("0.10 ms", "0.15 ms", ["worse  x1.50  Control period | ur3, 125 Hz, 5, emulator | p50: 0.10 ms -> 0.15 ms"]),
    ],
)
def test_changed_figures_are_listed(tmp_path: Path, old: str, new: str, expected_lines: list[str]) -> None:
    before, after = tmp_path / "before.md", tmp_path / "after.md"
    before.write_text(PAGE)
    after.write_text(PAGE.replace(old, new))
    done = subprocess.run([sys.executable, str(COMPARE), str(before), str(after)], capture_output=True, text=True)
    *listed, _ = done.stdout.splitlines()
    assert listed == expected_lines
    assert done.returncode == any(line.startswith("worse") for line in expected_lines), done.stderr
