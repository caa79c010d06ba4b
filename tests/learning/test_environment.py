"""The base of tasks: reproducible episodes of an emulated robot, in the environment's own process and in others."""

import multiprocessing

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

import gymnasium
from gymnasium.utils.env_checker import check_env

from emulator.journal.doors import plain_values
from emulator.learning import GoalEnv, RobotEnv, TaskError
from emulator.learning.task_file import TASKS
from emulator.virtual import replayed_robot
from urproto.controlapi import NotPossible

NAME = "emulator.learning:ur_emulator/PickAndPlace-v1"
GOAL = -1.4  # rad


@pytest.fixture(scope="module")
def env():
    made = GoalEnv("pick_and_place")
    yield made
    made.close()


def flat(seen):
    return np.concatenate([np.ravel(values).astype(float) for values in seen.values()])


def play(env, seed, steps=20):
    """Observations and rewards of random actions, and the scene's whole state after them."""
    seen, _ = env.reset(seed=seed)
    chance, run = np.random.default_rng(seed), [flat(seen)]
    for _ in range(steps):
        seen, reward, *_ = env.step(chance.uniform(-1.0, 1.0, 4).astype(np.float32))
        run += [flat(seen), [reward]]
    return np.concatenate(run).tobytes(), env.scene.save()


@pytest.mark.parametrize("arm", ["ideal", "dynamic"])
def test_equal_seeds_give_bit_identical_runs(arm):
    env = GoalEnv("pick_and_place", arm=arm)

    def episode(env, seed):
        seen = play(env, seed)
        return seen, plain_values(env.state) | {"timestamp": None}

    first = episode(env, 1)
    other = episode(env, 2)
    assert episode(env, 1) == first
    assert episode(GoalEnv("pick_and_place", arm=arm), 1) == first
    assert other != first


@pytest.mark.parametrize("arm", ["ideal", "dynamic"])
def test_a_recorded_episode_is_the_same_and_can_be_executed_again(arm):
    plain, recorded = (GoalEnv("pick_and_place", arm=arm, **more) for more in ({}, {"recorded": True, "checked": True}))
    assert play(recorded, 4) == play(plain, 4)
    again = replayed_robot(recorded.robot.journal, checked=True)
    assert again.controller.world.save() == recorded.scene.save()
    assert plain_values(again.controller.snapshot) == plain_values(recorded.state)


def test_an_episode_that_ended_with_the_part_in_the_gripper_leaves_no_force():
    """A payload that is set zeroes the sensor, by what it measures at that moment."""
    env, forces = GoalEnv("pick_and_place"), []
    env.reset(seed=0, options={"part": [-0.45, 0.0]})
    for height_m, closing, steps in ((0.02, -1.0, 40), (0.02, 1.0, 15), (0.12, 1.0, 30)):
        for _ in range(steps):
            away = np.array([-0.45, 0.0, height_m]) - env.state.actual_TCP_pose[:3]
            env.step(np.array([*np.clip(20.0 * away, -1.0, 1.0), closing]))
    assert env.scene.pose("part")[2] > 0.08
    for each in (env, GoalEnv("pick_and_place")):
        each.reset(seed=5)
        for _ in range(3):
            each.step(np.zeros(4))
            forces.append(each.state.actual_TCP_force)
    assert forces[:3] == forces[3:]


def test_episodes_start_the_same_even_after_a_protective_stop(env):
    before = play(env, 5)
    env.reset(seed=3)
    env.robot.protective_stop()
    *_, ended, _, info = env.step(np.zeros(4, np.float32))
    assert ended
    assert info["stopped"] == "PROTECTIVE_STOP"
    assert play(env, 5) == before


def test_a_robot_that_cannot_come_to_rest_is_replaced(env):
    before = play(env, 6)
    old = env.robot
    old.press_emergency_stop()
    assert play(env, 6) == before
    assert env.robot is not old
    with pytest.raises(NotPossible):
        old.save()


def test_a_step_takes_a_fixed_robot_time_and_longer_if_the_policy_does():
    env = Turn(step_s=0.1, latency_s=[0.0, 0.096, 0.2])
    env.reset(seed=0)
    assert env.step_s == pytest.approx(0.096)  # whole periods of 8 ms
    took = []
    for _ in range(20):
        before = env.state.timestamp
        *_, info = env.step(np.zeros(1, np.float32))
        took.append((round(env.state.timestamp - before, 6), info.get("late", False)))
    assert set(took) == {(0.096, False), (0.2, True)}


def test_during_the_policys_latency_the_last_action_goes_on():
    """An action takes effect in the control period in which it arrives, or the next one."""
    env = Turn(latency_s=0.024)
    env.reset(seed=0)
    speeds = []
    env.robot.controller.on_tick.append(lambda: speeds.append(env.state.target_qd[0]))
    env.step(np.ones(1, np.float32))
    first = next(i for i, speed in enumerate(speeds) if speed > 0.0)
    assert first in (4, 5)  # of 5 periods, the first 3 are the latency; a hook sees the period before


def test_scene_faults_can_be_injected_in_an_episode(env):
    """An episode can have any fault of ``inject_fault``."""
    env.reset(seed=0)
    fault = env.robot.inject_fault("missing_part", part="part")
    seen, _, ended, _, info = env.step(np.zeros(4, np.float32))
    assert seen["achieved_goal"][2] < 0
    assert ended
    assert info["stopped"] == "part fell off the table"
    env.robot.clear_fault(fault)
    assert play(env, 0)


def test_vector_environments_step_in_parallel():
    """Gymnasium's vector environment resets each environment at the end of its episode."""
    envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="sync")
    envs.action_space.seed(4)
    seen, _ = envs.reset(seed=[1, 2])
    assert seen["observation"].shape == (2, 32)
    assert not np.array_equal(*seen["observation"])
    for _ in range(3):
        seen, rewards, *_ = envs.step(envs.action_space.sample())
    assert rewards.shape == (2,)
    envs.close()


@pytest.mark.long
def test_environments_in_separate_processes_give_the_same_results_and_exit():
    """As in docs/learning.md. Workers do not need anything that a fork of this process would inherit."""
    runs = []
    for mode, options in (("sync", {}), ("async", {"context": "spawn"})):
        envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode=mode, vector_kwargs=options)
        envs.action_space.seed(4)
        run = [flat(envs.reset(seed=[1, 2])[0])]
        for _ in range(10):
            seen, rewards, *_ = envs.step(envs.action_space.sample())
            run += [flat(seen), rewards.copy()]
        workers = multiprocessing.active_children()
        envs.close()
        runs.append(b"".join(values.tobytes() for values in run))
        assert len(workers) == (2 if mode == "async" else 0)
        assert not any(worker.is_alive() for worker in workers)
    assert runs[0] == runs[1]


def test_invalid_options_are_a_one_line_error():
    for options, problem in (
        ({"step_s": -1.0}, r"step_s must be from 0.001 to 10 s, not \[-1.0\]"),
        ({"step_s": float("nan")}, "step_s must be"),
        ({"latency_s": []}, "latency_s must be from 0 to 10 s"),
        ({"latency_s": [0.1, -0.1]}, "latency_s must be"),
        ({"render_mode": "human"}, "render_mode must be rgb_array or None"),
    ):
        with pytest.raises(TaskError, match=problem):
            Turn(**options)

    class Broken(Turn):
        program = "def broken(:\nend\n"

    with pytest.raises(TaskError, match="Broken: its program does not start"):
        Broken()


class Turn(RobotEnv):
    """A user's task: turn the base to an angle, with an action of one number."""

    world = TASKS / "reach" / "scene.yaml"
    program = """def turn():
  while True:
    speedj([read_input_float_register(24), 0, 0, 0, 0, 0], 2.0, {step_s})
  end
end
"""

    def __init__(self, **options):
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,))
        super().__init__(**{"initial_q": (0.0, -1.5, 1.5, -1.57, -1.57, 0.0), **options})

    def arrange(self, options):
        pass

    def act(self, action):
        self.write(float(action[0]))

    def observe(self):
        return np.array([self.state.actual_q[0]], np.float32)

    def judge(self):
        return -abs(self.state.actual_q[0] - GOAL), False, {}


def test_a_task_of_ones_own_with_another_arm():
    env = Turn(model="ur5e")
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=0)
    for _ in range(90):
        seen, reward, *_ = env.step(np.clip(4.0 * (GOAL - seen), -1.0, 1.0).astype(np.float32))
    assert seen[0] == pytest.approx(GOAL, abs=0.01)
    assert reward > -0.01
