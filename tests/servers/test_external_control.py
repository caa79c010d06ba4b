"""A program with an External Control node and its driver, over real connections."""

import asyncio
import gzip
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from emulator.app import Emulator
from emulator.commands.requests import DashboardLine
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.services.sockets import ScriptNetwork
from emulator.services.urcap import DriverAddress
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.robots import load_model

HOST = "127.0.0.1"
URP = (
    '<URProgram name="drive"><children><MainProgram runOnlyOnce="true"><children>'
    '<Contributed strategyURCapName="External Control"><dataModel/></Contributed>'
    "</children></MainProgram></children></URProgram>"
)
# as long as the official one, so that it arrives in several pieces
PROGRAM = "# HEADER_BEGIN\n" + "# a line of the header\n" * 3000 + "# HEADER_END\n" + 'textmsg("driven")\nsync()\n'


class Driver:
    """Answers requests like the official library: the connection stays open."""

    def __init__(self) -> None:
        self.port = 0
        self.requests: list[bytes] = []
        self.ends = 0
        self._writers: list[asyncio.StreamWriter] = []

    async def __aenter__(self) -> "Driver":
        self._server = await asyncio.start_server(self._serve, HOST, 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for writer in self._writers:
            writer.transport.abort()
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        while request := await reader.readline():
            self.requests.append(request)
            writer.write(PROGRAM.encode())
        self.ends += 1


@pytest.fixture
async def driver() -> AsyncIterator[Driver]:
    async with Driver() as driver:
        yield driver


def emulator(folder: Path | None, port: int, network: ScriptNetwork = ScriptNetwork.ANY) -> Emulator:
    if folder is not None:
        (folder / "drive.urp").write_bytes(gzip.compress(URP.encode()))
    controller = ControllerConfig(
        model=load_model("ur5e"), running=True, programs_dir=folder, external_control=DriverAddress(HOST, port)
    )
    return Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, script_network=network))


async def send_request(emulator: Emulator, line: str) -> str:
    answer: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    emulator.controller.post(DashboardLine(line), answer.set_result)
    return await asyncio.wait_for(answer, 20)


async def test_a_driver_is_requested_and_its_program_runs(tmp_path: Path, driver: Driver) -> None:
    async with emulator(tmp_path, driver.port) as robot:
        await send_request(robot, "load drive.urp")
        assert await send_request(robot, "play") == "Starting program"
        async with timeout(20):
            while robot.controller.programs.state is not RuntimeState.STOPPED or driver.ends == 0:
                await asyncio.sleep(0.005)
        assert driver.requests == [b"request_program\n"]
        assert any("driven" in line for line in robot.controller.messages.history)


async def test_a_robot_without_programs_has_the_external_control_program(driver: Driver) -> None:
    async with emulator(None, driver.port) as robot:
        loaded = await send_request(robot, "load external_control.urp")
        assert loaded.startswith("Loading program: /programs/external_control.urp,")
        assert await send_request(robot, "get loaded program") == "Loaded program: /programs/external_control.urp"
        assert await send_request(robot, "play") == "Starting program"
        async with timeout(20):
            while not any("driven" in line for line in robot.controller.messages.history):
                await asyncio.sleep(0.005)
        assert robot.controller.programs.state is RuntimeState.PLAYING  # it starts again
        assert (await send_request(robot, "load loading.py")).startswith("File not found")


async def test_a_closed_driver_port(tmp_path: Path) -> None:
    with socket.socket() as bound:
        bound.bind((HOST, 0))
        port = bound.getsockname()[1]
        async with emulator(tmp_path, port) as robot:
            await send_request(robot, "load drive.urp")
            assert await send_request(robot, "play") == "Starting program"
            text = await popup(robot)
    assert (
        text == f"The connection to the remote PC at {HOST}:{port} could not be established. Reason: Connection refused"
    )


async def test_script_network_restrictions_apply_to_external_control(tmp_path: Path, driver: Driver) -> None:
    async with emulator(tmp_path, driver.port, ScriptNetwork.NONE) as robot:
        await send_request(robot, "load drive.urp")
        await send_request(robot, "play")
        assert "the script network is none" in await popup(robot)
    assert driver.requests == []


async def popup(robot: Emulator) -> str:
    async with timeout(20):
        while not robot.controller.popups.shown:
            await asyncio.sleep(0.005)
    return robot.controller.popups.shown[0].text
