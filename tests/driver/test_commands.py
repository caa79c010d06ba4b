"""Commands beside the motion."""

import pytest
from driver_rig import CALM_S, HOME, PATIENCE_S

from client.driver import URDriver, points
from client.errors import ProgramEndedError, ProgramNotRunningError
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import TrajectoryResult, from_words

SUCCESS, CANCELED, FAILURE = TrajectoryResult
E_SERIES = pytest.mark.parametrize("robot", ["ur5e", "ur5e 5.9.4"], indirect=True)
COMPLY_Z = ((0.0,) * 6, (0, 0, 1, 0, 0, 0), (0, 0, -10.0, 0, 0, 0), 2, (0.1,) * 6)
TOUCH = (0.0, 0.0, 30.0, 0.0, 0.0, 0.0)
NOTHING = (0.0,) * 6


@pytest.mark.parametrize("start", [True, False], ids=["beside the program", "without a program"])
async def test_payload_voltage_and_gravity(connect, start):
    async with connect(start=start) as pair:
        installation, signals = pair.robot.controller.installation, pair.robot.controller.signals
        await pair.driver.set_payload(1.5, [0, 0, 0.1])
        await pair.until(lambda: installation.target_payload.mass == 1.5)
        assert installation.target_payload.cog == pytest.approx((0, 0, 0.1))
        await pair.driver.set_tool_voltage(24)
        await pair.until(lambda: signals.tool_voltage == 24)
        await pair.driver.set_gravity([0, 9.82, 0])
        await pair.until(lambda: installation.gravity == (0, 9.82, 0))
        assert pair.driver.program_running is start


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
@pytest.mark.parametrize("start", [True, False], ids=["beside the program", "without a program"])
async def test_payload_with_inertia_and_zeroing(connect, start):
    async with connect(start=start) as pair:
        installation = pair.robot.controller.installation
        await pair.driver.set_target_payload(2.0, [0.01, 0.02, 0.03], [0.1, 0.2, 0.3, 0, 0, 0], 0.01)
        await pair.until(lambda: installation.target_payload.mass == 2.0)
        assert installation.target_payload.inertia == pytest.approx((0.1, 0.2, 0.3, 0, 0, 0))
        pair.robot.controller.external_wrench = TOUCH
        await pair.until(lambda: pair.snapshot.actual_TCP_force[2] > 20)
        await pair.driver.zero_ftsensor()
        await pair.until(lambda: abs(pair.snapshot.actual_TCP_force[2]) < 1)


async def test_the_tool_centre_point(pair):
    pair.driver.set_tcp([0, 0, 0.1, 0, 0, 0])
    await pair.until(lambda: pair.robot.controller.installation.tcp[2] == pytest.approx(0.1))


async def test_force_mode_gives_way_until_it_ends(pair):
    z = pair.snapshot.actual_TCP_pose[2]
    pair.driver.start_force_mode(*COMPLY_Z, damping=0.1)
    await pair.until(lambda: pair.snapshot.actual_TCP_pose[2] < z - 0.005)
    pair.driver.end_force_mode()
    await pair.until(lambda: pair.at_rest)
    assert pair.driver.program_running


async def test_freedrive_follows_the_hand(pair):
    pair.driver.start_freedrive()
    pair.robot.controller.external_wrench = (0.0, 0.0, 20.0, 0.0, 0.0, 0.0)
    await pair.until(lambda: pair.distance() > 0.01)
    await pair.until(lambda: pair.distance() > 0.02)
    pair.driver.stop_freedrive()
    pair.robot.controller.external_wrench = NOTHING
    await pair.until(lambda: pair.at_rest)
    await pair.setpoints(0.1, lambda _: pair.driver.servoj(pair.q, CALM_S))
    assert pair.driver.program_running


@E_SERIES
async def test_contact_stops_a_motion_and_takes_it_back(pair):
    down = [0, 0, -0.05, 0, 0, 0]
    pair.driver.start_tool_contact()
    await pair.setpoints(0.3, lambda _: pair.driver.speedl(down, CALM_S))
    where = pair.snapshot.actual_TCP_pose
    pair.robot.controller.external_wrench = TOUCH
    await pair.setpoints(0.6, lambda _: pair.driver.speedl(down, CALM_S))
    assert await pair.driver.tool_contact_result(PATIENCE_S) is SUCCESS
    assert pair.snapshot.actual_TCP_pose == pytest.approx(where, abs=2e-3)
    assert pair.at_rest
    pair.robot.controller.external_wrench = NOTHING
    pair.driver.end_tool_contact()
    await pair.setpoints(0.2, lambda _: pair.driver.speedl(down, CALM_S))
    assert pair.snapshot.actual_TCP_pose[2] < where[2] - 0.003


@E_SERIES
async def test_contact_ends_a_trajectory(pair):
    pair.driver.start_tool_contact()
    target = list(pair.snapshot.actual_TCP_pose)
    target[2] -= 0.2
    await pair.driver.start_trajectory([points.movel(target, v=0.1)])
    await pair.until(lambda: pair.snapshot.actual_TCP_pose[2] < target[2] + 0.19)
    pair.robot.controller.external_wrench = TOUCH
    assert await pair.driver.trajectory_result(PATIENCE_S) is CANCELED
    assert await pair.driver.tool_contact_result(PATIENCE_S) is SUCCESS


@E_SERIES
async def test_no_contact(pair):
    pair.driver.start_tool_contact()
    pair.driver.idle()
    pair.driver.end_tool_contact()
    assert await pair.driver.tool_contact_result(PATIENCE_S) is CANCELED


@E_SERIES
async def test_waiting_for_contact_ends_with_the_program(pair):
    pair.driver.start_tool_contact()
    pair.robot.controller.programs.stop()
    with pytest.raises(ProgramEndedError, match="tool contact"):
        await pair.driver.tool_contact_result(PATIENCE_S)


async def test_the_wrench_can_come_from_an_input(pair):
    sensor = pair.robot.controller.ft_input
    pair.driver.ft_rtde_input_enable(True, 0.5, [0, 0, 0.05], [0, 0, 0.02])
    await pair.until(lambda: sensor.enabled)
    assert (sensor.sensor_mass, sensor.measuring_offset) == (0.5, pytest.approx((0, 0, 0.05)))


@pytest.mark.parametrize("robot", ["ur3"], indirect=True)
async def test_what_a_cb3_robot_does_not_have_is_refused(pair):
    refused = pytest.raises(RobotRefused, match="CB3 robots")
    with refused:
        await pair.driver.zero_ftsensor()
    with refused:
        await pair.driver.set_target_payload(1, [0, 0, 0])
    for call in (pair.driver.start_tool_contact, pair.driver.end_tool_contact):
        with refused:
            call()
    with refused:
        pair.driver.set_friction_compensation(True)
    with refused:
        pair.driver.set_friction_scales([1] * 6, [1] * 6)


@pytest.mark.parametrize("robot", ["ur5e 5.9.4"], indirect=True)
async def test_a_refusal_says_which_version_to_update_to(pair):
    with pytest.raises(RobotRefused, match=r"5\.9\.4.*update the robot to 5\.10"):
        await pair.driver.set_target_payload(1, [0, 0, 0])
    with pytest.raises(RobotRefused, match=r"update the robot to 5\.25\.1"):
        pair.driver.set_friction_scales([1] * 6, [1] * 6)


async def test_wrong_values_are_the_callers_fault(pair):
    frame, selection, wrench, kind, limits = COMPLY_Z
    for wrong in (
        (frame, selection, wrench, 4, limits),
        (frame, (0, 0, 2, 0, 0, 0), wrench, kind, limits),
        (frame, selection, wrench, kind, (-1.0,) * 6),
        (frame[:5], selection, wrench, kind, limits),
    ):
        with pytest.raises(LocalProtocolError):
            pair.driver.start_force_mode(*wrong)
    with pytest.raises(LocalProtocolError):
        pair.driver.start_force_mode(*COMPLY_Z, damping=2.0)
    with pytest.raises(LocalProtocolError):
        await pair.driver.set_payload(-1, [0, 0, 0])
    with pytest.raises(LocalProtocolError):
        await pair.driver.set_tool_voltage(5)
    await pair.periods(5)
    assert pair.driver.program_running


async def test_other_commands_need_the_program(connect):
    async with connect(start=False) as pair:
        with pytest.raises(ProgramNotRunningError):
            pair.driver.set_tcp(HOME)


class Sent:
    """A driver that is not connected, and the commands that it would send."""

    def __init__(self, monkeypatch):
        self.driver = URDriver("127.0.0.1")
        self.commands, self.requested = [], []
        monkeypatch.setattr(self.driver.commands, "send", self.commands.append)
        monkeypatch.setattr(self.driver.link, "require", self.requested.append)


@pytest.fixture
def sent(monkeypatch):
    return Sent(monkeypatch)


@pytest.mark.parametrize("fraction", [0.0, 0.009, 1.001, -1.0, float("nan")])
async def test_the_speed_slider_has_two_ends(sent, fraction):
    with pytest.raises(LocalProtocolError, match=r"speed slider: from 0\.01 to 1"):
        await sent.driver.set_speed_slider(fraction)


@pytest.mark.parametrize("mass", [-0.001, float("nan")])
async def test_a_mass_that_is_none_is_refused_also_where_a_script_would_carry_it(sent, mass):
    for command in (sent.driver.set_payload, sent.driver.set_target_payload):
        with pytest.raises(LocalProtocolError, match="a mass:"):
            await command(mass, (0.0, 0.0, 0.0))


def test_numbers_of_commands_go_where_they_belong(sent):
    viscous, coulomb = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), (0.7, 0.8, 0.9, 1.0, 0.0, 0.05)
    sent.driver.set_friction_scales(viscous, coulomb)
    assert from_words(sent.commands[-1].words) == (*viscous, *coulomb)
    assert sent.requested == ["set_friction_scales"]
    sent.driver.set_stream_parameters(lookahead_s=0.05, gain=500.0, acceleration=7.0, deceleration_rad_s2=3.0)
    assert from_words(sent.commands[-1].words) == (0.05, 500.0, 7.0, 3.0)
    sent.driver.set_force_mode_parameters(0.3, 1.5)
    assert from_words(sent.commands[-1].words) == (0.3, 1.5)
