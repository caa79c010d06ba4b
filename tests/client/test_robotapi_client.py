"""The Robot API's clients, and the dashboard's verbs over it, against an emulator and against what is none."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from client import AsyncRobot, dashboard, robotapi
from client.dashboard import BlockingDashboardClient, DashboardClient
from client.errors import RobotUnreachableError
from client.robotapi import BlockingRobotAPIClient, RobotAPIClient
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from tests.robotapi.rig import empty_urpx
from urproto.dashboard import ProgramState
from urproto.errors import RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

HOST = "127.0.0.1"
ANSWER = "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {length}\r\n{more}\r\n"


def emulated(version: str, programs: Path, **options: Any) -> Emulator:
    options = {"remote_control": True, **options}
    controller = ControllerConfig(
        model=load_model("ur5e"), version=PolyscopeVersion.parse(version), programs_dir=programs, **options
    )
    return Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True))


@pytest.fixture
async def robot(tmp_path: Path) -> AsyncIterator[Emulator]:
    async with emulated("10.12", tmp_path) as running:
        yield running


def no_port() -> int:
    with socket.create_server((HOST, 0)) as taken:
        return int(taken.getsockname()[1])


async def test_every_request(robot: Emulator) -> None:
    async with RobotAPIClient(HOST, robot.ports["robot api"]) as api:
        assert api.core.version == (3, 1, 4)
        await api.request(robotapi.POWER_ON)
        assert await api.request(robotapi.ROBOT_MODE) is RobotMode.IDLE
        await api.request(robotapi.BRAKE_RELEASE)
        assert await api.request(robotapi.SAFETY_MODE) is SafetyMode.NORMAL
        assert await api.request(robotapi.IS_IN_REMOTE_CONTROL)
        assert (await api.request(robotapi.OPERATIONAL_MODE)).name == "AUTOMATIC"
        file = empty_urpx("a job")
        assert await api.request(robotapi.upload(file)) == "a job"
        assert await api.request(robotapi.upload(file, replace=True)) == "a job"
        assert await api.request(robotapi.download("a job")) == file
        assert [each.name for each in await api.request(robotapi.PROGRAMS)] == ["Default program", "a job"]
        await api.request(robotapi.load("a job"))
        assert await api.request(robotapi.LOADED_PROGRAM) == "a job"
        await api.request(robotapi.PLAY)
        await api.request(robotapi.STOP)
        assert await api.request(robotapi.PROGRAM_STATE) is ProgramState.STOPPED
        with pytest.raises(RobotRefused, match="the program 'a job' exists already"):
            await api.request(robotapi.upload(file))
        with pytest.raises(RobotRefused, match="not a PolyScope X program"):
            await api.request(robotapi.upload(b"?"))
        with pytest.raises(RobotRefused, match="no paused program"):
            await api.request(robotapi.RESUME)


async def test_an_older_api_gets_requests_of_its_version(tmp_path: Path) -> None:
    (tmp_path / "job.urpx").write_bytes(empty_urpx("job"))
    async with (
        emulated("10.11", tmp_path) as robot,
        RobotAPIClient(HOST, robot.ports["robot api"]) as api,
    ):
        await api.request(robotapi.load("job"))
        assert robot.controller.programs.loaded.name == "job"  # type: ignore[union-attr]
        with pytest.raises(RobotRefused, match=r"Robot API 3\.0\.0 does not have it - it needs 3\.1\.4"):
            await api.request(robotapi.ROBOT_MODE)


async def test_local_control(tmp_path: Path) -> None:
    async with (
        emulated("10.12", tmp_path, remote_control=False, enforce_remote_control=True) as robot,
        RobotAPIClient(HOST, robot.ports["robot api"]) as api,
    ):
        with pytest.raises(RobotRefused, match=r"local control: .* - switch the robot to Remote Control"):
            await api.request(robotapi.POWER_ON)


async def test_the_dashboards_verbs_on_polyscope_x(robot: Emulator) -> None:
    async with DashboardClient(HOST, no_port(), robot_api_port=robot.ports["robot api"]) as board:
        assert await board.request(dashboard.IS_RUNNING) is False
        await board.request(dashboard.BRAKE_RELEASE)
        assert await board.request(dashboard.ROBOT_MODE) is RobotMode.RUNNING
        assert await board.request(dashboard.load("/programs/Default program.urpx")) == "Default program"
        assert await board.request(dashboard.PROGRAM_STATE) == (ProgramState.STOPPED, "Default program")
        await board.request(dashboard.PLAY)
        await board.request(dashboard.STOP)
        assert await board.request(dashboard.IS_IN_REMOTE_CONTROL)
        for lacking in (dashboard.CLOSE_POPUP, dashboard.SERIAL_NUMBER, dashboard.SAFETY_STATUS):
            with pytest.raises(RobotRefused, match="Robot API of PolyScope X does not have it"):
                await board.request(lacking)


async def test_a_robot_is_made_ready_as_any_other(robot: Emulator) -> None:
    ports = {**robot.ports, "dashboard": no_port()}
    async with AsyncRobot(HOST, robot_ports=ports) as arm:
        await arm.make_ready()
        assert arm.state.robot_mode is RobotMode.RUNNING


def test_what_is_no_robot_api_is_no_robot(serve: Callable[..., int]) -> None:
    def other(connection: socket.socket) -> None:
        connection.recv(4096)
        connection.sendall(ANSWER.format(status="200 OK", length=2, more="").encode() + b"{}")

    port, missing = serve(other), no_port()
    with pytest.raises(RemoteProtocolError, match="this is not a Robot API"), BlockingRobotAPIClient(HOST, port):
        pass
    with (
        pytest.raises(RobotUnreachableError, match=f"{missing}"),  # what was asked for, and not what was tried instead
        BlockingDashboardClient(HOST, missing, robot_api_port=port),
    ):
        pass

    def another(connection: socket.socket) -> None:
        connection.recv(4096)
        connection.sendall(b"SSH-2.0 hello\r\n\r\n")

    garbage = serve(another)
    with (
        pytest.raises(RemoteProtocolError, match="not answer like a web server"),
        BlockingRobotAPIClient(HOST, garbage),
    ):
        pass


def test_redirects_are_followed_and_answers_without_length_read(serve: Callable[..., int]) -> None:
    requested = list[str]()

    def moved(connection: socket.socket) -> None:
        path = connection.recv(4096).decode().split(" ")[1]
        requested.append(path.rpartition("/")[2])
        content = json.dumps({"info": {"version": "3.1.4"}, "mode": "IDLE"}).encode()
        if path.endswith("robotmode"):
            more = "Location: http://robot/new/place\r\n"
            connection.sendall(ANSWER.format(status="307 Temporary Redirect", length=0, more=more).encode())
        elif path.endswith("openapi.json"):
            connection.sendall(ANSWER.format(status="200 OK", length=len(content), more="").encode() + content)
        else:
            connection.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + content)  # until the end

    with BlockingRobotAPIClient(HOST, serve(moved)) as api:
        assert api.request(robotapi.ROBOT_MODE) is RobotMode.IDLE
    assert requested == ["openapi.json", "robotmode", "place"]


async def test_requests_wait_for_those_before(robot: Emulator) -> None:
    async with RobotAPIClient(HOST, robot.ports["robot api"]) as api:
        modes = await asyncio.gather(*(api.request(robotapi.ROBOT_MODE) for _ in range(5)))
    assert set(modes) == {RobotMode.POWER_OFF}
