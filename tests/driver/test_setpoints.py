"""Setpoints reach the arm through the driver's own control program."""

import pytest
from driver_rig import CALM_S, HOME, swing

from client.errors import ProgramNotRunningError
from urproto.errors import LocalProtocolError, RobotRefused

TORQUE = ["ur5e 5.23 dynamic", "ur5e 5.25.1 dynamic"]


async def test_servoing_follows_joint_angles_and_comes_to_rest(pair):
    await pair.setpoints(1.0, lambda t: pair.driver.servoj(swing(t), CALM_S))
    assert pair.distance(swing(1.0)) < 0.02
    await pair.setpoints(1.2, lambda t: pair.driver.servoj(swing(min(1.0 + t, 2.0)), CALM_S))
    assert pair.distance() < 0.002
    pair.driver.idle()
    await pair.until(lambda: pair.at_rest)
    assert pair.driver.program_running


async def test_poses_are_followed(pair):
    x, *rest = pair.snapshot.actual_TCP_pose

    def send(t):
        pair.driver.servo_pose([x - 0.02 * min(t, 1.0), *rest], CALM_S)

    await pair.setpoints(1.3, send)
    pose = pair.snapshot.actual_TCP_pose
    assert pose[0] == pytest.approx(x - 0.02, abs=0.001)
    assert pose[1:] == pytest.approx(rest, abs=0.001)


async def test_joint_speeds(pair):
    await pair.setpoints(0.5, lambda _: pair.driver.speedj([0.2, 0, 0, 0, 0, -0.1], CALM_S))
    assert pair.snapshot.target_qd == pytest.approx((0.2, 0, 0, 0, 0, -0.1), abs=1e-6)
    assert pair.q[0] - HOME[0] == pytest.approx(0.1, abs=0.02)
    pair.driver.idle()
    await pair.until(lambda: pair.at_rest)


async def test_tool_velocity(pair):
    before = pair.snapshot.actual_TCP_pose
    await pair.setpoints(0.5, lambda _: pair.driver.speedl([0, 0, 0.04, 0, 0, 0], CALM_S))
    moved = [b - a for a, b in zip(before, pair.snapshot.actual_TCP_pose, strict=True)]
    assert moved[2] == pytest.approx(0.02, abs=0.005)
    assert moved[:2] == pytest.approx([0, 0], abs=1e-3)


async def test_one_mode_after_another(pair):
    await pair.setpoints(0.2, lambda _: pair.driver.speedj([0.1] * 6, CALM_S))
    await pair.setpoints(0.2, lambda _: pair.driver.speedl([0, 0, 0.02, 0, 0, 0], CALM_S))
    q = pair.q
    await pair.setpoints(0.3, lambda _: pair.driver.servoj(q, CALM_S))
    pose = pair.snapshot.actual_TCP_pose
    await pair.setpoints(0.3, lambda _: pair.driver.servo_pose(pose, CALM_S))
    assert pair.snapshot.actual_TCP_pose == pytest.approx(pose, abs=0.002)
    assert pair.driver.program_running


async def test_a_setpoint_out_of_reach_is_ignored_until_one_is_within_it(pair):
    far = (HOME[0] + 2.0, *HOME[1:])
    await pair.setpoints(0.1, lambda _: pair.driver.servoj(far, CALM_S))
    assert pair.distance() < 1e-3
    assert "asks for" in pair.robot.controller.popups.shown[-1].text
    await pair.setpoints(1.0, lambda t: pair.driver.servoj(swing(t), CALM_S))
    assert pair.distance(swing(1.0)) < 0.02


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_a_late_setpoint_is_no_jerk(pair):
    """Every fourth setpoint only, as from a slower driver: the arm goes on between them."""
    worst, before = 0.0, None

    def send(t):
        nonlocal worst, before
        if round(t / 0.002) % 4 == 0:
            pair.driver.servoj([HOME[0] + 0.2 * t, *HOME[1:]], CALM_S)
        speed = pair.snapshot.target_qd[0]
        if t > 0.5:
            worst = max(worst, abs(speed - 0.2))

    await pair.setpoints(1.0, send)
    assert worst < 0.15


@pytest.mark.parametrize("robot", TORQUE, indirect=True)
async def test_torques_accelerate_a_joint(pair):
    if pair.driver.version.minor < 25:
        pair.driver.set_friction_compensation(False)
    else:
        pair.driver.set_friction_scales([0.5] * 6, [0.5] * 6)
    await pair.setpoints(0.2, lambda _: pair.driver.torque([20, 0, 0, 0, 0, 0], CALM_S))  # beats friction
    assert pair.snapshot.actual_qd[0] > 0.1
    pair.driver.idle()
    await pair.until(lambda: pair.at_rest)
    assert pair.driver.program_running


async def test_torques_need_a_newer_robot(pair):
    with pytest.raises(RobotRefused, match=r"CB3 robots|update the robot to 5\.23"):
        pair.driver.torque([0] * 6)


async def test_values_that_cannot_be_sent_are_the_callers_fault(pair):
    for wrong in ([0.0] * 5, [float("nan")] * 6, [1e9] * 6):
        with pytest.raises(LocalProtocolError):
            pair.driver.servoj(wrong)
    assert pair.driver.program_running


async def test_without_a_program_nothing_can_be_sent(connect):
    async with connect(start=False) as pair:
        with pytest.raises(ProgramNotRunningError, match="start the program"):
            pair.driver.servoj(HOME)


async def test_the_speed_slider_scales_setpoints_and_reports(pair):
    await pair.driver.set_speed_slider(0.5)
    await pair.until(lambda: pair.snapshot.target_speed_fraction == 0.5)
    with pytest.raises(LocalProtocolError):
        await pair.driver.set_speed_slider(1.5)
