"""Path search by OMPL, in joint space or in any other six coordinates."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.parameterisation import Array
from urproto.extras import how_to_install
from urproto.robots import Joints

# Largest step of a tree: of 24 paths past a wall and a board, this missed 2 in 8 s; OMPL's own choice, 4 rad, missed 8.
_RANGE_RAD: Final = 0.5
_MARGIN_RAD: Final = np.pi  # how far beyond start and goals each joint is sampled


def search_joint_space(
    checker: CollisionChecker,
    start: Joints,
    goals: Sequence[Joints],
    planner: str,
    limit_s: float,
    seed: int,
    step_rad: float,
) -> list[Array] | None:
    """Search for a path between configurations, checking every ``step_rad``; None if none was found in time."""
    bounds = list(_bounds(checker, start, goals))
    return solve(bounds, checker.is_free, start, goals, planner, limit_s, seed, step_rad, _RANGE_RAD)


def solve(
    bounds: Sequence[tuple[float, float]],
    is_free: Callable[[Array], bool],
    start: Sequence[float] | Array,
    goals: Sequence[Sequence[float] | Array],
    planner: str,
    limit_s: float,
    seed: int,
    step: float,
    tree_step: float,
) -> list[Array] | None:
    """Search for a path within the bounds of six coordinates with OMPL; None if none was found within ``limit_s``.

    step: between validity checks. tree_step: the longest extension of a tree (OMPL's range). Raises PlanningError
    without OMPL.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise PlanningError(f"planning needs OMPL: {how_to_install('plan')}") from error
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(6)
    box = base.RealVectorBounds(6)
    for i, (low, high) in enumerate(bounds):
        box.setLow(i, low)
        box.setHigh(i, high)
    space.setBounds(box)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: is_free(np.array([state[i] for i in range(6)])))
    information.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    ends = base.GoalStates(information)
    for goal in goals:
        ends.addState(_state(space, goal))
    problem.setGoal(ends)
    search = getattr(geometric, planner)(information)
    if planner != "PRM":
        search.setRange(tree_step)
    search.setProblemDefinition(problem)
    search.setup()
    if not search.solve(limit_s) or not problem.hasExactSolution():
        return None
    found = problem.getSolutionPath()
    states = (found.getState(i) for i in range(found.getStateCount()))
    return [np.array([state[i] for i in range(6)]) for state in states]


def _bounds(checker: CollisionChecker, start: Joints, goals: Sequence[Joints]) -> Iterator[tuple[float, float]]:
    """The range in which each joint is sampled: around start and goals, within its limits.

    Further whole turns would only cost time.
    """
    for i, (low, high) in enumerate(zip(*checker.scene.model.position_limits, strict=True)):
        angles = [start[i], *(goal[i] for goal in goals)]
        yield max(low, min(angles) - _MARGIN_RAD), min(high, max(angles) + _MARGIN_RAD)


def _state(space: Any, q: Sequence[float] | Array) -> Any:
    state = space.allocState()
    for i, angle in enumerate(q):
        state[i] = float(angle)
    return state
