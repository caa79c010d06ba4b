"""Force mode and freedrive."""

import pytest

from tests.budget import subset
from urproto.robots import MODELS

ZERO = (0.0,) * 6
BASE = ZERO
LIMITS = (0.2,) * 3 + (0.5,) * 3
Z_ONLY = (0, 0, 1, 0, 0, 0)


def add(pose, *shift):
    return tuple(a + b for a, b in zip(pose, (*shift, *ZERO)[:6], strict=True))


def push_down(rig, newton=10.0, limits=LIMITS):
    rig.motion.force_control.force_mode(BASE, Z_ONLY, (0, 0, -newton, 0, 0, 0), 2, limits)


def test_the_tool_yields_only_along_compliant_axes(rig):
    """As the ROS 2 driver's test: 10 N, damping 0.1, gain 0.8, 5 s: more than 3 cm along it, less than 1 mm across."""
    rig.motion.force_control.damping, rig.motion.force_control.gain_scaling = 0.1, 0.8
    start = rig.pose()
    push_down(rig)
    rig.steps(2500)
    moved = [b - a for a, b in zip(start, rig.pose(), strict=True)]
    assert moved[2] < -0.03
    assert moved[:2] == pytest.approx((0, 0), abs=1e-6)
    assert moved[3:] == pytest.approx((0, 0, 0), abs=1e-6)
    assert not rig.motion.idle
    assert not rig.motion.steady


def test_the_frame_rotates_the_force_direction(rig):
    """A frame turned by 90 degrees about x has its z along the base's -y."""
    start = rig.pose()
    rig.motion.force_control.force_mode((0, 0, 0, 1.5707963267948966, 0, 0), Z_ONLY, (0, 0, 10, 0, 0, 0), 2, LIMITS)
    rig.steps(1000)
    assert rig.pose()[1] - start[1] < -0.02
    assert rig.pose()[0] == pytest.approx(start[0], abs=1e-6)


@pytest.mark.parametrize("limit", [0.01, 0.05])
def test_speed_limit_of_a_compliant_direction(rig, limit):
    push_down(rig, 1000.0, (limit,) * 6)
    rig.steps(500)
    before = rig.pose()[2]
    rig.steps(100)
    assert before - rig.pose()[2] == pytest.approx(limit * 0.2, rel=1e-3)


def test_balanced_forces_do_not_move_the_arm(rig):
    rig.motion.force_control.set_external_wrench((0, 0, 10, 0, 0, 0))
    push_down(rig)
    q = rig.motion.q
    rig.steps(100)
    assert rig.motion.q == q
    assert rig.motion.qd == ZERO


def test_damping_slows_and_gain_speeds_up_the_motion(make_rig):
    def depth(damping, gain):
        rig = make_rig()
        rig.motion.force_control.damping, rig.motion.force_control.gain_scaling = damping, gain
        start = rig.pose()[2]
        push_down(rig)
        rig.steps(500)
        return start - rig.pose()[2]

    assert depth(1.0, 1.0) < depth(0.1, 1.0) < depth(0.1, 2.0)


def test_ending_force_mode_leaves_the_arm_at_rest(rig):
    push_down(rig)
    rig.steps(500)
    rig.motion.force_control.end()
    assert rig.rest() < 1.0
    q = rig.motion.q
    rig.steps(100)
    assert rig.motion.q == q


def test_a_move_continues_alongside_the_force(rig):
    start = rig.pose()
    goal = add(start, 0.1, 0.05, 0.03)  # its part along z is not followed: that direction is the force's
    push_down(rig)
    way = (0.1**2 + 0.05**2 + 0.03**2) ** 0.5
    assert rig.finish(rig.commands.movel(goal)) == pytest.approx(way / 0.25 + 0.25 / 1.2, abs=0.004)
    at = rig.pose()
    assert at[:2] == pytest.approx(goal[:2], abs=1e-4)
    assert at[2] < start[2] - 0.005


def test_the_next_move_starts_where_the_force_left_the_arm(rig):
    push_down(rig)
    rig.steps(500)
    rig.motion.force_control.end()
    goal = add(rig.pose(), 0.05)
    rig.finish(rig.commands.movel(goal))
    assert rig.pose() == pytest.approx(goal, abs=1e-8)
    assert rig.motion.idle


def test_repeating_force_mode_each_cycle_keeps_the_speed(rig):
    """A client's control script repeats force_mode() in every period."""
    start = rig.pose()[2]
    for _ in range(500):
        push_down(rig)
        rig.step()
    assert start - rig.pose()[2] > 0.02


def test_type_1_pulls_along_y_towards_the_origin_of_the_frame(rig):
    start = rig.pose()
    origin = add(start, 0.0, 0.0, -0.3)
    rig.motion.force_control.force_mode((*origin[:3], 0, 0, 0), (0, 1, 0, 0, 0, 0), (0, 10, 0, 0, 0, 0), 1, LIMITS)
    rig.steps(500)
    assert start[2] - rig.pose()[2] > 0.02


def test_type_3_complies_across_the_direction_of_motion(rig):
    """User manual, "Motion": x along the TCP's motion; nothing complies before the first motion, and the frame is
    kept."""
    start = rig.pose()
    rig.motion.force_control.force_mode(BASE, (0, 1, 0, 0, 0, 0), (0, 10, 0, 0, 0, 0), 3, LIMITS)
    rig.steps(500)
    assert rig.pose() == start
    rig.finish(rig.commands.movel(add(start, 0.0, 0.05)))  # along y of the base: its left is -x
    moved = start[0] - rig.pose()[0]
    assert moved > 0.001
    rig.steps(500)
    assert start[0] - rig.pose()[0] > moved + 0.02
    assert rig.pose()[1:3] == pytest.approx((start[1] + 0.05, start[2]), abs=1e-4)


def bent(rig, shift):
    """Joint angles with the tool off its target along x."""
    model = rig.model
    return rig.kinematics.inverse_near(add(rig.pose(), shift), rig.motion.q, model.q_min, model.q_max)


def pulled_aside(rig, limit, shift=0.004):
    """A stiff axis, x, has been deflected by 4 mm."""
    rig.motion.force_control.force_mode(BASE, Z_ONLY, ZERO, 2, (limit, 0.01, 0.2, 0.1, 0.1, 0.1))
    rig.step()
    rig.motion.force_control.set_external_wrench(ZERO, bent(rig, shift))
    rig.step()


def test_a_stiff_axis_may_deviate_up_to_its_limit(rig):
    """User manual, "Force": in non-compliant axes the limit is the largest deviation before a protective stop."""
    pulled_aside(rig, 0.005)
    assert rig.fault is None
    rig.motion.force_control.end()
    rig.step()
    rig = type(rig)(rig.model)
    pulled_aside(rig, 0.003)
    assert (rig.fault.code, rig.fault.argument) == (153, 0)
    assert "0.0040 m off its path along the task frame's x axis" in rig.fault.text
    rig.rest()


def test_a_compliant_axis_may_be_anywhere(rig):
    rig.motion.force_control.force_mode(BASE, (1, 0, 0, 0, 0, 0), ZERO, 2, (0.001, *[0.01] * 5))
    rig.step()
    rig.motion.force_control.set_external_wrench(ZERO, bent(rig, 0.004))
    rig.step()
    assert rig.fault is None


def test_unknown_type_is_refused(rig):
    with pytest.raises(ValueError, match="type must be 1, 2 or 3, not 4"):
        rig.motion.force_control.force_mode(BASE, Z_ONLY, ZERO, 4, LIMITS)
    assert rig.motion.idle


def test_the_arm_stops_at_the_edge_of_the_workspace(rig):
    rig.motion.force_control.force_mode(BASE, (1, 1, 1, 0, 0, 0), (-300, -300, 300, 0, 0, 0), 2, (1.0,) * 6)
    rig.steps(4000)
    assert rig.fault is None
    push_down(rig, 50.0)
    height = rig.pose()[2]
    rig.steps(500)
    assert rig.pose()[2] < height


def test_pausing_also_pauses_force_mode(rig):
    push_down(rig)
    rig.steps(300)
    rig.motion.pause()
    rig.steps(1000)
    assert rig.motion.qd == ZERO
    rig.motion.resume()
    rig.steps(100)
    assert rig.motion.qd != ZERO


def test_freedrive_follows_the_hand_and_stops_without_it(rig):
    rig.commands.freedrive()
    q = rig.motion.q
    rig.steps(50)
    assert rig.motion.q == q
    start = rig.pose()
    rig.motion.force_control.set_external_wrench((20, 0, 0, 0, 0, 0))
    rig.steps(500)
    rig.motion.force_control.set_external_wrench(ZERO)
    rig.steps(1500)
    assert rig.pose()[0] - start[0] > 0.02
    assert rig.motion.qd == ZERO
    rig.motion.force_control.end()
    rig.step()
    assert rig.motion.idle


def test_freedrive_along_chosen_axes_only(rig):
    start = rig.pose()
    rig.commands.freedrive((1, 0, 0, 0, 0, 0), BASE)
    rig.motion.force_control.set_external_wrench((20, 20, 20, 1, 1, 1))
    rig.steps(500)
    assert rig.pose()[0] - start[0] > 0.02
    assert rig.pose()[1:3] == pytest.approx(start[1:3], abs=1e-6)


def test_freedrive_takes_over_a_moving_arm(rig):
    rig.commands.movej((1.3, -1.1, 1.5, -1.5, -1.9, 0.9))
    rig.steps(300)
    rig.commands.freedrive()
    rig.steps(1000)
    assert rig.motion.qd == ZERO
    rig.motion.program_stopped()
    rig.rest()


def test_program_stopped_ends_force_mode(rig):
    push_down(rig)
    rig.steps(200)
    rig.motion.program_stopped()
    assert rig.rest() < 1.0


STRETCHED = (0, -1.57, 0, -1.57, 0, 0)  # rad: where a controller starts


@pytest.mark.parametrize("model", subset(MODELS, now=("ur3", "ur5e", "ur20")))
@pytest.mark.parametrize("newton", [20, -20])
def test_a_stretched_arm_gives_way_sideways(make_rig, model, newton):
    """Straight up, all of the arm's joints but the base swing the tool along x; none of them lifts it."""
    rig = make_rig(model, q=STRETCHED)
    start = rig.pose()
    rig.commands.freedrive()
    rig.motion.force_control.set_external_wrench((newton, 0, 0, 0, 0, 0))
    rig.steps(500)
    moved = [b - a for a, b in zip(start, rig.pose(), strict=True)]
    assert moved[0] / newton > 0.02 / 20
    assert abs(moved[1]) < 0.1 * abs(moved[0])
    most = 2.8 if model == "ur8long" else 2.1  # times the limit: no jerk although the elbow could bend quickly
    assert rig.largest_acceleration() < most * max(rig.model.qdd_max)
    rig.motion.force_control.set_external_wrench(ZERO)
    rig.steps(1500)
    assert rig.fault is None
    assert rig.motion.qd == ZERO


def test_a_stretched_arm_cannot_be_pulled_longer(make_rig):
    rig = make_rig("ur3", q=(0, -1.5707963267948966, 0, -1.5707963267948966, 0, 0))
    start = rig.pose()
    rig.commands.freedrive()
    rig.motion.force_control.set_external_wrench((0, 0, 200, 0, 0, 0))
    rig.steps(500)
    assert rig.pose() == pytest.approx(start, abs=1e-3)
    assert rig.fault is None


def test_a_stretched_arm_holds_its_non_compliant_axes(make_rig):
    """Straight up, the tool cannot move sideways without moving down: force mode along x alone soon stops."""
    rig = make_rig("ur3", q=STRETCHED)
    start = rig.pose()
    rig.motion.force_control.force_mode(BASE, (1, 0, 0, 0, 0, 0), (20, 0, 0, 0, 0, 0), 2, LIMITS)
    rig.steps(2000)
    assert rig.pose()[1:] == pytest.approx(start[1:], abs=2e-4)
    assert rig.fault is None
