"""Planning: random queries in three scenes, compared with OMPL alone in the same run, and execution of the plans.

A run without options is short. ``planning.py --full`` asks 200 queries in each scene for each arm and executes all
plans, which takes hours. ``--queries``, ``--executed`` and ``--models`` change that. ``--meshes FOLDER`` also measures
executed plans against meshes: a folder for each arm, with the files of ur_description.
"""

import argparse
import asyncio
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any
from unittest import mock

import numpy as np
from ompl import base, geometric, util
from table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from client.planning import CollisionChecker, JointGoal, NoPathError, Plan, Planner
from tests.driver.driver_rig import Lab, emulator
from tests.planning.clearance import Clearance
from tests.planning.described import Described
from tests.planning.scenes import SCENES, free_configurations, samples, scene_of
from urproto.robots import MODELS, Joints, load_model

QUERIES = 20
EXECUTED = 4
FULL = 200
ARMS = ("ur3", "ur5e")
LIMIT_S = 5.0  # Planner.plan's own
LONG_S = 30.0
MESHED = 40  # states of each plan that are checked with meshes
SPEED = 8.0  # of the emulator, times real time


@dataclass
class Tally:
    """The queries in one scene. CPU times [s] are of those that were solved."""

    queries: int = 0
    solved: int = 0
    solvable: int = 0
    cpu_s: list[float] = field(default_factory=list)
    around_s: list[float] = field(default_factory=list)  # queries whose straight path is blocked
    parts_s: list[tuple[float, float, float]] = field(default_factory=list)
    bare_solved: int = 0
    bare_cpu_s: list[float] = field(default_factory=list)
    bare_blocked: int = 0
    nearest_m: float = float("inf")
    plans: list[Plan] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Share of the queries that a long search solves."""
        return self.solved / self.solvable if self.solvable else 1.0


def measure_queries(model: str, place: str, queries: int, long_s: float = LONG_S) -> Tally:
    """Ask random queries, each also of OMPL alone; retry failures with more time and another seed."""
    scene = scene_of(place, model)
    planner, clearance = Planner(scene), Clearance(load_model(model), scene)
    configurations = free_configurations(planner.checker, Random(f"{model} {place}"), 2 * queries)
    tally = Tally()
    for number, (start, goal) in enumerate(zip(configurations[::2], configurations[1::2], strict=True)):
        tally.queries += 1
        plan, cpu_s = _timed(_plan, planner, start, goal, number, LIMIT_S)
        if plan is not None:
            tally.solved += 1
            tally.solvable += 1
            tally.cpu_s.append(cpu_s)
            if len(plan.path) > 2:
                tally.around_s.append(cpu_s)
            tally.parts_s.append((plan.search_s, plan.shortcutting_s, plan.parameterisation_s))
            tally.plans.append(plan)
            tally.nearest_m = min(tally.nearest_m, *(clearance(q) - scene.padding_m for q in samples(plan, 2)))
        elif _plan(planner, start, goal, FULL + number, long_s) is not None:
            tally.solvable += 1
        path, cpu_s = _timed(_bare, planner.checker, start, goal, number)
        if path is not None:
            tally.bare_solved += 1
            tally.bare_cpu_s.append(cpu_s)
            tally.bare_blocked += not all(planner.checker.path_is_free(one, other) for one, other in pairwise(path))
    return tally


def _timed(work: Callable[..., Any], *given: Any) -> tuple[Any, float]:
    began_s = time.process_time()
    return work(*given), time.process_time() - began_s


def _plan(planner: Planner, start: Joints, goal: Joints, seed: int, limit_s: float) -> Plan | None:
    try:
        return planner.plan(start, JointGoal(goal), seed=seed, time_limit_s=limit_s)
    except NoPathError:
        return None


def _bare(checker: CollisionChecker, start: Joints, goal: Joints, seed: int) -> list[np.ndarray] | None:
    """OMPL's RRT-Connect and simplification with default settings, in the arm's whole range."""
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    for i, (low, high) in enumerate(zip(*checker.scene.model.position_limits, strict=True)):
        bounds.setLow(i, max(low, -2.0 * np.pi))
        bounds.setHigh(i, min(high, 2.0 * np.pi))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: checker.is_free([state[i] for i in range(6)]))
    ends = []
    for q in (start, goal):
        state = space.allocState()
        for i, angle in enumerate(q):
            state[i] = angle
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
    if not setup.solve(LIMIT_S) or not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    path = setup.getSolutionPath()
    states = (path.getState(i) for i in range(path.getStateCount()))
    return [np.array([state[i] for i in range(6)]) for state in states]


async def execute(model: str, place: str, plans: Sequence[Plan], meshes: Path | None = None) -> tuple[int, int, float]:
    """Execute plans; return how many, the number of recorded states, and the smallest clearance beyond the padding [m].

    meshes: of the arm; some of the states are then checked with them, too.
    """
    scene = scene_of(place, model)
    clearance = Clearance(load_model(model), scene)
    taken, driven = 0, list[tuple[float, ...]]()
    async with emulator(model, speed=SPEED) as robot:
        with mock.patch("client.driver.reverse.time", robot.clock):
            async with Lab(robot).arm as arm:
                for plan in plans:
                    await arm.move_j(plan.path[0], speed_rad_s=3.0)
                    driven.append(arm.q)
                    listeners = arm.driver.link.on_state
                    listeners.append(note := lambda state: driven.append(tuple(state["actual_q"])))
                    await arm.planning.execute(plan)
                    listeners.remove(note)
                    taken += 1
    nearest_m = min((clearance(q) - scene.padding_m for q in driven), default=float("inf"))
    described = Described(scene, meshes)
    some = driven if meshes is None else driven[:: max(1, len(driven) // (MESHED * max(1, taken)))]
    return taken, len(driven), min([nearest_m, *map(described.beyond_padding, some)])


def measure(
    queries: int = QUERIES, executed: int = EXECUTED, models: Sequence[str] = ARMS, meshes: Path | None = None
) -> Table:
    """One row for each arm in each scene. meshes: a folder for each arm."""
    rows = [_row(model, place, queries, executed, meshes) for model in models for place in SCENES]
    note = (
        f"Random pairs of free configurations, seeded. Solved: within {LIMIT_S:g} s, of the queries that this or a "
        f"search of {LONG_S:g} s solves. CPU: of one plan with search, shortcutting and time parameterisation; "
        "blocked: of the queries whose straight path is blocked. OMPL: its RRT-Connect and simplification with default "
        "settings, no time parameterisation; in collision: its paths that collide between the configurations it "
        "checked. Nearest: clearance beyond the padding of planned paths, and of the recorded actual_q of executed "
        "ones, by separate geometry code of the tests, accurate to 1 mm; of executed ones also by the arm's URDF with "
        + ("meshes." if meshes else "simple shapes.")
    )
    columns = [
        "arm",
        "scene",
        "queries",
        "solved",
        "CPU median",
        "p95",
        "blocked: median",
        "search, shortcut, parameterise (wall)",
    ]
    columns += ["OMPL: solved", "CPU median", "in collision", "nearest planned", "executed", "nearest executed"]
    return Table("Planning", note, columns, rows)


def _row(model: str, place: str, queries: int, executed: int, meshes: Path | None) -> list[str]:
    tally = measure_queries(model, place, queries)
    taken, states, nearest = asyncio.run(
        execute(model, place, tally.plans[:executed], meshes / model if meshes else None)
    )
    parts = [1000 * statistics.median(part) for part in zip(*tally.parts_s, strict=True)] if tally.parts_s else []
    return [
        model,
        place,
        str(tally.queries),
        f"{tally.solved} of {tally.solvable} ({tally.share:.1%})",
        *_times(tally.cpu_s),
        f"{_times(tally.around_s)[0]} of {len(tally.around_s)}",
        ", ".join(f"{part:.0f}" for part in parts) + " ms",
        str(tally.bare_solved),
        _times(tally.bare_cpu_s)[0],
        str(tally.bare_blocked),
        f"{1000 * tally.nearest_m:+.1f} mm",
        f"{taken} ({states} states)",
        f"{1000 * nearest:+.1f} mm",
    ]


def _times(cpu_s: Sequence[float]) -> tuple[str, str]:
    if not cpu_s:
        return "-", "-"
    middle, high = np.percentile(cpu_s, (50, 95))
    return f"{1000 * middle:.0f} ms", f"{1000 * high:.0f} ms"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--queries", type=int)
    parser.add_argument("--executed", type=int)
    parser.add_argument("--models", nargs="+", choices=MODELS)
    parser.add_argument("--meshes", type=Path)
    wanted = parser.parse_args()
    queries = wanted.queries or (FULL if wanted.full else QUERIES)
    executed = wanted.executed if wanted.executed is not None else (queries if wanted.full else EXECUTED)
    models = wanted.models or (MODELS if wanted.full else ARMS)
    sys.stdout.write(measure(queries, executed, models, wanted.meshes).markdown())


if __name__ == "__main__":
    main()
