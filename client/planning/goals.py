"""Goals of a plan: joint angles, a pose of the TCP, a named configuration, or any of several goals.

Up to eight configurations reach a pose, each also with single joints turned once more; all of them are candidates.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi, tau
from typing import Final, TypeAlias

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.quantities import check_fields
from urproto.joints import JOINT_LABELS
from urproto.robots import Joints, RobotModel
from urproto.robots.kinematics import unwind
from urproto.robots.pose import pose_inv, pose_trans
from urproto.text import quoted, unknown
from urproto.vectors import ZERO6, Vector3, as_six

NAMED_CONFIGURATIONS: Final[dict[str, Joints]] = {
    "home": (0.0, -pi / 2, 0.0, 0.0, 0.0, 0.0),
    "up": (0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0),
    "test_configuration": (1.54, -1.62, 1.4, -1.2, -1.6, -0.11),
}
"""The group states of ur_moveit_config's SRDF."""

_MAX_TURN_RAD: Final = 1.5 * pi  # a joint that is turned the other way round moves no farther than this


class _Target:
    """A goal whose numbers are checked. Raises PlanningError."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)


@dataclass(frozen=True, slots=True)
class JointGoal(_Target):
    """Exactly these joint angles [rad] (6,)."""

    q_rad: Sequence[float]


@dataclass(frozen=True, slots=True)
class PoseGoal(_Target):
    """A pose of the TCP (6,) [m, rotation vector] in the base frame.

    tcp_offset: flange to TCP. None means the robot's TCP when a robot plans, and the flange when there is no robot.
    """

    pose: Sequence[float]
    tcp_offset: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class CircGoal(_Target):
    """A pose of the TCP, as in a `PoseGoal`, at the end of an arc (planner ``CIRC``).

    Give either ``interim``, a point on the arc, or ``center``, the centre of the shorter arc: x, y, z [m] in the base
    frame. The orientation changes uniformly; as in Pilz' planner, there is none to reach at the interim point.
    """

    pose: Sequence[float]
    interim: Vector3 | None = None
    center: Vector3 | None = None
    tcp_offset: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class NamedGoal(_Target):
    """A configuration of `NAMED_CONFIGURATIONS`."""

    name: str


@dataclass(frozen=True, slots=True)
class GoalSet:
    """Any one of several goals: the search covers all of them, and the nearest one wins if a straight path leads there.

    A blend after it is about the TCP of the first goal.
    """

    goals: "Sequence[JointGoal | PoseGoal | NamedGoal]"

    def __post_init__(self) -> None:
        if not (isinstance(self.goals, Sequence) and self.goals):
            raise PlanningError("a GoalSet needs at least one goal")
        for goal in self.goals:
            if not isinstance(goal, JointGoal | PoseGoal | NamedGoal):
                raise PlanningError(f"a GoalSet has JointGoals, PoseGoals and NamedGoals, not {quoted(goal)}")


Goal: TypeAlias = JointGoal | PoseGoal | NamedGoal | CircGoal | GoalSet


class GoalUnreachableError(PlanningError):
    """No valid configuration reaches the goal; the message says which limit or collision prevents it."""


def goal_configurations(goal: Goal, start_rad: Sequence[float], checker: CollisionChecker) -> list[Joints]:
    """The collision-free configurations that reach a goal, nearest to the start first.

    Raises GoalUnreachableError, saying which limit or which collision rules out the best of them.
    """
    configurations = _configurations(goal, start_rad, checker)
    free = [q for q in configurations if checker.is_free(q)]
    if not free:
        raise GoalUnreachableError(f"the goal cannot be reached: {_reason(configurations, checker)}")
    return sorted(free, key=lambda q: _distance(q, start_rad))


def _configurations(goal: Goal, start_rad: Sequence[float], checker: CollisionChecker) -> list[Joints]:
    model = checker.scene.model
    if isinstance(goal, GoalSet):
        return _any_configurations(goal, start_rad, checker)
    if isinstance(goal, CircGoal):
        raise PlanningError("a CircGoal needs the planner CIRC: give other planners a PoseGoal")
    if isinstance(goal, NamedGoal):
        if goal.name not in NAMED_CONFIGURATIONS:
            raise GoalUnreachableError(unknown("configuration", goal.name, NAMED_CONFIGURATIONS))
        return [NAMED_CONFIGURATIONS[goal.name]]
    if isinstance(goal, JointGoal):
        q = as_six(goal.q_rad)
        _check_limits(q, model)
        return [q]
    flange = pose_trans(goal.pose, pose_inv(ZERO6 if goal.tcp_offset is None else goal.tcp_offset))
    solutions = checker.scene.kinematics.inverse_all(flange, start_rad)
    if not solutions:
        raise GoalUnreachableError(
            f"the goal cannot be reached: p[{', '.join(f'{value:.4f}' for value in goal.pose)}] is out of the reach of "
            f"a {model.title}"
        )
    low, high = model.position_limits
    nearest = [unwind(q, start_rad, low, high) for q in solutions]
    return [q for near in nearest for q in _with_full_turns(near, start_rad, low, high)]


def _any_configurations(goal: GoalSet, start_rad: Sequence[float], checker: CollisionChecker) -> list[Joints]:
    found: list[Joints] = []
    reasons: list[str] = []
    for number, one in enumerate(goal.goals, 1):
        try:
            found += _configurations(one, start_rad, checker)
        except GoalUnreachableError as error:
            reasons.append(f"goal {number}: {error}")
    if not found:
        raise GoalUnreachableError(f"none of {len(goal.goals)} goals can be reached: {'; '.join(reasons)}")
    return found


def _with_full_turns(q: Joints, start_rad: Sequence[float], low: Joints, high: Joints) -> Iterator[Joints]:
    """A configuration, and those with one joint turned the other way round, if that joint would move far."""
    yield q
    for i, (angle, start) in enumerate(zip(q, start_rad, strict=True)):
        turned = angle - tau if angle > start else angle + tau
        if abs(turned - start) <= _MAX_TURN_RAD and low[i] <= turned <= high[i]:
            yield as_six(turned if k == i else q[k] for k in range(6))


def _check_limits(q_rad: Joints, model: RobotModel) -> None:
    lowest, highest = model.position_limits
    for i, name in enumerate(JOINT_LABELS):
        low, angle, high = lowest[i], q_rad[i], highest[i]
        if not low <= angle <= high:
            raise GoalUnreachableError(
                f"the goal cannot be reached: {name} would be at {angle:.4f} rad, its limits are {low:.4f} and "
                f"{high:.4f} rad"
            )


def _reason(configurations: Sequence[Joints], checker: CollisionChecker) -> str:
    least = min(configurations, key=lambda q: -min((pair.distance_m for pair in checker.collisions(q)), default=0.0))
    many = f"in the best of {len(configurations)} configurations, " if len(configurations) > 1 else ""
    return many + checker.violation(least)


def _distance(q: Sequence[float], other: Sequence[float]) -> float:
    return sum((one - two) ** 2 for one, two in zip(q, other, strict=True))
