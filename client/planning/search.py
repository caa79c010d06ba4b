"""OMPL looks for a way between joint angles."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.timing import Array
from urproto.robots import Joints

# of a tree's step: of 24 ways past wall and board it missed 2 in 8 s, and OMPL's own choice, 4 rad, missed 8
_RANGE_RAD: Final = 0.5
_AROUND_RAD: Final = np.pi  # how far from start and goals joints are tried


def searched(
    checker: CollisionChecker,
    start: Joints,
    goals: Sequence[Joints],
    planner: str,
    limit_s: float,
    seed: int,
    step_rad: float,
) -> list[Array] | None:
    """The way between joint angles that OMPL finds with looks so far apart; None without one."""
    bounds = list(_box(checker, start, goals))
    return solved(bounds, checker.is_free, start, goals, planner, limit_s, seed, step_rad, _RANGE_RAD)


def solved(
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
    """The way that OMPL finds in a box, of any six coordinates. None without one."""
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise PlanningError("planning needs OMPL: in the folder of ur-emulator, pip install '.[plan]'") from error
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


def _box(checker: CollisionChecker, start: Joints, goals: Sequence[Joints]) -> Iterator[tuple[float, float]]:
    """What is tried of each joint: around start and goals, within its limits; whole turns more only cost time."""
    for i, (low, high) in enumerate(zip(*checker.scene.model.position_limits, strict=True)):
        angles = [start[i], *(goal[i] for goal in goals)]
        yield max(low, min(angles) - _AROUND_RAD), min(high, max(angles) + _AROUND_RAD)


def _state(space: Any, q: Sequence[float] | Array) -> Any:
    state = space.allocState()
    for i, angle in enumerate(q):
        state[i] = float(angle)
    return state
