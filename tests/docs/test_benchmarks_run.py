"""`make benchmarks` writes its measurements, reports those that failed, and can repeat single tables."""

import subprocess
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
RUN = f"""
import sys
sys.path.insert(0, {str(BENCHMARKS)!r})
from pathlib import Path
from types import ModuleType
import run
from table import Table

def quick():
    return Table("Quick", "A note.", ["what", "figure"], [["a", FIGURE]])

def other():
    return Table("Other", "A note.", ["what", "figure"], [["b", FIGURE]])

def broken():
    raise OSError("no browser here")

for measurement in (quick, other, broken):
    sys.modules[measurement.__name__] = ModuleType(measurement.__name__)
    sys.modules[measurement.__name__].measure = measurement
run.MEASUREMENTS = ("quick.measure", "broken.measure", "other.measure")
run.TARGET, sys.argv[1:] = Path(sys.argv[1]), sys.argv[2:]
"""


def run(page: Path, figure: str, *modules: str) -> "subprocess.CompletedProcess[str]":
    code = RUN.replace("FIGURE", repr(figure)) + "sys.exit(run.main())"
    command = [sys.executable, "-c", code, str(page), *modules]
    return subprocess.run(command, capture_output=True, text=True, timeout=100)


def test_a_benchmark_that_fails_leaves_the_others_on_the_page(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    done = run(page, "1 ms")
    assert done.returncode == 1
    assert "no browser here" in done.stderr
    text = page.read_text()
    assert "Not measured: OSError: no browser here" in text
    assert text.index("## Quick") < text.index("Not measured") < text.index("## Other")


def test_a_single_table_is_measured_again(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    run(page, "1 ms")
    assert run(page, "2 ms", "other").returncode == 0
    text = page.read_text()
    assert "| a | 1 ms |" in text
    assert "| b | 2 ms |" in text
    assert "Not measured" in text


def test_an_unknown_benchmark_is_a_one_line_error(tmp_path: Path) -> None:
    done = run(tmp_path / "benchmarks.md", "1 ms", "speed")
    assert done.returncode == 2
    assert "no benchmark is called speed: there are broken, other, quick" in done.stderr
