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
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta, Struct
from msgspec.structs import asdict

from client.controllers.configuration import sections, text_of
from client.controllers.goals import JointTrajectoryPoint
from client.errors import ControllerError
from urproto.structures import converted

GOAL_TIME_S: Final = 4.0
"""Duration that the ROS publishers give each goal [s]."""

_TURN: Final = 2 * math.pi  # a joint without given limits may be anywhere within one turn


class _Node(Struct):
    """A section of the file; it also has a goal for each of goal_names."""

    goal_names: Annotated[list[str], Meta(min_length=1)]
    controller_name: str = ""
    publish_topic: str = ""
    wait_sec_between_publish: Annotated[float, Meta(ge=0.0)] = 6.0  # default of the ROS publishers
    joints: tuple[str, ...] = ()
    check_starting_point: bool = False
    starting_point_limits: dict[str, Any] = {}


class _Goal(Struct, forbid_unknown_fields=True):
    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


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
    return _goal_file(node, found[node])


def _goal_file(node: str, given: Mapping[str, Any]) -> GoalFile:
    error = partial(ControllerError, node)
    read = converted(given, _Node, "", error)
    goals = tuple(FileGoal(name, _point(node, name, given.get(name), len(read.joints))) for name in read.goal_names)
    topic, _, channel = read.publish_topic.strip("/").rpartition("/")
    controller = read.controller_name.strip("/") or topic
    if not controller:
        raise error("it has neither a controller_name nor a publish_topic such as /controller/commands")
    strange = [key for key in given if key not in (*_Node.__struct_fields__, "use_sim_time", *read.goal_names)]
    notes = tuple(f"{node}: {key} is unknown, or not listed in goal_names, and is ignored" for key in strange)
    limits: dict[str, tuple[float, float]] = {}
    if read.check_starting_point:
        limits = dict.fromkeys(read.joints, (-_TURN, _TURN))
        for joint, pair in read.starting_point_limits.items():
            where = f"starting_point_limits.{joint}"
            low, high = limits[joint] = converted(pair, tuple[float, float], where, error)
            if low > high:
                raise error(f"{where} must be the lowest and the highest angle, not {low:g} and {high:g}")
    commands = channel == "commands"  # forward controllers take plain commands, on such a topic
    return GoalFile(node, controller, commands, read.joints, goals, read.wait_sec_between_publish, limits, notes)


def _point(node: str, name: str, given: Any, count: int) -> JointTrajectoryPoint:
    given = {"positions": given} if isinstance(given, list) else given or {}  # a list is the older form
    read = converted(given, _Goal, f"the goal {name}", partial(ControllerError, node))
    fields = asdict(read)
    for key, numbers in fields.items():
        if numbers and count and len(numbers) != count:
            raise ControllerError(node, f"{name}.{key} has {len(numbers)} numbers for {count} joints")
    if not any(fields.values()):
        raise ControllerError(node, f"the goal {name} has none of {', '.join(fields)}")
    return JointTrajectoryPoint(**fields, time_from_start_s=GOAL_TIME_S)
