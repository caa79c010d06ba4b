"""Campaigns: robot time in a second of a core, and what becomes of it with more processes."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from table import Table

from emulator.campaign.conduct import Conductor
from emulator.campaign.journal import Journal
from emulator.campaign.plan import read_plan
from emulator.campaign.work import installed_version
from emulator.campaign.workers import LocalWorkers

RUNS = 40
PROGRAM = """def work():
  i = 0
  while i < 4:
    movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=1.4, v=1.05)
    movej([-0.5, -1.6, 1.3, -1.3, -1.57, 0.3], a=1.4, v=1.05)
    sleep(0.5)
    i = i + 1
  end
end
"""
CASES = (("ur3", "ideal"), ("ur5e", "ideal"), ("ur5e", "dynamic"))
WORKERS = (1, 2, 4)


def measure() -> Table:
    """One program with many seeds, by one, two and four processes."""
    rows = [row for model, arm in CASES for row in _rows(model, arm)]
    return Table(
        "Campaigns",
        f"{RUNS} runs of one program, a movej back and forth (docs/campaigns.md), on two cores. Per core: robot "
        "seconds per second of CPU time of the runs, including compiling and creating the controller, without starting "
        "Python. Speed-up: relative to one process, with warm processes; two cores allow 2.00.",
        (
            "arm",
            "kind",
            "processes",
            "robot seconds per core second",
            "times real time in total",
            "speed-up",
        ),
        rows,
    )


def _rows(model: str, arm: str) -> Iterator[list[str]]:
    alone = 0.0
    for workers in WORKERS:
        per_core, rate = _campaign(model, arm, workers)
        alone = alone or rate
        yield [model, arm, str(workers), f"{per_core:.0f}", f"{rate:.0f}", f"{rate / alone:.2f}"]


def _campaign(model: str, arm: str, processes: int) -> tuple[float, float]:
    """Robot seconds in a second of a core, and in a second."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "work.script").write_text(PROGRAM)
        file = Path(folder, "work.yaml")
        text = f"{{script: work.script, options: {{model: {model}, arm: {arm}}}, matrix: {{seed: {{count: %d}}}}}}"
        with closing(LocalWorkers(folder, processes)) as workers:
            for runs in (processes, RUNS):  # first one run for each process, which starts it
                file.write_text(text % runs)
                plan = read_plan(file)
                began = time.perf_counter()
                with Journal(Path(folder, str(runs)), plan, installed_version()) as journal:
                    Conductor(plan, workers, journal, installed_version(), lambda _: None).run()
                    results = list(journal.results())
                took = time.perf_counter() - began
    robot_s = sum(result.robot_s or 0.0 for result in results)
    return robot_s / sum(result.cpu_s for result in results), robot_s / took
