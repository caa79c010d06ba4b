"""``controllers serve`` on an emulated arm, in real time: commands of other shells go through it."""

import asyncio
import contextlib
from dataclasses import replace

import pytest
from driver_rig import HOME, HOST, PATIENCE_S, SCALED, driver_options, emulator, goals_file, moved
from emulator_process import EmulatorProcess

from client import dashboard
from client.commands.control import announce
from client.commands.controllers import serve
from client.commands.goals import ForwardKind, forward, go, publish
from client.controllers import JOINT_NAMES, JointTrajectory, JointTrajectoryPoint
from client.controllers.goal_files import read_goals
from client.controllers.remote import RemoteManager
from client.controllers.running import ManagerOptions, RunningManager, reached
from client.dashboard import DashboardClient
from client.errors import ControllerError, ManagerError, NoManagerError
from client.recording import read
from emulator.services.urcap import DriverAddress
from urproto.compat_asyncio import timeout
from urproto.modes import RobotMode

REST = (0.0,) * 6
ON_CB3 = pytest.mark.parametrize("robot", ["ur3"], indirect=True)


def way(q, time_s=1.0):
    return JointTrajectory(JOINT_NAMES, (JointTrajectoryPoint(q, REST, time_from_start_s=time_s),))


@contextlib.asynccontextmanager
async def serving(options):
    """``controllers serve``, from when it is ready."""
    task = asyncio.create_task(serve(options))
    async with timeout(PATIENCE_S):
        while True:
            try:
                async with RemoteManager(options.robot_ip, options.rtde_port):
                    break
            except NoManagerError:
                if task.done():
                    task.result()
                await asyncio.sleep(0.01)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


@contextlib.asynccontextmanager
async def shell(options):
    async with RemoteManager(options.robot_ip, options.rtde_port) as manager:
        yield manager


async def state_of(manager, name):
    return {one["name"]: one["state"] for one in await manager.request("list_controllers")}[name]


async def until(condition):
    async with timeout(PATIENCE_S):
        while not await condition():
            await asyncio.sleep(0.02)


@pytest.fixture
def options(robot):
    return ManagerOptions(HOST, driver_options(robot))


async def test_make_ready_waits_for_a_program_that_is_loaded_and_played(capsys, caplog):
    """Not headless, an arm that is off, nothing loaded; the second time the program is there, and is played."""
    async with emulator("ur5e") as robot, DashboardClient(HOST, port=robot.ports["dashboard"]) as board:
        await board.request(dashboard.POWER_OFF)
        options = ManagerOptions(HOST, driver_options(robot), headless=False, make_ready=True)
        async with reached(options) as arm:
            running = RunningManager(arm, headless=False)
            running.load_all()
            async with running.at_work(options):
                assert arm.driver.link.robot_mode is RobotMode.RUNNING
                assert "no program is loaded on the robot" in caplog.text
                ready = asyncio.create_task(announce(running, options))
                await until(lambda: _printed(capsys, "waiting for the control program: 127.0.0.1, "))
                port = arm.driver.program.sender.port
                address = DriverAddress(HOST, port)
                robot.controller.config = replace(robot.controller.config, external_control=address)
                await board.request(dashboard.load("external_control.urp"))
                assert not ready.done()
                await board.request(dashboard.PLAY)
                async with timeout(PATIENCE_S):
                    await ready
                assert await _printed(capsys, "the control program is running. Ctrl-C ends it.")
                await until(lambda: _active(running, SCALED))
        await board.request(dashboard.STOP)  # it loops, and asks for a driver that has left
        options = replace(options, driver_options=driver_options(robot, sender_port=port), controller="")
        async with reached(options) as arm, RunningManager(arm, headless=False).at_work(options):
            assert arm.driver.program_running


async def _printed(capsys, text):
    return text in capsys.readouterr().err


async def _active(running, name):
    return name in [controller.name for controller in running.manager.active()]


@ON_CB3
async def test_commands_of_the_thesis_go_through_the_running_manager(robot, options, target, tmp_path, capsys):
    there = moved(0.3, 0.0, 0.2, 0.0, 0.0, 0.0)
    async with serving(options), shell(options) as manager:
        await until(lambda: _is(manager, SCALED, "active"))
        await publish(
            replace(target, record=tmp_path / "run.mcap", speed_slider=0.8),
            read_goals(goals_file(tmp_path, there)),
            0.7,
            1,
        )
        output = capsys.readouterr()
        assert [line.split(":")[:2] for line in output.out.splitlines()] == [
            ["there", " SUCCESSFUL"],
            ["back", " SUCCESSFUL"],
        ]
        assert f"using the controller manager that is running for {HOST}" in output.err
        found = read(tmp_path / "run.mcap")
        assert max(found.tracking(SCALED).actual_q[:, 0]) == pytest.approx(there[0], abs=1e-2)
        assert await state_of(manager, SCALED) == "active"  # it goes on

        await forward(target, "forward_velocity_controller", ForwardKind.VELOCITY, (0, 0, 0, 0, 0, -0.3), 1.0, False)
        q = robot.controller.snapshot.actual_q
        assert q[5] == pytest.approx(HOME[5] - 0.3, abs=0.05)
        assert not any(robot.controller.snapshot.target_qd)
        assert f"forward_velocity_controller replaces {SCALED}" in capsys.readouterr().err
        await forward(target, "forward_position_controller", ForwardKind.POSITION, HOME, 0.8, False)
        assert robot.controller.snapshot.actual_q == pytest.approx(HOME, abs=0.01)
        with pytest.raises(ManagerError, match="limit"):
            await forward(target, "forward_position_controller", ForwardKind.POSITION, (9.0,) * 6, 0.8, False)

        going = asyncio.create_task(go(target, SCALED, way(moved(1.0, 0, 0, 0, 0, 0), 3.0)))
        await until(lambda: _moves(robot))
        going.cancel()
        with pytest.raises(asyncio.CancelledError):
            await going
        assert max(map(abs, robot.controller.snapshot.target_qd)) < 0.005
        assert await state_of(manager, SCALED) == "active"
        await go(target, SCALED, way(HOME))


async def _is(manager, name, state):
    return await state_of(manager, name) == state


async def _moves(robot):
    return max(map(abs, robot.controller.snapshot.target_qd)) > 0.2


@pytest.mark.long
async def test_the_robot_goes_and_comes_back():
    with EmulatorProcess(["--model", "ur3", "--running", "--no-pendant"]) as robot:
        free = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
        options = ManagerOptions(robot.host, free)
        async with serving(options), shell(options) as manager:
            await until(lambda: _is(manager, SCALED, "active"))
            robot.kill()
            await until(lambda: _is(manager, SCALED, "inactive"))
            trajectory = {"joint_names": JOINT_NAMES, "points": [{"positions": HOME, "time_from_start_s": 1.0}]}
            with pytest.raises(ControllerError, match=f"{SCALED}: it is inactive: activate it first"):
                await manager.request("joint_trajectory", controller=SCALED, trajectory=trajectory)
            await asyncio.to_thread(robot.start)
            await until(lambda: _is(manager, SCALED, "active"))
            await manager.request("set_hardware_component_state", name="ur3", state="unconfigured")
            assert await state_of(manager, SCALED) == "inactive"
            with pytest.raises(ControllerError, match="the hardware component ur3 is unconfigured: activate it first"):
                await manager.request("switch_controller", activate=[SCALED])
            await manager.request("set_hardware_component_state", name="ur3", state="active")
            await until(lambda: _is(manager, SCALED, "active"))
