"""The examples of examples/physics: ur_rtde, unmodified, in a world with physics."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from emulator_process import EmulatorProcess

pytest.importorskip("mujoco", reason="the extra physics")

FOLDER = Path(__file__).parents[2] / "examples" / "physics"
PATIENCE_S = 100.0  # under load


@contextmanager
def cell(scene: str, model: str, speed: float) -> Iterator[EmulatorProcess]:
    arguments = ["--model", model, "--running", "--remote-control", "--world", str(FOLDER / scene), "--physics"]
    process = EmulatorProcess([*arguments, "--speed", str(speed)])
    try:
        yield process.start()
        assert process.stop() == 0, process.log
    finally:
        process.dispose()


def run(example: str, host: str, *more: str) -> str:
    command = [sys.executable, str(FOLDER / example), host, *more]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.long
@pytest.mark.parametrize("count", [2, pytest.param(10, marks=pytest.mark.long)])
def test_parts_are_picked_from_a_conveyor(count: int) -> None:
    with cell("conveyor.yaml", "ur5", 2.0) as robot:
        printed = run("pick_from_conveyor.py", robot.host, str(count))
        places = robot.object_poses()
    assert printed.count("is on the table") == count
    for number in range(count):
        x, y = -0.25 + 0.08 * (number % 5), -0.55 - 0.08 * (number // 5)
        assert places[f"part {number}"][:3] == pytest.approx((x, y, 0.015), abs=0.01)


@pytest.mark.long
def test_a_peg_finds_its_hole_by_force_mode() -> None:
    with cell("peg.yaml", "ur5", 2.0) as robot:
        run("peg_in_hole.py", robot.host)
        x, y, z, *_ = robot.state()["actual_TCP_pose"]
    assert (x, y) == pytest.approx((-0.4, -0.3), abs=6e-4)  # half a millimetre of play
    assert z < 0.14 - 0.015


@pytest.mark.long
def test_a_wall_and_a_box_in_front_of_it_are_found_by_contact() -> None:
    with cell("wall.yaml", "ur5e", 2.0) as robot:
        printed = run("find_wall.py", robot.host)
        box = robot.object_poses()["box"]
    behind, above = (float(line.split("x = ")[1].split()[0]) for line in printed.splitlines() if "x = " in line)
    assert above == pytest.approx(-0.6, abs=0.002)
    assert behind == pytest.approx(-0.55, abs=0.002)  # the box, against the wall
    assert box[0] == pytest.approx(-0.575, abs=0.002)


@pytest.mark.long
def test_tools_are_changed() -> None:
    with cell("tools.yaml", "ur5e", 2.0) as robot:
        printed = run("change_tools.py", robot.host)
        places = robot.object_poses()
    assert float(printed.split("z = ")[1].split()[0]) == pytest.approx(0.02, abs=0.002)
    assert places["plate"][:3] == pytest.approx((-0.1, -0.5, 0.01), abs=0.003)
    for tool, y in (("cup head", 0.0), ("probe head", -0.2)):
        assert places[tool][:3] == pytest.approx((-0.5, y, 0.215), abs=0.003)
