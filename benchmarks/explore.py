"""Explorations: what a control period of one costs, and how many runs it takes to find planted faults."""

import sys
import tempfile
import time
from itertools import combinations_with_replacement
from math import prod, sqrt
from pathlib import Path
from random import Random
from statistics import median
from typing import Any

from table import Table

from emulator.branches import Copied
from emulator.explore.choices import Choice, Decision, Domain, OneOf, Schedule, Span
from emulator.explore.plan import Plan, read_plan
from emulator.explore.run import Run
from emulator.explore.search import Found, Runner, explored
from emulator.realtime import usable_cores
from emulator.virtual import virtual_robot

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.explore.planted import Planted, planted

SEEDS = range(5)
MOST_RUNS = 200
MENDED_RUNS = 100
GRID_POINTS = 10  # of each range
GRID_SAMPLE = 300  # points of it that are run
REPLAYS = 20
BATCH = 8
BLOCKS = 5


class _TimedRun(Run):
    """A run that says how much CPU time its process has used [s]."""

    @property
    def cpu_s(self) -> float:
        return time.process_time()


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
            with Copied.of(_TimedRun(plan)) as first:
                began = time.process_time() + first.ask("cpu_s")
                with first.copy() as copy:
                    copy.ask("finish", ())
                    used = copy.ask("cpu_s") + time.process_time() + first.ask("cpu_s") - began
                copied.append(periods / used)
    alone = median(bare)
    return Table(
        "Explorations: speed",
        f"Control periods of a UR3 per second of CPU time, in a run of 3 s of a program with two threads; medians of "
        f"{BLOCKS} runs. The bound is what the control periods of this program take alone. The second row includes the "
        "start of the robot and of the program; explorations make it once and then copy the process, as in the third.",
        ("", "periods per second", "of the bound"),
        [
            [name, f"{value:.0f}", f"{100 * value / alone:.0f} %"]
            for name, value in (
                ("control periods alone", alone),
                ("a run from its beginning", median(whole)),
                ("a run in a copy of the process", median(copied)),
            )
        ],
    )


def measure_planted() -> Table:
    """The search and a grid over the same choices, for each planted fault."""
    return Table(
        "Explorations: planted faults",
        f"Search: runs until the fault is found, with seeds {SEEDS[0]} to {SEEDS[-1]}, in steps of {BATCH}; - is not "
        f"within {MOST_RUNS}. Grid: {GRID_POINTS} values of each range, with as many choices as the simplest schedule "
        "has, which the search does not know; the mean number of points in random order until one breaks the program, "
        f"from the share of {GRID_SAMPLE} random points that do, with its 95 % interval. Choices: of what "
        f"is found with each seed, simplified, at most. Same: of {REPLAYS} repetitions, those that are the same. "
        f"Mended: what {MENDED_RUNS} runs of the program without the fault find.",
        ("fault", "search", "median", "grid", "choices", "same", "mended"),
        [_row(one) for one in planted().values()],
    )


def _row(one: Planted) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        plan = read_plan(one.write(Path(folder)))
        answers = [_search(plan, seed, MOST_RUNS) for seed in SEEDS]
        counts = [count for _, count in answers]
        told = ", ".join(str(count) if count <= MOST_RUNS else "-" for count in counts)
        row = [one.name, told, f"{median(counts):.0f}" if median(counts) <= MOST_RUNS else f"> {MOST_RUNS}"]
        trails = sorted((it.trail for found, _ in answers for it in found), key=lambda trail: len(trail.schedule))
        if trails:
            row += [
                _grid(plan, len(trails[0].schedule), SEEDS[0]),
                str(len(trails[-1].schedule)),
                f"{sum(Run(plan).finish(trails[0].schedule) == trails[0] for _ in range(REPLAYS))} of {REPLAYS}",
            ]
            mended, _ = _search(read_plan(one.write(Path(folder), mended=True)), SEEDS[0], MENDED_RUNS)
            row.append(", ".join(it.property for it in mended) or "nothing")
    row += [""] * (7 - len(row))
    sys.stdout.write(f"{row}\n")
    sys.stdout.flush()
    return row


def _search(plan: Plan, seed: int, most: int) -> tuple[list[Found], int]:
    """What is found first, and after how many runs."""
    told: list[str] = []
    with Runner(plan, usable_cores()) as runner:
        found, _ = explored(plan, runner, seed, lambda: bool(told) or runner.runs >= most, told.append)
    return list(found.values()), min((it.runs for it in found.values()), default=most + 1)


def _grid(plan: Plan, size: int, seed: int) -> str:
    """The mean number of points of the grid until one breaks the program, with its interval."""
    axes = [
        [axis for name in names for axis in _axes(plan.choices[name])]
        for names in combinations_with_replacement(plan.choices, size)
    ]
    sizes = [prod(len(axis) for axis in one) for one in axes]
    numbers = Random(seed).sample(range(sum(sizes)), min(GRID_SAMPLE, sum(sizes)))
    with Runner(plan, usable_cores()) as runner:
        schedules = [_schedule(plan, size, axes, sizes, number) for number in numbers]
        broken = sum(bool(entry.trail.broken) for entry in runner.carry_out(schedules, keeping=False))
    low, high = _interval(broken, len(numbers))
    if not broken:
        return f"> {1.0 / high:.0f}"
    return f"{len(numbers) / broken:.0f} ({1.0 / high:.0f} to {1.0 / low:.0f})"


def _interval(hits: int, number: int) -> tuple[float, float]:
    """Wilson's interval of a share, 95 %."""
    share, square = hits / number, 1.96**2 / number
    middle, half = share + square / 2.0, sqrt(square * (share * (1.0 - share) + square / 4.0))
    return (middle - half) / (1.0 + square), (middle + half) / (1.0 + square)


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
