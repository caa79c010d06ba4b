"""Explorations: what a control period of one costs, and how many runs it takes to find planted faults."""

import sys
import tempfile
import time
from itertools import combinations_with_replacement
from math import prod
from pathlib import Path
from random import Random
from statistics import median
from typing import Any

from table import Table

from emulator.explore.choices import Choice, Decision, Domain, OneOf, Schedule, Span
from emulator.explore.plan import Plan, read_plan
from emulator.explore.run import Run
from emulator.explore.search import Found, Runner, explored
from emulator.realtime import usable_cores
from emulator.virtual import virtual_robot

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.explore.planted import Planted, planted

SEEDS = (0, 1, 2)
MOST_RUNS = 250
MENDED_RUNS = 100
GRID_POINTS = 10  # of each range
GRID_MOST = 10  # times the runs of the search, after which the grid has lost
REPLAYS = 20
BATCH = 8
BLOCKS = 5


def measure() -> Table:
    """A run of an exploration next to the same control periods without one."""
    bare, whole, copied = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        one = planted()["two threads that move"]
        plan = read_plan(one.write(Path(folder)))
        for _ in range(BLOCKS):
            robot = virtual_robot(plan.model, running=True)
            robot.send_script(one.entry["program"])
            periods = Run(plan).last
            began = time.process_time()
            for _ in range(periods):
                robot.controller.tick()
            bare.append(periods / (time.process_time() - began))
            began = time.process_time()
            Run(plan).finish(())
            whole.append(periods / (time.process_time() - began))
            with Runner(plan, usable_cores()) as runner:
                schedules = [(Decision(period, "lamp", (("index", 7), ("level", True))),) for period in range(40)]
                began = time.perf_counter()
                runner.carry_out(schedules, keeping=False)
                copied.append(len(schedules) * periods / (time.perf_counter() - began))
    return Table(
        "Explorations: speed",
        f"Control periods of a UR3 per second, in a run of 3 s of a program with two threads; medians of {BLOCKS} "
        "runs. A run of an exploration includes the start of the robot and of the program. The last row is all cores "
        f"({usable_cores()} here) in real time, with the copies of processes; the others are CPU time.",
        ("", "periods per second"),
        [
            ["control periods alone", f"{median(bare):.0f}"],
            ["a run of an exploration", f"{median(whole):.0f}"],
            ["explorations, all cores", f"{median(copied):.0f}"],
        ],
    )


def measure_planted() -> Table:
    """The search and a grid over the same choices, for each planted fault."""
    return Table(
        "Explorations: planted faults",
        f"Runs until the fault is found, at most {MOST_RUNS}: median of {len(SEEDS)} seeds, in steps of {BATCH}. Grid: "
        f"{GRID_POINTS} values of each range, as many choices as the simplest schedule has, in random order; it is "
        f"given up after {GRID_MOST} times the runs of the search. Choices: of what is found with each seed, "
        f"simplified, at most. Same: repetitions of {REPLAYS} that are the same. Mended: what {MENDED_RUNS} runs of "
        "the program without the fault find.",
        ("fault", "search", "grid", "choices", "same", "mended"),
        [_row(one) for one in planted().values()],
    )


def _row(one: Planted) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        plan = read_plan(one.write(Path(folder)))
        answers = [_search(plan, seed, MOST_RUNS) for seed in SEEDS]
        runs = median(count for _, count in answers)
        trails = sorted((it.trail for found, _ in answers for it in found), key=lambda trail: len(trail.schedule))
        if runs > MOST_RUNS or not trails:
            row = [one.name, f"> {MOST_RUNS}", "", "", "", ""]
        else:
            most = round(GRID_MOST * runs)
            grid = _grid_runs(plan, len(trails[0].schedule), SEEDS[0], most)
            same = sum(Run(plan).finish(trails[0].schedule) == trails[0] for _ in range(REPLAYS))
            mended, _ = _search(read_plan(one.write(Path(folder), mended=True)), SEEDS[0], MENDED_RUNS)
            row = [
                one.name,
                f"{runs:.0f}",
                str(grid) if grid <= most else f"> {most}",
                str(len(trails[-1].schedule)),
                f"{same} of {REPLAYS}",
                ", ".join(it.property for it in mended) or "nothing",
            ]
    sys.stdout.write(f"{row}\n")
    sys.stdout.flush()
    return row


def _search(plan: Plan, seed: int, most: int) -> tuple[list[Found], int]:
    """What is found first, and after how many runs."""
    told: list[str] = []
    with Runner(plan, usable_cores()) as runner:
        found, _ = explored(plan, runner, seed, lambda: bool(told) or runner.runs >= most, told.append)
    return list(found.values()), min((it.runs for it in found.values()), default=most + 1)


def _grid_runs(plan: Plan, size: int, seed: int, most: int) -> int:
    """The runs until a grid has found something; more than ``most`` if it has not."""
    axes = [
        [axis for name in names for axis in _axes(plan.choices[name])]
        for names in combinations_with_replacement(plan.choices, size)
    ]
    sizes = [prod(len(axis) for axis in one) for one in axes]
    numbers = Random(seed).sample(range(sum(sizes)), min(most, sum(sizes)))
    with Runner(plan, usable_cores()) as runner:
        for first in range(0, len(numbers), BATCH):
            batch = [_schedule(plan, size, axes, sizes, number) for number in numbers[first : first + BATCH]]
            for number, entry in enumerate(runner.carry_out(batch, keeping=False), first + 1):
                if entry.trail.broken:
                    return number
    return most + 1


def _axes(choice: Choice) -> list[list[Any]]:
    """Values of the time and of each parameter."""
    return [_points(choice.at), *(_points(domain) for domain in choice.parameters.values())]


def _points(domain: Domain) -> list[Any]:
    if isinstance(domain, Span):
        step = (domain.high - domain.low) / (GRID_POINTS - 1)
        values = [domain.low + step * number for number in range(GRID_POINTS)]
        return sorted({round(value) for value in values} if domain.whole else {*values})
    return list(domain.values) if isinstance(domain, OneOf) else [domain.draw(Random(0))]


def _schedule(plan: Plan, size: int, axes: list[list[list[Any]]], sizes: list[int], number: int) -> Schedule:
    """The schedule of a number in the grid."""
    place = 0
    while number >= sizes[place]:
        number -= sizes[place]
        place += 1
    names = list(combinations_with_replacement(plan.choices, size))[place]
    values = []
    for axis in axes[place]:
        number, place = divmod(number, len(axis))
        values.append(axis[place])
    decisions = []
    for name in names:
        at_s, *own = (values.pop(0) for _ in range(1 + len(plan.choices[name].parameters)))
        pairs = tuple(zip(plan.choices[name].parameters, own, strict=True))
        decisions.append(Decision(round(at_s / plan.period_s), name, pairs))
    return tuple(sorted(decisions, key=lambda decision: decision.period))


if __name__ == "__main__":
    sys.stdout.write(measure().markdown() + measure_planted().markdown())
