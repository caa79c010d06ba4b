"""``ur-emulator evaluate``: statistics, the same report each time, and what is kept of failures."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

from typer.testing import CliRunner

from emulator.cli import app
from emulator.evaluation.report import decided, success_interval

ROOT = Path(__file__).resolve().parents[2]
BY_RULES = f"{ROOT}/examples/learning/scripted_policies.py"
POLICIES = """
import numpy as np

class Half:
    '''Reaches the goal in episodes with even seeds, and goes into the table in others.'''

    def __init__(self, env):
        self.size = env.action_space.shape[0]

    def reset(self, seed):
        self.good = seed % 2 == 0

    def __call__(self, seen):
        wanted = seen["desired_goal"] if self.good else np.array([0.0, 0.0, 0.0])
        return np.clip(20 * (wanted - seen["observation"][:3]), -1, 1)

def broken(env):
    return lambda seen: seen["missing"]

def short(env):
    return lambda seen: [0.0]

def nothing(env):
    return None

def unseeded(env):
    chance = np.random.default_rng()
    return lambda seen: chance.uniform(-1, 1, 3)
"""


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    file = tmp_path / "policies.py"
    file.write_text(POLICIES)
    return file


def evaluate(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["evaluate", *map(str, words)])
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    [  # published tables of exact binomial limits
        (0, 10, 0.0, 0.3085),
        (1, 10, 0.0025, 0.4450),
        (9, 10, 0.5550, 0.9975),
        (10, 10, 0.6915, 1.0),
        (50, 100, 0.3983, 0.6017),
        (98, 100, 0.9296, 0.9976),
    ],
)
def test_intervals_are_those_of_clopper_and_pearson(successes: int, episodes: int, low: float, high: float) -> None:
    assert success_interval(successes, episodes) == pytest.approx((low, high), abs=6e-5)


def test_the_interval_of_many_episodes_is_that_of_the_normal_distribution() -> None:
    low, high = success_interval(16_000, 20_000)
    assert (low, high) == pytest.approx((0.8 - 1.96 * 0.002828, 0.8 + 1.96 * 0.002828), abs=1e-4)


def test_the_sequential_test_decides_after_the_fewest_episodes() -> None:
    """With errors of 5 %, the ratio of likelihoods has to reach 19."""
    assert decided([True] * 50, 0.5, 0.9) == (6, 0.9)  # 1.8 ** 6 = 34, 1.8 ** 5 = 18.9
    assert decided([False] * 50, 0.5, 0.9) == (2, 0.5)  # 5 ** 2 = 25
    assert decided([True, True, False], 0.5, 0.9) == (3, None)
    assert decided([], 0.5, 0.9) == (0, None)


def test_reports_are_the_same_and_failures_are_kept(policies: Path, tmp_path: Path) -> None:
    words = ("reach", "--policy", f"{policies}:Half", "--episodes", 5, "--steps", 30, "--option", "model=ur3e")
    status, text, notes = evaluate(*words, "--workers", 1, "--out", tmp_path / "a", "--keep", 1, "--at-least", 0.7)
    assert status == 1
    assert "reach: 3 of 5 episodes reached the goal: 60.0% (95% confidence: 14.7% to 94.7%)" in text
    assert "seeds of episodes that did not reach it: 1, 3" in text
    assert f"kept {tmp_path}/a/failures/1.journal" in notes
    assert evaluate(*words, "--workers", 1, "--out", tmp_path / "b", "--keep", 0, "--at-least", 0.6)[:2] == (0, text)
    report = (tmp_path / "a" / "report.json").read_bytes()
    assert (tmp_path / "b" / "report.json").read_bytes() == report
    each = json.loads(report)["each"]
    assert [one["seed"] for one in each] == [*range(5)]
    assert all(one["path_m"] > 0.02 and one["jerk_rad_s3"] > 1.0 for one in each)
    assert [one["steps"] for one in each if not one["success"]] == [30, 30]
    replayed = CliRunner().invoke(app, ["replay", str(tmp_path / "a" / "failures" / "1.journal")])
    assert replayed.exit_code == 0, replayed.stderr
    assert "the same in all" in replayed.stdout


@pytest.mark.long
def test_the_number_of_processes_makes_no_difference(policies: Path, tmp_path: Path) -> None:
    for workers in ("1", "2"):
        words = ["reach", "--policy", f"{policies}:Half", "--episodes", "5", "--steps", "60", "--workers", workers]
        command = [
            sys.executable,
            "-m",
            "emulator",
            "evaluate",
            *words,
            "--out",
            str(tmp_path / workers),
            "--keep",
            "0",
        ]
        subprocess.run(command, check=True, cwd=ROOT)
    assert (tmp_path / "1" / "report.json").read_bytes() == (tmp_path / "2" / "report.json").read_bytes()


def test_it_stops_when_it_is_clear_which_rate_it_is(policies: Path) -> None:
    status, text, _ = evaluate(
        "reach", "--policy", f"{BY_RULES}:Reach", "--episodes", 50, "--sprt", "0.5,0.9", "--workers", 1
    )
    assert status == 0
    assert "reach: 6 of 6 episodes" in text
    assert "success rate of 0.5 or 0.9: 0.9" in text
    assert evaluate("reach", "--policy", "random", "--sprt", "0.5,0.9", "--steps", 5, "--workers", 1)[0] == 1


def test_late_actions_are_counted(tmp_path: Path) -> None:
    measured = tmp_path / "latencies.txt"
    measured.write_text("0.01\n0.09\n")
    for latency, late in (("0.03", False), ("0.05..0.06", True), (measured, True)):
        _, text, _ = evaluate(
            "reach", "--policy", f"{BY_RULES}:Reach", "--episodes", 1, "--latency", latency, "--workers", 1
        )
        assert ("actions were late" in text) == late, latency


def test_a_task_can_be_an_environment_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from emulator.learning import GoalEnv\n"
        "class Near(GoalEnv):\n"
        "    def __init__(self, **options):\n"
        "        super().__init__('reach', continuing_task=False, **options)\n"
        "class Other(Near):\n"
        "    def __init__(self, colour):\n"
        "        super().__init__()\n"
    )
    assert evaluate(f"{tmp_path}/mine.py:Near", "--policy", "random", "--episodes", 1, "--workers", 1)[0] == 0
    _, _, problem = evaluate(f"{tmp_path}/mine.py:Other", "--policy", "random", "--workers", 1)
    assert "mine.py:Other failed: TypeError" in problem


def test_a_policy_that_is_not_determined_is_noticed(policies: Path, tmp_path: Path) -> None:
    status, _, notes = evaluate(
        "reach", "--policy", f"{policies}:unseeded", "--episodes", 1, "--steps", 3, "--workers", 1, "--out", tmp_path
    )
    assert status == 0
    assert "episode 0 went otherwise when it was played again" in notes
    assert not (tmp_path / "failures").exists()


def test_mistakes_are_one_line_errors(policies: Path) -> None:
    for words, problem in (
        (("jump", "--policy", "random"), "there is no task 'jump': choose peg_in_hole"),
        (("reach", "--policy", "best"), "'best' must be FILE.py:NAME or MODULE:NAME"),
        (("reach", "--policy", "missing.py:It"), "there is no file missing.py"),
        (("reach", "--policy", "no_such_module:It"), "no_such_module cannot be loaded: ModuleNotFoundError"),
        (("reach", "--policy", f"{policies}:It"), "policies.py has no It"),
        (("reach", "--policy", f"{policies}:broken"), "KeyError (policies.py:"),
        (("reach", "--policy", f"{policies}:short"), "an action of this task must be 3 numbers"),
        (("reach", "--policy", f"{policies}:nothing"), "NoneType, which cannot be called with an observation"),
        (("reach", "--policy", "random", "--option", "model"), "--option must be NAME=VALUE, not 'model'"),
        (("reach", "--policy", "random", "--option", "model=ur4"), "ur4"),
        (("reach", "--policy", "random", "--option", "colour=red"), "no option 'colour'"),
        (("reach", "--policy", "random", "--option", "step_s=-1"), "step_s must be from"),
        (("reach", "--policy", "random", "--latency", "soon"), "--latency must be seconds"),
        (("reach", "--policy", "random", "--sprt", "0.9,0.5"), "--sprt must be two rates"),
    ):
        status, _, shown = evaluate(*words, "--episodes", 1, "--workers", 1)
        assert status == 2, words
        assert problem in shown, (words, shown)
        assert len(shown.splitlines()) == 1, shown
