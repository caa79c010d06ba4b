"""The state helper and the script interface before a plain rclpy program in another process."""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from driver_rig import HOST, driver_options, emulator
from ros2_rig import Peer, free_domain, in_this_process, peer

from client import AsyncRobot
from client.ros2.control_side import ControlSide
from client.ros2.host import NodeHost
from client.ros2.state_helper import StateHelperNode
from client.ros2.urscript_interface import URScriptNode
from emulator.app import Emulator
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from tests.budget import subset
from urproto.compat_asyncio import timeout
from urproto.modes import RobotMode, RuntimeState, SafetyMode

SPEED = 3.0
SET_MODE = "/ur_robot_state_helper/set_mode"
SCRIPT = "/urscript_interface/execute_script"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
ENDLESS = "def endless():\n  while True:\n    sync()\n  end\nend\n"


class Bench:
    """A robot, its driver, and who calls the nodes."""

    def __init__(self, robot: Emulator, arm: AsyncRobot, peer: Peer) -> None:
        self.robot = robot
        self.arm = arm
        self.peer = peer

    async def set_mode(self, mode: int, last: dict[str, int] | None = None, **more: bool) -> dict[str, Any]:
        goal = {"target_robot_mode": int(mode), **more}
        answer = await self.peer.request(goal=SET_MODE, type="ur_dashboard_msgs/action/SetMode", request=goal)
        assert answer["accepted"]
        answer = await self.peer.request(result=SET_MODE, last=last or {})
        assert answer["result"]["success"] == (answer["status"] == SUCCEEDED)
        return answer

    async def begin_script(self, program: str, **more: Any) -> bool:
        goal = {"program": program, "start_timeout": {"sec": 60, "nanosec": 0}, **more}
        answer = await self.peer.request(goal=SCRIPT, type="ur_msgs/action/SendScript", request=goal)
        return answer["accepted"]

    async def script(self, program: str, **more: Any) -> dict[str, Any]:
        assert await self.begin_script(program, **more)
        return await self.peer.request(result=SCRIPT)

    async def send(self, program: str) -> None:
        await self.peer.request(publish="/urscript_interface/script_command", type="std_msgs/msg/String",
                            message={"data": program})  # fmt: skip

    async def until(self, condition: Any) -> None:
        async with timeout(60.0):
            while not condition():
                await asyncio.sleep(0.01)


@asynccontextmanager
async def bench_of(robot: Emulator, node_type: Any, *ros_arguments: str, **options: Any) -> AsyncIterator[Bench]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    async with AsyncRobot(HOST, **driver_options(robot, **options)) as arm:
        with free_domain() as domain:
            side = ControlSide()
            side.robot = arm
            async with (
                in_this_process(side) as link,
                NodeHost(link, domain=domain, ros_arguments=ros_arguments) as host,
                peer(domain) as other,
            ):
                node = await asyncio.to_thread(node_type, host, arm.driver.config)
                try:
                    yield Bench(robot, arm, other)
                finally:
                    await asyncio.to_thread(node.close)


@pytest.mark.parametrize("model", subset(["ur3", "ur5e"], now=["ur3"]))
async def test_modes(model: str) -> None:
    async with emulator(model, speed=SPEED) as robot, bench_of(robot, StateHelperNode) as bench:
        controller = robot.controller
        answer = await bench.set_mode(RobotMode.POWER_OFF)
        assert answer["status"] == SUCCEEDED, answer
        assert bench.arm.driver.link.robot_mode is RobotMode.POWER_OFF

        mode = {"current_robot_mode": int(RobotMode.IDLE), "current_safety_mode": int(SafetyMode.NORMAL)}
        answer = await bench.set_mode(RobotMode.IDLE, last=mode)
        assert answer["status"] == SUCCEEDED, answer

        answer = await bench.set_mode(RobotMode.RUNNING, play_program=True)
        assert answer["status"] == SUCCEEDED, answer
        assert bench.arm.driver.program_running

        controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
        await bench.until(lambda: bench.arm.driver.protective_stopped)
        answer = await bench.set_mode(RobotMode.RUNNING, stop_program=True, play_program=True)
        assert answer["status"] == SUCCEEDED, answer
        assert controller.safety.mode is SafetyMode.NORMAL
        assert bench.arm.driver.program_running

        controller.safety_event(SafetyEvent.VIOLATION)
        await bench.until(lambda: bench.arm.driver.link.safety_mode is SafetyMode.VIOLATION)
        answer = await bench.set_mode(RobotMode.IDLE)
        assert answer["status"] == SUCCEEDED, answer
        assert bench.arm.driver.link.robot_mode is RobotMode.IDLE

        for mode in (RobotMode.BOOTING, 99):
            answer = await bench.set_mode(mode)
            assert answer["status"] == ABORTED
            assert "cannot be requested" in answer["result"]["message"]

        controller.safety_event(SafetyEvent.ROBOT_EMERGENCY_STOP)
        await bench.until(lambda: bench.arm.driver.link.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP)
        answer = await bench.set_mode(RobotMode.RUNNING)
        assert answer["status"] == ABORTED
        assert "release the emergency stop" in answer["result"]["message"]


async def test_a_program_of_the_pendant_is_played(tmp_path: Path) -> None:
    """Without headless mode; and a goal is not cancelled, while the node answers."""
    (tmp_path / "pick.script").write_text("while True:\n  sync()\nend\n")
    async with (
        emulator("ur5e", programs_dir=tmp_path, speed=SPEED) as robot,
        bench_of(robot, StateHelperNode, "-p", "headless_mode:=false") as bench,
    ):
        robot.controller.power_event(PowerEvent.POWER_OFF)
        await bench.until(lambda: bench.arm.driver.link.robot_mode is RobotMode.POWER_OFF)
        goal = {"target_robot_mode": 7, "play_program": True}
        order = {"type": "ur_dashboard_msgs/action/SetMode", "request": goal}
        assert (await bench.peer.request(goal=SET_MODE, **order))["accepted"]
        assert (await bench.peer.request(cancel=SET_MODE))["goals_canceling"] == []
        answer = await bench.peer.request(result=SET_MODE)
        assert answer["status"] == ABORTED
        assert "Failed to execute: play" in answer["result"]["message"]  # nothing is loaded
        assert robot.controller.power.robot_mode is RobotMode.RUNNING

        await bench.arm.dashboard.load("pick.script")
        answer = await bench.set_mode(RobotMode.RUNNING, play_program=True)
        assert answer["status"] == SUCCEEDED, answer
        assert robot.controller.programs.state is RuntimeState.PLAYING


async def test_scripts() -> None:
    async with emulator("ur5e", speed=SPEED) as robot, bench_of(robot, URScriptNode) as bench:
        await bench.send("sec lamp():\n  set_digital_out(3, True)\nend")
        await bench.until(lambda: bench.arm.digital_out(3))
        await bench.send("set_digital_out(3, False)")
        await bench.until(lambda: not bench.arm.digital_out(3))

        answer = await bench.script("set_digital_out(4, True)\nsync()", script_name="lamp_four")
        assert answer["status"] == SUCCEEDED, answer
        assert answer["result"]["success"]
        await bench.until(lambda: bench.arm.digital_out(4))
        answer = await bench.script("sec lamp():\n  set_digital_out(4, False)\nend")
        assert answer["status"] == SUCCEEDED, answer
        await bench.until(lambda: not bench.arm.digital_out(4))

        for program, words in (
            ("def wrong():\n  movej(nowhere)\nend", "line 2"),
            ("# nothing\n\n", "empty"),
            ("sync()", "not a program name"),
        ):
            name = "4 wheels" if program == "sync()" else ""
            answer = await bench.script(program, script_name=name)
            assert answer["status"] == ABORTED
            assert not answer["result"]["success"]
            assert words in answer["result"]["message"]

        assert await bench.begin_script(ENDLESS)
        await bench.until(lambda: robot.controller.programs.state is RuntimeState.PLAYING)
        await bench.send("set_digital_out(5, True)")  # not heeded meanwhile
        assert len((await bench.peer.request(cancel=SCRIPT))["goals_canceling"]) == 1
        answer = await bench.peer.request(result=SCRIPT)
        assert answer["status"] == CANCELED
        assert not answer["result"]["success"]
        assert robot.controller.programs.state is RuntimeState.STOPPED
        assert not bench.arm.digital_out(5)

        assert await bench.begin_script(ENDLESS)
        assert not await bench.begin_script("sync()")  # one at a time
        await bench.peer.call(f"{SCRIPT}/_action/cancel_goal", "action_msgs/srv/CancelGoal")  # all of them, at once
        async with timeout(60.0):
            while not await bench.begin_script("sync()"):
                await asyncio.sleep(0.05)
        assert (await bench.peer.request(result=SCRIPT))["status"] == SUCCEEDED

        robot.controller.power_event(PowerEvent.POWER_OFF)
        answer = await bench.script("sync()")
        assert answer["status"] == ABORTED
        assert "POWER_OFF" in answer["result"]["message"]
