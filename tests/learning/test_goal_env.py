"""Tasks of folders: the conventions of Gymnasium-Robotics, every arm within its reach, all can be solved."""

import itertools
import runpy
from math import pi
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

import gymnasium
from gymnasium.utils.env_checker import check_env

import emulator.learning
from emulator.learning import CONTROL_MODES, GoalEnv, TaskError
from emulator.learning.task_file import TASK_FILE, TASKS, find_task, read_task
from emulator.physics.cameras import CameraError
from urproto.robots import MODELS, kinematics_of, load_model

NAMES = sorted(path.parent.name for path in TASKS.glob(f"*/{TASK_FILE}"))
ROOT = Path(__file__).resolve().parents[2]
POLICIES = runpy.run_path(str(ROOT / "examples/learning/scripted_policies.py"))
BY_RULES = {"reach": "Reach", "push": "Push", "pick_and_place": "PickAndPlace", "peg_in_hole": "PegInHole"}


@pytest.fixture(scope="module")
def env():
    made = GoalEnv("push", continuing_task=False)
    yield made
    made.close()


@pytest.mark.parametrize("name", NAMES)
def test_gymnasiums_own_checks_pass_and_observations_are_what_is_said(name):
    env = gymnasium.make(f"ur_emulator/{BY_RULES[name]}-v1")
    check_env(env.unwrapped, skip_render_check=True)
    seen, _ = env.reset(seed=0)
    assert len(seen["observation"]) == sum(env.unwrapped.observed.values())
    assert env.spec.max_episode_steps == env.unwrapped.task.steps
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_every_arm_reaches_the_whole_workspace_away_from_singularities(name):
    task, unreached = read_task(find_task(name)), []
    for model in map(load_model, MODELS):
        kinematics = kinematics_of(model)
        spans = zip(*task.workspace.corners(model), strict=True)
        for x, y, z in itertools.product(*(np.linspace(low, high, 4) for low, high in spans)):
            q = kinematics.inverse_near(
                (x, y, z + task.tcp[2], 0, pi, 0), (0, -1.5, 1.5, -pi / 2, -pi / 2, 0), model.q_min, model.q_max
            )
            least = 0.0 if q is None else np.linalg.svd(np.array(kinematics.jacobian(q)))[1][-1]
            if least < 0.04:
                unreached.append((model.name, x, y, z))
    assert not unreached


@pytest.mark.parametrize(
    ("name", "model"), [(name, "ur3") for name in NAMES] + [("peg_in_hole", "ur20"), ("pick_and_place", "ur10e")]
)
def test_a_policy_by_rules_solves_the_task(name, model):
    env = GoalEnv(name, model=model, continuing_task=False)
    policy = POLICIES[BY_RULES[name]](env)
    seen, info = env.reset(seed=1)
    ended, steps = False, 0
    while not ended and steps < env.task.steps:
        seen, reward, ended, _, info = env.step(policy(seen))
        steps += 1
    assert info["is_success"], (steps, info)
    assert reward == 0.0
    assert np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"]) <= env.task.distance_m


def test_rewards_are_those_of_gymnasium_robotics(env):
    """A reward depends on the goals alone, one or many; so goals can be exchanged afterwards."""
    seen, _ = env.reset(seed=2)
    _, reward, *_, info = env.step(np.zeros(3, np.float32))
    assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info) == -1.0
    achieved = np.array([seen["achieved_goal"], seen["desired_goal"]])
    assert env.compute_reward(achieved, seen["desired_goal"], {}).tolist() == [-1.0, 0.0]
    beside = achieved + np.array([[1.01, 0.0, 0.0], [0.99, 0.0, 0.0]]) * env.task.distance_m
    assert env.compute_reward(beside, achieved, {}).tolist() == [-1.0, 0.0]
    assert env.compute_terminated(seen["desired_goal"], seen["desired_goal"], {})
    dense = GoalEnv("push", reward="dense")
    away = np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"])
    assert dense.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}) == pytest.approx(-away)
    assert not dense.compute_terminated(seen["desired_goal"], seen["desired_goal"], {})  # it goes on at the goal


@pytest.mark.parametrize("mode", CONTROL_MODES)
def test_control_modes_do_what_they_say(mode):
    env = GoalEnv("reach", control_mode=mode)
    env.reset(seed=0)
    still = env.state.actual_TCP_pose
    held = {"joint_position": env.state.actual_q, "tcp_position": still[:3]}.get(
        mode, [0.0] * env.action_space.shape[0]
    )
    for _ in range(10):
        env.step(np.array(held))
    assert env.state.actual_TCP_pose == pytest.approx(still, abs=1e-4)
    moved = np.array(held, float)
    moved[0] += 0.05 if mode.endswith("position") else 1.0
    for _ in range(8 if mode.endswith("velocity") else 20):
        env.step(moved)
    if mode == "tcp_velocity":
        assert env.state.actual_TCP_speed == pytest.approx((0.25, 0, 0, 0, 0, 0), abs=1e-3)
    elif mode == "joint_velocity":
        assert env.state.actual_qd == pytest.approx((1, 0, 0, 0, 0, 0), abs=1e-3)
    elif mode == "tcp_position":
        assert env.state.actual_TCP_pose == pytest.approx((still[0] + 0.05, *still[1:]), abs=1e-3)
    else:
        assert env.state.actual_q == pytest.approx(moved, abs=1e-3)


def test_the_tool_stays_in_its_workspace():
    env = GoalEnv("reach")
    low, high = map(np.array, env.workspace)
    for way in itertools.product((1, -1), repeat=3):
        env.reset(seed=0)
        for _ in range(40):
            *_, ended, _, info = env.step(np.array(way, np.float32))
            assert not ended, info
            place = np.array(env.state.actual_TCP_pose[:3])
            assert (place > low - 0.005).all()
            assert (place < high + 0.005).all()


def test_mistakes_are_one_line_errors(env):
    for options, problem in (
        ({"reward": "much"}, "unknown reward 'much': choose one of sparse, dense"),
        ({"control_mode": "tcp"}, "unknown control mode 'tcp': choose one of"),
        ({"task": "pick"}, "there is no task 'pick': choose peg_in_hole, pick_and_place, push, reach, or a folder"),
    ):
        with pytest.raises(TaskError, match=problem):
            GoalEnv(**{"task": "push", **options})
    for options, problem in (
        ({"part": [5, 5]}, r"part must be 2 numbers within the workspace, x from -0.578 to -0.340, .* not \[5, 5\]"),
        ({"part": [-0.45, 0.0, 0.0]}, "part must be 2 numbers"),
        ({"goal": "there"}, "goal must be 3 numbers .* not 'there'"),
        ({"place": 1}, "unknown option of reset 'place': choose one of goal, part"),
    ):
        with pytest.raises(ValueError, match=problem):
            env.reset(seed=0, options=options)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="an action of this task must be 3 numbers, not"):
        env.step(np.zeros(4, np.float32))
    with pytest.raises(ValueError, match="finite numbers"):
        env.step(np.full(3, np.nan, np.float32))


def test_places_can_be_given(env):
    seen, _ = env.reset(seed=0, options={"part": [-0.5, 0.05], "goal": [-0.4, 0.0, 0.02]})
    assert seen["achieved_goal"] == pytest.approx([-0.5, 0.05, 0.02], abs=1e-3)
    assert seen["desired_goal"].tolist() == [-0.4, 0.0, 0.02]


def test_a_folder_is_a_task(tmp_path):
    (tmp_path / "scene.yaml").write_text((TASKS / "push/scene.yaml").read_text())
    file = tmp_path / "task.yaml"
    good = (TASKS / "push/task.yaml").read_text()
    file.write_text(good.replace("steps: 300", "steps: 7"))
    env = gymnasium.make("ur_emulator/Task-v1", task=str(tmp_path), model="ur3e", disable_env_checker=True)
    env.reset(seed=0)
    ends = [env.step(np.zeros(3, np.float32))[2:4] for _ in range(7)]
    assert ends == [(False, False)] * 6 + [(False, True)]
    for broken, problem in (
        (good.replace("distance_m: 0.02", "distance_m: near"), "task.yaml: distance_m must be a number, not text"),
        (good.replace("apart_m", "apart"), "task.yaml: unknown 'apart'"),
        (good.replace("moved: part", "moved: box"), "task.yaml: .*places needs 'box', which is to be moved"),
        (
            good.replace("part:", "box:").replace("moved: part", "moved: box"),
            "scene.yaml unknown object 'box': choose one of",
        ),
        (good.replace("goal:", "# goal:"), "task.yaml: .*it needs either goal or goal_at"),
        (good.replace("apart_m: 0.06", "apart_m: 1.0"), "no places found that are 1 m apart"),
        ("{", "task.yaml is not YAML"),
    ):
        file.write_text(broken)
        with pytest.raises(TaskError, match=problem):
            GoalEnv(str(tmp_path)).reset(seed=0)


def test_pictures_are_observations():
    """A camera beside the arm sees an arm of any size at the same size."""
    try:
        env = GoalEnv("reach", cameras=["overview", "wrist"], model="ur3")
    except CameraError as error:
        pytest.skip(str(error))
    seen, _ = env.reset(seed=0)
    assert seen["pixels"]["overview"].shape == (240, 320, 3)
    assert env.observation_space.contains(seen)
    other = GoalEnv("reach", model="ur10")
    ratio = other.arm.reach_m / env.arm.reach_m
    places = [made.scene.model.camera("overview").pos for made in (env, other)]
    assert places[1] == pytest.approx(ratio * places[0])
    mounted = [made.scene.model.camera("wrist").pos for made in (env, other)]
    assert mounted[1] == pytest.approx(mounted[0])
    env.close()
    with pytest.raises(CameraError, match="there is no camera 'top'"):
        GoalEnv("reach", cameras=["top"])


def test_registered_names_have_a_version():
    assert {name for name in gymnasium.registry if name.startswith("ur_emulator/")} == {
        *(f"ur_emulator/{name}-v1" for name in BY_RULES.values()),
        "ur_emulator/Task-v1",
    }
    assert emulator.learning.GoalEnv is GoalEnv
