"""A way from here to there: found, shortened, rounded and timed.

OMPL looks for the way. It asks only every tenth of a radian whether the arm is free, which is cheap; each piece of the
way that it finds is then shown to be free as a whole, and where one is not, the search goes on with finer steps.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from random import Random
from typing import Any, Final, Literal, get_args

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.goals import Goal, candidates
from client.planning.path import RoundedPath
from client.planning.scene import PlanningScene
from client.planning.timing import Array, Limits, TimedPath, time_optimal
from urproto.robots import Joints, RobotModel

PlannerName = Literal["RRTConnect", "RRTstar", "PRM"]

_STEPS_RAD: Final = (0.1, 0.04, 0.015)  # between looks at a way, ever finer
# of a tree's step: of 24 ways past wall and board it missed 2 in 8 s, and OMPL's own choice, 4 rad, missed 8
_RANGE_RAD: Final = 0.5
_AROUND_RAD: Final = np.pi  # how far from start and goals joints are tried
_SHORTCUTS: Final = 40  # tries
_AWAY_RAD: Final = 0.02  # guess: more than an arm sags, less than any clearance
_APART: Final = 1e-6  # rad; nearer points are one
_SEEDS: Final = 2**31  # OMPL takes 32 bits
_ROUNDINGS: Final = 7  # halvings of a corner that comes too near to something
_STEP_S: Final = 0.04  # between points of a trajectory (guess)
_A_RAD_S2: Final = 10.0  # guess: what MoveIt users give a UR, and a fourth of what the controller takes
_J_RAD_S3: Final = 200.0  # guess


class StartInCollisionError(PlanningError):
    """The arm touches something, or is too near, where it is."""


class NoPathError(PlanningError):
    """None was found in time."""


def usual_limits(model: RobotModel) -> Limits:
    """Of an arm: its joints' speeds, and gentle accelerations."""
    return Limits(np.array(model.qd_max), np.full(6, _A_RAD_S2), np.full(6, _J_RAD_S3))


@dataclass(frozen=True, slots=True)
class Plan:
    """A trajectory that is free of collisions, and how it came about.

    way: the corners of the path [rad]. search_s, shortening_s, timing_s: what that took. planner: which one.
    """

    timed: TimedPath
    way: tuple[Joints, ...]
    planner: str
    search_s: float
    shortening_s: float
    timing_s: float

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

    def __init__(self, scene: PlanningScene, limits: Limits | None = None) -> None:
        self.scene = scene
        self.checker = CollisionChecker(scene)
        self.limits = limits or usual_limits(scene.model)

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
    ) -> Plan:
        """The way from these joint angles [rad] (6,) to a goal, from rest to rest.

        seed: the same one in the same scene gives the same plan. time_limit_s: for the search; RRTstar uses all of it
        to find shorter ways. Raises StartInCollisionError, GoalUnreachableError, NoPathError, PlanningError.
        """
        if planner not in get_args(PlannerName):
            raise PlanningError(f"there is no planner {planner!r}; there are {', '.join(get_args(PlannerName))}")
        if not 0 <= seed < _SEEDS:
            raise PlanningError(f"a seed is from 0 to {_SEEDS - 1}, not {seed}")
        if not 0.0 < time_limit_s < float("inf"):
            raise PlanningError(f"the time limit is above 0 s, not {time_limit_s}")
        limits = self.limits.scaled(velocity_scaling, acceleration_scaling)
        start = _six(start_rad)
        if not all(map(isfinite, start)):
            raise PlanningError(f"the start has numbers that no joint has: {list(start)}")
        began_s = time.perf_counter()
        self.check_start(start)
        goals = candidates(goal, start, self.checker)
        way = self._search(start, goals, planner, time_limit_s, seed)
        found_s = time.perf_counter()
        way = self._shortened(way, Random(seed))
        shortened_s = time.perf_counter()
        timed = self._timed(way, limits)
        return Plan(
            timed,
            tuple(_six(q) for q in way),
            planner,
            found_s - began_s,
            shortened_s - found_s,
            time.perf_counter() - shortened_s,
        )

    def check_start(self, start_rad: Sequence[float]) -> None:
        """Raise StartInCollisionError, saying what touches what, and how deep."""
        if not self.checker.is_free(start_rad):
            near = self.checker.collisions(start_rad)
            if near:
                raise StartInCollisionError(
                    f"the arm cannot start here: {'; '.join(map(str, near[:3]))}, and "
                    f"{1000 * self.scene.padding_m:g} mm are to be kept. Move it away, or allow this pair to touch"
                )
            raise StartInCollisionError("the arm cannot start here: a joint is beyond its limits")

    # searching

    def _search(
        self, start: Joints, goals: Sequence[Joints], planner: PlannerName, time_limit_s: float, seed: int
    ) -> list[Array]:
        if self.checker.way_is_free(start, goals[0]):  # as it mostly is, and shorter than any other
            return [np.array(start), np.array(goals[0])]
        until_s = time.perf_counter() + time_limit_s
        for step in _STEPS_RAD:
            left_s = until_s - time.perf_counter()
            if left_s <= 0.0:
                break
            way = _searched(self.checker, start, goals, planner, left_s, seed, step)
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

    def _timed(self, way: list[Array], limits: Limits) -> TimedPath:
        path = self._rounded(way)
        return time_optimal(path, path.places, limits, step_s=_STEP_S)

    def _rounded(self, way: list[Array]) -> RoundedPath:
        """Each corner as round as what is around it allows."""
        roundness = [1.0] * max(0, len(way) - 2)
        for i in range(len(roundness)):
            for _ in range(_ROUNDINGS):
                path = RoundedPath(way[i : i + 3], [roundness[i]])
                if self._is_free(path):
                    break
                roundness[i] *= 0.5
            else:
                raise PlanningError(f"corner {i + 1} of the way cannot be rounded: the scene leaves no room there")
        return RoundedPath(way, roundness)

    def _is_free(self, path: RoundedPath) -> bool:
        return self.checker.blocked_at(lambda share: path.at(share * path.length), path.length * path.steepest) is None


def _searched(
    checker: CollisionChecker,
    start: Joints,
    goals: Sequence[Joints],
    planner: str,
    limit_s: float,
    seed: int,
    step_rad: float,
) -> list[Array] | None:
    """The way that OMPL finds with looks so far apart; None without one."""
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise PlanningError("planning needs OMPL: in the folder of ur-emulator, pip install '.[plan]'") from error
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    for i, (low, high) in enumerate(_box(checker, start, goals)):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: checker.is_free([state[i] for i in range(6)]))
    information.setStateValidityCheckingResolution(step_rad / space.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    ends = base.GoalStates(information)
    for goal in goals:
        ends.addState(_state(space, goal))
    problem.setGoal(ends)
    search = getattr(geometric, planner)(information)
    if planner != "PRM":
        search.setRange(_RANGE_RAD)
    search.setProblemDefinition(problem)
    search.setup()
    if not search.solve(limit_s) or not problem.hasExactSolution():
        return None
    found = problem.getSolutionPath()
    states = (found.getState(i) for i in range(found.getStateCount()))
    return [np.array([state[i] for i in range(6)]) for state in states]


def _box(checker: CollisionChecker, start: Joints, goals: Sequence[Joints]) -> Iterator[tuple[float, float]]:
    """What is tried of each joint: around start and goals, within its limits; whole turns more only cost time."""
    for i, (low, high) in enumerate(zip(*checker.scene.model.position_limits, strict=True)):
        angles = [start[i], *(goal[i] for goal in goals)]
        yield max(low, min(angles) - _AROUND_RAD), min(high, max(angles) + _AROUND_RAD)


def _state(space: Any, q: Joints) -> Any:
    state = space.allocState()
    for i, angle in enumerate(q):
        state[i] = angle
    return state


def _distinct(way: Sequence[Array]) -> list[Array]:
    kept = [way[0]]
    for q in way[1:]:
        if float(np.linalg.norm(q - kept[-1])) > _APART:
            kept.append(q)
    return kept if len(kept) > 1 else [way[0], way[-1]]


def _at(way: Sequence[Array], ends: Array, i: int, place: float) -> Array:
    share = (place - float(ends[i])) / float(ends[i + 1] - ends[i])
    at: Array = way[i] + share * (way[i + 1] - way[i])
    return at


def _six(q: Sequence[float] | Array) -> Joints:
    a, b, c, d, e, f = (float(value) for value in q)
    return (a, b, c, d, e, f)
