"""A system without packages of Pinocchio, such as native Windows: features that work, and features refused by name.

It is simulated by a Python that finds neither Pinocchio nor its dependencies.
"""

import subprocess
import sys
from pathlib import Path

import pytest

HIDDEN = """
import sys

from importlib.machinery import PathFinder

class Hidden(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.split(".")[0] in ("pinocchio", "coal", "hppfcl"):
            return None
        return PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Hidden
"""


def run(code: str, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P" if sys.version_info >= (3, 11) else "-B", "-c", HIDDEN + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=cwd, check=False)


@pytest.mark.long
def test_an_arm_moves_with_the_same_torques_as_pinocchio() -> None:
    moving = """
from urproto.testing import virtual_robot

robot = virtual_robot("ur5e", running=True)
robot.send_script(
    "def go():\\n  set_target_payload(2, [0, 0.01, 0.05])\\n  movej([0.3, -1.2, 1.3, -1.6, -1.5, 0.2])\\nend\\n"
)
robot.run_until("runtime_state == PLAYING")
robot.run_until("actual_q[0] > 0.1")
state = robot.state(["target_moment", "actual_current", "actual_q"])
print([round(value, 9) for name in sorted(state) for value in state[name]])
print(sorted(name for name in __import__("sys").modules if name in ("pinocchio", "coal")))
"""
    hidden = run(moving)
    assert hidden.returncode == 0, hidden.stderr
    numbers, loaded = hidden.stdout.splitlines()
    assert loaded == "[]"
    seen = subprocess.run([sys.executable, "-c", moving], capture_output=True, text=True, timeout=100, check=True)
    assert numbers == seen.stdout.splitlines()[0]
    assert "pinocchio" in seen.stdout.splitlines()[1]


def test_features_that_need_pinocchio_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text("links: true\nobjects: {ball: {sphere: 0.1, pose: [1, 0, 0]}}\n")
    starting = "from emulator.cli import main; sys.argv[0] = 'ur-emulator'; main()"
    for options, feature in (
        (["--world", "world.yaml"], "links: true in world.yaml"),
        (["--self-collision"], "--self-collision"),
    ):
        done = run(starting, *options, "--exit-when-ready", cwd=tmp_path)
        assert done.returncode == 2, done.stdout + done.stderr
        assert f"{feature} needs Pinocchio: " in done.stderr
        assert "[pinocchio]'" in done.stderr
        assert done.stderr.count("\n") == 1


def test_planning_reports_what_is_missing() -> None:
    done = run("\nimport client.planning")
    assert done.returncode == 1
    assert "planning (Pinocchio, OMPL) needs packages that are not installed: " in done.stderr.splitlines()[-1]


def test_a_dynamic_arm_is_slower_and_says_so() -> None:
    done = run("\nfrom emulator.config import controller_config\ncontroller_config('ur3', arm='dynamic')")
    assert done.returncode == 0, done.stderr
    assert "without Pinocchio, a dynamic arm takes five times the time: " in done.stderr
