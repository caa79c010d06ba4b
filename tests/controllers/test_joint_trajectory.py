"""The joint trajectory controllers over joints that do what they are told."""

from itertools import pairwise

import pytest
from controllers_rig import JOINTS, RATE_HZ, SCALING, Bench, point, started, trajectory

from client.controllers.goals import ErrorCode, GoalStatus
from client.controllers.joint_trajectory import Gains, Pid
from client.errors import ControllerError, GoalRejectedError
from tests.rows import each_row

TOLERANCES = {
    "constraints": {
        "goal_time": 0.5,
        "stopped_velocity_tolerance": 0.2,
        **{joint: {"trajectory": 0.2, "goal": 0.05} for joint in JOINTS},
    }
}
REST = (0.0, 0.0)


def test_a_goal_is_followed_and_succeeds():
    bench, jtc = started(**TOLERANCES)
    states = []
    jtc.state_topic.subscribe(states.append)
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, -2.0, v=REST), point(2.0, 0.5, 0.0, v=REST)))
    result = bench.until(handle)
    assert (result.error_code, result.error_string) == (ErrorCode.SUCCESSFUL, "Goal successfully reached!")
    assert handle.status is GoalStatus.SUCCEEDED
    assert bench.q == pytest.approx((0.5, 0.0), abs=1e-3)
    passing = min(states, key=lambda state: abs(state.reference.positions[0] - 1.0))
    assert passing.reference.positions == pytest.approx((1.0, -2.0), abs=1e-3)
    assert max(abs(value) for state in states for value in state.error.positions) < 1e-6


def test_setpoints_are_one_period_ahead():
    bench, jtc = started()
    jtc.send_goal(trajectory(point(1.0, 1.0, 2.0)))
    bench.cycle()
    assert [bench.joints.commands[f"{joint}/position"] for joint in JOINTS] == pytest.approx([0.01, 0.02])


def test_joints_are_taken_by_name_in_any_order():
    bench, jtc = started()
    bench.until(jtc.send_goal(trajectory(point(1.0, 1.0, 2.0), names=JOINTS[::-1])))
    assert bench.q == pytest.approx((2.0, 1.0))


def test_speed_scaling_stretches_time():
    bench, scaled = started("scaled")
    bench.joints.states[SCALING] = 0.25
    handle = scaled.send_goal(trajectory(point(1.0, 1.0, 0.0)))
    bench.run(2.0)
    assert bench.q[0] == pytest.approx(0.5, abs=0.02)
    bench.joints.states[SCALING] = 0.0
    bench.run(5.0)
    assert bench.q[0] == pytest.approx(0.5, abs=0.02)
    bench.joints.states[SCALING] = 1.0
    bench.run(0.55)
    assert handle.done
    assert handle.status is GoalStatus.SUCCEEDED


def test_the_plain_controller_ignores_the_scaling_without_its_interface():
    for scaling, there in ({}, 1.0), ({"speed_scaling": {"state_interface": SCALING}}, 0.5):
        bench, jtc = started(**scaling)
        bench.joints.states[SCALING] = 0.5
        jtc.send_goal(trajectory(point(1.0, 1.0, 0.0)))
        bench.run(1.02)
        assert bench.q[0] == pytest.approx(there, abs=0.02)


def test_a_joint_off_its_path_aborts_and_holds():
    bench, jtc = started(**TOLERANCES)
    handle = jtc.send_goal(trajectory(point(2.0, 1.0, 1.0)))
    bench.run(0.5)
    bench.joints.stuck.add("elbow_joint")
    result = bench.until(handle)
    assert (handle.status, result.error_code) == (GoalStatus.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED)
    assert "path tolerance violation (elbow_joint: position error 0.20" in result.error_string
    bench.cycle(2)
    held = bench.q
    bench.run(2.0)
    assert bench.q == pytest.approx(held)


def test_without_a_goal_time_it_waits_for_ever():
    bench, jtc = started(constraints={"elbow_joint": {"goal": 0.05}})
    bench.joints.stuck.add("elbow_joint")
    handle = jtc.send_goal(trajectory(point(1.0, 0.1, 0.1)))
    bench.run(30.0)
    assert not handle.done
    bench.joints.stuck.clear()
    assert bench.until(handle, 0.1).error_code is ErrorCode.SUCCESSFUL


def test_the_stopped_velocity_counts_where_speeds_are_commanded():
    gains = {joint: {"p": 5.0, "ff_velocity_scale": 1.0} for joint in JOINTS}
    bench, jtc = started(
        command_interfaces=["velocity"], gains=gains, **{"constraints": {"stopped_velocity_tolerance": 0.05}}
    )
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0, v=REST)))
    bench.run(0.99)
    bench.joints.stuck.add("elbow_joint")
    bench.joints.states["elbow_joint/velocity"] = 0.1
    bench.run(1.0)
    assert not handle.done
    bench.joints.states["elbow_joint/velocity"] = 0.01
    bench.cycle()
    assert handle.status is GoalStatus.SUCCEEDED


def test_the_integral_is_clamped_so_that_it_turns_round_at_once():
    pid = Pid(Gains(i=1.0, i_clamp_max=0.5, i_clamp_min=-0.2))
    assert [pid.command(1.0, 0.0, 0.2) for _ in range(4)] == pytest.approx([0.2, 0.4, 0.5, 0.5])
    assert [pid.command(-1.0, 0.0, 0.2) for _ in range(5)] == pytest.approx([0.3, 0.1, -0.1, -0.2, -0.2])


def test_an_activation_begins_with_speeds_of_zero_and_an_end_leaves_none():
    gains = {joint: {"i": 1.0} for joint in JOINTS}
    bench, jtc = started(command_interfaces=["velocity"], gains=gains)
    names = [f"{joint}/velocity" for joint in JOINTS]
    left = []
    bench.joints.perform_command_mode_switch = lambda start, stop: left.append(bench.joints.commands.lend(stop).get())
    bench.joints.stuck.update(JOINTS)
    jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(1.0)
    assert min(bench.joints.commands.lend(names).get()) > 0.3, "the integral of what is missing"
    bench.manager.deactivate("jtc")
    assert left[-1] == [0.0, 0.0], "whatever the hardware makes of the end"
    bench.manager.activate("jtc")
    bench.cycle()
    assert bench.joints.commands.lend(names).get() == [0.0, 0.0]


def test_a_scaling_that_is_not_known_stays_what_it_was():
    bench, scaled = started("scaled")
    bench.joints.states[SCALING] = 0.5
    scaled.send_goal(trajectory(point(2.0, 1.0, 0.0)))
    bench.run(1.0)
    bench.joints.states[SCALING] = float("nan")
    bench.run(1.0)
    assert scaled.scaling == 0.5
    assert bench.q[0] == pytest.approx(0.5, abs=0.02)


def test_braking_has_nothing_to_do_with_the_speed_of_a_path_that_no_arm_follows():
    joints = {joint: {"trajectory": 0.2, "max_deceleration_on_cancel": 1.0} for joint in JOINTS}
    for canceled in (False, True):
        bench, jtc = started(constraints={"decelerate_on_cancel": True} | joints)
        bench.joints.stuck.update(JOINTS)
        handle = jtc.send_goal(trajectory(point(1.0, 0.0, 0.0), point(1.05, -1.0, 1.0)))
        if canceled:
            bench.run(1.01)
            jtc.cancel()
        else:
            assert bench.until(handle).error_code is ErrorCode.PATH_TOLERANCE_VIOLATED
        bench.run(5.0)
        sent = bench.joints.commands.lend([f"{joint}/position" for joint in JOINTS]).get()
        assert sent == pytest.approx(bench.q, abs=0.5 if canceled else 1e-9)


def test_braking_lasts_as_long_when_the_robot_is_slow():
    constraints = {"decelerate_on_cancel": True} | {joint: {"max_deceleration_on_cancel": 1.0} for joint in JOINTS}
    bench, scaled = started("scaled", constraints=constraints)
    bench.joints.states[SCALING] = 0.5
    scaled.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(1.0)  # at 0.5 rad/s
    places = [bench.q[0]]
    scaled.cancel()
    for _ in range(60):
        bench.cycle()
        places.append(bench.q[0])
    speeds = [(b - a) * RATE_HZ for a, b in pairwise(places)]
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.03  # no jerk
    assert speeds[25] == pytest.approx(0.25, abs=0.03)
    assert speeds[-1] == 0.0


def test_braking_begins_at_the_scaled_speed_while_the_arm_is_still_faster():
    constraints = {"decelerate_on_cancel": True} | {joint: {"max_deceleration_on_cancel": 1.0} for joint in JOINTS}
    bench, scaled = started("scaled", constraints=constraints)
    scaled.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(0.5)  # at 1 rad/s
    bench.joints.states[SCALING] = 0.5
    bench.cycle()
    assert bench.joints.states["shoulder_joint/velocity"] == pytest.approx(1.0)
    begun_at = bench.q[0]
    scaled.cancel()
    bench.run(3.0)
    assert bench.q[0] - begun_at == pytest.approx(0.5**2 / 2.0, abs=0.02)


def test_goals_of_a_single_point_follow_each_other_without_a_jerk():
    bench, jtc = started()
    jtc.send_goal(trajectory(point(2.0, 2.0, 0.0)))
    places = []
    for cycle in range(300):
        if cycle == 100:
            jtc.send_goal(trajectory(point(1.0, 0.0, 0.0, v=REST)))
        bench.cycle()
        places.append(bench.q[0])
    speeds = [(b - a) * RATE_HZ for a, b in pairwise(places[50:])]
    assert speeds[0] == pytest.approx(1.0)
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.12  # 10 rad/s2, the cubic's own
    assert places[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_trajectory_for_later_replaces_the_old_one_then():
    bench, jtc = started()
    jtc.command(trajectory(point(2.0, 2.0, 0.0), point(4.0, 4.0, 0.0)))
    bench.run(1.0)
    jtc.command(trajectory(point(1.0, 0.0, 0.0, v=REST), stamp_s=bench.time_s + 0.5))
    bench.run(0.5)
    assert bench.q[0] == pytest.approx(1.5, abs=0.03)
    bench.run(1.1)
    assert bench.q[0] == pytest.approx(0.0, abs=0.01)


def test_points_in_the_past_are_left_out():
    bench, jtc = started()
    jtc.command(trajectory(point(2.0, 2.0, 0.0), point(4.0, 4.0, 0.0)))
    bench.run(1.0)
    jtc.command(trajectory(point(0.5, -5.0, 0.0), point(2.0, 3.0, 0.0), stamp_s=bench.time_s - 1.0))
    places = []
    for _ in range(100):
        bench.cycle()
        places.append(bench.q[0])
    assert min(places) > 0.9
    assert places[-1] == pytest.approx(3.0, abs=0.03)


def test_joints_that_a_new_goal_leaves_out_go_on_as_before():
    bench, jtc = started(allow_partial_joints_goal=True)
    jtc.command(trajectory(point(2.0, 2.0, 2.0), point(4.0, 4.0, 4.0)))
    bench.run(1.0)
    jtc.command(trajectory(point(1.0, 0.0), names=JOINTS[:1]))
    bench.run(1.02)
    assert bench.q == pytest.approx((0.0, 2.0), abs=0.03)
    bench.run(2.1)
    assert bench.q == pytest.approx((0.0, 4.0), abs=0.03)


def test_joints_that_are_left_out_stay_where_they_are_without_an_old_goal():
    bench, jtc = started(allow_partial_joints_goal=True)
    bench.until(jtc.send_goal(trajectory(point(1.0, 1.0, 2.0))))
    bench.until(jtc.send_goal(trajectory(point(1.0, 0.0), names=JOINTS[1:])))
    assert bench.q == pytest.approx((1.0, 0.0))


def test_speeds_alone_are_integrated_where_that_is_allowed():
    bench, jtc = started(allow_integration_in_goal_trajectories=True)
    bench.until(jtc.send_goal(trajectory(point(1.0, v=(1.0, 2.0)), point(2.0, v=REST))))
    assert bench.q == pytest.approx((1.0, 2.0), abs=0.02)


def test_a_trajectory_that_is_not_renewed_ends_after_its_timeout():
    bench, jtc = started(cmd_timeout=0.5, constraints={"elbow_joint": {"goal": 0.01}})
    bench.joints.stuck.add("elbow_joint")
    jtc.command(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(1.4)
    assert bench.joints.commands["elbow_joint/position"] == 1.0
    bench.run(0.2)
    assert bench.joints.commands["elbow_joint/position"] == 0.0  # where it is


def test_a_goal_counts_as_reached_after_the_timeout():
    """As ros2_controllers has it: from then on the arm holds, and a holding arm violates no tolerance."""
    bench, jtc = started(cmd_timeout=0.5, constraints={"elbow_joint": {"goal": 0.01}})
    bench.joints.stuck.add("elbow_joint")
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(1.4)
    assert not handle.done
    bench.run(0.2)
    assert handle.result.error_code is ErrorCode.SUCCESSFUL
    assert bench.joints.commands["elbow_joint/position"] == 1.0


def test_the_output_is_what_is_on_the_interfaces():
    bench, jtc = started()
    jtc.command(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(0.5)
    output = jtc.state_topic.latest.output
    assert output.positions == tuple(bench.joints.commands[f"{joint}/position"] for joint in jtc.joints)
    assert (output.velocities, output.accelerations, output.effort) == ((), (), ())


def test_from_the_desired_state_on_request():
    for wanted, there in ((False, 0.5), (True, 1.0)):
        bench, jtc = started(interpolate_from_desired_state=wanted)
        bench.until(jtc.send_goal(trajectory(point(1.0, 1.0, 1.0))))
        bench.joints.stuck.add("elbow_joint")
        bench.joints.states["elbow_joint/position"] = 0.5
        jtc.command(trajectory(point(1.0, 1.0, 1.0)))
        bench.cycle()
        assert bench.joints.commands["elbow_joint/position"] == pytest.approx(there, abs=0.01)


@each_row(
    ("wrong", "code", "words"),
    [
        (trajectory(), ErrorCode.INVALID_GOAL, "no points"),
        (trajectory(point(1.0, 1.0)), ErrorCode.INVALID_GOAL, "1 positions for 2 joints"),
        (trajectory(point(1.0, 1.0), names=JOINTS[:1]), ErrorCode.INVALID_JOINTS, "leaves out elbow_joint"),
        (trajectory(point(1.0, 1, 1), names=("a", "b")), ErrorCode.INVALID_JOINTS, "no joint a"),
        (trajectory(point(1.0, 1, 1), names=JOINTS[:1] * 2), ErrorCode.INVALID_JOINTS, "each joint once"),
        (trajectory(point(1.0, 1, 1), point(1.0, 2, 2)), ErrorCode.INVALID_GOAL, "times must increase"),
        (trajectory(point(-1.0, 1, 1)), ErrorCode.INVALID_GOAL, "times must increase"),
        (trajectory(point(1.0, 1, float("nan"))), ErrorCode.INVALID_GOAL, "not numbers"),
        (trajectory(point(1.0, 1, 1, v=(0.1, 0))), ErrorCode.INVALID_GOAL, "ends with shoulder_joint at 0.1"),
        (trajectory(point(1.0, v=(0.0, 0.0))), ErrorCode.INVALID_GOAL, "no positions"),
        (trajectory(point(1.0, 1, 1), stamp_s=2.0), ErrorCode.OLD_HEADER_TIMESTAMP, "ends at 3.000 s"),
    ],
)
def test_what_is_not_taken(wrong, code, words):
    bench, jtc = started()
    going = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    with pytest.raises(GoalRejectedError, match=words) as caught:
        jtc.send_goal(wrong)
    assert caught.value.code is code
    assert bench.until(going).error_code is ErrorCode.SUCCESSFUL  # nothing is lost


@each_row(
    ("parameters", "words"),
    [
        ({"command_interfaces": ["acceleration"]}, "command_interfaces is one of"),
        ({"command_interfaces": ["position", "velocity"]}, "command_interfaces is one of"),
        ({"state_interfaces": ["velocity"]}, "state_interfaces must include position"),
        ({"joints": []}, "each joint once"),
        ({"interpolation_method": "cubic"}, "splines or none"),
        ({"constraints": {"decelerate_on_cancel": True}}, "max_deceleration_on_cancel"),
        (
            {
                "state_interfaces": ["position"],
                "constraints": {
                    "decelerate_on_cancel": True,
                    **{joint: {"max_deceleration_on_cancel": 1.0} for joint in JOINTS},
                },
            },
            "the state interface velocity",
        ),
        ({"constraints": {"wrist_joint": {"goal": 0.1}}}, "wrist_joint"),
        ({"constraints": {"goal_time": "soon"}}, "constraints.goal_time must be a number"),
        ({"joints": "elbow_joint"}, "joints must be a list"),
    ],
)
def test_parameters_that_make_no_sense(parameters, words):
    bench = Bench(**parameters)
    with pytest.raises(ControllerError, match=words):
        bench.manager.activate("jtc")
