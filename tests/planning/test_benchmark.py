"""The planning benchmark with few queries: it solves all that a long search solves, and plans keep their clearance."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("ompl")

from scenes import SCENES

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location("benchmark_of_planning", BENCHMARKS / "planning.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look up their module
    path = list(sys.path)
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path[:] = path
    return module


@pytest.mark.parametrize("place", SCENES)
def test_queries_are_solved_and_keep_clear(benchmark: ModuleType, place: str) -> None:
    tally = benchmark.measure_queries("ur10e", place, 3)
    assert tally.queries == 3
    assert tally.solved == tally.solvable
    assert tally.nearest_m > -0.001
    assert len(tally.cpu_s) == len(tally.plans) == tally.solved


async def test_plans_are_executed_and_keep_clear(benchmark: ModuleType) -> None:
    tally = benchmark.measure_queries("ur3", "shelf", 2)
    taken, states, nearest_m = await benchmark.execute("ur3", "shelf", tally.plans)
    assert taken == tally.solved > 0
    assert states > 100
    assert nearest_m > -0.002
