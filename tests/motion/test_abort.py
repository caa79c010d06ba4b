"""The command abort of interpreter mode, as the Script Manual describes it."""

from math import dist

import pytest

GOAL = (1.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # the rig starts 1 rad away
NEXT = (1.3, -1.2, 1.7, -1.5, -1.5, 0.2)


def shifted(pose, x=0.0, y=0.0):
    return (pose[0] + x, pose[1] + y, *pose[2:])


def test_without_a_blend_radius_the_arm_stops_on_its_path(rig):
    move = rig.commands.movej(GOAL)
    rig.steps(300)
    rig.commands.abort()
    assert not move.ready, "the program waits until the arm is at rest"
    rig.finish(move)
    assert rig.motion.idle
    assert 0.3 < rig.motion.q[0] < GOAL[0] - 0.2
    assert rig.motion.q[1:] == pytest.approx(GOAL[1:], abs=1e-12)
    assert rig.largest_acceleration() < 15.0
    rig.finish(rig.commands.movej(GOAL))
    assert rig.motion.q == pytest.approx(GOAL)


def test_stopping_does_not_leave_the_line(rig):
    start = rig.pose()
    move = rig.commands.movel(shifted(start, x=0.3))
    rig.steps(300)
    rig.commands.abort()
    rig.finish(move)
    at = rig.pose()
    assert 0.01 < at[0] - start[0] < 0.25
    assert at[1:] == pytest.approx(start[1:], abs=1e-9)


@pytest.mark.parametrize("command", ["movej", "movel"])
def test_with_a_blend_radius_the_next_move_blends_in_immediately(rig, make_rig, command):
    def nearest_to_the_corner(rig, aborted):
        corner = shifted(rig.pose(), x=0.25)
        line = command == "movel"
        first = rig.commands.movel(corner, v=0.2, r=0.02) if line else rig.commands.movej(GOAL, r=0.02)
        rig.steps(400)
        assert not first.ready
        if aborted:
            rig.commands.abort()
            rig.step()
            assert first.ready
        rig.finish(first)
        speed_before = max(map(abs, rig.motion.qd))
        second = rig.commands.movel(shifted(corner, y=0.2)) if line else rig.commands.movej(NEXT)
        rig.step()
        assert max(map(abs, rig.motion.qd)) > 0.9 * speed_before, "no stop in between"
        rig.finish(second)
        assert rig.largest_acceleration() < 15.0
        waypoint = corner[:3] if line else rig.kinematics.forward(GOAL)[:3]
        return min(dist(rig.kinematics.forward(q)[:3], waypoint) for q in rig.q)

    assert nearest_to_the_corner(rig, aborted=True) > 1.2 * nearest_to_the_corner(make_rig(), aborted=False)


def test_with_a_blend_radius_but_no_next_move_the_arm_reaches_its_target(rig):
    move = rig.commands.movej(GOAL, r=0.05)
    rig.steps(200)
    rig.commands.abort()
    rig.step()
    assert move.ready
    rig.rest()
    assert rig.motion.q == pytest.approx(GOAL)


def test_abort_is_ignored_in_an_initial_blend(rig):
    rig.finish(rig.commands.movej(GOAL, r=0.1))
    second = rig.commands.movej(NEXT, r=0.05)
    rig.steps(3)
    rig.commands.abort()
    rig.steps(3)
    assert not second.ready


@pytest.mark.parametrize("command", ["movep", "movec", "servoj", "speedj", "stopj", "pause", "rest"])
def test_abort_does_not_affect_other_commands(rig, make_rig, command):
    def run(rig, aborted):
        start = rig.pose()
        match command:
            case "movep":
                rig.commands.movep(shifted(start, x=0.3))
            case "movec":
                rig.commands.movec(shifted(start, x=0.1, y=0.1), shifted(start, x=0.2))
            case "servoj":
                rig.commands.servoj(GOAL, t=2.0)
            case "speedj":
                rig.commands.speedj((0.3, 0, 0, 0, 0, 0), a=1.0, t=2.0)
            case "stopj":
                rig.finish(rig.commands.speedj((0.3, 0, 0, 0, 0, 0), a=1.0, t=1.0))
                rig.commands.stopj(0.2)
            case "pause":
                rig.commands.movej(GOAL)
                rig.steps(200)
                rig.motion.pause()
        rig.steps(200)
        if aborted:
            rig.commands.abort()
        rig.steps(200)
        rig.motion.resume()
        rig.steps(200)
        return rig.q

    assert run(rig, aborted=True) == run(make_rig(), aborted=False)
