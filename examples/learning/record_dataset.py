"""A dataset for LeRobot from episodes in virtual time: what a policy by rules does, for another one to imitate.

    pip install '.[learning,lerobot]'
    python examples/learning/record_dataset.py pick_and_place 50 picks

plays 50 episodes and writes those that reach the goal, at 25 frames per second of robot time, to the folder picks.
"""

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from client.lerobot import Episode, write_episodes
from emulator.learning import GoalEnv

POLICIES = {"reach": "Reach", "push": "Push", "pick_and_place": "PickAndPlace", "peg_in_hole": "PegInHole"}
GOALS = ("achieved_goal", "desired_goal")


def goals(seen: dict[str, Any]) -> np.ndarray:
    """What is to be moved, and where to."""
    return np.concatenate([seen[name] for name in GOALS]).astype(np.float32)


def play(env: GoalEnv, policy: Any, task: str, episodes: int) -> Iterator[Episode]:
    """Play episodes with the seeds from 0 on, and yield those that reach the goal."""
    for seed in range(episodes):
        seen, _ = env.reset(seed=seed)
        policy.reset(seed)
        states, actions, environment, ended, info = [], [], [], False, {}
        while not ended and len(states) < env.task.steps:
            action = policy(seen)
            states.append(seen["observation"])
            actions.append(action)
            environment.append(goals(seen))
            seen, _, ended, _, info = env.step(action)
        if info["is_success"]:
            yield Episode(task, np.array(states), np.array(actions), environment=np.array(environment))


def main(task: str, episodes: str, folder: str) -> None:
    """Record so many episodes of a task."""
    env = GoalEnv(task, continuing_task=False)
    policy = runpy.run_path(str(Path(__file__).with_name("scripted_policies.py")))[POLICIES[task]](env)
    made = write_episodes(
        folder,
        play(env, policy, task, int(episodes)),
        fps=round(1.0 / env.step_s),
        state=[f"{name}[{i}]" for name, size in env.observed.items() for i in range(size)],
        action=[f"action[{i}]" for i in range(env.action_space.shape[0])],
        environment=[f"{name}[{i}]" for name in GOALS for i in range(3)],
        robot_type=env.arm.name,
    )
    print(f"{made.episodes} episodes, {made.frames} frames: {made.path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
