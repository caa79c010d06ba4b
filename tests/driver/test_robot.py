"""The facade: what a lab script asks of a robot, and what it is told when that does not happen."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import pytest
from driver_rig import HOME, PATIENCE_S, Lab, emulator, swing

from client import (
    LateSetpointError,
    MotionError,
    MotionStoppedError,
    OutOfReachError,
    ProgramEndedError,
    ProgramNotRunningError,
    ProtectiveStopError,
    RobotUnreachableError,
    SafetyStopError,
    points,
)
from client.robot.reach import Reach
from emulator.app import Emulator
from emulator.lifecycle.power import PowerEvent, PowerState
from emulator.lifecycle.safety import SafetyEvent
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modes import RobotMode, RuntimeState, SafetyMode

E_SERIES = pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
FAST = {"speed_rad_s": 2.0, "acceleration_rad_s2": 5.0}
SLOW = {"speed_rad_s": 0.5}
STOP_IT = "sec hit():\n  protective_stop()\nend"


@pytest.fixture
def enter(robot: Emulator) -> Callable[..., AbstractAsyncContextManager[Lab]]:
    """``async with enter() as lab``: a facade of that robot; options are those of DriverConfig."""

    @asynccontextmanager
    async def open_lab(**options: object) -> AsyncIterator[Lab]:
        lab = Lab(robot, **options)
        async with lab.arm:
            yield lab

    return open_lab


@pytest.fixture
async def lab(enter: Callable[..., AbstractAsyncContextManager[Lab]]) -> AsyncIterator[Lab]:
    async with enter() as lab:
        yield lab


def off(*offsets):
    """Joint angles away from HOME."""
    return tuple(q + offset for q, offset in zip(HOME, (*offsets, 0, 0, 0, 0, 0, 0), strict=False))


def shifted(pose, x=0.0, y=0.0, z=0.0):
    return (pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:])


async def under_way(lab):
    """A long move that has just begun."""
    await lab.arm.move_j(off(1.5), **SLOW, wait=False)
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.1)


# moving


async def test_moves_end_where_they_should(lab):
    arm = lab.arm
    await arm.move_j(off(0.2), **FAST)
    assert arm.q == pytest.approx(off(0.2), abs=1e-6)
    pose = arm.tcp_pose
    await arm.move_l(shifted(pose, z=0.03), speed_m_s=0.5)
    assert arm.tcp_pose == pytest.approx(shifted(pose, z=0.03), abs=1e-4)
    await arm.move_p(shifted(pose, x=0.03, z=0.03), speed_m_s=0.3)
    await arm.move_c(shifted(pose, x=0.045, y=0.015, z=0.03), shifted(pose, x=0.03, y=0.03, z=0.03), speed_m_s=0.3)
    assert arm.tcp_pose == pytest.approx(shifted(pose, x=0.03, y=0.03, z=0.03), abs=1e-4)
    await arm.move_j(pose_base_tcp=pose, near_q_rad=off(0.2), **FAST)
    assert lab.distance(off(0.2)) < 1e-3
    assert lab.at_rest
    assert not arm.moving


@E_SERIES
async def test_a_sequence_blends_without_a_stop(lab):
    speeds = []
    unsubscribe = lab.robot.controller.subscribe(lambda s: speeds.append(max(map(abs, s.target_qd))))
    way = [points.movej(off(0.2), v=1, a=4, blend_radius_m=0.03), points.movej(off(0.2, 0.2), v=1, a=4)]
    await lab.arm.sequence(way)
    unsubscribe()
    moving = [speed for speed in speeds if speed > 0.0]
    assert lab.distance(off(0.2, 0.2)) < 1e-6
    assert min(moving[len(moving) // 4 : -len(moving) // 4]) > 0.3


@E_SERIES
async def test_speeds_last_as_long_as_they_should(lab):
    pose = lab.arm.tcp_pose
    await lab.arm.speed_l([0, 0, 0.05, 0, 0, 0], 0.4)
    assert lab.arm.tcp_pose[2] - pose[2] == pytest.approx(0.02, abs=0.006)
    assert lab.at_rest
    await lab.arm.speed_j([0, 0, 0, 0, 0, 0.3], 0.3)
    assert lab.q[5] - HOME[5] > 0.05
    assert lab.at_rest


@E_SERIES
async def test_servoing_paces_and_follows(lab):
    arm = lab.arm
    async with arm.servo_j() as follow:
        state = await follow(HOME)
        began = state.timestamp_s
        while state.timestamp_s < began + 1.0:
            state = await follow(swing(state.timestamp_s - began))
        assert lab.distance(swing(1.0)) < 0.02
    assert lab.at_rest
    x, *rest = arm.tcp_pose
    async with arm.servo_pose() as follow:
        state = await follow([x, *rest])
        began = state.timestamp_s
        while state.timestamp_s < began + 1.3:
            state = await follow([x + 0.01 * min(1.0, state.timestamp_s - began), *rest])
    assert arm.tcp_pose[0] == pytest.approx(x + 0.01, abs=1e-3)


async def test_a_target_too_far_for_servoing_is_reported(lab):
    async def jump():
        async with lab.arm.servo_j() as follow, timeout(PATIENCE_S):
            while True:
                await follow(off(2.0))

    with pytest.raises(MotionError, match="asks for"):
        await jump()
    await lab.arm.move_j(off(0.1), **FAST)


@E_SERIES
async def test_freedrive_follows_the_hand_and_holds(lab):
    async with lab.arm.freedrive():
        lab.robot.controller.external_wrench = (0.0, 0.0, 20.0, 0.0, 0.0, 0.0)
        await lab.until(lambda: lab.distance() > 0.02)
        with pytest.raises(LocalProtocolError, match="has to wait for freedrive"):
            await lab.arm.move_j(HOME)
        lab.robot.controller.external_wrench = (0.0,) * 6
    assert lab.arm.state.at_rest
    await lab.arm.move_j(HOME, **FAST)


@E_SERIES
async def test_force_mode_complies_until_it_ends(lab):
    z = lab.arm.tcp_pose[2]
    async with lab.arm.force_mode((0.0,) * 6, (0, 0, 1, 0, 0, 0), (0, 0, -10.0, 0, 0, 0), limits=(0.1,) * 6):
        state = await lab.arm.wait_for(lambda state: state.pose_base_tcp[2] < z - 0.005, 5)
    assert state.pose_base_tcp[2] < z - 0.005
    assert lab.arm.state.at_rest
    await lab.arm.move_j(HOME, **FAST)


# one motion at a time


async def test_stop_in_the_middle_of_a_move(lab):
    waiting = asyncio.create_task(lab.arm.move_j(off(1.5), **SLOW))
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.1)
    await lab.arm.stop()
    assert lab.at_rest
    assert 0 < lab.distance() < 1.0
    with pytest.raises(MotionStoppedError, match=r"move_j.*stop\(\) was called"):
        await waiting
    await lab.arm.move_j(HOME, **FAST)
    assert lab.distance() < 1e-6


async def test_stop_just_after_the_beginning(lab):
    await lab.arm.make_ready()
    await lab.arm.move_j(off(1.5), **SLOW, wait=False)
    await lab.arm.stop()
    await lab.periods(20)
    assert lab.at_rest
    assert lab.distance() < 0.2


@E_SERIES
@pytest.mark.parametrize("motion", ["speed_l", "servo_j"])
async def test_stop_ends_what_is_sent_all_the_time(lab, motion):
    async def servo():
        async with lab.arm.servo_j() as follow:
            while True:
                await follow(off(0.4 * min(1.0, lab.arm.state.timestamp_s - begin)))

    await lab.arm.make_ready()
    begin = lab.arm.state.timestamp_s
    task = asyncio.create_task(servo() if motion == "servo_j" else lab.arm.speed_l([0, 0, 0.05, 0, 0, 0], 10))
    await lab.until(lambda: not lab.at_rest)
    await lab.arm.stop()
    with pytest.raises(MotionStoppedError):
        await task
    await lab.until(lambda: lab.at_rest)
    await lab.arm.move_j(HOME, **FAST)


async def test_of_two_moves_at_the_same_time_one_is_refused(lab):
    both = await asyncio.gather(lab.arm.move_j(off(0.1)), lab.arm.move_j(off(-0.1)), return_exceptions=True)
    assert sorted(map(type, both), key=str) == sorted([type(None), LocalProtocolError], key=str)


async def test_stop_while_the_program_is_being_started(lab):
    task = asyncio.create_task(lab.arm.move_j(off(1.5)))
    await lab.until(lambda: not lab.program_ended)
    await lab.arm.stop()
    with pytest.raises(MotionStoppedError):
        await task
    await lab.periods(20)
    assert lab.at_rest


async def test_a_move_in_the_background(lab):
    await lab.arm.move_j(off(0.5), **FAST, wait=False)
    assert lab.arm.moving
    with pytest.raises(LocalProtocolError, match="set_tcp has to wait for move_j"):
        await lab.arm.set_tcp([0.0] * 6)
    with pytest.raises(TimeoutError, match="move_j is still under way"):
        await lab.arm.wait_done(0.01)
    await lab.arm.wait_for(lambda state: state.q_rad[0] > HOME[0] + 0.1, 5)
    await lab.arm.wait_done()
    assert lab.distance(off(0.5)) < 1e-6


async def test_a_move_in_the_background_is_replaced(lab):
    await under_way(lab)
    waiting = asyncio.create_task(lab.arm.wait_done())
    await lab.periods(20)
    await lab.arm.move_j(off(-0.1), **FAST)
    assert lab.distance(off(-0.1)) < 1e-6
    with pytest.raises(MotionStoppedError, match="move_j replaced it"):
        await waiting
    await lab.arm.speed_j([0.3, 0, 0, 0, 0, 0], 30, wait=False)
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.29)
    slowest = []
    unsubscribe = lab.robot.controller.subscribe(lambda s: slowest.append(s.target_qd[0]))
    await lab.arm.speed_j([0.4, 0, 0, 0, 0, 0], 30, wait=False)
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.39)
    unsubscribe()
    assert min(slowest) > 0.28
    await lab.arm.stop()
    assert lab.at_rest


async def test_setpoints_that_come_too_late_stop_the_arm_and_are_to_blame(lab):
    """The program goes on and the next motion needs nobody's help, but nothing moves by itself."""

    async def hold_up():
        async with lab.arm.velocity_j() as follow:
            for _ in range(40):
                await follow([0.1, 0, 0, 0, 0, 0])
            await lab.until(lambda: lab.at_rest)
            q = lab.q
            await lab.periods(100)
            assert lab.q == q
            await follow([0.1, 0, 0, 0, 0, 0])

    with pytest.raises(LateSetpointError, match=r"velocity_j.*(no setpoint for \d+ ms|waited too long)"):
        await hold_up()
    assert lab.arm.stream.late == 1
    assert lab.driver.program_running
    assert lab.at_rest
    await lab.arm.move_j(HOME, **FAST)


async def test_a_program_lost_through_our_own_fault_is_back_and_rests(lab, monkeypatch):
    await under_way(lab)
    beat = lab.driver.keep_alive._cycle
    monkeypatch.setattr(lab.driver.keep_alive, "_cycle", lambda due_s: due_s)
    with pytest.raises(ProgramEndedError, match="received nothing from this machine"):
        await lab.arm.wait_done(PATIENCE_S)
    monkeypatch.setattr(lab.driver.keep_alive, "_cycle", beat)
    async with timeout(PATIENCE_S):
        while not lab.driver.program_running:
            await asyncio.sleep(0.02)
    q = lab.q
    await lab.periods(50)
    assert lab.q == q
    await lab.arm.move_j(HOME, **FAST)


async def test_the_program_counts_as_ended_as_soon_as_the_robot_reports_it(lab):
    """Also where its connections linger."""
    await lab.arm.make_ready()
    assert lab.driver.program_running
    lab.robot.controller.programs.stop()
    await lab.until(lambda: lab.driver.state["runtime_state"] == 1)
    assert not lab.driver.program_running


async def test_what_is_set_in_a_protective_stop(lab):
    await lab.arm.make_ready()
    await lab.driver.link.send_script(STOP_IT)
    await lab.until(lambda: lab.driver.protective_stopped)
    await lab.arm.set_tcp([0, 0, 0.07, 0, 0, 0])
    assert lab.robot.controller.installation.tcp[2] == pytest.approx(0.07)
    await lab.arm.set_digital_out(1, True)


async def test_a_protective_stop_is_the_reason_why_nothing_takes_effect(lab, monkeypatch):
    async def ignore(_: str) -> None:
        return

    await lab.driver.link.send_script(STOP_IT)
    await lab.until(lambda: lab.driver.protective_stopped)
    monkeypatch.setattr("client.robot.settings._EFFECT_S", 0.1)
    monkeypatch.setattr(lab.driver.link, "send_script", ignore)
    for setting in (lab.arm.set_tcp([0, 0, 0.07, 0, 0, 0]), lab.arm.set_digital_out(1, True)):
        with pytest.raises(ProtectiveStopError, match=r"PROTECTIVE_STOP, C\d+A\d+"):
            await setting


async def test_a_caller_that_is_cancelled_stops_the_arm(lab):
    task = asyncio.create_task(lab.arm.move_j(off(1.5), **SLOW))
    await lab.until(lambda: lab.snapshot.target_qd[0] > 0.1)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await lab.until(lambda: lab.at_rest)
    assert lab.distance(off(1.5)) > 0.3
    await lab.arm.move_j(HOME, **FAST)


async def test_leaving_stops_a_move_in_the_background(enter):
    async with enter() as lab:
        await under_way(lab)
    await lab.until(lambda: lab.at_rest and lab.program_ended)


async def test_a_failure_that_was_not_awaited_is_raised_on_leaving(enter):
    async def look_away():
        async with enter() as lab:
            await under_way(lab)
            lab.robot.controller.programs.stop()
            await lab.until(lambda: not lab.arm.moving)

    with pytest.raises(ProgramEndedError):
        await look_away()


async def test_waiting_ends_when_the_move_fails(lab):
    await under_way(lab)
    lab.robot.controller.programs.stop()
    with pytest.raises(ProgramEndedError):
        await lab.arm.wait_for(lambda state: False, 10)


async def test_waiting_in_vain(lab):
    with pytest.raises(TimeoutError, match=r"within 0\.05 s"):
        await lab.arm.wait_for(lambda state: state.digital_in(0), 0.05)


# what cannot be


async def test_targets_out_of_reach_are_named_before_anything_moves(lab):
    pose = lab.arm.tcp_pose
    with pytest.raises(OutOfReachError, match=r"move_j.*elbow at 7\.0000 rad"):
        await lab.arm.move_j([0, 0, 7.0, 0, 0, 0])
    for move in (lab.arm.move_l, lab.arm.move_p):
        with pytest.raises(OutOfReachError, match="no joint angles"):
            await move(shifted(pose, x=3.0))
    with pytest.raises(OutOfReachError, match=r"the sequence.*point 2") as caught:
        await lab.arm.sequence([points.movej(HOME), points.movel(pose), points.movel(shifted(pose, z=3.0))])
    assert caught.value.point == 2
    assert lab.distance() == 0.0
    await lab.arm.move_l(shifted(pose, z=0.01))


async def test_a_target_only_the_robot_knows_to_be_out_of_reach(lab, monkeypatch):
    monkeypatch.setattr(Reach, "check", lambda *_: None)
    with pytest.raises(OutOfReachError, match="inverse kinematics") as caught:
        await lab.arm.move_j(pose_base_tcp=[9, 9, 9, 0, 0, 0])
    assert caught.value.point is None
    await lab.arm.move_j(off(0.1), **FAST)


async def test_the_reach_is_that_of_the_tool(lab):
    far = shifted(lab.arm.tcp_pose, z=0.0)
    length = 1.2
    await lab.arm.set_tcp([0, 0, length, 0, 0, 0])
    with pytest.raises(OutOfReachError):
        await lab.arm.move_l([0.0, 0.0, 0.3, *far[3:]])
    assert lab.arm.tcp_pose != pytest.approx(far, abs=0.1)


async def test_wrong_calls(lab):
    pose = lab.arm.tcp_pose
    with pytest.raises(LocalProtocolError, match="give one of them"):
        await lab.arm.move_j()
    with pytest.raises(LocalProtocolError, match="give one of them"):
        await lab.arm.move_j(HOME, pose_base_tcp=pose)
    with pytest.raises(LocalProtocolError):
        await lab.arm.move_l(pose[:5])
    with pytest.raises(LocalProtocolError):
        await lab.arm.move_l(pose, speed_m_s=-1)
    with pytest.raises(LocalProtocolError):
        await lab.arm.speed_l([0] * 6, 0)
    with pytest.raises(LocalProtocolError):
        await lab.arm.speed_l([0] * 5, 1)
    with pytest.raises(LocalProtocolError, match="no digital signal 18"):
        await lab.arm.set_digital_out(18, True)
    with pytest.raises(LocalProtocolError):
        lab.arm.digital_in(-1)
    with pytest.raises(LocalProtocolError):
        await lab.arm.set_tcp([0, 0, 0])
    assert lab.distance() == 0.0


# what goes wrong on the way


async def test_a_protective_stop_is_explained_and_recovered_from(lab):
    pose = lab.arm.tcp_pose
    with pytest.raises(ProtectiveStopError, match=r"move_l.*PROTECTIVE_STOP, C\d+A\d+ .*recover\(\)") as caught:
        await lab.arm.move_l([-pose[0], -pose[1], *pose[2:]], speed_m_s=0.5)  # through the base
    assert caught.value.mode is SafetyMode.PROTECTIVE_STOP
    assert caught.value.cause
    with pytest.raises(ProtectiveStopError, match="make_ready"):
        await lab.arm.make_ready()
    with pytest.raises(ProtectiveStopError, match="move_j"):
        await lab.arm.move_j(HOME)
    await lab.arm.recover()
    await lab.arm.move_j(HOME, **FAST)
    assert lab.distance() < 1e-6


@pytest.mark.parametrize("context", ["servo_j", "freedrive", "wait=False"])
async def test_a_protective_stop_ends_whatever_is_under_way(lab, context):
    async def servo():
        async with lab.arm.servo_j() as follow:
            while True:
                await follow(HOME)

    async def freedrive():
        async with lab.arm.freedrive():
            await lab.until(lambda: lab.driver.protective_stopped)

    async def background():
        await under_way(lab)
        await lab.arm.wait_done()

    work = {"servo_j": servo, "freedrive": freedrive, "wait=False": background}[context]
    await lab.arm.make_ready()
    task = asyncio.create_task(work())
    await lab.periods(50)
    await lab.driver.link.send_script(STOP_IT)
    with pytest.raises(ProtectiveStopError, match=r"C\d+A\d+"):
        async with timeout(PATIENCE_S):
            await task


@E_SERIES
async def test_an_emergency_stop_says_what_to_do(lab):
    await under_way(lab)
    lab.robot.controller.safety_event(SafetyEvent.ROBOT_EMERGENCY_STOP)
    with pytest.raises(SafetyStopError, match="release the emergency stop") as caught:
        await lab.arm.wait_done()
    assert caught.value.mode is SafetyMode.ROBOT_EMERGENCY_STOP
    lab.robot.controller.safety_event(SafetyEvent.EMERGENCY_STOP_RELEASED)
    await lab.arm.wait_for(lambda state: state.safety_mode == SafetyMode.NORMAL, 5)
    await lab.arm.make_ready()
    await lab.arm.move_j(HOME, **FAST)


async def test_a_program_ended_by_a_user_is_not_restarted_automatically(lab):
    await under_way(lab)
    lab.robot.controller.programs.stop()
    with pytest.raises(ProgramEndedError, match=r"move_j.*it was stopped on the robot.*make_ready\(\)"):
        await lab.arm.wait_done()
    with pytest.raises(ProgramEndedError, match=r"make_ready\(\)"):
        await lab.arm.move_j(HOME)
    await lab.arm.make_ready()
    await lab.arm.move_j(HOME, **FAST)


async def test_the_error_for_a_rejected_command_quotes_the_robot(lab):
    rest = (0.0,) * 6
    with pytest.raises(MotionError, match=r"the sequence.*too far away"):
        await lab.arm.sequence([points.spline(off(3.0), rest, 0.01), points.spline(HOME, rest, 1.0)])
    await lab.arm.move_j(off(0.1), **FAST)


async def test_a_paused_program_is_no_place_for_a_move(lab):
    await lab.arm.make_ready()
    lab.robot.controller.programs.pause()
    await lab.arm.wait_for(lambda state: state.runtime_state == 4, 5)
    with pytest.raises(RobotRefused, match="paused"):
        await lab.arm.move_j(HOME)
    await lab.arm.make_ready()
    await lab.arm.move_j(off(0.1), **FAST)


async def test_power_that_is_lost_on_the_way(lab):
    await under_way(lab)
    lab.robot.controller.power_event(PowerEvent.POWER_OFF)
    with pytest.raises(ProgramEndedError, match="mode is POWER_OFF"):
        await lab.arm.wait_done()
    with pytest.raises(RobotRefused, match=r"make_ready\(\)"):
        await lab.arm.move_j(HOME)


async def test_a_robot_that_freezes_in_a_move(enter, robot):
    async with enter(silence_s=1.0) as lab:
        await under_way(lab)
        robot.clock.close()
        with pytest.raises(RobotUnreachableError, match="during move_j"):
            async with timeout(PATIENCE_S):
                await lab.arm.wait_done()
        with pytest.raises(RobotUnreachableError):
            await lab.arm.move_j(HOME)
        robot.clock.start(robot._tick)
        await lab.until(lambda: lab.program_ended and lab.at_rest)


async def test_a_robot_that_goes_away_in_a_move(tmp_path):
    async with emulator("ur5e", None, tmp_path) as robot:
        lab = Lab(robot)
        await lab.arm.__aenter__()
        await under_way(lab)
    with pytest.raises(RobotUnreachableError, match="during move_j"):
        async with timeout(PATIENCE_S):
            await lab.arm.wait_done()
    await lab.arm.__aexit__(None, None, None)


# getting ready


async def test_a_robot_that_is_off_is_made_ready(enter, robot):
    robot.controller.power_event(PowerEvent.POWER_OFF)
    async with enter() as lab:
        await lab.until(lambda: lab.robot.controller.power.state is PowerState.OFF)
        await lab.arm.make_ready()
        assert lab.arm.state.robot_mode == RobotMode.RUNNING
        await lab.arm.move_j(off(0.1), **FAST)
        await lab.arm.make_ready()  # nothing left to do
        assert lab.arm.q == pytest.approx(off(0.1), abs=1e-6)


async def test_entering_leaves_the_running_program_alone(enter, robot):
    robot.controller.programs.submit("def other():\n  while True:\n    sync()\n  end\nend\n")
    async with enter() as lab:
        await lab.arm.wait_for(lambda state: state.runtime_state == 2, 5)
        assert lab.robot.controller.programs.name == "other"


@E_SERIES
async def test_local_control_is_the_reason(enter, monkeypatch):
    """A robot in local control ignores the program; that the emulator does not, so another program stands in."""
    monkeypatch.setattr("client.driver.control_program._template", lambda: "sync()\n")
    async with enter(start_timeout_s=0.3) as lab:
        with pytest.raises(RobotRefused, match=r"local control.*Remote Control"):
            await lab.arm.move_j(HOME)


@E_SERIES
async def test_a_robot_that_plays_the_program_is_not_in_local_control(enter, monkeypatch):
    """It cannot reach the driver, or the machine is too busy."""
    endless = "while True:\n  sync()\nend\n"
    monkeypatch.setattr("client.driver.control_program._template", lambda: endless)
    async with enter(start_timeout_s=0.3) as lab:
        lab.robot.controller.programs.submit(f"def other():\n{endless}end\n")
        await lab.arm.wait_for(lambda state: state.runtime_state == RuntimeState.PLAYING, PATIENCE_S)
        with pytest.raises(ProgramNotRunningError, match="must be able to reach"):
            await lab.arm.make_ready()


@pytest.mark.parametrize("robot", ["ur3"], indirect=True)
async def test_without_remote_control_it_is_the_network(enter, monkeypatch):
    monkeypatch.setattr("client.driver.control_program._template", lambda: "sleep(0.1)\n")
    async with enter(start_timeout_s=0.3) as lab:
        with pytest.raises(ProgramNotRunningError, match="must be able to reach"):
            await lab.arm.make_ready()


# settings


async def test_outputs_of_each_kind(lab):
    for number in (0, 7, 8, 15, 16, 17):
        await lab.arm.set_digital_out(number, True)
        assert lab.arm.digital_out(number)
        await lab.arm.set_digital_out(number, False)
        assert not lab.arm.digital_out(number)


async def test_an_input_can_be_waited_for(lab):
    await lab.arm.move_j(off(0.3), **SLOW, wait=False)
    await lab.arm.set_digital_out(3, True)
    assert lab.arm.moving
    assert not lab.arm.digital_in(3)
    lab.robot.controller.signals.digital_inputs |= 1 << 3
    state = await lab.arm.wait_for(lambda state: state.digital_in(3), 5)
    assert state.digital_in(3)
    await lab.arm.stop()


@pytest.mark.parametrize("ready", [True, False], ids=["beside the program", "without a program"])
async def test_payload_and_tcp(lab, ready):
    if ready:
        await lab.arm.make_ready()
    installation = lab.robot.controller.installation
    before = lab.arm.tcp_pose
    await lab.arm.set_tcp([0, 0, 0.1, 0, 0, 0])
    assert installation.tcp[2] == pytest.approx(0.1)
    assert lab.arm.tcp_pose != pytest.approx(before, abs=0.01)
    await lab.arm.set_payload(1.5, [0, 0, 0.1])
    await lab.until(lambda: installation.target_payload.mass == 1.5)
    await lab.arm.move_l(shifted(lab.arm.tcp_pose, z=0.01))
    assert installation.tcp[2] == pytest.approx(0.1)


async def test_the_speed_slider(lab):
    await lab.arm.set_speed_slider(0.5)
    assert lab.arm.state.speed_fraction == 0.5
    with pytest.raises(LocalProtocolError):
        await lab.arm.set_speed_slider(2)


async def test_a_setting_without_effect_is_no_success(lab, monkeypatch):
    async def ignore(_: str) -> None:
        return

    monkeypatch.setattr("client.robot.settings._EFFECT_S", 0.1)
    monkeypatch.setattr(lab.driver.link, "send_script", ignore)
    with pytest.raises(RobotRefused, match="digital output 1"):
        await lab.arm.set_digital_out(1, True)
