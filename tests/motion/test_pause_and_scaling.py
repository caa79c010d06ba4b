"""Speed slider, pause, stops: time is stretched, the path is kept."""

from math import dist

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.budget import examples

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig
GOAL = (1.3, -1.1, 1.5, -1.5, -1.9, 0.9)


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def on_joint_line(rig):
    """Every configuration so far lies on the line from START to GOAL."""
    for q in rig.q:
        share = (q[0] - START[0]) / (GOAL[0] - START[0])
        line = tuple(a + share * (b - a) for a, b in zip(START, GOAL, strict=True))
        assert q == pytest.approx(line, abs=1e-12)


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.1])
def test_speed_scaling_stretches_time(rig, fraction):
    full = 1.0 / 1.05 + 1.05 / 1.4
    assert rig.finish(rig.commands.movej(GOAL), fraction) == pytest.approx(full / fraction, abs=0.01)
    on_joint_line(rig)


def test_target_speed_is_the_actual_rate_of_motion(rig):
    rig.commands.movej(GOAL, v=1.0)
    rig.steps(800, 0.5)
    assert max(map(abs, rig.motion.qd)) == pytest.approx(0.5, rel=1e-6)


@settings(max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(fractions=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=12))
def test_any_change_of_the_slider_stays_on_the_path(make_rig, fractions):
    rig = make_rig(period_s=0.008)
    move = rig.commands.movej(GOAL, v=2.0, a=5.0)
    for fraction in fractions:
        rig.steps(10, fraction)
    rig.finish(move)
    on_joint_line(rig)
    assert rig.largest_acceleration() <= 21.0  # the slider's ramp and the move's own, never the joints' 40
    assert rig.motion.q == GOAL


def test_slider_on_a_tool_path(rig):
    start, goal = rig.pose(), add(rig.pose(), 0.2)
    move = rig.commands.movel(goal, v=0.5)
    for fraction in (1.0, 0.2, 0.0, 0.7, 1.0, 0.05, 1.0):
        rig.steps(60, fraction)
    rig.finish(move)
    for q in rig.q:
        assert rig.kinematics.forward(q)[1:3] == pytest.approx(start[1:3], abs=1e-9)
    assert rig.pose() == pytest.approx(goal, abs=1e-9)


def test_slider_at_zero_stops_and_resumes(rig):
    move = rig.commands.movej(GOAL)
    rig.steps(300)
    rig.steps(300, 0.0)
    assert rig.motion.qd == ZERO
    assert not move.ready
    rig.finish(move)
    on_joint_line(rig)


@pytest.mark.parametrize("after", [1, 100, 400, 700])
@pytest.mark.parametrize("tool", [False, True])
def test_pause_and_resume_on_the_path(rig, after, tool):
    goal = add(rig.pose(), 0.1, 0.1)
    move = rig.commands.movel(goal, v=0.1) if tool else rig.commands.movej(GOAL)
    rig.steps(after)
    rig.motion.pause()
    rig.steps(200)
    assert rig.motion.paused
    assert rig.motion.qd == ZERO
    stood = rig.motion.q
    rig.steps(round(0.5 / rig.motion.period_s))
    assert rig.motion.steady
    assert rig.motion.q == stood
    rig.motion.resume()
    rig.finish(move)
    if tool:
        assert rig.pose() == pytest.approx(goal, abs=1e-9)
    else:
        on_joint_line(rig)
        assert rig.motion.q == GOAL
    assert rig.largest_acceleration() < 15.0


def test_pause_in_a_blend(rig):
    start = rig.pose()
    waypoint, goal = add(start, 0.1), add(start, 0.1, 0.1)
    rig.finish(rig.commands.movel(waypoint, r=0.04))
    move = rig.commands.movel(goal)
    rig.steps(20)
    rig.motion.pause()
    rig.steps(200)
    assert rig.motion.qd == ZERO
    assert dist(rig.pose()[:3], waypoint[:3]) < 0.04
    rig.motion.resume()
    rig.finish(move)
    assert rig.pose() == pytest.approx(goal, abs=1e-9)


def test_protective_stop_takes_a_known_time_and_can_be_resumed(rig):
    move = rig.commands.movej(GOAL, v=2.0, a=10.0)
    rig.steps(250)
    assert max(map(abs, rig.motion.qd)) == pytest.approx(2.0, rel=0.02)
    rig.motion.protective_stop()
    taken = 0
    while rig.motion.qd != ZERO:
        rig.step()
        taken += 1
    assert taken * rig.motion.period_s == pytest.approx(2.0 / 40.0, abs=0.006)
    on_joint_line(rig)
    rig.motion.resume()
    rig.finish(move)
    assert rig.motion.q == GOAL


@pytest.mark.parametrize("decel", [2.0, 20.0, None])
def test_stop_ends_the_movement_on_its_path(rig, decel):
    move = rig.commands.movej(GOAL, v=0.8)
    rig.steps(400)
    rig.motion.commands.stop(decel)
    assert rig.rest() == pytest.approx(0.8 / (decel or 10.0), abs=0.008)
    assert move.ready
    on_joint_line(rig)
    rig.steps(100)
    assert rig.motion.qd == ZERO


@pytest.mark.parametrize("tool", [False, True])
def test_a_gentle_stop_after_a_protective_stop_does_not_soften_it(rig, tool):
    rig.finish(rig.commands.speedj((1.0, -0.5, 0, 0, 0, 0), a=10.0))
    rig.motion.protective_stop()
    move = rig.commands.stopl(0.1, 0.1) if tool else rig.commands.stopj(0.5)
    rig.steps(round(1.0 / min(rig.model.qdd_max) / rig.motion.period_s) + 2)
    assert rig.motion.qd == ZERO
    assert not move.ready
    rig.motion.resume()
    rig.finish(move)
    assert rig.motion.qd == ZERO


@pytest.mark.parametrize("command", ["movej", "movel", "servoj", "speedj", "speedl", "servoc"])
def test_stopping_the_program_brings_any_movement_to_rest(rig, command):
    motion, there = rig.motion, add(rig.pose(), 0.1)
    {
        "movej": lambda: motion.commands.movej(GOAL),
        "movel": lambda: motion.commands.movel(there),
        "servoj": lambda: motion.commands.servoj(GOAL, t=0.1),
        "speedj": lambda: motion.commands.speedj((0.5, 0, 0.2, 0, 0, 0), a=2.0),
        "speedl": lambda: motion.commands.speedl((0.1, 0, 0, 0, 0, 0.2), a=1.0),
        "servoc": lambda: motion.commands.servoc(there),
    }[command]()
    rig.steps(120)
    assert motion.qd != ZERO
    motion.program_stopped()
    assert rig.rest() < 0.5
    assert motion.qd == ZERO
    assert not motion.paused
    rig.finish(motion.commands.movej(START))  # and the next program moves as usual
    assert motion.q == START


def test_halt_is_instantaneous(rig):
    rig.commands.movej(GOAL)
    rig.steps(100)
    rig.motion.halt()
    assert rig.motion.idle
    stood = rig.motion.q
    rig.steps(10)
    assert rig.motion.q == stood


def test_set_position_only_at_rest(rig):
    rig.motion.set_position(GOAL)
    assert rig.motion.q == GOAL
    rig.commands.movej(START)
    rig.step()
    with pytest.raises(ValueError, match="moving"):
        rig.motion.set_position(START)


def test_at_rest_nothing_changes(rig):
    rig.finish(rig.commands.movel(add(rig.pose(), 0.05)))
    stood = rig.motion.q
    rig.steps(50)
    assert rig.motion.q == stood
    assert (rig.motion.qd, rig.motion.qdd) == (ZERO, ZERO)
