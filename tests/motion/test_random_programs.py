"""Random programs on every arm, in virtual time. `random_programs.Run` has the conditions checked in each period.

A small number in the suite. For many more:

    RANDOM_PROGRAMS=10000 python -m pytest -n auto tests/motion/test_random_programs.py
"""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from random_programs import Case, programs, run

from tests.rows import each_row
from urproto.robots import MODELS

PROGRAM_COUNT = os.environ.get("RANDOM_PROGRAMS")
PHASES = tuple(Phase) if PROGRAM_COUNT else (Phase.generate,)  # shrinking a finding takes minutes
EACH = max(1, round(int(PROGRAM_COUNT) / len(MODELS))) if PROGRAM_COUNT else 4

MAIN = ("ur3", "ur5e", "ur20")
ARMS = [name if name in MAIN else pytest.param(name, marks=pytest.mark.long) for name in MODELS]


UPRIGHT, BENT = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0), (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
FOUND = {
    "servoc stops where the elbow is nearly stretched": Case(
        "ur5",
        BENT,
        (("servoc(pose_trans(get_target_tcp_pose(), p[-0.1988, -0.1992, 0.078, -0.084, 1, -0.12]), a=8, v=0.05)",),),
    ),
    "a conveyor begins to move a stretched arm in force mode": Case(
        "ur5e",
        UPRIGHT,
        (
            (
                "encoder_enable_pulse_decode(0, 1, 0, 1)",
                "track_conveyor_circular(p[0,0,0,0,0,0], 5000, True)",
                "force_mode(p[0.1, -0.1, 0.9, 0.27, -0.22, -1], [0, 0, 1, 0, 0, 0], [0, 0, -13, 0, 0, 0], 1, "
                "[0.3, 0.3, 0.3, 1, 1, 1])",
                "protective_stop()",
                "speedl([-0.2432, -0.8, -0.7344, -0.652, -0.496, -0.476], 0.9, 0.04)",
            ),
        ),
        ((0.0, "slider", 0.0),),
        0.05,
    ),
    "a force stretches the arm beside a move that waits": Case(
        "ur10e",
        BENT,
        (
            (
                "force_mode(p[0, 0, 0, 0, 0, 0], [1, 1, 0, 0, 0, 1], [-12.08, -31.92, 4.72, -2.952, -1.314, -1.398], "
                "1, [0.3, 0.3, 0.3, 1, 1, 1])",
                "optimovel(p[0.3564, 0.1008, -0.1989, -0.7688, -1.1656, -3.0194], a=0.5564, v=0.6665)",
            ),
        ),
        ((0.2, "slider", 0.03),),
        0.05,
    ),
    "a gentle stop follows a protective stop in the same period": Case(
        "ur15",
        (-2.0, -2.0, -1.4, -0.9, 1.5, 3.0),
        (
            (
                "movep(pose_trans(get_target_tcp_pose(), p[-0.0304, 0, -0.1156, -0.332, -0.602, -0.93]), a=5.5, v=2.6, "
                "r=0.1)",
                "protective_stop()",
                "stopj(7)",
            ),
        ),
        patience_s=10.0,
    ),
    "a line ends where the arm is stretched": Case(
        "ur5", (0.4, -1.1, 1.9, -2.2, -1.2, 0.7), (("movel([0.5, -0.3, 0.0001, -0.4, -1.5, 0], t=0.7189)",),)
    ),
}


@each_row("name", FOUND)
def test_previously_found_programs(name: str) -> None:
    run(FOUND[name])


@pytest.mark.timeout(0 if PROGRAM_COUNT else 120)
@pytest.mark.parametrize(
    "model", [name if name in MAIN else pytest.param(name, marks=pytest.mark.long) for name in MODELS]
)
def test_random_programs_keep_the_limits_of_the_arm(model):
    @settings(max_examples=EACH, deadline=None, database=None, suppress_health_check=list(HealthCheck), phases=PHASES)
    @given(programs(model))
    def each(case: Case) -> None:
        run(case)

    each()
