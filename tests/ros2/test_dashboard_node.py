"""The node ``dashboard_client`` before a plain rclpy program in another process, and before robots of both series."""

import asyncio
import gzip
import json
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from driver_rig import HOST, emulator
from ros2_rig import Peer, free_domain, peer

from client.driver import DriverConfig
from client.ros2.dashboard import ROBOT_API_SERVICES, SERVICES, DashboardNode
from client.ros2.host import NodeHost
from emulator.lifecycle.safety import SafetyEvent
from tests.budget import subset
from urproto.dashboard import GREETING, encode_line
from urproto.modes import RobotMode, SafetyMode, SafetyStatus

SPEED = 10.0  # nobody here is a second late
PROGRAM = "while True:\n  sync()\nend\n"
TYPES = {row.name: row.type for row in (*SERVICES, *ROBOT_API_SERVICES)} | {"connect": "Trigger"}
INSTALLATION = (
    b'<Installation><TCPSettings activePose="TCP" toolPayload="0.5"><availablePoses>'
    b'<tcp name="TCP" offset="0, 0, 0.2, 0, 0, 0"/></availablePoses></TCPSettings></Installation>'
)
BOTH = pytest.mark.parametrize("model", subset(["ur3", "ur5e"], now=["ur3"]))


class Dashboard:
    """Calls services, and knows which."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.called: set[str] = set()

    async def __call__(self, name: str, **request: Any) -> dict[str, Any]:
        self.called.add(name)
        package = "std_srvs" if TYPES[name] == "Trigger" else "ur_dashboard_msgs"
        return await self._peer.call(f"/dashboard_client/{name}", f"{package}/srv/{TYPES[name]}", **request)

    async def well(self, name: str, **request: Any) -> dict[str, Any]:
        answer = await self(name, **request)
        assert answer["success"], answer
        return answer

    async def words(self, name: str, **request: Any) -> str:
        answer = await self.well(name, **request)
        return answer.get("message") or answer["answer"]

    async def refusal(self, name: str, **request: Any) -> str:
        answer = await self(name, **request)
        assert not answer["success"], answer
        return answer.get("message") or answer["answer"]

    async def parameter(self, name: str, kind: int, **value: Any) -> bool:
        """Whether it could be set."""
        wanted = {"name": name, "value": {"type": kind, **value}}
        service = "/dashboard_client/set_parameters"
        answer = await self._peer.call(service, "rcl_interfaces/srv/SetParameters", parameters=[wanted])
        return answer["results"][0]["successful"]


@asynccontextmanager
async def dashboard_of(ports: dict[str, int], *ros_arguments: str) -> AsyncIterator[Dashboard]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with free_domain() as domain:
        async with NodeHost(domain=domain, ros_arguments=ros_arguments) as host, peer(domain) as other:
            node = await asyncio.to_thread(DashboardNode, host, DriverConfig(host=HOST, robot_ports=ports))
            try:
                yield Dashboard(other)
            finally:
                await asyncio.to_thread(node.close)


@BOTH
async def test_every_service(model: str, tmp_path: Path) -> None:
    (tmp_path / "pick.script").write_text(PROGRAM)
    (tmp_path / "default.installation").write_bytes(gzip.compress(INSTALLATION))
    cb3 = model == "ur3"
    async with emulator(model, programs_dir=tmp_path, speed=SPEED) as robot, dashboard_of(robot.ports) as send_request:
        log = robot.controller.messages.history

        assert await send_request.words("power_off") == "Powering off"
        assert (await send_request.well("get_robot_mode"))["robot_mode"]["mode"] == RobotMode.POWER_OFF
        assert await send_request.words("power_on") == "Powering on"
        mode = await send_request.well("get_robot_mode")
        assert mode["robot_mode"]["mode"] == RobotMode.IDLE
        assert mode["answer"] == "Robotmode: IDLE"
        assert await send_request.words("brake_release") == "Brake releasing"
        assert (await send_request.well("get_robot_mode"))["robot_mode"]["mode"] == RobotMode.RUNNING
        assert (await send_request.well("get_safety_mode"))["safety_mode"]["mode"] == SafetyMode.NORMAL
        assert (await send_request.well("get_safety_status"))["safety_status"]["status"] == SafetyStatus.NORMAL

        assert "Failed to execute: play" in await send_request.refusal("play")
        unnamed = "No program loaded" if cb3 else "/programs/<unnamed>.urp"
        assert unnamed in await send_request.refusal("get_loaded_program")
        await send_request.refusal("program_saved")
        assert "File not found: lost.script" in await send_request.refusal("load_program", filename="lost.script")
        assert (await send_request.words("load_program", filename="pick.script")).startswith("Loading program: ")
        assert (await send_request.well("get_loaded_program"))["program_name"].endswith("pick.script")
        saved = await send_request.well("program_saved")
        assert saved["program_saved"]
        assert saved["program_name"] == "pick.script"
        state = await send_request.well("program_state")
        assert (state["state"]["state"], state["program_name"]) == ("STOPPED", "pick.script")
        assert await send_request.words("play") == "Starting program"
        assert (await send_request.well("program_running"))["program_running"]
        assert await send_request.words("pause") == "Pausing program"
        assert (await send_request.well("program_state"))["state"]["state"] == "PAUSED"
        assert await send_request.words("stop") == "Stopped"
        assert not (await send_request.well("program_running"))["program_running"]
        assert "Failed to execute: pause" in await send_request.refusal("pause")
        assert "lost.installation" in await send_request.refusal("load_installation", filename="lost.installation")
        words = await send_request.words("load_installation", filename="default.installation")
        assert words.startswith("Loading installation: ")
        assert robot.controller.installation.name == "default.installation"

        assert await send_request.words("popup", message="look here") == "showing popup"
        assert robot.controller.popups.shown
        assert await send_request.words("close_popup") == "closing popup"
        assert await send_request.words("close_safety_popup") == "closing safety popup"
        assert await send_request.words("add_to_log", message="noted") == "Added log message"
        assert any("noted" in line for line in log)
        assert "No log message to add" in await send_request.refusal("add_to_log", message="")
        assert "one line" in await send_request.refusal("add_to_log", message="one\ntwo")

        assert "UR" in (await send_request.well("get_robot_model"))["robot_model"]
        assert (await send_request.well("get_serial_number"))["serial_number"] > 0
        assert (await send_request.well("get_polyscope_version"))["version"]["major"] == (3 if cb3 else 5)
        assert (await send_request.well("generate_flight_report"))["report_id"]
        assert (await send_request.well("generate_support_file", dir_path="."))["generated_file_name"].endswith(".zip")
        assert (await send_request("raw_request", query="robotmode"))["answer"] == "Robotmode: RUNNING"
        assert "could not understand" in (await send_request("raw_request", query="dance"))["answer"]

        if cb3:
            for role in ("PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED"):
                await send_request.well("set_user_role", user_role={"role": role})
                assert (await send_request.well("get_user_role"))["user_role"]["role"] == role
            assert "KING" in await send_request.refusal("set_user_role", user_role={"role": "KING"})
            for name in ("is_in_remote_control", "get_operational_mode", "clear_operational_mode"):
                assert "e-Series since" in await send_request.refusal(name)
            assert "e-Series" in await send_request.refusal("set_operational_mode", operational_mode={"mode": "MANUAL"})
        else:
            for remote in (False, True):
                robot.controller.remote_control = remote
                assert (await send_request.well("is_in_remote_control"))["remote_control"] == remote
            for mode in ("MANUAL", "AUTOMATIC"):
                await send_request.well("set_operational_mode", operational_mode={"mode": mode})
                assert (await send_request.well("get_operational_mode"))["operational_mode"]["mode"] == mode
            await send_request.refusal("set_operational_mode", operational_mode={"mode": "NONE"})
            await send_request.well("clear_operational_mode")
            assert "CB3 since" in await send_request.refusal("get_user_role")
            assert "CB3 since" in await send_request.refusal("set_user_role", user_role={"role": "NONE"})
        for service in ROBOT_API_SERVICES:
            assert f"'{service.name}': this robot has no Robot API" in await send_request.refusal(service.name)

        robot.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
        assert (await send_request.well("get_safety_mode"))["safety_mode"]["mode"] == SafetyMode.PROTECTIVE_STOP
        assert "until 5s after" in await send_request.refusal("unlock_protective_stop")
        while not robot.controller.safety.may_unlock_remotely:
            await asyncio.sleep(0.01)
        assert await send_request.words("unlock_protective_stop") == "Protective stop releasing"
        robot.controller.safety_event(SafetyEvent.VIOLATION)
        assert "Failed to execute: power on" in await send_request.refusal("power_on")
        assert await send_request.words("restart_safety") == "Restarting safety"
        assert (await send_request.well("get_safety_mode"))["safety_mode"]["mode"] == SafetyMode.NORMAL

        assert "connected already" in await send_request.refusal("connect")
        assert await send_request.words("quit") == "Disconnected"
        assert "~/connect" in await send_request.refusal("get_robot_mode")
        await send_request.well("connect")
        assert await send_request.words("shutdown") == "Shutting down"
        assert robot.controller.shutdown_requested
        assert send_request.called == set(TYPES)


async def test_programs_on_polyscope_x(tmp_path: Path) -> None:
    """Stored, listed, replaced, fetched and resumed through the Robot API; the file is the emulator's own."""
    file = resources.files("emulator.programs.polyscope_x") / "default.urpx"
    path, copy = tmp_path / "a.urpx", tmp_path / "copy.urpx"
    path.write_bytes(file.read_bytes().replace(b"Default program", b"pick"))
    async with (
        emulator("ur5e", version="10.12.0", speed=SPEED) as robot,
        dashboard_of({"dashboard": 0, **robot.ports}) as send_request,
    ):
        stored = await send_request.well("upload_program", file_path=str(path))
        assert stored["answer"] == f"{stored['program_name']} is stored"
        listed = await send_request.well("get_programs")
        assert stored["program_name"] in [program["name"] for program in listed["programs"]]
        await send_request.refusal("upload_program", file_path=str(path))
        await send_request.well("update_program", file_path=str(path))
        await send_request.well("download_program", program_name=stored["program_name"], target_path=str(copy))
        assert json.loads(copy.read_bytes())["program"]
        assert "no-such" in await send_request.refusal("upload_program", file_path=str(tmp_path / "no-such"))
        assert "no/folder" in await send_request.refusal(
            "download_program", program_name=stored["program_name"], target_path=str(tmp_path / "no/folder/x")
        )
        await send_request.refusal("resume")


async def test_a_robot_that_goes_and_comes_back(tmp_path: Path) -> None:
    """Nobody has to connect again, and a robot that is away is said to be."""
    async with emulator("ur5e", speed=SPEED) as robot, dashboard_of(robot.ports) as send_request:
        await send_request.well("get_robot_mode")
        assert (await send_request("raw_request", query="quit"))[
            "answer"
        ] == "Disconnected"  # the robot ends the connection
        await send_request.well("get_robot_mode")
        await robot.__aexit__(None, None, None)
        assert "no connection to" in await send_request.refusal("get_robot_mode")
        assert "no connection to" in await send_request.refusal("connect")


async def test_parameters() -> None:
    """Only the patience can be changed; without autoconnect a connection is asked for."""
    with socket.create_server((HOST, 0)) as silent:
        port = silent.getsockname()[1]
        async with dashboard_of(
            {"primary": port, "rtde": port, "dashboard": port}, "-p", "autoconnect:=false"
        ) as send_request:
            assert "~/connect" in await send_request.refusal("play")
            assert not await send_request.parameter("robot_ip", 4, string_value="10.0.0.1")
            assert not await send_request.parameter("receive_timeout", 3, double_value=-1.0)
            assert await send_request.parameter("receive_timeout", 3, double_value=0.1)
            silent.setblocking(True)
            answer = asyncio.create_task(send_request("connect"))
            connection, _ = await asyncio.to_thread(silent.accept)
            with connection:
                connection.sendall(encode_line(GREETING))
                assert (await answer)["success"]
                assert "for 0.1 s" in await send_request.refusal("play")
