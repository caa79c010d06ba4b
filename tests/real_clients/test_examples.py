"""The numbered examples and the programs of docs/client.md run unchanged and succeed."""

import subprocess
import sys
from pathlib import Path

import pytest
from rig import Rig

pytestmark = pytest.mark.robot_speed(3)

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("[0-9][0-9]_*.py"))
NAMES = [example.stem for example in EXAMPLES]
DEADLINE_S = 45.0
THESIS = "09_thesis"
THESIS_S = 100.0  # at 30 % of the speed slider
PAGE = Path(__file__).parents[2] / "docs" / "client.md"
PROGRAMS = [block.split("```")[0] for block in PAGE.read_text().split("```python\n")[1:]]
PAGE_HOST = '"192.168.1.10"'
FREE_PORTS = "reverse_port=0, sender_port=0, trajectory_port=0, command_port=0"


def run(
    example: Path, host: str, folder: Path, *more: str, deadline_s: float = DEADLINE_S
) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, str(example), host, *more]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=deadline_s, check=False)


def test_the_examples_are_found_and_short() -> None:
    assert len(EXAMPLES) >= 8
    for example in EXAMPLES:
        assert len(example.read_text().splitlines()) < 60, example.name


@pytest.mark.page
@pytest.mark.parametrize("name", [name for name in NAMES if name != THESIS])
def test_example(rig: Rig, name: str, tmp_path: Path) -> None:
    done = run(EXAMPLES[0].with_stem(name), rig.host, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout


@pytest.mark.page
@pytest.mark.long  # the page of the thesis is typed in every run
@pytest.mark.robot_speed(2)
def test_example_of_the_thesis(rig: Rig, tmp_path: Path) -> None:
    done = run(EXAMPLES[0].with_stem(THESIS), rig.host, tmp_path, ".", "2", deadline_s=THESIS_S)  # seconds per goal
    assert done.returncode == 0, done.stdout + done.stderr


def paced(text: str) -> object:
    """Run at a robot with longer timeouts, for load on the machine, if setpoints are streamed to it."""
    return pytest.param(text, marks=pytest.mark.robot_speed(0.25) if "servo" in text else ())


@pytest.mark.page
@pytest.mark.parametrize("text", [paced(text) for text in PROGRAMS], ids=range(len(PROGRAMS)))
def test_program_of_the_client_page(rig: Rig, text: str, tmp_path: Path) -> None:
    assert PAGE_HOST in text
    here = text.replace(f"URDriver({PAGE_HOST}", f"URDriver({PAGE_HOST}, {FREE_PORTS}")
    (program := tmp_path / "page.py").write_text(here.replace(PAGE_HOST, f'"{rig.host}"'))
    done = run(program, rig.host, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_first_connection_wakes_a_robot_that_is_off(rig: Rig) -> None:
    with rig.watch() as state:
        rig.process.dashboard("power off")
        state.wait_until(lambda sample: sample["robot_mode"] == 3)
        subprocess.run(
            [sys.executable, str(EXAMPLES[0]), rig.host], check=True, timeout=DEADLINE_S, capture_output=True
        )
        assert state.newest()["robot_mode"] == 7
