"""What the facade asks of the controller, and what it sets beside motions."""

import asyncio
import math
from collections.abc import AsyncIterator
from itertools import pairwise

import pytest
from driver_rig import HOME, PATIENCE_S, Lab, swing

from client import MotionError, ProgramEndedError, ProtectiveStopError
from client import points as way
from client.errors import ScriptFailedError
from emulator.app import Emulator
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modes import SafetyMode
from urproto.robots.kinematics import Kinematics

NEWEST = pytest.mark.parametrize("robot", ["ur5e 5.25.1"], indirect=True)
E_SERIES = pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
OTHER = (-0.7, -1.1, 1.2, -0.6, 1.3, 0.4)
TOOL = (0.01, -0.02, 0.12, 0.1, 0.2, -0.3)


@pytest.fixture
async def lab(robot: Emulator) -> AsyncIterator[Lab]:
    lab = Lab(robot, outputs=("output_int_register_24", "output_double_register_25"))
    async with lab.arm:
        yield lab


@pytest.fixture
def geometry(lab: Lab) -> Kinematics:
    return Kinematics(lab.robot.controller.model.dh)


def turned(angle_rad: float) -> tuple[float, ...]:
    return (HOME[0] + angle_rad, *HOME[1:])


async def test_forward_and_inverse_kinematics(lab, geometry):
    kinematics = lab.arm.kinematics
    assert await kinematics.forward() == pytest.approx(geometry.forward(HOME), abs=1e-9)
    assert await kinematics.forward(OTHER, TOOL) == pytest.approx(geometry.forward(OTHER, TOOL), abs=1e-9)
    pose = geometry.forward(OTHER, TOOL)
    assert await kinematics.inverse(pose, OTHER, TOOL) == pytest.approx(OTHER, abs=1e-8)
    assert await kinematics.inverse((9, 9, 9, 0, 0, 0)) is None
    assert await kinematics.has_solution(pose, OTHER, TOOL)
    assert not await kinematics.has_solution((9, 9, 9, 0, 0, 0))
    assert await kinematics.pose_within_limits(geometry.forward(OTHER))
    assert not await kinematics.pose_within_limits((9, 9, 9, 0, 0, 0))
    assert await kinematics.joints_within_limits(OTHER)
    assert not await kinematics.joints_within_limits((0, -7, 0, 0, 0, 0))
    await lab.arm.set_tcp(TOOL)
    assert await lab.arm.tcp_offset() == pytest.approx(TOOL, abs=1e-6)
    assert await kinematics.flange_pose() == pytest.approx(geometry.forward(HOME), abs=1e-6)


@NEWEST
async def test_matrices_and_torques(lab, geometry):
    jacobian = await lab.arm.kinematics.jacobian(OTHER, TOOL)
    step = 1e-6
    for joint in range(6):
        moved = tuple(q + step * (index == joint) for index, q in enumerate(OTHER))
        change = [
            (a - b) / step for a, b in zip(geometry.forward(moved, TOOL), geometry.forward(OTHER, TOOL), strict=True)
        ]
        assert [row[joint] for row in jacobian[:3]] == pytest.approx(change[:3], abs=1e-5)
    mass = await lab.arm.dynamics.mass_matrix(OTHER)
    assert [[row[i] for row in mass] for i in range(6)] == [pytest.approx(row, abs=1e-9) for row in mass]
    assert mass[0][0] > 0.1
    assert await lab.arm.dynamics.coriolis_torques(OTHER, (0.0,) * 6) == pytest.approx((0.0,) * 6, abs=1e-9)
    assert any(await lab.arm.dynamics.coriolis_torques(OTHER, (1.0, 0.5, 0.0, 0.0, 0.0, 0.0)))
    assert await lab.arm.dynamics.joint_torques() == pytest.approx((0.0,) * 6, abs=0.01)
    derivative = await lab.arm.kinematics.jacobian_time_derivative(OTHER, (1.0, 0, 0, 0, 0, 0))
    assert len(derivative) == 6 == len(derivative[0])
    assert await lab.arm.dynamics.target_accelerations() == (0.0,) * 6
    assert await lab.arm.kinematics.freedrive_status() == 0


async def test_what_a_version_lacks_is_refused(lab):
    with pytest.raises(RobotRefused, match=r"CB3 robots|update the robot to 5\.23"):
        await lab.arm.kinematics.jacobian()


@E_SERIES
async def test_questions_beside_a_motion(lab, geometry):
    arm = lab.arm
    target = turned(0.6)
    assert await arm.is_steady()
    assert await arm.step_time() == pytest.approx(0.002)
    await arm.sequence([way.movej(turned(0.2)), way.movej(target)], wait=False)
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.1)
    first = await arm.progress()
    assert (first.operation, first.running, first.point, first.points) == ("the sequence", True, 0, 2)
    await lab.until(lambda: lab.q[0] > HOME[0] + 0.25)
    assert (await arm.progress()).point == 1
    assert not await arm.is_steady()
    assert await arm.target_waypoint() == pytest.approx(
        Kinematics(lab.robot.controller.model.dh).forward(target), abs=1e-6
    )
    before, now = await arm.history(50), await arm.history(0)
    assert before[0] < now[0]
    await arm.wait_done()
    assert not (await arm.progress()).running


@NEWEST
async def test_contact_is_noted_beside_motions(lab):
    arm = lab.arm
    assert await arm.contact.steps() == 0
    await arm.contact.start_detection()
    assert not await arm.contact.detected()
    lab.robot.controller.external_wrench = (0.0, 0.0, 40.0, 0.0, 0.0, 0.0)
    await lab.periods(20)
    lab.robot.controller.external_wrench = (0.0,) * 6
    assert await arm.contact.stop_detection()
    await arm.contact.start_detection((0, 0, 1, 0, 0, 0))
    assert not await arm.contact.stop_detection()


@NEWEST
async def test_moving_until_contact(lab):
    arm = lab.arm
    begin = arm.tcp_pose[2]
    task = asyncio.create_task(arm.move_until_contact((0, 0, -0.1, 0, 0, 0)))
    await lab.until(lambda: lab.snapshot.actual_TCP_pose[2] < begin - 0.03)
    lab.robot.controller.external_wrench = (0.0, 0.0, 40.0, 0.0, 0.0, 0.0)
    await task
    lab.robot.controller.external_wrench = (0.0,) * 6
    assert lab.at_rest
    touched = arm.tcp_pose[2]
    assert begin - 0.1 < touched < begin - 0.02
    await lab.periods(50)
    assert arm.tcp_pose[2] == pytest.approx(touched, abs=1e-6)  # nothing that was on its way moves it on
    with pytest.raises(MotionError, match="touched nothing within"):
        await arm.move_until_contact((0, 0, 0.02, 0, 0, 0), timeout_s=0.2)
    await arm.move_j(HOME)


@E_SERIES
async def test_jogging_in_the_tools_frame(lab):
    arm = lab.arm
    pose = arm.tcp_pose
    await arm.jog((0, 0, 0.05, 0, 0, 0), frame="tool")
    await lab.periods(200)
    await arm.jog((0, 0, 0.1, 0, 0, 0), frame="tool")
    await lab.periods(100)
    await arm.stop()
    x, y, z, *_ = arm.kinematics.pose_trans(
        tuple(-value if index < 3 else 0.0 for index, value in enumerate(pose)), arm.tcp_pose
    )
    along = arm.kinematics.pose_trans((0, 0, 0, *pose[3:]), (0, 0, 1, 0, 0, 0))[:3]
    length = math.hypot(x, y, z)
    assert length > 0.02
    assert [x / length, y / length, z / length] == pytest.approx(along, abs=1e-3)
    with pytest.raises(LocalProtocolError, match="a frame is"):
        await arm.jog((0,) * 6, frame="flange")


@E_SERIES
async def test_accelerations_lookahead_and_gain(lab):
    speeds = []
    await lab.arm.make_ready()
    unsubscribe = lab.robot.controller.subscribe(lambda snapshot: speeds.append(snapshot.target_qd[0]))
    await lab.arm.speed_j((0.2, 0, 0, 0, 0, 0), 0.5, acceleration_rad_s2=1.0)
    unsubscribe()
    steps = [b - a for a, b in pairwise(speeds) if b > a]
    assert max(steps) == pytest.approx(0.002, rel=0.01)
    async with lab.arm.servo_j(lookahead_s=0.1, gain=300) as follow:
        began = lab.arm.state.timestamp_s
        q = lab.q
        while lab.arm.state.timestamp_s < began + 0.5:
            offset = swing(lab.arm.state.timestamp_s - began)[0] - HOME[0]
            await follow((q[0] + offset, *q[1:]))
        assert lab.distance((q[0] + offset, *q[1:])) > 0.01  # a longer lookahead lags behind
    assert lab.arm.stream.sent > 100
    with pytest.raises(LocalProtocolError, match="lookahead"):
        async with lab.arm.servo_j(lookahead_s=5.0):
            pytest.fail("entered")


async def test_registers_and_analog_outputs(lab):
    arm = lab.arm
    await arm.io.set_int_register(24, 7)
    await arm.io.set_double_register(25, 0.5)
    await lab.until(lambda: lab.snapshot.input_int_registers[24] == 7)
    await lab.until(lambda: lab.snapshot.input_double_registers[25] == 0.5)
    await arm.programs.send("sec echo():\n  write_output_integer_register(24, read_input_integer_register(24))\nend\n")
    await arm.wait_for(lambda state: arm.io.int_register(24) == 7, 5)
    await arm.io.set_analog_voltage(1, 2.5)
    await arm.wait_for(lambda state: arm.io.analog_out(1) == pytest.approx(2.5), 5)
    await arm.io.set_analog_current(0, 0.012)
    await arm.wait_for(lambda state: arm.io.analog_out(0) == pytest.approx(0.012), 5)
    assert arm.io.analog_out(1) == pytest.approx(2.5)
    with pytest.raises(LocalProtocolError, match="request it when connecting"):
        arm.io.int_register(30)
    with pytest.raises(LocalProtocolError):
        await arm.io.set_analog_voltage(0, 11)


async def test_a_script_of_ones_own_and_the_control_program_again(lab):
    arm = lab.arm
    await arm.move_j(turned(0.1))
    result = await arm.programs.run_function("mine", '  textmsg("here")\n  sleep(0.1)')
    assert "here" in result.texts
    await arm.move_j(HOME)
    with pytest.raises(ScriptFailedError, match="nonsense"):
        await arm.programs.run("nonsense()\n")
    await arm.move_j(turned(0.1))


async def test_a_watchdog_that_is_not_kicked_ends_the_program(lab):
    arm = lab.arm
    await arm.move_j(turned(1.5), speed_rad_s=0.05, wait=False)
    arm.set_watchdog(1.0)
    for _ in range(12):  # for longer than without any
        await asyncio.sleep(0.1)
        arm.kick_watchdog()
    assert arm.moving
    with pytest.raises(ProgramEndedError, match=r"watchdog was not kicked.*make_ready\(\)"):
        await arm.wait_done(PATIENCE_S)
    await lab.until(lambda: lab.at_rest)
    with pytest.raises(ProgramEndedError):
        await arm.move_j(HOME)
    await arm.make_ready()
    await arm.move_j(HOME)


async def test_a_protective_stop_of_ones_own(lab):
    await lab.arm.move_j(turned(1.5), speed_rad_s=0.3, wait=False)
    await lab.until(lambda: not lab.at_rest)
    await lab.arm.programs.send("sec hit():\n  protective_stop()\nend\n")
    with pytest.raises(ProtectiveStopError):
        await lab.arm.wait_done(PATIENCE_S)
    with pytest.raises(ProtectiveStopError, match="tcp_offset"):
        await lab.arm.tcp_offset()
    assert lab.arm.state.safety_mode == SafetyMode.PROTECTIVE_STOP


async def test_the_dashboard(lab):
    board = lab.arm.dashboard
    assert (await board.robot_model()).startswith("UR")
    version = await board.polyscope_version()
    assert version.short == lab.driver.version.short
    assert version.build > 0  # RTDE has that of URControl instead, which is 0
    await board.popup("hello")
    await lab.until(lambda: bool(lab.robot.controller.popups.shown))
    await board.close_popup()


@pytest.mark.parametrize("robot", ["ur5e 5.25.1 dynamic"], indirect=True)
async def test_torques_and_freedrive_along_one_axis(lab):
    arm = lab.arm
    q = lab.q
    async with arm.direct_torque() as follow:
        for _ in range(50):
            await follow((20, 0, 0, 0, 0, 0))  # beats friction
    assert lab.q[0] > q[0] + 1e-3
    await lab.until(lambda: lab.at_rest)
    begin = arm.tcp_pose
    async with arm.freedrive((0, 0, 1, 0, 0, 0)):
        lab.robot.controller.external_wrench = (20.0, 0.0, 20.0, 0.0, 0.0, 0.0)
        await lab.until(lambda: lab.snapshot.actual_TCP_pose[2] > begin[2] + 0.02)
        lab.robot.controller.external_wrench = (0.0,) * 6
    assert arm.tcp_pose[:2] == pytest.approx(begin[:2], abs=1e-3)


async def test_an_event_loop_that_hangs_ends_the_program(lab, monkeypatch):
    await lab.arm.move_j(turned(1.5), speed_rad_s=0.3, wait=False)
    monkeypatch.setattr(lab.driver.keep_alive, "_hang_timeout_s", 0.3)
    monkeypatch.setattr(lab.driver.keep_alive, "report_alive", lambda: None)
    with pytest.raises(ProgramEndedError, match=r"event loop .* has hung"):
        await lab.arm.wait_done(PATIENCE_S)
    await lab.until(lambda: lab.at_rest)
