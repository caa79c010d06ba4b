"""Goal files, in the format of the publishers of ros2_controllers_test_nodes.

publisher_joint_trajectory_controller:
  ros__parameters:
    controller_name: scaled_joint_trajectory_controller
    wait_sec_between_publish: 6
    goal_names: [pos1, pos2]
    pos1: {positions: [0.785, -1.57, 0.785, 0.785, 0.785, 0.785]}
    pos2: {positions: [0.0, -1.57, 0.0, 0.0, 0.0, 0.0]}
    joints: [shoulder_pan_joint, shoulder_lift_joint, ...]
    check_starting_point: true
    starting_point_limits: {shoulder_pan_joint: [-0.1, 0.1], ...}
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from client.controllers.configuration import sections, text_of
from client.controllers.goals import JointTrajectoryPoint
from client.errors import ControllerError
from urproto.text import quoted
from urproto.vectors import is_number

GOAL_TIME_S: Final = 4.0
"""Duration that the ROS publishers give each goal [s]."""

_WAIT_S: Final = 6.0  # default of the ROS publishers
_FIELDS: Final = ("positions", "velocities", "accelerations", "effort")
_KNOWN: Final = (
    "controller_name", "publish_topic", "wait_sec_between_publish", "goal_names", "joints", "check_starting_point",
    "starting_point_limits", "use_sim_time",
)  # fmt: skip
_TURN: Final = 2 * math.pi  # a joint without given limits may be anywhere within one turn


@dataclass(frozen=True, slots=True)
class FileGoal:
    """A named target; for forward controllers, ``positions`` contains the commands."""

    name: str
    point: JointTrajectoryPoint


@dataclass(frozen=True, slots=True)
class GoalFile:
    """Goals for one controller, in the order of goal_names.

    commands: whether the controller takes plain commands, as forward controllers do. joints: order of the goals'
    numbers, empty if the file does not say. starting_point_limits: by joint [rad], empty unless they are to be checked.
    notes: entries of the file that are ignored.
    """

    node: str
    controller: str
    commands: bool
    joints: tuple[str, ...]
    goals: tuple[FileGoal, ...]
    wait_s: float
    starting_point_limits: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...] = ()

    def check_start(self, q_rad: Mapping[str, float]) -> None:
        """Raise ControllerError if a joint is outside the limits for the start. q_rad: joint angles by name [rad]."""
        for joint, (low, high) in self.starting_point_limits.items():
            q = q_rad.get(joint)
            if q is None:
                raise ControllerError(self.node, f"starting_point_limits names {joint}, which the robot does not have")
            if not low <= q <= high:
                raise ControllerError(
                    self.node,
                    f"the arm is not within the limits for the start: {joint} is at {q:.3f} rad, not between "
                    f'{low:g} and {high:g}; move it there first: ur-client goal --positions "{self._start(q_rad)}"',
                )

    def _start(self, q_rad: Mapping[str, float]) -> str:
        """A permitted start near the arm's position: joints outside their limits move to the middle."""
        limits = self.starting_point_limits
        nearest = {
            joint: q if (pair := limits.get(joint, (q, q)))[0] <= q <= pair[1] else sum(pair) / 2.0
            for joint, q in q_rad.items()
        }
        return ",".join(f"{q:.3f}" for q in nearest.values())


def read_goals(path: Path, node: str | None = None) -> GoalFile:
    """Read the goals of a node; by default the only one in the file. Raises ControllerError, OSError."""
    found = {name: given for name, given in sections(text_of(path), str(path), {}).items() if "goal_names" in given}
    if node is None and len(found) == 1:
        (node,) = found
    if node is None or node not in found:
        names = ", ".join(found) or "none"
        raise ControllerError(str(path), f"name one of its sections with goal_names ({names}), not {node or 'none'}")
    return _Section(node, found[node]).read()


class _Section:
    def __init__(self, node: str, given: Mapping[str, Any]) -> None:
        self._node = node
        self._given = given

    def read(self) -> GoalFile:
        joints = tuple(self._texts("joints")) if "joints" in self._given else ()
        names = self._texts("goal_names")
        if not names:
            raise self._error("goal_names is empty")
        goals = tuple(FileGoal(name, self._point(name, len(joints))) for name in names)
        controller, commands = self._target()
        strange = [key for key in self._given if key not in (*_KNOWN, *names)]
        notes = tuple(f"{self._node}: {key} is unknown, or not listed in goal_names, and is ignored" for key in strange)
        wait_s = self._number("wait_sec_between_publish", _WAIT_S)
        return GoalFile(self._node, controller, commands, joints, goals, wait_s, self._limits(joints), notes)

    def _target(self) -> tuple[str, bool]:
        """The controller, and whether it takes plain commands, which a topic ~/commands shows."""
        topic = str(self._given.get("publish_topic", "")).strip("/")
        name, _, channel = topic.rpartition("/")
        if "controller_name" in self._given:
            return str(self._given["controller_name"]).strip("/"), channel == "commands"
        if not name:
            raise self._error("it has neither a controller_name nor a publish_topic such as /controller/commands")
        return name, channel == "commands"

    def _point(self, name: str, count: int) -> JointTrajectoryPoint:
        given = self._given.get(name)
        if isinstance(given, list):  # the older form
            given = {"positions": given}
        if not isinstance(given, Mapping) or not set(given) & set(_FIELDS):
            raise self._error(f"the goal {name} has none of {', '.join(_FIELDS)}")
        if unknown := sorted(set(given) - set(_FIELDS)):
            raise self._error(f"the goal {name} has an unknown field {unknown[0]}: use {', '.join(_FIELDS)}")
        values = {key: self._numbers(f"{name}.{key}", given.get(key, ())) for key in _FIELDS}
        for key, numbers in values.items():
            if numbers and count and len(numbers) != count:
                raise self._error(f"{name}.{key} has {len(numbers)} numbers for {count} joints")
        return JointTrajectoryPoint(**values, time_from_start_s=GOAL_TIME_S)

    def _limits(self, joints: Sequence[str]) -> dict[str, tuple[float, float]]:
        if self._given.get("check_starting_point", False) is not True:
            return {}
        given = self._given.get("starting_point_limits", {})
        if not isinstance(given, Mapping):
            raise self._error("starting_point_limits must have a pair of numbers for each joint")
        limits = dict.fromkeys(joints, (-_TURN, _TURN))
        for joint, pair in given.items():
            numbers = self._numbers(f"starting_point_limits.{joint}", pair)
            if len(numbers) != 2 or numbers[0] > numbers[1]:
                raise self._error(
                    f"starting_point_limits.{joint} must be the lowest and the highest angle, not {quoted(pair)}"
                )
            limits[joint] = (numbers[0], numbers[1])
        return limits

    def _texts(self, key: str) -> list[str]:
        value = self._given.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self._error(f"{key} must be a list of names, not {quoted(value)}")
        return value

    def _numbers(self, key: str, value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or not all(is_number(item) for item in value):
            raise self._error(f"{key} must be a list of numbers, not {quoted(value)}")
        return tuple(float(item) for item in value)

    def _number(self, key: str, default: float) -> float:
        value = self._given.get(key, default)
        if not is_number(value) or value < 0:
            raise self._error(f"{key} must be a number of seconds, not {quoted(value)}")
        return float(value)

    def _error(self, reason: str) -> ControllerError:
        return ControllerError(self._node, reason)
