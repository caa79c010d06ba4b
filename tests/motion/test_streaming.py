"""servoj, servoc, speedj, speedl and the stops that end them."""

from math import dist, sin

import pytest

from tests.rows import each_row

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig
DRIVER = {"lookahead_time": 0.03, "gain": 2000.0}  # parameters of the External Control program
PERIODS = [0.002, 0.008]


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def servo(rig, target, **arguments):
    """One servoj call of one period."""
    move = rig.commands.servoj(target, t=rig.motion.period_s, **arguments)
    rig.step()
    assert move.ready
    return max(abs(a - b) for a, b in zip(target, rig.motion.q, strict=True))


@pytest.mark.parametrize("t", [0.0, 0.002, 0.008, 0.1])
def test_servoj_blocks_for_t(rig, t):
    move = rig.commands.servoj((0.4, *START[1:]), t=t)
    assert rig.finish(move) == pytest.approx(max(t, 0.002))


def test_servoj_blocks_longer_at_a_low_speed_slider(rig):
    assert rig.finish(rig.commands.servoj((0.4, *START[1:]), t=0.002), 0.5) == pytest.approx(0.004)


@each_row("period_s", PERIODS)
@each_row("speed", [0.5, 2.0, -3.0])
@each_row(("settings", "lag"), [(DRIVER, 0.0247), ({}, 0.0704)])
def test_lag_behind_a_steady_target(make_rig, period_s, speed, settings, lag):
    """Drivers tolerate 0.08 s at 2 rad/s, acceleration included."""
    rig = make_rig(period_s=period_s)
    worst, late = 0.0, 0.0
    for k in range(int(1.2 / period_s)):
        late = servo(rig, (START[0] + speed * k * period_s, *START[1:]), **settings)
        worst = max(worst, late)
    behind = abs(speed) * lag
    assert late == pytest.approx(behind, abs=abs(speed) * period_s)
    speeding_up = speed**2 / (2.0 * 40.0)  # a target that starts at full speed cannot be followed
    assert worst <= max(behind, speeding_up) + abs(speed) * period_s
    if settings is DRIVER:
        assert worst < abs(speed) * 0.08
    assert rig.motion.qd[0] == pytest.approx(speed, rel=1e-3)


@each_row("period_s", PERIODS)
@each_row("step", [0.001, 0.1, 2.0])
@each_row("settings", [DRIVER, {}, {"lookahead_time": 0.2, "gain": 100.0}])
def test_a_step_of_the_target_is_reached_without_overshoot(make_rig, period_s, step, settings):
    rig = make_rig(period_s=period_s)
    goal = (START[0] + step, *START[1:])
    rig.commands.servoj(goal, t=0.0, **settings)
    rig.step()
    assert rig.rest() < 4.0
    assert rig.motion.q == goal
    assert max(q[0] for q in rig.q) <= goal[0] + 1e-3 * step
    assert rig.largest_acceleration() <= 40.0 * 1.03


def test_an_unreachable_target_speed_lags_and_settles_on_the_final_target(rig):
    """1 rad in 0.05 s is beyond the joints; interrupted there, the arm settles on the final target."""
    for k in range(25):
        servo(rig, (START[0] - 20.0 * k * 0.002, *START[1:]), **DRIVER)
    hold = rig.motion.q
    for _ in range(1000):
        servo(rig, hold, **DRIVER)
    assert rig.motion.q == pytest.approx(hold, abs=0.01)
    assert rig.motion.qd == ZERO


def test_servoj_follows_a_sine_smoothly(rig):
    for k in range(1000):
        servo(rig, (START[0] + 0.3 * sin(3 * k * 0.002), *START[1:]), **DRIVER)
    assert rig.largest_acceleration() < 30.0  # a step to 0.9 rad/s, through a 25 ms lag


def test_servoj_then_stopj(rig):
    for k in range(300):
        servo(rig, (START[0] + 0.002 * k, *START[1:]), **DRIVER)
    assert rig.finish(rig.commands.stopj(4.0)) == pytest.approx(1.0 / 4.0, abs=0.004)
    assert rig.motion.qd == ZERO
    assert rig.motion.idle


@pytest.mark.parametrize("period_s", PERIODS)
def test_servoc_arrives_without_overshoot(make_rig, period_s):
    rig = make_rig(period_s=period_s)
    start = rig.pose()
    goal = add(start, 0.1, 0.05, 0.0, 0.0, 0.0, 0.2)
    taken = rig.finish(rig.commands.servoc(goal, a=1.0, v=0.2))
    assert rig.pose() == pytest.approx(goal, abs=1e-6)
    assert rig.motion.idle
    assert taken < 1.2 * (dist(start[:3], goal[:3]) / 0.2 + 0.2)


def test_servoc_is_ready_within_its_radius_and_continues_to_the_next(rig):
    start = rig.pose()
    first = add(start, 0.1)
    rig.finish(rig.commands.servoc(first, r=0.02))
    assert dist(rig.pose()[:3], first[:3]) == pytest.approx(0.02, abs=1e-3)
    goal = add(first, 0.0, 0.1)
    rig.finish(rig.commands.servoc(goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-6)
    assert rig.largest_acceleration() < 40.0


def test_speedj_without_t_returns_at_speed_and_holds_it(rig):
    wanted = (0.6, -0.3, 0.0, 0.0, 0.0, 0.1)
    assert rig.finish(rig.commands.speedj(wanted, a=2.0)) == pytest.approx(0.6 / 2.0, abs=0.002)
    rig.steps(100)
    assert rig.motion.qd == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("t", [0.002, 0.1, 0.5])
def test_speedj_with_t_returns_after_t(rig, t):
    assert rig.finish(rig.commands.speedj((1.0, 0, 0, 0, 0, 0), a=2.0, t=t)) == pytest.approx(t)
    assert rig.motion.qd[0] == pytest.approx(min(1.0, 2.0 * (t - 0.001)), abs=1e-9)


@pytest.mark.parametrize("t", [1e-16, 0.0, 0.0005])
def test_speedj_takes_at_least_one_period(rig, t):
    assert rig.finish(rig.commands.speedj((1.0, 0, 0, 0, 0, 0), a=2.0, t=t)) == 0.002


def test_speedj_without_acceleration_keeps_its_speed(rig):
    rig.finish(rig.commands.speedj((0.5, 0, 0, 0, 0, 0), a=2.0))
    for _ in range(10):
        move = rig.commands.speedj((0.5, 0, 0, 0, 0, 0), a=0.0, t=0.002)
        rig.step()
        assert move.ready
        assert rig.motion.qd[0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("fraction", [1.0, 0.5])
def test_speedj_follows_a_spline_sampled_by_its_speed(rig, fraction):
    """The External Control program executes splines like this: the acceleration lasts exactly one period."""
    duration, h, speed = 1.0, 0.002, 0.0
    for k in range(1, 501):
        share = k * h / duration
        wanted = 0.6 * (6 * share - 6 * share**2) / duration  # cubic from 0 to 0.6 rad
        move = rig.commands.speedj((wanted, 0, 0, 0, 0, 0), a=abs(wanted - speed) / h, t=h)
        rig.finish(move, fraction)
        speed = wanted
    assert rig.motion.q[0] - START[0] == pytest.approx(0.6, abs=1e-4)
    rig.finish(rig.commands.stopj(4.0))
    assert rig.motion.qd == ZERO


def test_speedj_beyond_the_joint_limit_is_scaled_as_a_whole(rig):
    rig.finish(rig.commands.speedj((8.0, 0, 0, 0, 4.0, 0), a=40.0))
    rig.step()
    most = rig.model.qd_max[0]
    assert rig.motion.qd == pytest.approx((most, 0, 0, 0, most / 2, 0), abs=1e-9)


def test_speedj_to_zero_brings_the_arm_to_rest(rig):
    rig.finish(rig.commands.speedj((0.5, 0, 0, 0, 0, 0), a=2.0))
    rig.finish(rig.commands.speedj(ZERO, a=2.0))
    assert rig.motion.qd == ZERO
    assert rig.motion.idle


@each_row("joint", range(6))
@each_row("direction", [1.0, -1.0])
def test_speedj_into_a_position_limit_is_a_fault_and_stops_inside(make_rig, joint, direction):
    rig = make_rig("ur10e", period_s=0.008)
    speeds = tuple(direction * 2.0 if i == joint else 0.3 for i in range(6))
    move = rig.commands.speedj(speeds, a=10.0)
    for _ in range(1000):
        rig.step()
        if rig.fault is not None:
            break
    assert rig.fault is not None
    assert (rig.fault.code, rig.fault.joint) == (150, joint)
    assert move.failed is rig.fault
    assert rig.rest() < 0.1
    limit = rig.model.q_max[joint] if direction > 0 else rig.model.q_min[joint]
    assert rig.motion.q[joint] == pytest.approx(limit, abs=0.04)


def test_speedl_moves_the_tool_straight(rig):
    start = rig.pose()
    rig.finish(rig.commands.speedl((0.1, 0, 0, 0, 0, 0), a=0.5, t=1.0))
    at = rig.pose()
    assert at[0] - start[0] == pytest.approx(0.1 * 1.0 - 0.1**2 / (2 * 0.5), abs=1e-9)
    assert at[1:] == pytest.approx(start[1:], abs=1e-9)
    assert rig.finish(rig.commands.stopl(0.5)) == pytest.approx(0.2, abs=0.004)
    assert rig.pose()[0] - at[0] == pytest.approx(0.1**2 / (2 * 0.5), abs=1e-4)
    assert rig.pose()[1:] == pytest.approx(start[1:], abs=1e-5)
    assert rig.motion.qd == ZERO


def test_speedl_turns_the_tool(rig):
    rig.finish(rig.commands.speedl((0, 0, 0, 0, 0, 0.5), a=1.0, a_rot=2.0))
    before = rig.pose()
    rig.steps(100)
    assert rig.pose()[:3] == pytest.approx(before[:3], abs=1e-9)
    row = rig.kinematics.jacobian(rig.motion.q)
    turn = [sum(row[k][i] * rig.motion.qd[i] for i in range(6)) for k in range(6)]
    assert turn == pytest.approx((0, 0, 0, 0, 0, 0.5), abs=2e-3)


def test_speedl_uses_a_separate_rotational_acceleration(rig):
    """0.2 m/s at 1 m/s2 take 0.2 s, 0.5 rad/s at 5 rad/s2 take 0.1 s: ready when the slower one is."""
    move = rig.commands.speedl((0.2, 0, 0, 0, 0, 0.5), a=1.0, a_rot=5.0)
    rig.steps(50)

    def turn():
        row = rig.kinematics.jacobian(rig.motion.q)
        return sum(row[5][i] * rig.motion.qd[i] for i in range(6))

    assert turn() == pytest.approx(0.5, abs=0.01)
    assert 0.1 + rig.finish(move) == pytest.approx(0.2, abs=0.005)


@pytest.mark.parametrize("joint", range(6))
def test_servoj_beyond_a_joint_limit_is_refused_and_stops_the_arm(rig, joint):
    beyond = list(START)
    beyond[joint] = rig.model.q_max[joint] + 0.001
    move = rig.commands.servoj(beyond, t=0.002)
    assert move.failed
    rig.step()
    assert rig.fault is not None
    rig.rest()
    assert rig.motion.q == pytest.approx(START)


def test_speedl_out_of_the_workspace_stops_with_a_fault(rig):
    rig.commands.speedl((0.3, 0, 0.3, 0, 0, 0), a=1.0)
    for _ in range(5000):
        rig.step()
        if rig.fault:
            break
    assert rig.fault is not None
    assert rig.fault.code == 154  # at the edge of the workspace, the arm is stretched
    rig.rest()
    assert rig.motion.qd == ZERO


@pytest.mark.parametrize("a", [0.5, 4.0, 40.0])
def test_stopj_keeps_the_direction_and_takes_the_time_v_over_a(rig, a):
    rig.finish(rig.commands.speedj((1.0, -0.5, 0.25, 0, 0, 0), a=10.0))
    rig.steps(50)
    before = rig.motion.q
    assert rig.finish(rig.commands.stopj(a)) == pytest.approx(1.0 / a, abs=0.004)
    moved = [x - y for x, y in zip(rig.motion.q, before, strict=True)]
    assert moved[:3] == pytest.approx((0.5 / a, -0.25 / a, 0.125 / a), abs=1e-6)
    assert rig.motion.qd == ZERO


def test_stopl_from_a_joint_move_stays_near_its_screw(rig):
    rig.commands.movej((1.3, -1.1, 1.5, -1.5, -1.9, 0.9))
    rig.steps(400)
    rig.finish(rig.commands.stopl(1.0, 4.0))
    assert rig.motion.qd == ZERO
    assert rig.largest_acceleration() < 80.0


def test_stop_ignores_the_slider(rig):
    """A stop must end in time even when the operator slows the program down."""
    rig.finish(rig.commands.speedj((1.0, 0, 0, 0, 0, 0), a=10.0))
    assert rig.finish(rig.commands.stopj(4.0), 0.01) == pytest.approx(0.25, abs=0.004)


@pytest.mark.parametrize("period_s", [0.002, 0.008])
def test_raising_the_slider_from_0_during_servoj_is_a_fault(make_rig, period_s):
    """Seen with the ROS drivers: the arm is at rest at 0, and the next value causes a protective stop."""
    rig = make_rig(period_s=period_s)
    goal = (0.32, *rig.motion.q[1:])
    rig.commands.servoj(goal, t=5.0)
    rig.steps(20)
    rig.steps(200, fraction=0.0)
    assert rig.fault is None
    assert rig.motion.qd == ZERO
    rig.step(fraction=0.5)
    assert rig.fault is not None
    assert rig.fault.code == 204
    assert "slider" in rig.fault.text
    rig.rest()


def test_a_pause_during_servoj_is_not_a_slider_at_0(rig):
    move = rig.commands.servoj((0.32, *rig.motion.q[1:]), t=0.5)
    rig.steps(20)
    rig.motion.pause()
    rig.steps(100)
    rig.motion.resume()
    rig.steps(20, fraction=0.01)
    rig.finish(move)
    assert rig.fault is None
