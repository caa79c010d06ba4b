"""Tasks for Gymnasium: its checks and wrappers, reproducible runs, and a task that can be solved."""

import multiprocessing
import runpy
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics

from emulator.journal.doors import plain_values
from emulator.learning import PickAndPlaceEnv, RobotEnv, TaskError
from emulator.learning.pick_and_place import HIGH, LOW
from urproto.controlapi import NotPossible

ROOT = Path(__file__).resolve().parents[2]
NAME = "ur_emulator/PickAndPlace-v0"
GOAL = -1.4  # rad


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("emulator.learning:" + NAME)
    yield made
    made.close()


def play(env, seed, steps=20):
    """Observations and rewards of random actions, and the scene's whole state after them."""
    seen, _ = env.reset(seed=seed)
    chance, run = np.random.default_rng(seed), [seen]
    for _ in range(steps):
        seen, reward, *_ = env.step(chance.uniform(-1.0, 1.0, 4).astype(np.float32))
        run += [seen, [reward]]
    return np.concatenate(run).tobytes(), env.unwrapped.scene.save()


def test_gymnasiums_own_checks_pass(env):
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("arm", ["ideal", "dynamic"])
def test_equal_seeds_give_bit_identical_runs(arm):
    env = PickAndPlaceEnv(arm=arm)

    def episode(env, seed):
        seen = play(env, seed)
        return seen, plain_values(env.unwrapped.state) | {"timestamp": None}

    first = episode(env, 1)
    other = episode(env, 2)
    assert episode(env, 1) == first
    assert episode(PickAndPlaceEnv(arm=arm), 1) == first
    assert other != first


def test_episodes_start_the_same_even_after_a_protective_stop(env):
    before = play(env, 5)
    env.reset(seed=3)
    env.unwrapped.robot.protective_stop()
    *_, ended, _, info = env.step(np.zeros(4, np.float32))
    assert ended
    assert info["stopped"] == "PROTECTIVE_STOP"
    assert play(env, 5) == before


def test_a_robot_that_cannot_come_to_rest_is_replaced(env):
    before = play(env, 6)
    old = env.unwrapped.robot
    old.press_emergency_stop()
    assert play(env, 6) == before
    assert env.unwrapped.robot is not old
    with pytest.raises(NotPossible):
        old.save()


def test_a_step_takes_a_fixed_robot_time():
    env = PickAndPlaceEnv(step_s=0.1)
    env.reset(seed=0)
    before = env.state.timestamp
    env.step(np.zeros(4, np.float32))
    assert env.step_s == pytest.approx(0.096)  # whole periods of 8 ms
    assert env.state.timestamp - before == pytest.approx(env.step_s)


def test_the_tool_stays_in_its_workspace(env):
    env.reset(seed=0)
    for way in ((1, 1, 1), (-1, -1, -1)):
        for _ in range(90):
            _, _, ended, _, info = env.step(np.array([*way, -1], np.float32))
            assert not ended, info
            place = np.array(env.unwrapped.state.actual_TCP_pose[:3])
            assert (place > np.array(LOW) - 0.005).all()
            assert (place < np.array(HIGH) + 0.005).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_rule_based_policy_solves_the_task(env, seed):
    policy = runpy.run_path(str(ROOT / "examples/learning/scripted_policy.py"))["ScriptedPolicy"]()
    counted = RecordEpisodeStatistics(env)
    seen, _ = counted.reset(seed=seed)
    ended = late = False
    while not (ended or late):
        seen, _, ended, late, info = counted.step(policy(seen))
    assert info["success"]
    assert ended
    assert not late
    assert np.linalg.norm(seen[8:10] - seen[11:13]) < 0.03
    assert info["episode"]["l"] < 150


def test_scene_faults_can_be_injected_in_an_episode(env):
    """An episode can have any fault of ``inject_fault``."""
    env.reset(seed=0)
    robot = env.unwrapped.robot
    fault = robot.inject_fault("missing_part", part="part")
    seen, _, ended, *_ = env.step(np.zeros(4, np.float32))
    assert seen[10] < 0
    assert ended
    robot.clear_fault(fault)
    assert play(env, 0)


def test_vector_environments_step_in_parallel():
    """Gymnasium's vector environment resets each environment at the end of its episode."""
    envs = gymnasium.make_vec("emulator.learning:" + NAME, num_envs=2, vectorization_mode="sync")
    envs.action_space.seed(4)
    seen, _ = envs.reset(seed=[1, 2])
    assert seen.shape == (2, 14)
    assert not np.array_equal(seen[0], seen[1])
    for _ in range(3):
        seen, rewards, *_ = envs.step(envs.action_space.sample())
    assert rewards.shape == (2,)
    envs.close()


@pytest.mark.long
def test_environments_in_separate_processes_give_the_same_results_and_exit():
    """As in docs/learning.md. Workers do not need anything that a fork of this process would inherit."""
    runs = []
    for mode, options in (("sync", {}), ("async", {"context": "spawn"})):
        envs = gymnasium.make_vec(
            "emulator.learning:" + NAME, num_envs=2, vectorization_mode=mode, vector_kwargs=options
        )
        envs.action_space.seed(4)
        run = [envs.reset(seed=[1, 2])[0]]
        for _ in range(10):
            seen, rewards, *_ = envs.step(envs.action_space.sample())
            run += [seen.copy(), rewards.copy()]
        workers = multiprocessing.active_children()
        envs.close()
        runs.append(b"".join(values.tobytes() for values in run))
        assert len(workers) == (2 if mode == "async" else 0)
        assert not any(worker.is_alive() for worker in workers)
    assert runs[0] == runs[1]


def test_an_action_that_is_not_a_number_is_refused(env):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="finite numbers"):
        env.unwrapped.step(np.full(4, np.nan, np.float32))


def test_invalid_tasks_are_a_one_line_error():
    with pytest.raises(TaskError, match="reward must be dense or sparse"):
        PickAndPlaceEnv(reward="much")
    with pytest.raises(TaskError, match="render_mode"):
        PickAndPlaceEnv(render_mode="human")

    class Broken(PickAndPlaceEnv):
        program = "def broken(:\nend\n"

    with pytest.raises(TaskError, match="Broken: its program does not start"):
        Broken()


class Reach(RobotEnv):
    """A user's task: turn the base to an angle, with an action of one number."""

    world = PickAndPlaceEnv.world
    program = """def reach():
  while True:
    speedj([read_input_float_register(24), 0, 0, 0, 0, 0], 2.0, {step_s})
  end
end
"""

    def __init__(self, **options):
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,))
        super().__init__(**options)

    def arrange(self, options):
        pass

    def act(self, action):
        self.write(float(action[0]))

    def observe(self):
        return np.array([self.state.actual_q[0]], np.float32)

    def judge(self):
        return -abs(self.state.actual_q[0] - GOAL), False, {}


def test_a_custom_task_with_another_arm():
    env = Reach(model="ur5e")
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=0)
    for _ in range(40):
        seen, reward, *_ = env.step(np.clip(4.0 * (GOAL - seen), -1.0, 1.0).astype(np.float32))
    assert seen[0] == pytest.approx(GOAL, abs=0.01)
    assert reward > -0.01
