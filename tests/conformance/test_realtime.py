"""Realtime interface: one state every control period, in step with RTDE."""

from itertools import pairwise

import pytest

AT_REST_RAD = 1e-3


def test_one_state_per_period(robot):
    with robot.realtime() as realtime:
        stamps = [realtime.receive()["timestamp"] for _ in range(30)]
    steps_s = [after - before for before, after in pairwise(stamps)]
    assert steps_s == pytest.approx([robot.period_s] * len(steps_s), abs=robot.period_s / 10)


def test_the_state_agrees_with_rtde(robot):
    with robot.realtime() as realtime, robot.rtde(["timestamp", "actual_q", "robot_mode", "safety_mode"]) as rtde:
        seen = realtime.receive()
        state = rtde.latest()
    assert seen["timestamp"] == pytest.approx(state["timestamp"], abs=1.0)  # connections open one after the other
    assert seen["actual_q"] == pytest.approx(state["actual_q"], abs=AT_REST_RAD)
    assert (seen["robot_mode"], seen["safety_mode"]) == (state["robot_mode"], state["safety_mode"])
