"""The joint trajectory controllers' rules as tables: tolerances, ends of goals, replacement, scaling, sampling, gains.

Sources: control_msgs, and ros2_controllers' user documentation of joint_trajectory_controller.
"""

import math
from itertools import pairwise

import pytest
from controllers_rig import JOINTS, RATE_HZ, SCALING, Bench, point, started, trajectory

from client.controllers.goals import ErrorCode, FollowJointTrajectory, GoalStatus, JointTrajectoryPoint, Tolerance
from client.controllers.joint_trajectory import Gains, Pid
from client.errors import ControllerError, GoalRejectedError
from tests.rows import each_row

CYCLE_S = 1.0 / RATE_HZ
LIMITS = {"goal_time": 0.5, "stopped_velocity_tolerance": 0.2} | {
    joint: {"trajectory": 0.2, "goal": 0.05, "max_deceleration_on_cancel": 1.0} for joint in JOINTS
}


def displaced(bench, radians):
    """Something holds the elbow beside its path, once that has begun."""
    bench.cycle()
    bench.joints.stuck.add("elbow_joint")
    bench.joints.states["elbow_joint/position"] = radians


# the controller's and the goal's tolerance, the error, and whether the goal survives
@each_row("sign", [1.0, -1.0])
@each_row(
    ("own", "given", "error", "survives"),
    [
        (0.2, 0.0, 0.199, True),
        (0.2, 0.0, 0.201, False),
        (0.2, 0.1, 0.099, True),
        (0.2, 0.1, 0.101, False),
        (0.1, 0.2, 0.15, True),
        (0.2, -1.0, 9.0, True),
        (0.0, 0.0, 9.0, True),
        (0.0, 0.1, 0.101, False),
    ],
)
def test_tolerances_along_the_path_and_at_the_goal(own, given, error, survives, sign):
    tolerance = {"elbow_joint": Tolerance(given)}
    bench, jtc = started(constraints={"elbow_joint": {"trajectory": own}})
    handle = jtc.send_goal(FollowJointTrajectory(trajectory(point(5.0, 1.0, 0.0)), path_tolerance=tolerance))
    displaced(bench, sign * error)
    bench.cycle(5)
    assert handle.done is not survives
    assert survives or handle.result.error_code is ErrorCode.PATH_TOLERANCE_VIOLATED

    bench, jtc = started(constraints={"elbow_joint": {"goal": own}})
    handle = jtc.send_goal(FollowJointTrajectory(trajectory(point(0.2, 1.0, 0.0)), goal_tolerance=tolerance))
    displaced(bench, sign * error)
    bench.run(0.15)
    assert not handle.done, "along the path, the goal's tolerance does not count"
    bench.run(0.1)
    assert handle.done is survives
    assert not survives or handle.status is GoalStatus.SUCCEEDED


@each_row(
    ("tolerance", "words"),
    [
        ({"path_tolerance": {"elbow_joint": Tolerance(-0.5)}}, r"the path tolerance of elbow_joint is -0\.5"),
        ({"goal_tolerance": {"elbow_joint": Tolerance(0.0, -2.0)}}, r"the goal tolerance of elbow_joint is -2\.0"),
        ({"goal_tolerance": {"elbow_joint": Tolerance(0.0, 0.0, -2.0)}}, "the goal tolerance of elbow_joint"),
        ({"goal_tolerance": {"wrist_joint": Tolerance(0.1)}}, "names the joint wrist_joint"),
        ({"goal_time_tolerance_s": -0.5}, r"the goal time is -0\.5"),
    ],
)
def test_invalid_tolerances_leave_the_goal_under_way(tolerance, words):
    bench, jtc = started()
    going = jtc.send_goal(trajectory(point(0.2, 1.0, 0.0)))
    with pytest.raises(GoalRejectedError, match=words) as caught:
        jtc.send_goal(FollowJointTrajectory(trajectory(point(1.0, 1.0, 0.0)), **tolerance))
    assert caught.value.code is ErrorCode.INVALID_GOAL
    assert bench.until(going).error_code is ErrorCode.SUCCESSFUL


# what is commanded, the tolerance of the speed along the path, the speed of a joint that should stand, the survival
@each_row(
    ("command", "tolerance", "speed", "survives"),
    [
        ("position", 0.1, 5.0, True),
        ("velocity", 0.1, 0.09, True),
        ("velocity", 0.1, -0.11, False),
        ("velocity", 0.0, 5.0, True),
    ],
)
def test_speeds_count_where_they_are_commanded(command, tolerance, speed, survives):
    bench, jtc = started(command_interfaces=[command])
    limit = {"elbow_joint": Tolerance(velocity=tolerance)}
    handle = jtc.send_goal(FollowJointTrajectory(trajectory(point(5.0, 1.0, 0.0, v=(0.0, 0.0))), path_tolerance=limit))
    displaced(bench, 0.0)
    bench.joints.states["elbow_joint/velocity"] = speed
    bench.cycle(5)
    assert handle.done is not survives


# the controller's goal time, the goal's, and when a goal that is missed ends; it is due after 1 s
@each_row(
    ("own_s", "given_s", "ends_s"),
    [(0.5, 0.0, 1.5), (0.5, 0.2, 1.2), (0.2, 0.5, 1.5), (0.5, -1.0, None), (0.0, 0.0, None), (0.0, 0.2, 1.2)],
)
def test_how_late_the_arm_may_arrive(own_s, given_s, ends_s):
    constraints = {"goal_time": own_s, "elbow_joint": {"goal": 0.05, "trajectory": 0.08}}
    bench, jtc = started(constraints=constraints)
    bench.joints.stuck.add("elbow_joint")
    handle = jtc.send_goal(
        FollowJointTrajectory(
            trajectory(point(1.0, 0.0, 0.1)),
            path_tolerance={"elbow_joint": Tolerance(0.11)},
            goal_time_tolerance_s=given_s,
        )
    )
    if ends_s is None:
        bench.run(5.0)
        assert not handle.done
        return
    bench.run(ends_s)
    assert not handle.done
    result = bench.until(handle, 0.04)
    assert result.error_code is ErrorCode.GOAL_TOLERANCE_VIOLATED
    assert "elbow_joint: position error 0.1000, tolerance 0.05" in result.error_string


PREEMPTED = "Current goal preempted by new incoming action."
DEACTIVATED = "Current goal cancelled during deactivate transition."


@each_row("braking", [False, True])
@each_row(
    ("end", "status", "code", "text"),
    [
        ("send_goal", GoalStatus.ABORTED, ErrorCode.INVALID_GOAL, PREEMPTED),
        ("command", GoalStatus.ABORTED, ErrorCode.INVALID_GOAL, PREEMPTED),
        ("cancel", GoalStatus.CANCELED, ErrorCode.SUCCESSFUL, ""),
        ("halt", GoalStatus.ABORTED, ErrorCode.INVALID_GOAL, "the arm was stopped"),
        ("deactivate", GoalStatus.ABORTED, ErrorCode.INVALID_GOAL, DEACTIVATED),
    ],
)
@each_row("begun", [True, False])
def test_how_a_goal_ends_that_is_not_reached(end, status, code, text, braking, begun):
    """Each goal ends once; then the arm follows what has replaced it, or stops."""
    bench, jtc = started(constraints=LIMITS | {"decelerate_on_cancel": braking})
    ends = []
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, -1.0)))
    handle.on_end.append(ends.append)
    if begun:
        bench.run(0.5)
    new = trajectory(point(1.0, 0.0, 0.0))
    match end:
        case "send_goal" | "command":
            getattr(jtc, end)(new)
        case "cancel":
            jtc.cancel()
        case "halt":
            bench.joints.halt = text
            bench.cycle()
        case "deactivate":
            bench.manager.deactivate("jtc")
    assert (handle.status, handle.result.error_code, handle.result.error_string) == (status, code, text)
    stopped = bench.q[0]
    bench.run(2.0)
    assert len(ends) == 1
    brakes = 0.5 if braking and begun and end == "cancel" else 0.0
    assert bench.q[0] == pytest.approx(stopped + brakes if end not in ("send_goal", "command") else 0.0, abs=0.03)
    if end == "deactivate":
        return
    assert jtc.progress == 1.0 if end != "command" else jtc.goal is None
    after = jtc.send_goal(trajectory(point(0.5, 0.3, 0.3)))
    assert bench.until(after).error_code is ErrorCode.SUCCESSFUL
    assert bench.q == pytest.approx((0.3, 0.3), abs=1e-3)


def test_a_goal_that_is_replaced_before_it_begins_leaves_nothing():
    bench, jtc = started()
    first = jtc.send_goal(trajectory(point(1.0, 5.0, 5.0)))
    second = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    assert first.status is GoalStatus.ABORTED
    assert bench.until(second, 1.1).error_code is ErrorCode.SUCCESSFUL
    assert bench.q == pytest.approx((1.0, 1.0), abs=1e-3)
    assert not jtc.goal
    jtc.send_goal(trajectory(point(1.0, 5.0, 5.0)))
    jtc.cancel()
    bench.run(1.0)
    assert bench.q == pytest.approx((1.0, 1.0), abs=1e-3)


def test_a_topics_trajectory_has_the_controllers_tolerances_and_not_those_of_the_goal_before():
    bench, jtc = started(constraints=LIMITS)
    anything = dict.fromkeys(JOINTS, Tolerance(-1.0))
    bench.until(jtc.send_goal(FollowJointTrajectory(trajectory(point(0.1, 0.0, 0.0)), path_tolerance=anything)))
    jtc.command(trajectory(point(5.0, 1.0, 0.0)))
    displaced(bench, 0.3)
    bench.run(1.0)
    assert bench.joints.commands["shoulder_joint/position"] < 0.1, "it holds, because the elbow is off its path"


# speed scaling


@each_row("scaling", [1.0, 0.5, 0.25])
def test_a_replacement_continues_from_where_a_scaled_path_is(scaling):
    bench, scaled = started("scaled")
    bench.joints.states[SCALING] = scaling
    scaled.send_goal(trajectory(point(4.0, 4.0, 0.0)))
    bench.run(1.0)
    scaled.send_goal(trajectory(point(1.0, 0.0, 0.0, v=(0.0, 0.0))))
    places = [bench.q[0]]
    for _ in range(round(1.1 / scaling * RATE_HZ)):
        bench.cycle()
        places.append(bench.q[0])
    speeds = [(b - a) * RATE_HZ / scaling for a, b in pairwise(places)]
    assert speeds[0] == pytest.approx(1.0)
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.2
    assert places[-1] == pytest.approx(0.0, abs=1e-6)


@each_row("factor", [0.0, 0.5, 1.0, 2.0])
def test_a_scaling_that_is_set_applies_until_it_is_read(factor):
    bench, jtc = started()
    jtc.set_scaling(factor)
    jtc.send_goal(trajectory(point(2.0, 2.0, 0.0)))
    bench.run(0.5)
    assert bench.q[0] == pytest.approx(0.5 * factor, abs=0.02 + 0.02 * factor)
    bench, scaled = started("scaled")
    bench.joints.states[SCALING] = 0.5
    scaled.set_scaling(factor)
    bench.cycle()
    assert scaled.scaling == 0.5


@each_row("factor", [-0.1, math.inf, math.nan])
def test_invalid_scaling(factor):
    _, jtc = started()
    with pytest.raises(ControllerError, match="0 or more"):
        jtc.set_scaling(factor)
    assert jtc.scaling == 1.0
    _, speeds = started(command_interfaces=["velocity"])
    with pytest.raises(ControllerError, match="does not command positions"):
        speeds.set_scaling(0.5)


def test_a_robot_that_stands_still_does_not_brake_until_it_moves():
    bench, scaled = started("scaled", constraints=LIMITS | {"decelerate_on_cancel": True})
    scaled.send_goal(trajectory(point(1.0, 1.0, 0.0)))
    bench.run(0.5)
    scaled.cancel()
    bench.joints.states[SCALING] = 0.0
    bench.cycle(2)
    stood = bench.q[0]
    bench.run(1.0)
    assert bench.q[0] == stood
    bench.joints.states[SCALING] = 0.1
    bench.run(1.5)
    assert bench.q[0] == pytest.approx(0.5 + 0.5, abs=0.03), "braking is not stretched"


# sampling, progress and feedback


def test_samples_are_of_the_time_asked_for_at_the_present_scaling():
    bench, jtc = started()
    with pytest.raises(ControllerError, match="follows no trajectory"):
        jtc.sampled(bench.time_s)
    handle = jtc.send_goal(trajectory(point(2.0, 2.0, 0.0)))
    with pytest.raises(ControllerError, match="follows no trajectory"):
        jtc.sampled(bench.time_s)
    bench.run(1.0 + CYCLE_S)
    for scaling in (1.0, 0.5):
        jtc.set_scaling(scaling)
        for ahead_s in (0.0, 0.4, -0.4):
            there = jtc.sampled(bench.time_s + ahead_s).positions[0]
            assert there == pytest.approx(1.0 + ahead_s * scaling, abs=1e-6)
    jtc.set_scaling(1.0)
    for time_s, words in ((-2.0, "before the start"), (2.0, "after the end")):
        with pytest.raises(ControllerError, match=words):
            jtc.sampled(bench.time_s + time_s)
    bench.until(handle)
    with pytest.raises(ControllerError, match="follows no trajectory"):
        jtc.sampled(bench.time_s)


def test_progress_is_0_while_a_trajectory_waits_and_1_while_holding():
    bench, jtc = started()
    assert jtc.progress == 1.0
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 0.0), stamp_s=bench.time_s + 0.5))
    assert jtc.progress == 0.0
    bench.run(0.25)
    assert jtc.progress == 0.0
    bench.run(0.75)
    assert jtc.progress == pytest.approx(0.5, abs=0.02)
    bench.until(handle)
    assert jtc.progress == 1.0


def test_feedback_counts_the_points_of_its_own_goal():
    bench, jtc = started()
    jtc.send_goal(trajectory(point(1.0, 1.0, 0.0), point(2.0, 2.0, 0.0), point(3.0, 3.0, 0.0)))
    bench.run(1.5)
    handle = jtc.send_goal(trajectory(point(1.0, 2.0, 0.0), point(2.0, 3.0, 0.0), stamp_s=bench.time_s + 1.0))
    seen = []
    for _ in range(310):
        bench.cycle()
        seen.append(handle.feedback.index)
    assert [index for index, before in zip(seen[1:], seen, strict=False) if index != before] == [1]
    assert seen[0] == 0
    assert seen[150] == 0
    assert seen[250] == 1


# gains and interfaces


@each_row(
    ("gains", "error", "rate", "command"),
    [
        (Gains(p=2.0), 0.3, 9.0, 0.6),
        (Gains(i=2.0), 0.3, 9.0, 0.06),
        (Gains(d=2.0), 0.3, 0.4, 0.8),
        (Gains(p=2.0, i=2.0, d=2.0), 0.3, 0.4, 1.46),
        (Gains(p=2.0, u_clamp_max=0.5), 0.3, 0.0, 0.5),
        (Gains(p=2.0, u_clamp_min=-0.5), -0.3, 0.0, -0.5),
        (Gains(p=2.0, u_clamp_min=-0.5, u_clamp_max=0.9), 0.3, 0.0, 0.6),
        (Gains(i=2.0, i_clamp_max=0.05), 0.3, 0.0, 0.05),
        (Gains(i=2.0, i_clamp_min=-0.05), -0.3, 0.0, -0.05),
    ],
)
def test_gains(gains, error, rate, command):
    pid = Pid(gains)
    assert pid.command(error, rate, 0.1) == pytest.approx(command)
    pid.reset()
    assert pid.command(error, rate, 0.1) == pytest.approx(command)


@each_row(("p", "feedforward", "speed"), [(0.0, 1.0, 0.5), (0.0, 0.5, 0.25), (2.0, 0.0, 1.0)])
def test_the_first_speed_that_is_commanded(p, feedforward, speed):
    """At 0.5 rad/s along a line, half a second after the start, of joints that have not moved."""
    gains = {joint: {"p": p, "ff_velocity_scale": feedforward} for joint in JOINTS}
    bench, jtc = started(command_interfaces=["velocity"], gains=gains)
    bench.joints.stuck.update(JOINTS)
    jtc.send_goal(trajectory(point(2.0, 1.0, -1.0)))
    bench.run(1.0 + CYCLE_S)
    assert bench.joints.commands["shoulder_joint/velocity"] == pytest.approx(speed)
    assert bench.joints.commands["elbow_joint/velocity"] == pytest.approx(-speed)
    jtc.cancel()
    bench.cycle()
    assert bench.joints.commands["shoulder_joint/velocity"] == pytest.approx(0.0)


def test_an_activation_holds_the_last_command_unless_told_to_hold_the_position():
    for last, held in ((True, 0.7), (False, 0.4)):
        bench = Bench(set_last_command_interface_value_as_state_on_activation=last)
        bench.joints.stuck.update(JOINTS)
        bench.joints.states["shoulder_joint/position"] = 0.4
        bench.joints.perform_command_mode_switch = lambda start, _, joints=bench.joints: joints.commands.lend(
            list(start)
        ).fill(0.7)
        bench.manager.activate("jtc")
        bench.cycle(2)
        assert bench.joints.commands["shoulder_joint/position"] == pytest.approx(held)


@each_row("kinds", [["velocity"], ["position", "effort"], []])
def test_state_interfaces_that_it_cannot_use(kinds):
    with pytest.raises(ControllerError, match="state_interfaces must include position"):
        Bench(state_interfaces=kinds).manager.activate("jtc")


def test_points_may_not_have_efforts_where_none_are_commanded():
    _, jtc = started()
    heavy = JointTrajectoryPoint((1.0, 1.0), effort=(1.0, 1.0), time_from_start_s=1.0)
    with pytest.raises(GoalRejectedError, match="point 0 has effort"):
        jtc.send_goal(trajectory(heavy))
