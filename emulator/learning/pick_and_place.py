"""Pick up a part and place it at a goal: ``ur_emulator/PickAndPlace-v0``."""

from math import dist, hypot, pi
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from emulator.learning.environment import RobotEnv, TaskError

LONGEST: Final = 250
"""Steps of an episode: 10 s of robot time."""
PART: Final = "part"
HOLDING: Final = 1  # the input of the gripper, see pick_and_place.yaml
HOME: Final = (0.0, -1.5, 1.5, -pi / 2, -pi / 2, 0.0)  # rad: tool straight down
SPEED_M_S: Final = 0.25  # of the tool along each axis, for an action of 1
LOW: Final = (-0.65, -0.4, 0.015)
"""With `HIGH`, corners of the box in which the tool may move, in the base frame [m]."""
HIGH: Final = (-0.25, 0.1, 0.35)
_TABLE: Final = ((-0.55, -0.35), (-0.3, 0.0))  # x and y of part and goal
_RESTING_M: Final = 0.02  # height of the part's middle, lying
_APART_M: Final = 0.1  # minimum distance of part and goal at the beginning
_NEAR_M: Final = 0.03  # distance from the goal that counts as reached
_LIFTED_M: Final = 0.005  # off the table
_FALLEN_M: Final = -0.05
_BRAKING_S: Final = 0.2  # the speed towards a side of the box is limited to the remaining distance in this time
_GRASP_REWARD: Final = 0.5
_DONE_REWARD: Final = 10.0
_FAR: Final = 5.0  # bounds of what is observed


class PickAndPlaceEnv(RobotEnv[NDArray[np.float32], NDArray[np.float32]]):
    """Move a part of 40 mm and 0.1 kg on a table from a random place to another.

    action (4,): speeds of the tool along x, y, z of the base frame, -1 to 1 for -0.25 to 0.25 m/s, and the gripper: it
    closes above 0. The tool stays vertical, and in a box above the table.

    observation (14,): position (3) [m] and velocity (3) [m/s] of the tool, whether the gripper was commanded to close,
    whether it holds something, position of the part (3) and of the goal (3) [m].

    reward: dense: after each step minus the distances from tool to part and from part to goal [m], plus 0.5 while the
    gripper holds something; sparse: none. In both cases 10 when the part lies at the goal, released.

    The episode ends then (``info["success"]``), when the part falls off the table, or when the robot stops. Options of
    ``reset``: ``part`` and ``goal``, x and y [m], instead of random places.
    """

    world = Path(__file__).with_name("pick_and_place.yaml")
    program = """def pick_and_place():
  set_tcp(p[0, 0, 0.11, 0, 0, 0])
  set_payload(0.5, [0, 0, 0.035])
  while True:
    set_standard_digital_out(0, read_input_boolean_register(64))
    v = [read_input_float_register(24), read_input_float_register(25), read_input_float_register(26), 0, 0, 0]
    speedl(v, 2.0, {step_s})
  end
end
"""

    def __init__(self, *, reward: str = "dense", **options: Any) -> None:
        if reward not in ("dense", "sparse"):
            raise TaskError(f"reward must be dense or sparse, not {reward!r}")
        self.observation_space = spaces.Box(-_FAR, _FAR, (14,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)
        self._dense = reward == "dense"
        self._goal = (0.0, 0.0, 0.0)
        self._closing = False
        super().__init__(**{"initial_q": HOME, **options})

    def arrange(self, options: dict[str, Any]) -> None:
        if unknown := set(options) - {PART, "goal"}:
            raise ValueError(f"reset has no option {min(unknown)!r}: choose part or goal")
        part = _place(options, PART)
        goal = _place(options, "goal")
        if part is None:
            part = self._random_place()
        while goal is None or ("goal" not in options and hypot(*(goal - part)) < _APART_M):
            goal = self._random_place()
        self._goal = (float(goal[0]), float(goal[1]), _RESTING_M)
        self._closing = False
        self.scene.move(PART, (float(part[0]), float(part[1]), _RESTING_M + 1e-4, 0.0, 0.0, 0.0))

    def _random_place(self) -> NDArray[np.float64]:
        return np.array([self.np_random.uniform(*along) for along in _TABLE])

    def act(self, action: NDArray[np.float32]) -> None:
        *along, closing = np.asarray(action, float).tolist()
        place = self.state.actual_TCP_pose[:3]
        self.write(
            *(
                _within((low - at) / _BRAKING_S, SPEED_M_S * _within(-1.0, share, 1.0), (high - at) / _BRAKING_S)
                for share, at, low, high in zip(along, place, LOW, HIGH, strict=True)
            )
        )
        self._closing = closing > 0.0
        self.switch(self._closing)

    def observe(self) -> NDArray[np.float32]:
        state = self.state
        values = (*state.actual_TCP_pose[:3], *state.actual_TCP_speed[:3], self._closing, self._holding, *self._part)
        return np.array((*values, *self._goal), np.float32).clip(-_FAR, _FAR)

    def judge(self) -> tuple[float, bool, dict[str, Any]]:
        part, goal = self._part, self._goal
        away = dist(part, goal)
        there = dist(part[:2], goal[:2]) < _NEAR_M and part[2] < _RESTING_M + _LIFTED_M
        success = there and not self._closing and not self._holding
        reward = _DONE_REWARD if success else 0.0
        if self._dense:
            reach = dist(part, self.state.actual_TCP_pose[:3])
            reward += _GRASP_REWARD * self._holding - reach - away
        return reward, success or part[2] < _FALLEN_M, {"success": success, "distance_m": away}

    @property
    def _holding(self) -> bool:
        return bool(self.state.actual_digital_input_bits >> HOLDING & 1)

    @property
    def _part(self) -> tuple[float, ...]:
        return self.scene.pose(PART)[:3]


def _within(low: float, value: float, high: float) -> float:
    return min(max(value, low), high)


def _place(options: dict[str, Any], name: str) -> NDArray[np.float64] | None:
    """The place of an object from the options of ``reset``. Raises ValueError."""
    if options.get(name) is None:
        return None
    place = np.asarray(options[name], float)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise ValueError(f"{name} must be x and y [m], not {options[name]!r}")
    return place
