"""Pick a part up and put it down elsewhere by rules, without learning: what a policy for PickAndPlace-v0 has to find.

    pip install '.[learning]'
    python examples/learning/scripted_policy.py 3

plays three episodes, and says how each ended.
"""

import sys

import gymnasium
import numpy as np
from numpy.typing import NDArray

ABOVE_M = 0.1
GAIN = 20.0  # action per metre


class ScriptedPolicy:
    """Above the part, down, grip, up, above the goal, down, let go."""

    def __init__(self) -> None:
        self.stage = 0

    def __call__(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """The action for an observation."""
        tool, holds, part, goal = seen[:3], seen[7] > 0.5, seen[8:11], seen[11:14]
        up = np.array([0.0, 0.0, ABOVE_M])
        target, closed = [
            (part + up, False),
            (part, False),
            (part, True),
            (np.array([*tool[:2], ABOVE_M]), True),
            (goal + up, True),
            (goal, True),
            (goal, False),
        ][self.stage]
        away = target - tool
        done = bool(holds) if self.stage == 2 else float(np.abs(away).max()) < 0.005
        if done and self.stage < 6:
            self.stage += 1
        return np.array([*np.clip(GAIN * away, -1.0, 1.0), 1.0 if closed else -1.0], np.float32)


def main(episodes: int = 1) -> None:
    """Play so many episodes."""
    env = gymnasium.make("emulator.learning:ur_emulator/PickAndPlace-v0")
    for seed in range(episodes):
        policy, steps, over = ScriptedPolicy(), 0, False
        seen, _ = env.reset(seed=seed)
        while not over:
            seen, _, ended, late, info = env.step(policy(seen))
            steps, over = steps + 1, ended or late
        print(f"episode {seed}: {'done' if info['success'] else 'not done'} after {steps} steps")
    env.close()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
