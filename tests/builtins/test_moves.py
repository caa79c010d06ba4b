"""Moves of scripts: their final positions and durations."""

import math

import pytest

from tests.rows import each_row
from urproto.modes import ReportLevel, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots.pose import pose_sub, pose_trans

HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
START = "[0, -1.5, 1.5, -1.6, -1.57, 0]"


def trapezoid(distance: float, v: float, a: float) -> float:
    """Time of a rest-to-rest move [s]."""
    if distance < v * v / a:
        return 2.0 * math.sqrt(distance / a)
    return distance / v + v / a


@pytest.mark.parametrize(("distance", "a", "v"), [(1.0, 1.4, 1.05), (0.1, 2.0, 1.0), (2.0, 5.0, 0.5)])
def test_movej_reaches_its_target_in_the_time_of_its_profile(rig, distance, a, v):
    took = rig.run(f"movej([{distance}, -1.5, 1.5, -1.6, -1.57, 0], a={a}, v={v})")
    assert rig.q == pytest.approx((distance, *HOME[1:]), abs=1e-9)
    assert took == pytest.approx(trapezoid(distance, v, a), abs=0.03)


def test_movej_on_cb3_uses_the_8_ms_period(cb3):
    took = cb3.run("movej([0.5, -1.5, 1.5, -1.6, -1.57, 0])")
    assert cb3.q[0] == pytest.approx(0.5, abs=1e-9)
    assert took == pytest.approx(trapezoid(0.5, 1.05, 1.4), abs=0.08)


def test_time_overrides_speed(rig):
    assert rig.run("movej([0.5, -1.5, 1.5, -1.6, -1.57, 0], t=2)") == pytest.approx(2.0, abs=0.03)


def test_movej_to_a_pose_takes_the_nearest_configuration(rig):
    rig.run("movej([0.3, -1.4, 1.4, -1.6, -1.5, 0.2])")
    reached = rig.q
    rig.run(f"target = get_actual_tcp_pose()\nmovej({START})\nmovej(target)")
    assert rig.q == pytest.approx(reached, abs=1e-6)


def test_movel_goes_straight(rig):
    start = rig.controller.snapshot.actual_TCP_pose
    rig.start("movel(pose_add(get_actual_tcp_pose(), p[0, 0.1, -0.1, 0, 0, 0]), a=1, v=0.2)")
    worst = 0.0
    rig.tick()
    while rig.state is not RuntimeState.STOPPED:
        rig.tick()
        x, y, z = rig.controller.snapshot.actual_TCP_pose[:3]
        worst = max(worst, abs(x - start[0]), abs((y - start[1]) + (z - start[2])))
    end = rig.controller.snapshot.actual_TCP_pose
    assert end[:3] == pytest.approx((start[0], start[1] + 0.1, start[2] - 0.1), abs=1e-7)
    assert worst < 1e-6


def test_movel_accepts_joint_angles(rig):
    rig.run(f"movej([0.3, -1.4, 1.4, -1.6, -1.5, 0.2])\nmovel({START})")
    assert rig.q == pytest.approx(HOME, abs=1e-6)


OVERLAPPING = """
p0 = get_actual_tcp_pose()
movel(pose_add(p0, p[0, 0.1, 0, 0, 0, 0]), r=0.04)
movel(pose_add(p0, p[0, 0.1, -0.06, 0, 0, 0]), r=0.04)
movel(pose_add(p0, p[0, 0, -0.1, 0, 0, 0]))
textmsg(point_dist(get_actual_tcp_pose(), pose_add(p0, p[0, 0, -0.1, 0, 0, 0])) < 1e-6)
"""


@pytest.mark.parametrize("series", ["rig", "cb3"])
def test_overlapping_blends_are_reported_as_an_error_code(series, request):
    robot = request.getfixturevalue(series)
    robot.run(OVERLAPPING)
    assert robot.texts == ["True"]
    problem = [m for m in robot.messages if isinstance(m, ErrorCodeMessage)]
    assert [(m.code, m.argument, m.level) for m in problem] == [(171, 11, ReportLevel.WARNING)]
    assert "overlapping blends, a waypoint is skipped" in problem[0].text
    assert robot.controller.snapshot.safety_mode == SafetyMode.NORMAL


def test_a_skipped_waypoint_pauses_the_program_if_requested(rig):
    rig.start(f"pause_on_error_code(171)\n{OVERLAPPING}")
    rig.until(lambda: rig.state is RuntimeState.PAUSED)
    assert rig.controller.snapshot.safety_mode == SafetyMode.NORMAL


def test_movec_and_movep_arrive(rig):
    rig.run(
        """
        p0 = get_actual_tcp_pose()
        via = pose_add(p0, p[-0.05, 0.05, 0, 0, 0, 0])
        to = pose_add(p0, p[0, 0.1, 0, 0, 0, 0])
        movec(via, to, 0.5, 0.1, 0, 0)
        textmsg(point_dist(get_actual_tcp_pose(), to) < 1e-6)
        movep(pose_add(p0, p[0, 0.05, 0, 0, 0, 0]), a=0.5, v=0.1, r=0.01)
        movep(p0, a=0.5, v=0.1)
        """
    )
    assert rig.texts == ["True"]
    assert rig.q == pytest.approx(HOME, abs=1e-6)


def test_blended_move_returns_early_and_does_not_stop(rig):
    rig.start(
        """
        movej([0.5, -1.5, 1.5, -1.6, -1.57, 0], a=6, v=1, r=0.05)
        textmsg("blending")
        movej([1.0, -1.5, 1.5, -1.6, -1.57, 0], a=6, v=1)
        """
    )
    rig.until(lambda: rig.texts == ["blending"])
    assert 0.3 < rig.q[0] < 0.5
    slowest = 1.0
    while rig.q[0] < 0.7:
        rig.tick()
        slowest = min(slowest, rig.controller.snapshot.target_qd[0])
    assert slowest > 0.9
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.q[0] == pytest.approx(1.0, abs=1e-9)


def test_movej_out_of_reach_is_a_runtime_exception(rig):
    text = rig.fault("movej(p[10, 0, 0, 0, 0, 0])")
    assert "inverse kinematics" in text
    assert rig.controller.snapshot.safety_mode is SafetyMode.NORMAL


def test_movel_out_of_reach_is_a_protective_stop(rig):
    rig.start("movel(p[10, 0, 0, 0, 0, 0])")
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 1.0)
    assert rig.controller.snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert rig.exceptions == []
    assert len([m for m in rig.messages if isinstance(m, ErrorCodeMessage)]) == 1


@each_row("call", ["movej(%s, v=0)", "movel(%s, a=-1)", "optimovej(%s, v=1.5)", "stopj(0)"])
def test_impossible_profiles_are_refused(rig, call):
    assert "must be" in (text := rig.fault(call.replace("%s", START))) or "fraction" in text


def test_optimovej_arrives(rig):
    rig.run("optimovej([0.5, -1.5, 1.5, -1.6, -1.57, 0], a=0.1, v=0.2)")
    assert rig.q[0] == pytest.approx(0.5, abs=1e-9)


def test_optimovej_fractions_refer_to_the_slowest_joint(make_rig):
    """A UR10e's base turns more slowly than its wrists."""
    rig = make_rig("ur10e", None)
    model = rig.controller.model
    assert min(model.qd_max) < max(model.qd_max)
    rig.start("optimovej([2.5, -1.5, 1.5, -1.6, -1.57, 0], a=0.5, v=0.5)")
    speeds = []
    rig.until(lambda: speeds.append(max(map(abs, rig.controller.snapshot.actual_qd))) or rig.q[0] > 2.0, 10.0)
    assert max(speeds) == pytest.approx(0.5 * min(model.qd_max), rel=1e-3)


@pytest.mark.parametrize(("given", "turning"), [("", 0.5), (", aRot=2.0", 2.0)])
def test_the_rotational_acceleration_of_speedl_defaults_to_its_acceleration(rig, given, turning):
    rig.start(f"speedl([0, 0, 0, 0, 0, 0.5], a=0.5, t=3{given})")
    rig.until(lambda: rig.controller.snapshot.actual_TCP_speed[5] > 0.05, 1.0)
    assert rig.controller.snapshot.actual_TCP_acceleration[5] == pytest.approx(turning, rel=0.05)


WORLD = """add_frame("table", p[0.4, -0.2, 0.3, 0.1, 3, 0.2])
add_frame("part", p[0.05, 0, 0.02, 0, 0, 0.3], "table")
attach_frame("part", "table")
"""


@pytest.mark.parametrize("move", ["optimovej", "optimovel"])
@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ('"part"', 'get_pose("part", "base")'),
        (
            'struct(pose=p[0.01, 0, 0, 0, 0.1, 0], frame="part")',
            'pose_trans(get_pose("part", "base"), p[0.01, 0, 0, 0, 0.1, 0])',
        ),
        ("p[0.45, -0.2, 0.3, 0.1, 3, 0.2]", "p[0.45, -0.2, 0.3, 0.1, 3, 0.2]"),
    ],
)
def test_optimove_goes_to_frames_and_poses_in_frames(rig, move, goal, expected):
    rig.run(WORLD + f"movej(p[0.4, -0.2, 0.35, 0.1, 3, 0.2])\n{move}({goal})")
    reached, wanted = rig.value("get_target_tcp_pose()"), rig.value(expected)
    assert list(pose_sub(reached, wanted)) == pytest.approx([0.0] * 6, abs=1e-6)


def test_a_goal_in_a_tracked_frame_uses_the_current_position_of_the_frame(rig):
    rig.run(
        WORLD
        + """movej(p[0.4, -0.2, 0.35, 0.1, 3, 0.2])
        frame_tracking_enable("table")
        move_frame("table", p[0.35, -0.25, 0.3, 0.1, 3, 0.2])
        sleep(2)
        optimovel(struct(pose=p[0, 0, -0.02, 0, 0, 0], frame="part"))
        wanted = pose_trans(get_pose("part", "base"), p[0, 0, -0.02, 0, 0, 0])
        textmsg(point_dist(get_target_tcp_pose(), wanted) < 1e-6)"""
    )
    assert rig.texts == ["True"]


@each_row(
    ("goal", "problem"),
    [
        ('"nowhere"', 'there is no frame "nowhere"'),
        ('struct(pose=p[0, 0, 0, 0, 0, 0], frame="nowhere")', 'there is no frame "nowhere"'),
        ("struct(pose=1, frame=2)", "goal must be joint angles"),
        ("struct(place=p[0, 0, 0, 0, 0, 0])", "goal must be joint angles"),
        ("True", "goal must be joint angles"),
        ("[1, 2, 3]", "6 finite numbers"),
        ('["a", 0, 0, 0, 0, 0]', "6 finite numbers"),
    ],
)
def test_impossible_goals_of_optimove_end_the_program(rig, goal, problem):
    assert problem in rig.fault(f"optimovej({goal})")


def test_servoj_blocks_for_its_time(rig):
    steps = 100
    took = rig.run(
        f"""
        i = 0
        while i < {steps}:
          servoj([0.0005 * i, -1.5, 1.5, -1.6, -1.57, 0], t=0.002, lookahead_time=0.03, gain=2000)
          i = i + 1
        end
        stopj(5)
        """
    )
    assert took >= steps * rig.period
    assert took == pytest.approx(steps * rig.period, abs=0.15)
    assert rig.q[0] == pytest.approx(0.05, abs=0.02)


def test_single_frame_calls_take_one_frame_each(rig):
    took = rig.run("i = 0\nwhile i < 50:\n  servoj(get_actual_joint_positions())\n  i = i + 1\nend")
    assert took == pytest.approx(50 * rig.period, abs=3 * rig.period)
    took = rig.run("i = 0\nwhile i < 50:\n  speedj([0, 0, 0, 0, 0, 0], 1, get_steptime())\n  i = i + 1\nend")
    assert took == pytest.approx(50 * rig.period, abs=3 * rig.period)


def test_stopping_an_arm_at_rest_takes_one_frame(rig):
    took = rig.run("i = 0\nwhile i < 20:\n  stopj(4)\n  stopl(4)\n  i = i + 1\nend")
    assert took == pytest.approx(40 * rig.period, abs=3 * rig.period)


def test_speedj_accelerates_and_holds(rig):
    rig.start("speedj([0.5, 0, 0, 0, 0, 0], 2, 1)\nstopj(2)")
    rig.seconds(0.6)
    assert rig.controller.snapshot.target_qd[0] == pytest.approx(0.5)
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.q[0] == pytest.approx(0.5 * 1 - 0.5**2 / 4 + 0.5**2 / 4, abs=0.01)
    assert rig.controller.snapshot.target_qd == (0.0,) * 6


def test_speedl_moves_the_tool(rig):
    start = rig.controller.snapshot.actual_TCP_pose
    rig.run("speedl([0, 0, -0.1, 0, 0, 0], a=1, t=0.5)\nstopl(1)")
    end = rig.controller.snapshot.actual_TCP_pose
    assert end[2] - start[2] == pytest.approx(-0.05, abs=2e-3)
    assert end[:2] == pytest.approx(start[:2], abs=1e-4)


def test_speed_slider_stretches_movements_but_not_sleep(rig):
    rig.controller.speed.set_slider(0.5)
    took = rig.run("movej([0.5, -1.5, 1.5, -1.6, -1.57, 0])")
    assert took == pytest.approx(2 * trapezoid(0.5, 1.05, 1.4), abs=0.15)
    assert rig.run("sleep(0.5)") == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("seconds", "frames"), [("0.5", 250), ("1.0E-10", 1), ("0", 1), ("0.0021", 2)])
def test_sleep_takes_whole_periods(rig, seconds, frames):
    took = rig.run(f"sleep({seconds})")
    assert took == pytest.approx(frames * rig.period, abs=1.5 * rig.period)


def test_set_pos_moves_the_simulated_arm_instantly(rig):
    rig.run("set_pos([0.1, -1.4, 1.3, -1.2, -1.1, 0.9])")
    assert rig.q == pytest.approx((0.1, -1.4, 1.3, -1.2, -1.1, 0.9))


def test_zero_direct_torque_holds_the_arm(rig):
    rig.controller.version = rig.controller.version.parse("5.25.1")
    rig.run("i = 0\nwhile i < 100:\n  direct_torque([0, 0, 0, 0, 0, 0])\n  i = i + 1\nend")
    assert rig.q == pytest.approx(HOME, abs=1e-9)


def test_direct_torque_brings_an_ideal_arm_to_rest(rig):
    rig.controller.version = rig.controller.version.parse("5.25.1")
    rig.run(
        "speedj([0.5, 0, 0, 0, 0, 0], 5)\ni = 0\nwhile i < 50:\n  direct_torque([20, 0, 0, 0, 0, 0])\n  i = i + 1\nend"
    )
    assert rig.controller.motion.qd == (0.0,) * 6
    assert HOME[0] < rig.q[0] < HOME[0] + 0.05


def test_servoj_refuses_a_negative_time(rig):
    rig.start("servoj(get_actual_joint_positions(), t=-1)")
    rig.seconds(0.1)
    assert "servoj: t must be 0 or more" in rig.exceptions[0].text


@pytest.mark.parametrize("command", ["movej", "movel", "movep", "servoc"])
def test_a_negative_blend_radius_is_refused(rig, command):
    rig.start(f"{command}(get_actual_tcp_pose(), r=-0.01)")
    rig.seconds(0.1)
    assert f"{command}: r must be 0 or more" in rig.exceptions[0].text


def test_move_with_another_tcp_brings_that_point_to_the_target(rig):
    rig.run(
        """
        target = pose_add(get_actual_tcp_pose(), p[0, 0, -0.05, 0, 0, 0])
        set_tcp(p[0, 0, 0.1, 0, 0, 0])
        movel(target)
        """
    )
    snapshot = rig.controller.snapshot
    flange = rig.controller.arm.kinematics.forward(rig.q)
    assert snapshot.tcp_offset == (0, 0, 0.1, 0, 0, 0)
    assert snapshot.actual_TCP_pose == pytest.approx(pose_trans(flange, (0, 0, 0.1, 0, 0, 0)), abs=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        "sleep(nan[1])",
        "set_tcp(p[nan[1], 0, 0, 0, 0, 0])",
        "set_payload(nan[1])",
        "set_gravity([0, 0, nan[1]])",
        "set_pos([9, 0, 0, 0, 0, 0])",
        "freedrive_mode(feature=p[nan[1], 0, 0, 0, 0, 0])",
        'socket_open("10.0.0.1", 70000)',
        "socket_send_int(nan[1])",
        "q = get_inverse_kin(p[nan[1], 0, 0, 0, 0, 0])",
        "movej(p[nan[1], 0, 0, 0, 0, 0])",
    ],
)
def test_unusable_numbers_are_program_errors(rig, call):
    text = rig.fault(f"nan = socket_read_ascii_float(1)\n{call}")
    assert "internal error" not in text
    rig.tick(5)
    assert rig.q == pytest.approx(HOME)
