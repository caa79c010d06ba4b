"""Controllers move an emulated arm in real time, through the driver."""

import asyncio
import math
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from itertools import pairwise

import pytest
from driver_rig import HOME, HOST, PATIENCE_S, SCALED, Pair, emulator, emulator_thread, goals_file, moved

from client import dashboard
from client.commands.goals import go, publish
from client.controllers import (
    JOINT_NAMES,
    RTDE_OUTPUTS,
    BlockingRobotControl,
    ControlLoop,
    ErrorCode,
    FollowJointTrajectory,
    GoalStatus,
    JointTrajectory,
    JointTrajectoryPoint,
    Tolerance,
)
from client.controllers.goal_files import read_goals
from client.errors import ControllerError, MotionError, OutOfReachError
from client.recording import read
from emulator.faults.rtde import StaleData
from urproto.compat_asyncio import timeout

PASSTHROUGH = "passthrough_trajectory_controller"
REST = (0.0,) * 6
ON_E_SERIES = pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
ON_CB3 = pytest.mark.parametrize("robot", ["ur3"], indirect=True)
NOTHING = (0.0,) * 6
PUSH = (0.0, 40.0, 0.0, 0.0, 0.0, 0.0)
TOUCH = (0.0, 0.0, 60.0, 0.0, 0.0, 0.0)


class Bench(Pair):
    """A pair with a control loop; names are active from the beginning."""

    loop: ControlLoop

    @property
    def manager(self):
        return self.loop.manager

    def controller(self, name):
        return self.manager.controller(name)

    async def after(self, seconds):
        """Let the robot's time pass."""
        end = self.manager.time_s + seconds
        while self.manager.time_s < end:
            await self.loop.cycles()


@asynccontextmanager
async def controlled(robot, *names, **options) -> AsyncIterator[Bench]:
    bench = Bench(robot, outputs=RTDE_OUTPUTS, **options)
    async with bench.driver:
        await bench.driver.start_program()
        async with ControlLoop(bench.driver) as bench.loop:
            bench.manager.activate(*names)
            yield bench


def way(*points):
    """(time, joint angles) to be passed, at rest at the end."""
    made = [JointTrajectoryPoint(q, REST, time_from_start_s=t) for t, q in points]
    return JointTrajectory(JOINT_NAMES, tuple(made))


def deviation(path, places):
    """How far from the nearest point of the path the farthest place is [rad]."""
    return max(min(math.dist(place, q) for q in path) for place in places)


@pytest.mark.parametrize(("robot", "slider"), [("ur3", 1.0), ("ur5e", 0.3)], indirect=["robot"])
async def test_goals_are_followed_at_any_speed_slider(robot, slider):
    async with controlled(robot, SCALED) as bench:
        await bench.driver.set_speed_slider(slider)
        states = []
        bench.controller(SCALED).state_topic.subscribe(states.append)
        goal = way((0.7, moved(0.3, -0.2, 0.3, 0.0, -0.3, 0.4)), (1.4, moved(0.0, -0.2, 0.0, 0.3, -0.3, 0.0)))
        began = bench.manager.time_s
        result = await bench.loop.follow(SCALED, goal)
        assert (result.error_code, result.error_string) == (ErrorCode.SUCCESSFUL, "Goal successfully reached!")
        assert bench.manager.time_s - began == pytest.approx(1.4 / slider, rel=0.1)
        await bench.after(0.3 / slider)
        assert bench.distance(goal.points[-1].positions) < 0.005
        planned = [state.reference.positions for state in states]
        assert deviation(planned[::2], [state.feedback.positions for state in states[::20]]) < 0.02


@ON_CB3
async def test_a_goal_survives_a_protective_stop(robot):
    async with controlled(robot, SCALED) as bench:
        factors = []
        bench.controller(SCALED).state_topic.subscribe(lambda state: factors.append(state.speed_scaling_factor))
        goal = moved(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
        handle = bench.controller(SCALED).send_goal(way((1.0, goal)))
        await bench.after(0.5)
        await bench.driver.link.send_script("sec hit():\n  protective_stop()\nend")
        await bench.until(lambda: bench.driver.protective_stopped and bench.at_rest)
        await bench.after(0.1)
        stood, waited = bench.q, bench.controller(SCALED).progress
        assert 0.3 < waited < 0.9
        await bench.after(5.2)  # before that the robot does not unlock
        assert (bench.q, bench.controller(SCALED).progress) == (pytest.approx(stood, abs=1e-3), waited)
        board = bench.driver.link.dashboard
        await board.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        await board.request(dashboard.PLAY)
        assert (await bench.loop.result(handle)).error_code is ErrorCode.SUCCESSFUL
        await bench.after(0.5)
        assert bench.distance(goal) < 0.005
        rising = factors[len(factors) - 1 - factors[::-1].index(0.0) :]
        assert max(b - a for a, b in pairwise(rising)) < 0.05


async def test_a_goal_survives_a_new_program_after_a_protective_stop():
    async with emulator("ur3", speed=2.0) as robot, controlled(robot, SCALED) as bench:
        goal = moved(-0.4, 0.0, 0.0, 0.0, 0.0, 0.0)
        handle = bench.controller(SCALED).send_goal(way((1.0, goal)))
        await bench.after(0.5)
        await bench.driver.link.send_script("sec hit():\n  protective_stop()\nend")
        await bench.until(lambda: bench.driver.protective_stopped)
        await bench.driver.recover()
        assert (await bench.loop.result(handle)).error_code is ErrorCode.SUCCESSFUL
        await bench.after(0.5)
        assert bench.distance(goal) < 0.005


@ON_E_SERIES
async def test_a_program_that_ends_ends_the_controllers_that_move(robot):
    async with controlled(robot, SCALED, "joint_state_broadcaster") as bench:
        handle = bench.controller(SCALED).send_goal(way((3.0, moved(0.5, 0, 0, 0, 0, 0))))
        await bench.after(0.3)
        await bench.driver.stop_program()
        result = await bench.loop.result(handle)
        assert handle.status is GoalStatus.ABORTED
        assert "control program on the robot has ended" in result.error_string
        assert [one.name for one in bench.manager.active()] == ["joint_state_broadcaster"]
        with pytest.raises(ControllerError, match="control program on the robot has ended"):
            bench.manager.activate(SCALED)
        await bench.driver.start_program()
        await bench.loop.cycles(2)
        bench.manager.activate(SCALED)
        assert (await bench.loop.follow(SCALED, way((0.5, bench.q)))).error_code is ErrorCode.SUCCESSFUL


@ON_CB3
async def test_a_robot_that_falls_silent_ends_the_goal(robot):
    async with controlled(robot, SCALED, silence_s=0.5) as bench:
        handle = bench.controller(SCALED).send_goal(way((3.0, moved(0.5, 0, 0, 0, 0, 0))))
        await bench.after(0.2)
        robot.clock.close()
        async with timeout(PATIENCE_S):
            result = await bench.loop.result(handle)
        assert "the robot sends nothing" in result.error_string
        robot.clock.start(robot._tick)
        await bench.until(lambda: bench.program_ended)


@ON_CB3
async def test_states_that_stay_old_end_the_goal_like_silence(robot):
    async with controlled(robot, SCALED, silence_s=0.5, max_age_s=0.2) as bench:
        handle = bench.controller(SCALED).send_goal(way((3.0, moved(0.5, 0, 0, 0, 0, 0))))
        await bench.after(0.2)
        robot.faults.inject(StaleData(timestamp="stands"))
        last_s = bench.manager.time_s
        async with timeout(PATIENCE_S):
            result = await bench.loop.result(handle)
        assert re.search(r"the robot's states may be \d\.\d\d s old", result.error_string)
        assert bench.manager.time_s - last_s < 1.0, "cycles were made from old states"


@ON_E_SERIES
async def test_forward_controllers_and_their_conflicts(robot):
    async with controlled(robot, "forward_position_controller") as bench:
        start = bench.q
        for step in range(60):
            bench.controller("forward_position_controller").command([q + 0.001 * step for q in start])
            await bench.loop.cycles()
        await bench.after(0.4)
        assert bench.distance(tuple(q + 0.059 for q in start)) < 0.003
        with pytest.raises(
            ControllerError, match=r"forward_position_controller has claimed shoulder_pan_joint/position"
        ):
            bench.manager.activate(SCALED)
        with pytest.raises(ControllerError, match="position and velocity cannot be commanded at the same time"):
            bench.manager.activate("forward_velocity_controller")
        bench.manager.switch(activate=["forward_velocity_controller"], deactivate=["forward_position_controller"])
        bench.controller("forward_velocity_controller").command([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
        before = bench.q
        await bench.after(0.6)
        assert bench.q[5] - before[5] == pytest.approx(0.17, abs=0.04)
        bench.manager.deactivate("forward_velocity_controller")
        await bench.until(lambda: bench.at_rest)
        assert bench.driver.program_running


@ON_E_SERIES
async def test_passthrough_lets_the_robot_follow(robot):
    async with controlled(robot, PASSTHROUGH, "force_mode_controller") as bench:
        names = tuple(reversed(JOINT_NAMES))
        there, back = moved(0.2, 0.0, -0.2, 0.1, 0.0, 0.3), moved(0.0, 0.0, -0.1, 0.0, 0.0, 0.0)
        points = tuple(JointTrajectoryPoint(q[::-1], REST, time_from_start_s=t) for t, q in ((0.5, there), (1.0, back)))
        tolerance = dict.fromkeys(JOINT_NAMES, Tolerance(position=0.01))
        goal = FollowJointTrajectory(JointTrajectory(names, points), goal_tolerance=tolerance)
        handle = bench.controller(PASSTHROUGH).send_goal(goal)
        places = []
        handle.on_feedback.append(lambda feedback: places.append(feedback.actual.positions))
        with pytest.raises(ControllerError, match="a trajectory is under way"):
            bench.controller(PASSTHROUGH).send_goal(goal)
        result = await bench.loop.result(handle)
        assert result.error_code is ErrorCode.SUCCESSFUL
        assert "executed successfully in 1." in result.error_string
        assert bench.distance(back) < 0.005
        assert min(math.dist(place, there) for place in places) < 0.02
        second = bench.controller(PASSTHROUGH).send_goal(way((4.0, there)))
        await bench.after(0.5)
        bench.controller(PASSTHROUGH).cancel()
        assert second.status is GoalStatus.CANCELED
        await bench.until(lambda: bench.at_rest)
        assert bench.distance(back) < 0.1
        third = await bench.loop.follow(PASSTHROUGH, way((0.5, back)))
        assert third.error_code is ErrorCode.SUCCESSFUL


@ON_E_SERIES
async def test_force_mode_presses_and_ends(robot):
    async with controlled(robot, "force_mode_controller") as bench:
        controller = bench.controller("force_mode_controller")
        height = bench.snapshot.actual_TCP_pose[2]
        await bench.loop.answer(
            controller.start_force_mode(
                REST, (0, 0, 1, 0, 0, 0), (0, 0, -15.0, 0, 0, 0), speed_limits=(0.1, 0.1, 0.1, 1, 1, 1)
            )
        )
        await bench.until(lambda: bench.snapshot.actual_TCP_pose[2] < height - 0.01)
        bench.manager.deactivate("force_mode_controller")
        await bench.until(lambda: bench.at_rest)
        with pytest.raises(ControllerError, match="activate it first"):
            controller.stop_force_mode()


@ON_CB3
async def test_inputs_outputs_and_status(robot):
    async with controlled(robot, "io_and_status_controller", "speed_scaling_state_broadcaster") as bench:
        io = bench.controller("io_and_status_controller")
        calls = [io.set_digital_out(pin, True) for pin in (0, 9, 16)]
        calls += [io.set_speed_slider(0.5), io.set_analog_out(1, 0.5, voltage=True), io.set_payload(0.5, (0, 0, 0.01))]
        for call in calls:
            await bench.loop.answer(call)
        assert [pin for pin, on in enumerate(io.io_states.latest.digital_out) if on] == [0, 9, 16]
        await bench.until(
            lambda: bench.robot.controller.snapshot.standard_analog_output1 == pytest.approx(5.0, abs=0.1)
        )
        assert bench.controller("speed_scaling_state_broadcaster").topic.latest == pytest.approx(50.0)
        assert (io.robot_mode.latest, io.safety_mode.latest, io.program_running.latest) == (7, 1, True)
        with pytest.raises(ControllerError, match="the robot did not accept it"):
            await bench.loop.answer(io.zero_ftsensor())  # CB3 robots have none
        with pytest.raises(ControllerError, match="no digital output 18"):
            io.set_digital_out(18, True)


@ON_E_SERIES
async def test_freedrive_lasts_as_long_as_requested(robot):
    async with controlled(robot, "freedrive_mode_controller") as bench:
        controller = bench.controller("freedrive_mode_controller")
        for _ in range(2):
            controller.enable_freedrive_mode(True)
            await bench.after(0.2)
        robot.controller.external_wrench = PUSH
        await bench.until(lambda: bench.distance() > 0.02)
        robot.controller.external_wrench = NOTHING
        await bench.after(1.2)
        assert not controller.enabled
        await bench.until(lambda: bench.at_rest)
        place = bench.q
        robot.controller.external_wrench = PUSH
        await bench.after(0.3)
        assert bench.distance(place) < 0.002


@ON_E_SERIES
async def test_tool_contact_halts_the_motion_where_contact_began(robot):
    async with controlled(robot, SCALED, "tool_contact_controller") as bench:
        controller = bench.controller("tool_contact_controller")
        call = controller.detect_tool_contact()
        handle = bench.controller(SCALED).send_goal(way((4.0, moved(0.0, 0.4, 0.0, 0.0, 0.0, 0.0))))
        await bench.after(1.5)
        where = bench.q
        bench.robot.controller.external_wrench = TOUCH
        await bench.loop.answer(call)
        assert handle.done
        assert bench.distance(where) < 0.05
        bench.robot.controller.external_wrench = NOTHING
        await bench.after(0.5)
        assert bench.distance(where) < 0.05  # it does not go back into it
        assert (await bench.loop.follow(SCALED, way((1.0, HOME)))).error_code is ErrorCode.SUCCESSFUL


async def test_cb3_robots_have_no_tool_contact():
    async with emulator("ur3") as robot, controlled(robot) as bench:
        with pytest.raises(ControllerError, match="CB3 robots have no tool contact"):
            bench.manager.activate("tool_contact_controller")


def test_a_script_without_asyncio(tmp_path):
    file = tmp_path / "run.mcap"
    with emulator_thread("ur3") as robot, BlockingRobotControl(HOST, robot_ports=robot.ports, record=file) as arm:
        arm.activate(SCALED, "joint_state_broadcaster")
        assert arm.follow(SCALED, way((0.5, moved(0.1, 0, 0, 0, 0, 0)))).error_code is ErrorCode.SUCCESSFUL
        arm.rest()
        with pytest.raises(OutOfReachError, match=r"base at 9\.1000 rad"):
            arm.follow(SCALED, way((9.0, moved(8.9, 0, 0, 0, 0, 0))))
        with pytest.raises(MotionError, match=r"elbow_joint has 0\.1 s for 1\.00 rad, .* give it 0\.\d+ s or more"):
            arm.follow(SCALED, way((3.0, moved(0.2, 0, 0, 0, 0, 0)), (3.1, moved(0.2, 0, 1.0, 0, 0, 0))))
        arm.switch(activate=["forward_velocity_controller"], deactivate=[SCALED])
        arm.command("forward_velocity_controller", [0.2, 0, 0, 0, 0, 0])
        arm.cycles(50)
        state = arm.do(lambda manager: manager.controller("joint_state_broadcaster").topic.latest)
        assert state.velocity[0] == pytest.approx(0.2, abs=0.02)
        assert state.position[0] > HOME[0] + 0.12
    assert max(read(file).tracking(SCALED).actual_q[:, 0]) > HOME[0] + 0.09


# from the shell


@ON_CB3
async def test_the_goals_of_a_file_one_after_the_other(robot, target, tmp_path, capsys):
    there = moved(0.2, 0.0, 0.2, 0.0, 0.0, 0.0)
    await publish(target, read_goals(goals_file(tmp_path, there)), 0.7, 1)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[:2] for line in lines] == [["there", " SUCCESSFUL"], ["back", " SUCCESSFUL"]]
    assert max(abs(a - b) for a, b in zip(robot.controller.snapshot.actual_q, HOME, strict=True)) < 0.01
    elsewhere = read_goals(goals_file(tmp_path, there, base=(1.0, 2.0)))
    with pytest.raises(ControllerError, match=r"is at 0\.\d+ rad, not between 1 and 2; .* --positions \"1\.500,-1\.4"):
        await publish(target, elsewhere, 0.7, 1)


@pytest.mark.long
@ON_CB3
async def test_goals_record_what_was_desired_and_what_was(robot, target, tmp_path, capsys):
    there = moved(0.3, 0.0, 0.2, 0.0, 0.0, 0.0)
    recorded = replace(target, record=tmp_path / "run.mcap", speed_slider=0.5)
    await publish(recorded, read_goals(goals_file(tmp_path, there)), 0.7, 1)
    assert robot.controller.snapshot.target_speed_fraction == 0.5
    found = read(tmp_path / "run.mcap")
    tracking = found.tracking(SCALED)
    assert tracking.joints == JOINT_NAMES
    assert len(tracking.time_s) > 2 * 0.7 / 0.5 / robot.controller.period_s * 0.5  # a busy machine skips some
    assert max(tracking.desired_q[:, 0]) == pytest.approx(there[0], abs=1e-3)
    assert max(tracking.actual_q[:, 0]) == pytest.approx(there[0], abs=1e-2)
    assert tracking.largest_path_deviation < 0.02
    assert float(found["target_speed_fraction"][-1]) == 0.5
    assert found.info["polyscope"].startswith("3.")
    assert "recording to" in capsys.readouterr().err


@ON_E_SERIES
async def test_an_interrupted_goal_stops_softly(robot, target):
    speeds = []
    unsubscribe = robot.controller.subscribe(lambda snapshot: speeds.append(snapshot.target_qd[0]))
    going = asyncio.create_task(go(target, SCALED, way((2.0, moved(1.0, 0, 0, 0, 0, 0)))))
    async with timeout(PATIENCE_S):
        while not speeds or speeds[-1] < 0.5:
            await asyncio.sleep(0.01)
        going.cancel()
        with pytest.raises(asyncio.CancelledError):
            await going
    unsubscribe()
    assert speeds[-1] == 0.0
    braking = [(a - b) / robot.controller.period_s for a, b in pairwise(speeds)]
    assert max(braking) < 10.0  # rad/s2
