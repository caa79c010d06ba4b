"""Plan a trajectory from start to goal: find a path, shortcut it, round its corners and parameterise it over time.

OMPL searches for the path. It checks configurations only every tenth of a radian, which is cheap. Each segment of the
path it returns is then verified as a whole; if one is in collision, the search is repeated at a finer resolution.
"""

import time
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise
from random import Random
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from client.errors import PlanningError
from client.planning.cartesian import cartesian_motions
from client.planning.collisions import CollisionChecker
from client.planning.constraints import ConstrainedChecker, PathConstraints
from client.planning.goals import Goal, GoalSet, PoseGoal, goal_configurations
from client.planning.industrial import (
    INDUSTRIAL,
    BlendedMotion,
    CartesianLimits,
    IncompletePathError,
    MotionSequenceItem,
    PlannedSegment,
    blended_motions,
    cartesian_segment,
    first_collision,
    interpolator_for,
    ptp_segment,
)
from client.planning.lines import COLUMNS
from client.planning.parameterisation import Array, Limits, Trajectory, parameterise
from client.planning.path import RoundedPath, rounded_corner
from client.planning.scene import PlanningScene
from client.planning.search import TaskSpaceSearch, search_joint_space
from client.quantities import checked
from urproto.robots import Joints, RobotModel
from urproto.text import quoted, unknown
from urproto.vectors import as_six

PlannerName = Literal["RRTConnect", "RRTstar", "PRM", "PTP", "LIN", "CIRC"]
PLANNERS: Final[tuple[str, ...]] = get_args(PlannerName)

_RESOLUTIONS_RAD: Final = (0.1, 0.04, 0.015)  # between OMPL's validity checks; finer on each further attempt
_SHORTCUT_ATTEMPTS: Final = 40
_START_TOLERANCE_RAD: Final = 0.02  # guess: more than an arm sags, less than any clearance
_DISTINCT_RAD: Final = 1e-6  # closer waypoints count as the same one
_ROUNDINGS: Final = 7  # times that the roundness of a corner in collision is halved
_SAMPLE_S: Final = 0.04  # between points of a trajectory (guess)
_A_RAD_S2: Final = 5.0  # ur_moveit_config/config/joint_limits.yaml, all joints; that file limits no jerk
_J_RAD_S3: Final = 200.0  # guess


class StartInCollisionError(PlanningError):
    """The start configuration is in collision, closer to something than the padding, or violates a constraint."""


class NoPathError(PlanningError):
    """No path was found within the time limit."""


def default_limits(model: RobotModel, jerk_rad_s3: float = _J_RAD_S3) -> Limits:
    """Joint limits of an arm: speeds from ur_description, accelerations from ur_moveit_config's joint_limits.yaml."""
    return Limits(np.array(model.qd_max), np.full(6, _A_RAD_S2), np.full(6, jerk_rad_s3))


@dataclass(frozen=True, slots=True)
class Plan:
    """A collision-free trajectory, and how it was computed.

    path: the configurations [rad] at its corners; for lines and arcs, at their ends. planner: the planner that found
    it. search_s, shortcutting_s, parameterisation_s: wall-clock time of each step. stopped_by: why it ends before the
    goal, if it covers only a fraction of a Cartesian path.
    """

    trajectory: Trajectory
    path: tuple[Joints, ...]
    planner: str
    search_s: float
    shortcutting_s: float
    parameterisation_s: float
    stopped_by: str = ""

    @property
    def duration_s(self) -> float:
        return self.trajectory.duration_s

    def check_start(self, q_rad: Sequence[float]) -> None:
        """Raise PlanningError unless the plan begins at this configuration (6,) [rad]."""
        off = max(abs(one - other) for one, other in zip(q_rad, self.path[0], strict=True))
        if off > _START_TOLERANCE_RAD:
            raise PlanningError(
                f"the arm is {off:.3f} rad from the start of the plan: it has moved since; plan again from where it is"
            )


class CartesianPath(NamedTuple):
    """The result of `Planner.compute_cartesian_path`: an executable plan, and the fraction of the path it covers."""

    plan: Plan
    fraction: float


@partial(checked, error=PlanningError)
class Planner:
    """Plans in one scene, each time as the scene is at the call."""

    def __init__(
        self, scene: PlanningScene, limits: Limits | None = None, cartesian_limits: CartesianLimits | None = None
    ) -> None:
        self.scene = scene
        self.checker: CollisionChecker = CollisionChecker(scene)
        self.limits = limits or default_limits(scene.model)
        self.cartesian_limits = cartesian_limits or CartesianLimits()

    def plan(
        self,
        start_rad: Sequence[float],
        goal: Goal,
        *,
        planner: PlannerName = "RRTConnect",
        time_limit_s: float = 5.0,
        seed: int = 0,
        velocity_scaling: float = 1.0,
        acceleration_scaling: float = 1.0,
        path_constraints: PathConstraints | None = None,
    ) -> Plan:
        """Plan a motion from a start configuration (6,) [rad] to a goal, from rest to rest.

        planner: RRTConnect, RRTstar and PRM search for a path around obstacles; PTP, LIN and CIRC do not, see
        `plan_sequence`. seed: the same seed in the same scene gives the same plan. time_limit_s: for the search;
        RRTstar uses all of it to shorten the path. path_constraints: hold along the whole path. Raises
        StartInCollisionError, GoalUnreachableError, NoPathError, IncompletePathError, PlanningError.
        """
        item = MotionSequenceItem(goal, planner)
        return self.plan_sequence(
            start_rad,
            [item],
            time_limit_s=time_limit_s,
            seed=seed,
            velocity_scaling=velocity_scaling,
            acceleration_scaling=acceleration_scaling,
            path_constraints=path_constraints,
        )

    def plan_sequence(
        self,
        start_rad: Sequence[float],
        items: Sequence[MotionSequenceItem],
        *,
        time_limit_s: float = 5.0,
        seed: int = 0,
        velocity_scaling: float = 1.0,
        acceleration_scaling: float = 1.0,
        path_constraints: PathConstraints | None = None,
    ) -> Plan:
        """Plan several motions one after the other, without a stop where they blend.

        PTP moves all joints straight to the goal (for a pose, to the nearest configuration that reaches it), arriving
        together. LIN moves the TCP straight to a `PoseGoal`. CIRC moves it along the arc of a `CircGoal`. A blend stays
        within a sphere of its radius about the goal. time_limit_s: for each search. path_constraints: hold along the
        whole path. Raises the same as `plan`; IncompletePathError says where a motion ends and why.
        """
        if path_constraints is not None:
            return self._constrained(path_constraints).plan_sequence(
                start_rad,
                items,
                time_limit_s=time_limit_s,
                seed=seed,
                velocity_scaling=velocity_scaling,
                acceleration_scaling=acceleration_scaling,
            )
        if not (isinstance(items, Sequence) and items):
            raise PlanningError("a sequence needs at least one motion")
        for item in items:
            if not isinstance(item, MotionSequenceItem):
                raise PlanningError(f"a sequence has MotionSequenceItems, not {quoted(item)}")
            if item.planner not in PLANNERS:
                raise PlanningError(unknown("planner", item.planner, PLANNERS))
        limits = self.limits.scaled(velocity_scaling, acceleration_scaling)
        start = as_six(start_rad)
        began_s = time.perf_counter()
        self.check_start(start)
        segments: list[PlannedSegment] = []
        for item in items:
            begin = segments[-1].waypoints[-1] if segments else start
            segments.append(self._segment(begin, item, time_limit_s, seed))
        parts = list(blended_motions(segments, items))
        for part in parts:
            self._check_free(part, items)
        found_s = time.perf_counter()
        shortcutting_s = sum(segment.shortcutting_s for segment in segments)
        trajectory = self._parameterise(parts, limits, start)
        corners = [segment.waypoints[1:] for segment in segments]
        return Plan(
            trajectory,
            (start, *(q for waypoints in corners for q in waypoints)),
            ", ".join(dict.fromkeys(item.planner for item in items)),
            found_s - began_s - shortcutting_s,
            shortcutting_s,
            time.perf_counter() - found_s,
        )

    def compute_cartesian_path(
        self,
        start_rad: Sequence[float],
        waypoints: Sequence[Sequence[float]],
        max_step_m: float = 0.01,
        jump_threshold: float = 0.0,
        *,
        revolute_jump_threshold_rad: float = 0.0,
        avoid_collisions: bool = True,
        tcp_offset: Sequence[float] | None = None,
        blend_radius_m: float = 0.0,
        velocity_scaling: float = 1.0,
        acceleration_scaling: float = 1.0,
        path_constraints: PathConstraints | None = None,
    ) -> CartesianPath:
        """Move the TCP straight from waypoint to waypoint as far as possible; return the plan and the fraction covered.

        waypoints: poses of the TCP (n, 6) in the base frame; each line counts equally in the fraction, as in MoveIt.
        max_step_m: largest distance between computed configurations (3.5 rad of rotation count as 1 m).
        jump_threshold: the path ends before a step whose joint-space distance exceeds this multiple of the average
        step. revolute_jump_threshold_rad: it ends before a step in which one joint moves farther than this. 0 disables
        either check. The arm never changes its kinematic branch on a line, regardless of the thresholds.
        avoid_collisions: the path ends before a collision. blend_radius_m: 0 stops at each waypoint; larger radii are
        reduced to what the lines leave room for. The plan's ``stopped_by`` says why the fraction is below 1. Raises
        StartInCollisionError, PlanningError.
        """
        limits = self.limits.scaled(velocity_scaling, acceleration_scaling)
        start = as_six(start_rad)
        began_s = time.perf_counter()
        if avoid_collisions:
            self.check_start(start)
        checker = self.checker if path_constraints is None else self._constrained(path_constraints).checker
        found = cartesian_motions(
            checker,
            start,
            waypoints,
            tcp_offset,
            max_step_m,
            (jump_threshold, revolute_jump_threshold_rad),
            avoid_collisions,
            blend_radius_m,
        )
        found_s = time.perf_counter()
        trajectory = self._parameterise(found.motions, limits, start)
        parameterisation_s = time.perf_counter() - found_s
        path = (start, *found.waypoints)
        plan = Plan(trajectory, path, "LIN", found_s - began_s, 0.0, parameterisation_s, found.stopped_by)
        return CartesianPath(plan, found.fraction)

    def check_start(self, start_rad: Sequence[float]) -> None:
        """Raise StartInCollisionError, saying what collides and how deeply, unless this configuration is valid."""
        if not self.checker.is_free(start_rad):
            violation = self.checker.violation(start_rad)
            raise StartInCollisionError(
                f"the arm cannot start here: {violation}. Move it away, or change the scene or the constraints"
            )

    def _constrained(self, constraints: PathConstraints) -> "Planner":
        other = copy(self)
        other.checker = ConstrainedChecker(self.scene, constraints)
        return other

    def _segment(self, start: Joints, item: MotionSequenceItem, time_limit_s: float, seed: int) -> PlannedSegment:
        if item.planner == "PTP":
            return ptp_segment(self.checker, start, item.goal)
        if item.planner in INDUSTRIAL:
            return cartesian_segment(self.checker, start, item.goal, item.planner, self.cartesian_limits)
        goals = goal_configurations(item.goal, start, self.checker)
        if isinstance(self.checker, ConstrainedChecker):
            targets = item.goal.goals if isinstance(item.goal, GoalSet) else [item.goal]
            any_turn = all(isinstance(one, PoseGoal) for one in targets)
            found = TaskSpaceSearch(self.checker, start, goals, any_turn).find(item.planner, 0.5 * time_limit_s, seed)
            if found is not None:
                return found
            time_limit_s *= 0.5  # the other half, for paths that change the kinematic branch
        path = self._search(start, goals, item.planner, time_limit_s, seed)
        began_s = time.perf_counter()
        path = self._shortcut(path, Random(seed))
        curve = self._rounded(path).with_columns(COLUMNS) if len(path) > 1 else None
        pose_of = interpolator_for(self.checker, item.goal).pose
        return PlannedSegment(curve, tuple(as_six(q) for q in path), pose_of, time.perf_counter() - began_s)

    def _check_free(self, part: BlendedMotion, items: Sequence[MotionSequenceItem]) -> None:
        """Raise IncompletePathError if a motion is in collision. Motions from a search alone were checked already."""
        if len(set(part.items)) == 1 and items[part.items[0]].planner not in INDUSTRIAL:
            return
        found = first_collision(self.checker, part.path)
        if found is None:
            return
        piece, q = found
        number = part.items[piece]
        first = part.items.index(number)
        own = slice(first, first + part.items.count(number))
        sizes = part.path.sizes[own]
        fraction = float(sizes[: piece - first].sum() / sizes.sum())
        which = f"motion {number + 1} ({items[number].planner})" if len(items) > 1 else items[number].planner
        raise IncompletePathError(
            f"{which} is free for {100 * fraction:.0f} % of its path, then {self.checker.violation(q)}. To plan around "
            "it, use RRTConnect",
            fraction,
            as_six(part.path.at(float(part.path.starts[piece]))[:6]),
        )

    # searching

    def _search(
        self, start: Joints, goals: Sequence[Joints], planner: str, time_limit_s: float, seed: int
    ) -> list[Array]:
        if self.checker.path_is_free(start, goals[0]):  # it usually is, and no other path is shorter
            return [np.array(start), np.array(goals[0])]
        until_s = time.perf_counter() + time_limit_s
        for attempt in count():  # a path may be in collision between two checks; another attempt may not be
            left_s = until_s - time.perf_counter()
            if left_s <= 0.0:
                break
            step = _RESOLUTIONS_RAD[min(attempt, len(_RESOLUTIONS_RAD) - 1)]
            path = search_joint_space(self.checker, start, goals, planner, left_s, seed + attempt, step)
            if path is None:
                break
            if all(self.checker.path_is_free(one, other) for one, other in pairwise(path)):
                return path
        raise NoPathError(
            f"no path was found within {time_limit_s:g} s: {planner} searched for one to {len(goals)} "
            f"configuration{'s' if len(goals) > 1 else ''} that reach the goal. Allow more time or more room: the "
            f"padding is {1000 * self.scene.padding_m:g} mm"
        )

    # shortcutting

    def _shortcut(self, path: list[Array], random: Random) -> list[Array]:
        """Try to connect random places of the path directly, where that is shorter and free."""
        path = self._reduce_vertices(_without_duplicates(path))
        for _ in range(_SHORTCUT_ATTEMPTS if len(path) > 2 else 0):
            path = self._try_shortcut(path, random)
        return self._reduce_vertices(_without_duplicates(path))

    def _reduce_vertices(self, path: list[Array]) -> list[Array]:
        """Remove each waypoint that the arm can bypass on a straight segment."""
        i = 0
        while i + 2 < len(path):
            if self._motion_is_valid(path[i], path[i + 2]):
                del path[i + 1]
                i = max(0, i - 1)
            else:
                i += 1
        return path

    def _try_shortcut(self, path: list[Array], random: Random) -> list[Array]:
        ends = np.cumsum([0.0, *(float(np.linalg.norm(other - one)) for one, other in pairwise(path))])
        low, high = sorted((random.uniform(0.0, ends[-1]), random.uniform(0.0, ends[-1])))
        i, j = (int(np.searchsorted(ends, at, side="right")) - 1 for at in (low, high))
        if i == j:
            return path
        begin, end = (_interpolated(path, ends, k, at) for k, at in ((i, low), (min(j, len(path) - 2), high)))
        if high - low - float(np.linalg.norm(end - begin)) < 1e-3 or not self._motion_is_valid(begin, end):
            return path
        return _without_duplicates([*path[: i + 1], begin, end, *path[j + 1 :]])

    def _motion_is_valid(self, one: Array, other: Array) -> bool:
        """Check single configurations first, which is cheap: most shortcuts collide near their middle."""
        return all(self.checker.is_free(one + share * (other - one)) for share in (0.5, 0.25, 0.75)) and (
            self.checker.path_is_free(one, other)
        )

    # time parameterisation

    def _parameterise(self, parts: Sequence[BlendedMotion], limits: Limits, start: Joints) -> Trajectory:
        wide = self.cartesian_limits.combined_with(limits)
        trajectory = Trajectory.at_rest(start)
        for part in parts:
            scalings = part.scaling_function()
            whole = parameterise(part.path, part.path.gridpoints, wide, step_s=_SAMPLE_S, scalings=scalings)
            trajectory = trajectory.followed_by(whole.joint_columns())
        return trajectory

    def _rounded(self, path: list[Array]) -> RoundedPath:
        """Round each corner as much as the obstacles around it allow."""
        roundness = [1.0] * max(0, len(path) - 2)
        for i in range(len(roundness)):
            for _ in range(_ROUNDINGS):
                corner = rounded_corner(path[i], path[i + 1], path[i + 2], roundness[i])
                if first_collision(self.checker, corner) is None:
                    break
                roundness[i] *= 0.5
            else:
                raise PlanningError(f"corner {i + 1} of the path cannot be rounded: the scene leaves no room there")
        return RoundedPath(path, roundness)


def _without_duplicates(path: Sequence[Array]) -> list[Array]:
    kept = [path[0]]
    for q in path[1:]:
        if float(np.linalg.norm(q - kept[-1])) > _DISTINCT_RAD:
            kept.append(q)
    return kept


def _interpolated(path: Sequence[Array], ends: Array, i: int, distance: float) -> Array:
    share = (distance - float(ends[i])) / float(ends[i + 1] - ends[i])
    at: Array = path[i] + share * (path[i + 1] - path[i])
    return at
