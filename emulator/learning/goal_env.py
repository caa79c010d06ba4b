"""A task of a folder as an environment, in the conventions of Gymnasium-Robotics for goals.

Observations are dictionaries with what was achieved and what is desired, and ``compute_reward`` takes many of both at
once, so that algorithms can learn from goals that were not meant (hindsight experience replay).
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from math import dist, pi
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from emulator.learning.control_modes import CONTROL_MODES, ControlMode
from emulator.learning.environment import FIRST_BIT, RobotEnv
from emulator.learning.task_file import GOAL, SCENE_FILE, Region, TaskError, find_task, read_task
from urproto.robots import RobotModel, kinematics_of, load_model
from urproto.robots.pose import pose_inv, pose_trans
from urproto.text import unknown
from urproto.vectors import Vector3

ENTRY: Final = "emulator.learning.goal_env:GoalEnv"
_REWARDS: Final = ("sparse", "dense")
_NEAR_Q: Final = (0.0, -1.5, 1.5, -pi / 2, -pi / 2, 0.0)  # rad: elbow up
_START_HEIGHT: Final = 0.6  # of the workspace
_DOWN: Final = (0.0, pi, 0.0)  # rotation vector of a tool that points to the table
_LOST_M: Final = 0.05  # below where an object lay: it fell off the table
_TRIES: Final = 1000
_FAR: Final = 10.0  # bounds of what is observed
_DRAWN_FOR_M: Final = 0.85  # reach of the arm for which the cameras of scenes stand right

Observation = dict[str, Any]
Action = NDArray[np.float32]


class GoalEnv(RobotEnv[Observation, Action]):
    """A task of a folder (docs/learning.md).

    task: ``reach``, ``push``, ``pick_and_place``, ``peg_in_hole``, or a folder of yours.

    action: numbers of the control mode, and one more for a gripper, which closes above 0: see `CONTROL_MODES`. The
    tool stays vertical in the modes of the tool.

    observation: ``observation`` (the numbers named by `observed`), ``achieved_goal`` and ``desired_goal`` (3) [m], the
    position of the TCP or the moved object, and the wanted one, in the base frame. cameras: names of cameras of the
    scene, whose pictures (height, width, 3) are then in ``pixels``.

    reward: sparse: 0 at the goal, otherwise -1; dense: minus the distance [m]. An episode goes on at the goal, where
    ``info["is_success"]`` is true, unless continuing_task is False. It ends when the moved object falls off the table
    or when the robot stops, for the reason ``info["stopped"]``. Options of ``reset``: ``goal`` (x, y, z [m]), and the
    names of objects (x, y [m]), instead of random places.

    model: the arm, whose reach determines the size of the task. Other options are those of `RobotEnv`.
    """

    def __init__(
        self,
        task: str,
        *,
        reward: str = "sparse",
        control_mode: str = "tcp_velocity",
        continuing_task: bool = True,
        cameras: Sequence[str] = (),
        model: str = "ur5",
        **options: Any,
    ) -> None:
        if reward not in _REWARDS:
            raise TaskError(unknown("reward", reward, _REWARDS))
        if control_mode not in CONTROL_MODES:
            raise TaskError(unknown("control mode", control_mode, CONTROL_MODES))
        folder = find_task(task)
        self.task = read_task(folder)
        self.world = folder / SCENE_FILE
        self.arm = load_model(model)
        self.workspace = self.task.workspace.corners(self.arm)
        self._mode: ControlMode = CONTROL_MODES[control_mode](self.arm, self.workspace)
        self.program = self._program()
        self._dense, self._continuing, self._seen_by = reward == "dense", continuing_task, tuple(cameras)
        self._goal: Vector3 = (0.0, 0.0, 0.0)
        self._closing = False
        super().__init__(**{"initial_q": self._start_q(), "model": model, **options})
        needed = {*self.task.places, *([self.task.goal_at.of] if self.task.goal_at else [])}
        if strange := needed - {*self.scene.names()}:
            raise TaskError(f"{folder}: {SCENE_FILE} {unknown('object', min(strange), self.scene.names())}")
        self.action_space = self._actions()
        self.observation_space = self._observations()

    # Gymnasium-Robotics

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The reward for achieving one goal where another is desired, both (3,), or (n, 3) for n rewards at once."""
        away = np.linalg.norm(np.asarray(achieved_goal) - np.asarray(desired_goal), axis=-1)
        return -away if self._dense else -(away > self.task.distance_m).astype(np.float64)

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        """Whether the episode ends because of the goals."""
        return not self._continuing and dist(achieved_goal, desired_goal) <= self.task.distance_m

    def compute_truncated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        """Never: Gymnasium's time limit ends episodes."""
        return False

    # RobotEnv

    def furnish(self) -> None:
        """Put the cameras that stand around the arm where they see an arm of this size as they see a UR5."""
        model = self.scene.model
        model.cam_pos[model.cam_bodyid == 0] *= self.arm.reach_m / _DRAWN_FOR_M

    def keep_still(self) -> None:
        self.write(*self._mode.begin(self.state))
        self.switch(False)

    def arrange(self, options: dict[str, Any]) -> None:
        if strange := set(options) - {GOAL, *self.task.places}:
            raise ValueError(unknown("option of reset", min(strange, key=str), [GOAL, *self.task.places]))
        if GOAL in options and self.task.goal_at:
            raise ValueError(f"the goal of this task is a point of {self.task.goal_at.of}: give the place of that")
        given = {name: self._given(name, options[name]) for name in options}
        for _ in range(_TRIES):
            places = {name: given.get(name) or self._draw(region) for name, region in self.task.places.items()}
            apart = [*places.values()]
            if self.task.goal is not None:
                self._goal = given.get(GOAL) or self._draw(self.task.goal)
                apart.append(self._goal)
            if len(given) == len(apart) or _least_distance(apart) >= self.task.apart_m:
                break
        else:
            raise TaskError(f"no places found that are {self.task.apart_m:g} m apart: give another place or apart_m")
        for name, place in places.items():
            self.move(name, (*place, 0.0, 0.0, 0.0))
        if (point := self.task.goal_at) is not None:
            x, y, z, *_ = pose_trans(self.scene.pose(point.of), (*point.offset, 0.0, 0.0, 0.0))
            self._goal = (x, y, z)
        self._closing = False

    def act(self, action: Action) -> None:
        values = np.asarray(action, float)
        if values.shape != self.action_space.shape:
            size = self.action_space.shape
            raise ValueError(f"an action of this task must be {size[0] if size else 0} numbers, not {action}")
        *numbers, closing = values.tolist() if self.task.gripper else [*values.tolist(), 0.0]
        self.write(*self._mode.registers(numbers, self.state, self.step_s))
        self._closing = closing > 0.0
        self.switch(self._closing)

    def observe(self) -> Observation:
        seen = np.array([*chain.from_iterable(self._parts().values())], np.float32).clip(-_FAR, _FAR)
        achieved, desired = (np.array(place, np.float64) for place in (self._achieved(), self._goal))
        found: Observation = {"observation": seen, "achieved_goal": achieved, "desired_goal": desired}
        if self._seen_by:
            found["pixels"] = {name: self.picture(name) for name in self._seen_by}
        return found

    def judge(self) -> tuple[float, bool, dict[str, Any]]:
        achieved = self._achieved()
        away_m = dist(achieved, self._goal)
        info: dict[str, Any] = {"is_success": away_m <= self.task.distance_m, "distance_m": away_m}
        ended = self.compute_terminated(achieved, self._goal, info)
        if self.task.moved and achieved[2] < self.task.places[self.task.moved].z_m - _LOST_M:
            ended, info = True, info | {"stopped": f"{self.task.moved} fell off the table"}
        return float(self.compute_reward(achieved, self._goal, info)), ended, info

    @property
    def observed(self) -> Mapping[str, int]:
        """What ``observation`` consists of: names, in order, and how many numbers each has."""
        return {name: len(values) for name, values in self._parts().items()}

    # parts

    def _parts(self) -> dict[str, Sequence[float]]:
        state, task = self.state, self.task
        parts: dict[str, Sequence[float]] = {
            "tcp_position": state.actual_TCP_pose[:3],
            "tcp_velocity": state.actual_TCP_speed[:3],
            "q": state.actual_q,
            "qd": state.actual_qd,
        }
        if task.gripper:
            holding = state.actual_digital_input_bits >> task.gripper.holding & 1
            parts["gripper"] = (float(self._closing), float(holding))
        if task.forces:
            parts["tcp_force"] = state.actual_TCP_force
        if task.moved:
            parts[f"{task.moved}_pose"] = self.scene.pose(task.moved)
            parts[f"{task.moved}_velocity"] = self.scene.velocity(task.moved)
        return parts

    def _achieved(self) -> Vector3:
        pose = self.scene.pose(self.task.moved) if self.task.moved else self.state.actual_TCP_pose
        return (pose[0], pose[1], pose[2])

    def _draw(self, region: Region) -> Vector3:
        return region.draw(self.arm, self.np_random)

    def _given(self, name: str, place: Any) -> Vector3:
        """A place from the options of ``reset``. Raises ValueError."""
        size = 3 if name == GOAL else 2
        low, high = self.workspace
        values = np.asarray(place, float) if _is_numbers(place, size) else None
        if values is None or not all(at <= value <= to for at, value, to in zip(low, values, high, strict=False)):
            spans = [f"{axis} from {at:.3f} to {to:.3f}" for axis, at, to in zip("xyz", low, high, strict=True)]
            where = ", ".join(spans[:size])
            raise ValueError(f"{name} must be {size} numbers within the workspace, {where} m, not {place!r}")
        x, y, *z = values.tolist()
        return (x, y, z[0] if z else self.task.places[name].z_m)

    def _start_q(self) -> tuple[float, ...]:
        """Joint angles with the tool above the middle of the workspace, pointing down. Raises TaskError."""
        low, high = self.workspace
        x, y = (0.5 * (low[i] + high[i]) for i in range(2))
        tcp = (x, y, low[2] + _START_HEIGHT * (high[2] - low[2]), *_DOWN)
        flange = pose_trans(tcp, pose_inv(self.task.tcp))
        arm: RobotModel = self.arm
        found = kinematics_of(arm).inverse_near(flange, _NEAR_Q, arm.q_min, arm.q_max)
        if found is None:
            raise TaskError(f"the {arm.title} does not reach the middle of the workspace: {x:.3f}, {y:.3f} m")
        return found

    def _program(self) -> str:
        task = self.task
        lines = ["def task():", f"  set_tcp(p[{', '.join(f'{value:g}' for value in task.tcp)}])"]
        if task.payload:
            cog = ", ".join(f"{value:g}" for value in task.payload.cog)
            lines.append(f"  set_payload({task.payload.mass:g}, [{cog}])")
        lines.append("  while True:")
        if task.gripper:
            closing = f"read_input_boolean_register({FIRST_BIT})"
            lines.append(f"    set_standard_digital_out({task.gripper.output}, {closing})")
        return "\n".join([*lines, f"    {self._mode.script}", "  end", "end", ""])

    def _actions(self) -> spaces.Space[Action]:
        low, high = self._mode.bounds
        if self.task.gripper:
            low, high = [*low, -1.0], [*high, 1.0]
        space: Any = spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
        found: spaces.Space[Action] = space
        return found

    def _observations(self) -> spaces.Dict:
        place = spaces.Box(-_FAR, _FAR, (3,), np.float64)
        found: dict[str, spaces.Space[Any]] = {
            "observation": spaces.Box(-_FAR, _FAR, (sum(self.observed.values()),), np.float32),
            "achieved_goal": place,
            "desired_goal": place,
        }
        if self._seen_by:
            boxes = {name: spaces.Box(0, 255, self.picture(name).shape, np.uint8) for name in self._seen_by}
            found["pixels"] = spaces.Dict({**boxes})
        return spaces.Dict(found)


def of_folder(task: str, **options: Any) -> TimeLimit[Observation, Action]:
    """A task of a folder, whose episodes have as many steps as it says."""
    env = GoalEnv(task, **options)
    return TimeLimit(env, env.task.steps)


def _is_numbers(values: Any, size: int) -> bool:
    try:
        return np.asarray(values, float).shape == (size,)
    except (TypeError, ValueError):
        return False


def _least_distance(places: Sequence[Vector3]) -> float:
    """The least horizontal distance between two of the places; infinite for fewer."""
    pairs = [(a, b) for i, a in enumerate(places) for b in places[:i]]
    return min((dist(a[:2], b[:2]) for a, b in pairs), default=float("inf"))
