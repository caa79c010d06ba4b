"""Explorations find what is planted, simplify it, and find nothing in the mended programs."""

import pytest

from emulator.explore.plan import read_plan
from emulator.explore.run import Run
from emulator.explore.search import Runner, explored
from tests.explore.planted import planted

PLANTED = planted()
QUICK = {"answer without a time limit"}
MOST_RUNS = 600
REPLAYS = 20


@pytest.mark.timeout(900)  # some hundreds of runs, also on a busy machine
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in PLANTED]
)
def test_a_planted_fault_is_found_and_none_if_it_is_mended(name, tmp_path):
    one = PLANTED[name]
    plan = read_plan(one.write(tmp_path))
    told: list[str] = []
    with Runner(plan, 2) as runner:
        found, _ = explored(plan, runner, 0, lambda: bool(told) or runner.runs >= MOST_RUNS, told.append)
    (first,) = list(found.values())[:1]
    assert 1 <= len(first.trail.schedule) <= 3
    assert all(Run(plan).finish(first.trail.schedule) == first.trail for _ in range(REPLAYS))
    mended = read_plan(one.write(tmp_path, mended=True))
    assert Run(mended).finish(first.trail.schedule).broken == {}
    with Runner(mended, 2) as runner:
        found, _ = explored(mended, runner, 0, lambda: runner.runs >= first.runs)
    assert found == {}
