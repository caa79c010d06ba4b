"""Policies by rules, one for each task: what a policy that learns has to find.

    pip install '.[learning]'
    ur-emulator evaluate pick_and_place --policy examples/learning/scripted_policies.py:PickAndPlace --episodes 20

They command the tool's speed (control mode tcp_velocity), with one more number for a gripper.
"""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

GAIN = 20.0  # action per metre
NEAR_M = 0.004
TOOL, HOLDS = slice(0, 3), 19  # in an observation, see `observed`

Vector = NDArray[np.float64]


def towards(target: Vector, tool: Vector, *gripper: float) -> NDArray[np.float32]:
    """The action that brings the tool nearer to a point."""
    return np.array([*np.clip(GAIN * (target - tool), -1.0, 1.0), *gripper], np.float32)


def near(target: Vector, tool: Vector, least_m: float = NEAR_M) -> bool:
    """Whether the tool is there."""
    return float(np.abs(target - tool).max()) < least_m


class Reach:
    """Straight to the goal."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""

    def __call__(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """The action for an observation."""
        return towards(seen["desired_goal"], seen["observation"][TOOL])


class Push:
    """Above a point behind the part, seen from the goal; down; and then through the part to the goal."""

    BEHIND_M, ABOVE_M, TOUCH_M = 0.05, 0.07, 0.029
    STRAY_M = 0.008  # of the part from the line; then again
    SLOW = 0.35

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.stage = 0

    def __call__(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """The action for an observation."""
        tool, part, goal = seen["observation"][TOOL], seen["achieved_goal"], seen["desired_goal"]
        away = (goal - part) * (1.0, 1.0, 0.0)
        ahead = away / max(float(np.linalg.norm(away)), 1e-6)
        behind = part - self.BEHIND_M * ahead
        if self.stage == 0:
            above = np.array([*behind[:2], self.ABOVE_M])
            if near(above, tool, 0.01):
                self.stage = 1
            if tool[2] < self.ABOVE_M - 0.01:  # first up
                return towards(np.array([*tool[:2], self.ABOVE_M]), tool)
            return towards(above, tool)
        if self.stage == 1:
            self.stage += near(behind, tool)
            return towards(behind, tool)
        lag = (part - tool) * (1.0, 1.0, 0.0)
        aside = float(np.linalg.norm(lag - lag.dot(ahead) * ahead))
        if aside > self.STRAY_M:
            self.stage = 0
        return self.SLOW * towards(tool + lag - lag.dot(ahead) * ahead + 0.05 * ahead, tool)


class PickAndPlace:
    """Above the part, down, grip, up, above the goal, to the goal."""

    ABOVE_M = 0.08

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.stage = 0

    def __call__(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """The action for an observation."""
        tool, holds = seen["observation"][TOOL], seen["observation"][HOLDS] > 0.5
        part, goal, up = seen["achieved_goal"], seen["desired_goal"], np.array([0.0, 0.0, self.ABOVE_M])
        target, closed = [
            (part + up, False),
            (part, False),
            (part, True),
            (np.array([*tool[:2], self.ABOVE_M]), True),
            (np.array([*goal[:2], self.ABOVE_M]), True),
            (goal, True),
        ][self.stage]
        if self.stage < 5:
            self.stage += bool(holds) if self.stage == 2 else near(target, tool)
        return towards(target, tool, 1.0 if closed else -1.0)


class PegInHole:
    """Above the hole, and straight down."""

    ABOVE_M = 0.05

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.inserting = False

    def __call__(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """The action for an observation."""
        tool, goal = seen["observation"][TOOL], seen["desired_goal"]
        above = goal + np.array([0.0, 0.0, self.ABOVE_M])
        self.inserting = self.inserting or near(above, tool, 0.0003)
        return towards(goal if self.inserting else above, tool)
