"""Random programs on every arm, in virtual time. What has to hold in each period: `random_programs.Run`.

A small number in the suite. For many more:

    RANDOM_PROGRAMS=10000 python -m pytest -n auto tests/motion/test_random_programs.py
"""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from random_programs import Case, programs, run

from urproto.robots import MODELS

WANTED = os.environ.get("RANDOM_PROGRAMS")
PHASES = tuple(Phase) if WANTED else (Phase.generate,)  # to make a finding smaller takes minutes
EACH = max(1, round(int(WANTED) / len(MODELS))) if WANTED else 4


@pytest.mark.timeout(0 if WANTED else 120)
@pytest.mark.parametrize("model", MODELS)
def test_whatever_the_program_the_arm_keeps_its_limits(model):
    @settings(max_examples=EACH, deadline=None, database=None, suppress_health_check=list(HealthCheck), phases=PHASES)
    @given(programs(model))
    def each(case: Case) -> None:
        run(case)

    each()
