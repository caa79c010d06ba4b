"""A way from here to there: found or given, shortened, rounded and timed.

OMPL looks for the way. It asks only every tenth of a radian whether the arm is free, which is cheap; each piece of the
way that it finds is then shown to be free as a whole, and where one is not, the search goes on with finer steps.
"""

import time
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import count, pairwise
from math import isfinite
from random import Random
from typing import Final, Literal, get_args

import numpy as np

from client.errors import PlanningError
from client.planning.cartesian import CartesianPath, cartesian_runs
from client.planning.collisions import CollisionChecker
from client.planning.constraints import ConstrainedChecker, PathConstraints
from client.planning.goals import Goal, GoalSet, PoseGoal, candidates, check_six
from client.planning.industrial import (
    INDUSTRIAL,
    CartesianLimits,
    IncompletePathError,
    MotionSequenceItem,
    Run,
    Segment,
    blocked,
    follower_of,
    runs,
    straight_segment,
    tool_segment,
)
from client.planning.lines import COLUMNS
from client.planning.path import RoundedPath, rounded_corner
from client.planning.scene import PlanningScene
from client.planning.search import searched
from client.planning.timing import Array, Limits, TimedPath, time_optimal
from client.planning.tool_search import ToolSearch
from urproto.robots import Joints, RobotModel

PlannerName = Literal["RRTConnect", "RRTstar", "PRM", "PTP", "LIN", "CIRC"]
PLANNERS: Final[tuple[str, ...]] = get_args(PlannerName)

_STEPS_RAD: Final = (0.1, 0.04, 0.015)  # between looks at a way, ever finer
_SHORTCUTS: Final = 40  # tries
_AWAY_RAD: Final = 0.02  # guess: more than an arm sags, less than any clearance
_APART: Final = 1e-6  # rad; nearer points are one
_SEEDS: Final = 2**31  # OMPL takes 32 bits
_ROUNDINGS: Final = 7  # halvings of a corner that comes too near to something
_STEP_S: Final = 0.04  # between points of a trajectory (guess)
_A_RAD_S2: Final = 5.0  # ur_moveit_config/config/joint_limits.yaml, all joints; that file limits no jerk
_J_RAD_S3: Final = 200.0  # guess


class StartInCollisionError(PlanningError):
    """The arm touches something, or is too near, where it is."""


class NoPathError(PlanningError):
    """None was found in time."""


def usual_limits(model: RobotModel, jerk_rad_s3: float = _J_RAD_S3) -> Limits:
    """Of an arm: its joints' speeds (ur_description), and the accelerations of ur_moveit_config's joint_limits.yaml."""
    return Limits(np.array(model.qd_max), np.full(6, _A_RAD_S2), np.full(6, jerk_rad_s3))


@dataclass(frozen=True, slots=True)
class Plan:
    """A trajectory that is free of collisions, and how it came about.

    way: the corners of the path [rad]; of lines and arcs their ends. search_s, shortening_s, timing_s: what that took.
    planner: which one. stopped_by: why it ends before its goal, for a path of which a fraction was wanted.
    """

    timed: TimedPath
    way: tuple[Joints, ...]
    planner: str
    search_s: float
    shortening_s: float
    timing_s: float
    stopped_by: str = ""

    @property
    def duration_s(self) -> float:
        """Of the motion."""
        return self.timed.duration_s

    def check_start(self, q_rad: Sequence[float]) -> None:
        """Raise PlanningError when an arm that stands there (6,) [rad] is not where the plan begins."""
        off = max(abs(one - other) for one, other in zip(q_rad, self.way[0], strict=True))
        if off > _AWAY_RAD:
            raise PlanningError(
                f"the arm is {off:.3f} rad from where the plan begins: it has moved since; plan again from where it is"
            )


class Planner:
    """Plans in one scene, as it is at each call."""

    def __init__(
        self, scene: PlanningScene, limits: Limits | None = None, cartesian_limits: CartesianLimits | None = None
    ) -> None:
        self.scene = scene
        self.checker: CollisionChecker = CollisionChecker(scene)
        self.limits = limits or usual_limits(scene.model)
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
        """The way from these joint angles [rad] (6,) to a goal, from rest to rest.

        planner: RRTConnect, RRTstar and PRM look for a way around what is in the way; PTP, LIN and CIRC do not, see
        `plan_sequence`. seed: the same one in the same scene gives the same plan. time_limit_s: for the search;
        RRTstar uses all of it to find shorter ways. Raises StartInCollisionError, GoalUnreachableError, NoPathError,
        IncompletePathError, PlanningError.
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
        """Motions one after the other, without a stop where they blend.

        PTP: all joints go straight to the goal (of a pose, to the nearest posture) and arrive together. LIN: the TCP of
        a `PoseGoal` goes straight. CIRC: on the arc of a `CircGoal`. time_limit_s: for each search. Blends keep within
        a sphere of their radius about the goal. path_constraints: what the tool keeps to all the way. Raises as `plan`;
        IncompletePathError says where a motion ends and why.
        """
        if path_constraints is not None:
            return self._under(path_constraints).plan_sequence(
                start_rad,
                items,
                time_limit_s=time_limit_s,
                seed=seed,
                velocity_scaling=velocity_scaling,
                acceleration_scaling=acceleration_scaling,
            )
        limits = self._wanted(items, time_limit_s, seed).scaled(velocity_scaling, acceleration_scaling)
        start = self._checked_start(start_rad)
        began_s = time.perf_counter()
        self.check_start(start)
        segments: list[Segment] = []
        for item in items:
            begin = segments[-1].way[-1] if segments else start
            segments.append(self._segment(begin, item, time_limit_s, seed))
        parts = list(runs(segments, items))
        for part in parts:
            self._check_free(part, items)
        found_s = time.perf_counter()
        shortening_s = sum(segment.shortening_s for segment in segments)
        timed = self._timed(parts, limits, start)
        corners = [segment.way[1:] for segment in segments]
        return Plan(
            timed,
            (start, *(q for way in corners for q in way)),
            _title(items),
            found_s - began_s - shortening_s,
            shortening_s,
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
    ) -> CartesianPath[Plan]:
        """The TCP straight from waypoint to waypoint as far as it can go: a plan, and the fraction of it, 0 to 1.

        waypoints: poses of the TCP (n, 6) in the base frame; each line counts the same in the fraction, as in MoveIt.
        max_step_m: between places where joint angles are computed (turns: 3.5 rad are one m). jump_threshold: the path
        ends before a step in which the joints go so many times as far as on average; revolute_jump_threshold_rad: or
        one joint so far; 0: neither. Postures never change on a line, whatever the thresholds. avoid_collisions: it
        ends before a collision. blend_radius_m: 0 stops at each waypoint; larger ones are cut to what the lines leave.
        The plan's stopped_by says why the fraction is below 1. Raises StartInCollisionError, PlanningError.
        """
        limits = self.limits.scaled(velocity_scaling, acceleration_scaling)
        start = self._checked_start(start_rad)
        began_s = time.perf_counter()
        if avoid_collisions:
            self.check_start(start)
        checker = self.checker if path_constraints is None else self._under(path_constraints).checker
        found = cartesian_runs(
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
        timed = self._timed(found.runs, limits, start)
        timing_s = time.perf_counter() - found_s
        plan = Plan(timed, (start, *found.way), "LIN", found_s - began_s, 0.0, timing_s, found.stopped_by)
        return CartesianPath(plan, found.fraction)

    def check_start(self, start_rad: Sequence[float]) -> None:
        """Raise StartInCollisionError, saying what touches what, and how deep."""
        if not self.checker.is_free(start_rad):
            objection = self.checker.objection(start_rad)
            raise StartInCollisionError(
                f"the arm cannot start here: {objection}. Move it away, or change the scene or the constraints"
            )

    def _under(self, constraints: PathConstraints) -> "Planner":
        """The same planner, for ways that keep to these."""
        other = copy(self)
        other.checker = ConstrainedChecker(self.scene, constraints)
        return other

    def _wanted(self, items: Sequence[MotionSequenceItem], time_limit_s: float, seed: int) -> Limits:
        """The limits, for what can be asked for. Raises PlanningError."""
        if not items:
            raise PlanningError("a sequence has at least one motion")
        for item in items:
            if item.planner not in PLANNERS:
                raise PlanningError(f"there is no planner {item.planner!r}; there are {', '.join(PLANNERS)}")
        if not 0 <= seed < _SEEDS:
            raise PlanningError(f"a seed is from 0 to {_SEEDS - 1}, not {seed}")
        if not 0.0 < time_limit_s < float("inf"):
            raise PlanningError(f"the time limit is above 0 s, not {time_limit_s}")
        return self.limits

    def _checked_start(self, start_rad: Sequence[float]) -> Joints:
        check_six(start_rad, "the start is six joint angles")
        start = _six(start_rad)
        if not all(map(isfinite, start)):
            raise PlanningError(f"the start has numbers that no joint has: {list(start)}")
        return start

    def _segment(self, start: Joints, item: MotionSequenceItem, time_limit_s: float, seed: int) -> Segment:
        if item.planner == "PTP":
            return straight_segment(self.checker, start, item.goal)
        if item.planner in INDUSTRIAL:
            return tool_segment(self.checker, start, item.goal, item.planner, self.cartesian_limits)
        goals = candidates(item.goal, start, self.checker)
        if isinstance(self.checker, ConstrainedChecker):
            wanted = item.goal.goals if isinstance(item.goal, GoalSet) else [item.goal]
            any_turn = all(isinstance(one, PoseGoal) for one in wanted)
            found = ToolSearch(self.checker, start, goals, any_turn).find(item.planner, 0.5 * time_limit_s, seed)
            if found is not None:
                return found
            time_limit_s *= 0.5  # for ways through other postures
        way = self._search(start, goals, item.planner, time_limit_s, seed)
        began_s = time.perf_counter()
        way = self._shortened(way, Random(seed))
        path = self._rounded(way).widened(COLUMNS) if len(way) > 1 else None
        pose_of = follower_of(self.checker, item.goal).pose
        return Segment(path, tuple(_six(q) for q in way), pose_of, time.perf_counter() - began_s)

    def _check_free(self, part: Run, items: Sequence[MotionSequenceItem]) -> None:
        """What was found by search alone is. Raises IncompletePathError."""
        if len(set(part.items)) == 1 and items[part.items[0]].planner not in INDUSTRIAL:
            return
        found = blocked(self.checker, part.path)
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
            f"{which} is free for {100 * fraction:.0f} % of its way, then {self.checker.objection(q)}. RRTConnect "
            "looks for a way around",
            fraction,
            _six(part.path.at(float(part.path.starts[piece]))[:6]),
        )

    # searching

    def _search(
        self, start: Joints, goals: Sequence[Joints], planner: str, time_limit_s: float, seed: int
    ) -> list[Array]:
        if self.checker.way_is_free(start, goals[0]):  # as it mostly is, and shorter than any other
            return [np.array(start), np.array(goals[0])]
        until_s = time.perf_counter() + time_limit_s
        for attempt in count():  # what was found may touch something between two looks, another way may not
            left_s = until_s - time.perf_counter()
            if left_s <= 0.0:
                break
            step = _STEPS_RAD[min(attempt, len(_STEPS_RAD) - 1)]
            way = searched(self.checker, start, goals, planner, left_s, seed + attempt, step)
            if way is None:
                break
            if all(self.checker.way_is_free(one, other) for one, other in pairwise(way)):
                return way
        raise NoPathError(
            f"no way was found within {time_limit_s:g} s: {planner} looked for one to {len(goals)} "
            f"posture{'s' if len(goals) > 1 else ''} that reach the goal. Give it longer, or more room: the padding is "
            f"{1000 * self.scene.padding_m:g} mm"
        )

    # shortening

    def _shortened(self, way: list[Array], random: Random) -> list[Array]:
        """Corners are cut between random places of the way while that is shorter and free."""
        way = self._without_detours(_distinct(way))
        for _ in range(_SHORTCUTS if len(way) > 2 else 0):
            way = self._cut(way, random)
        return self._without_detours(_distinct(way))

    def _without_detours(self, way: list[Array]) -> list[Array]:
        """Corners are left out where the arm may go straight past them."""
        i = 0
        while i + 2 < len(way):
            if self._may_go(way[i], way[i + 2]):
                del way[i + 1]
                i = max(0, i - 1)
            else:
                i += 1
        return way

    def _cut(self, way: list[Array], random: Random) -> list[Array]:
        ends = np.cumsum([0.0, *(float(np.linalg.norm(other - one)) for one, other in pairwise(way))])
        low, high = sorted((random.uniform(0.0, ends[-1]), random.uniform(0.0, ends[-1])))
        i, j = (int(np.searchsorted(ends, at, side="right")) - 1 for at in (low, high))
        if i == j:
            return way
        begin, end = (_at(way, ends, k, at) for k, at in ((i, low), (min(j, len(way) - 2), high)))
        if high - low - float(np.linalg.norm(end - begin)) < 1e-3 or not self._may_go(begin, end):
            return way
        return _distinct([*way[: i + 1], begin, end, *way[j + 1 :]])

    def _may_go(self, one: Array, other: Array) -> bool:
        """Cheap looks first: most shortcuts are blocked in their middle."""
        return all(self.checker.is_free(one + share * (other - one)) for share in (0.5, 0.25, 0.75)) and (
            self.checker.way_is_free(one, other)
        )

    # timing

    def _timed(self, parts: Sequence[Run], limits: Limits, start: Joints) -> TimedPath:
        wide = self.cartesian_limits.beside(limits)
        timed = TimedPath.still(start)
        for part in parts:
            whole = time_optimal(part.path, part.path.places, wide, step_s=_STEP_S, shares=part.shares())
            timed = timed.then(whole.joints())
        return timed

    def _rounded(self, way: list[Array]) -> RoundedPath:
        """Each corner as round as what is around it allows."""
        roundness = [1.0] * max(0, len(way) - 2)
        for i in range(len(roundness)):
            for _ in range(_ROUNDINGS):
                corner = rounded_corner(way[i], way[i + 1], way[i + 2], roundness[i])
                if blocked(self.checker, corner) is None:
                    break
                roundness[i] *= 0.5
            else:
                raise PlanningError(f"corner {i + 1} of the way cannot be rounded: the scene leaves no room there")
        return RoundedPath(way, roundness)


def _distinct(way: Sequence[Array]) -> list[Array]:
    kept = [way[0]]
    for q in way[1:]:
        if float(np.linalg.norm(q - kept[-1])) > _APART:
            kept.append(q)
    return kept


def _at(way: Sequence[Array], ends: Array, i: int, place: float) -> Array:
    share = (place - float(ends[i])) / float(ends[i + 1] - ends[i])
    at: Array = way[i] + share * (way[i + 1] - way[i])
    return at


def _six(q: Sequence[float] | Array) -> Joints:
    a, b, c, d, e, f = (float(value) for value in q)
    return (a, b, c, d, e, f)


def _title(items: Sequence[MotionSequenceItem]) -> str:
    """The planners, each once."""
    return ", ".join(dict.fromkeys(item.planner for item in items))
