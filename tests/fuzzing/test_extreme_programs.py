"""For any numbers in a program, the controller does not fail and publishes finite values. More in `make soak`."""

import os
from random import Random

import pytest
from extreme_programs import program, run

from tests.rows import each_row

EACH = int(os.environ.get("RANDOM_EXTREMES", "8")) // 4


@pytest.mark.timeout(0 if "RANDOM_EXTREMES" in os.environ else 120)
@each_row("dynamic", [False, True], ids=["ideal", "dynamic"])
@each_row("model", ["ur3", "ur5e"])
def test_extreme_numbers_do_not_make_the_controller_fail(model: str, dynamic: bool) -> None:
    for seed in range(EACH):
        chance = Random(seed)
        run([program(chance, model) for _ in range(3)], model, chance, dynamic=dynamic)
