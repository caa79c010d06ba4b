"""Robots that do harm, against everything a client offers: what they cause is an error that explains itself.

HOSTILE_ROBOTS=3000 (``make soak``) meets so many of them, a seed each; HOSTILE_SEED begins with another one.
"""

import asyncio
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, Final

import pytest
from typer.testing import CliRunner

from client import AsyncRobot, Robot, dashboard
from client.cli import app
from client.commands.following import follow
from client.connection import Connection
from client.controllers import RTDE_OUTPUTS, ControlLoop
from client.dashboard import BlockingDashboardClient, DashboardClient
from client.driver import BlockingURDriver, URDriver, points
from client.errors import ClientError
from client.modbus import BlockingModbusClient
from client.primary import POWER_ON, BlockingPrimaryClient, PrimaryClient
from client.realtime import BlockingRealtimeClient
from client.recording import DEFAULT_FIELDS, Recorder, read
from client.rtde import BlockingRTDEClient, RTDEClient
from client.tool_communication import ToolCommunication
from client.traffic.proxy import Proxy, Route
from client.traffic.recording import TrafficRecorder, TrafficRecording
from client.traffic.replay import ReplayRobot
from tests.hostile import KINDS, HostileRobot
from urproto.errors import RobotRefused, URError
from urproto.ports import CONTROLLER_PORTS

ROBOTS: Final = int(os.environ.get("HOSTILE_ROBOTS", "30"))
SEED: Final = int(os.environ.get("HOSTILE_SEED", "1"))
PATIENCE_S: Final = 0.4
LONGEST_S: Final = 60.0  # a client that is told nothing useful gives up; the machine may be busy
EXPLAINED: Final = URError
FREE_PORTS: Final = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
SCRIPT: Final = "def p():\n  textmsg(1)\n  sleep(0.02)\nend\n"

Entry = Callable[[HostileRobot, Path], object]


@pytest.fixture(scope="module")
def hostile() -> Iterator[HostileRobot]:
    with HostileRobot() as robot:
        yield robot


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clients that wait for some tenths of a second instead of some seconds, and commands that try once."""
    usual = Connection.__init__

    def hasty(self: Connection, host: str, port: int, timeout_s: float = PATIENCE_S) -> None:
        usual(self, host, port, min(timeout_s, PATIENCE_S))

    def give_up(robot: object) -> None:
        raise KeyboardInterrupt

    def briefly(robot: Any, sinks: Any, interrupts: Any, duration_s: float | None = 0.1) -> None:
        follow(robot, sinks, interrupts, duration_s)

    monkeypatch.setattr("client.commands.robot.follow", briefly)
    monkeypatch.setattr(Connection, "__init__", hasty)
    monkeypatch.setattr("client.commands.following._reconnect", give_up)
    monkeypatch.setattr("client.doctor._STREAM_S", 0.2)


def rtde(robot: HostileRobot, folder: Path) -> None:
    outputs = [*DEFAULT_FIELDS, "joint_mode"]
    with BlockingRTDEClient(robot.host, outputs, [["input_int_register_24"]], reconnect_s=0.1) as client:
        for _ in range(20):
            client.receive()
            client.latest()
            client.write(input_int_register_24=1)
        client.pause()
        client.resume()


def rtde_async(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with RTDEClient(robot.host, DEFAULT_FIELDS) as client:
            for _ in range(20):
                await client.receive()
                await client.latest()

    asyncio.run(use())


def primary(robot: HostileRobot, folder: Path) -> None:
    with BlockingPrimaryClient(robot.host) as client:
        for flow in (client.core.robot_state, client.core.polyscope_version, client.core.kinematics_info):
            client.run(flow())
        client.run(client.core.command(replace(POWER_ON, timeout_s=PATIENCE_S)))
        client.run(client.core.execute(SCRIPT, start_timeout_s=2.0, timeout_s=PATIENCE_S))
        repr([client.core.errors, client.core.texts, client.core.dialogues])


def primary_async(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with PrimaryClient(robot.host) as client:
            await client.run(client.core.configuration_data())
            await client.run(client.core.execute(SCRIPT, start_timeout_s=2.0, timeout_s=PATIENCE_S))

    asyncio.run(use())


def realtime(robot: HostileRobot, folder: Path) -> None:
    with BlockingRealtimeClient(robot.host) as client:
        for _ in range(10):
            client.receive()


QUESTIONS: Final = (dashboard.ROBOT_MODE, dashboard.SAFETY_MODE, dashboard.POLYSCOPE_VERSION, dashboard.PROGRAM_STATE,
                    dashboard.IS_RUNNING, dashboard.SERIAL_NUMBER, dashboard.load("none.urp"))  # fmt: skip


def board(robot: HostileRobot, folder: Path) -> None:
    with BlockingDashboardClient(robot.host) as client:
        for question in QUESTIONS:
            with suppress(RobotRefused):
                client.request(question)


def board_async(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with DashboardClient(robot.host) as client:
            for question in QUESTIONS:
                with suppress(RobotRefused):
                    await client.request(question)

    asyncio.run(use())


def modbus(robot: HostileRobot, folder: Path) -> None:
    with BlockingModbusClient(robot.host, robot.modbus_port) as client:
        client.write_register(128, 7)
        client.read_registers(128, 16)
        client.write_coil(16, True)
        client.read_coils(0, 8)


def facade(robot: HostileRobot, folder: Path) -> None:
    with Robot(robot.host, silence_s=PATIENCE_S, start_timeout_s=2.0) as arm:
        repr([arm.q, arm.tcp_pose, arm.state.robot_mode, arm.state.safety_mode, arm.state.runtime_state, arm.moving])
        arm.digital_in(0)
        arm.set_digital_out(0, True)
        arm.set_speed_slider(0.5)
        q = list(arm.q)
        arm.move_j([q[0] + 0.02, *q[1:]], wait=False)
        arm.wait_done(2.0)


def facade_async(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with AsyncRobot(robot.host, silence_s=PATIENCE_S, start_timeout_s=2.0) as arm:
            with Recorder(folder / "run.mcap", arm.state.values) as recorder:
                arm.driver.link.on_state.append(recorder.write)
                try:
                    await arm.speed_j([0.01, 0, 0, 0, 0, 0], 0.1)
                finally:
                    arm.driver.link.on_state.remove(recorder.write)

    asyncio.run(use())


def driver(robot: HostileRobot, folder: Path) -> None:
    with BlockingURDriver(robot.host, silence_s=PATIENCE_S, start_timeout_s=2.0, **FREE_PORTS) as arm:
        arm.start_program()
        arm.execute([points.movej([0.01, -1.5, 0.1, 0.0, 0.0, 0.0], v=0.1)], PATIENCE_S)


def driver_async(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with URDriver(robot.host, silence_s=PATIENCE_S, start_timeout_s=2.0, **FREE_PORTS) as arm:
            await arm.start_program()
            await arm.next_state()
            await arm.stop_program()

    asyncio.run(use())


def control_loop(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        async with (
            URDriver(robot.host, outputs=RTDE_OUTPUTS, silence_s=PATIENCE_S, start_timeout_s=2.0, **FREE_PORTS) as arm,
            ControlLoop(arm) as loop,
        ):
            loop.manager.activate("scaled_joint_trajectory_controller")
            await asyncio.sleep(0.1)

    asyncio.run(use())


def tool_line(robot: HostileRobot, folder: Path) -> None:
    async def use() -> None:
        device = folder / "tty"
        async with ToolCommunication(robot.host, device=device) as line:
            running = asyncio.create_task(line.run())
            near = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                for _ in range(20):
                    os.write(near, b"hello")
                    await asyncio.sleep(0.005)
                    with suppress(BlockingIOError):
                        os.read(near, 4096)
            finally:
                os.close(near)
                running.cancel()
                await asyncio.gather(running, return_exceptions=True)

    asyncio.run(use())


def recorded_and_replayed(robot: HostileRobot, folder: Path) -> None:
    """A client through a proxy that records, and then before what the recording makes of the robot."""
    names = ("rtde", "dashboard", "primary")
    routes = [Route(n, CONTROLLER_PORTS[n], "127.0.0.1", 0, robot.host, CONTROLLER_PORTS[n]) for n in names]

    def watch(host: str, port: int) -> None:
        with suppress(EXPLAINED), BlockingRTDEClient(host, DEFAULT_FIELDS, port=port) as client:
            for _ in range(10):
                client.receive()

    async def use() -> None:
        recorder = TrafficRecorder(folder / "traffic.pcapng", ["hostile"])
        try:
            async with Proxy(routes, recorder) as proxy:
                await asyncio.to_thread(watch, "127.0.0.1", proxy.ports["rtde"])
        finally:
            recorder.close()
        recording = TrafficRecording.read(folder / "traffic.pcapng")
        async with ReplayRobot(recording, "127.0.0.1", speed=100.0, free_ports=True) as again:
            if "rtde" in again.ports:
                await asyncio.to_thread(watch, "127.0.0.1", again.ports["rtde"])

    asyncio.run(use())


def command(*words: str) -> Entry:
    def invoke(robot: HostileRobot, folder: Path) -> None:
        placed = [word.replace("FOLDER", str(folder)) for word in words]
        done = CliRunner().invoke(app, placed, env={"UR_ROBOT_IP": robot.host})
        assert "Traceback" not in done.output
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception

    invoke.__name__ = f"command_{words[0]}"
    return invoke


def record(robot: HostileRobot, folder: Path) -> None:
    command("record", "FOLDER/run.csv", "--duration", "0.1")(robot, folder)
    with suppress(ClientError):
        read(folder / "run.csv")


ENTRIES: Final[tuple[Entry, ...]] = (
    facade, driver, rtde, primary, board, facade_async, record, realtime, modbus, driver_async, rtde_async,
    primary_async, board_async, command("state"), command("state", "--json"), command("dashboard", "robotmode"),
    command("watch", "actual_q", "robot_mode", "timestamp", "--csv", "FOLDER/watched.csv"),
    command("doctor"), command("doctor", "--json"), command("calibration", "-o", "FOLDER/calibration.yaml"),
    command("describe"), command("send", "FOLDER/p.script"), command("send", "FOLDER/p.script", "--wait"),
    command("record", "FOLDER/run.mcap", "--duration", "0.1"), command("record", "FOLDER/run.npz", "--duration", "0.1"),
    control_loop, tool_line, recorded_and_replayed, command("controllers", "interfaces"),
    command("goal", "0.1,-1.5,0.1,0,0,0", "--duration", "0.5", "--yes"),
)  # fmt: skip


def test_nothing_a_robot_does_is_more_than_an_error(hostile: HostileRobot, tmp_path: Path, caplog: Any) -> None:
    failures = []
    for seed in range(SEED, SEED + ROBOTS):
        random = Random(seed)
        entry = ENTRIES[(seed - SEED) % len(ENTRIES)]
        kinds = (random.choice(KINDS), "honest", "honest", random.choice(KINDS))
        if random.random() < 0.5:
            kinds = kinds[::-1]
        folder = tmp_path / str(seed)
        folder.mkdir()
        (folder / "p.script").write_text(SCRIPT)
        hostile.begin(kinds, seed)
        caplog.clear()
        began = time.monotonic()
        what = f"seed {seed}, {entry.__name__}, {', '.join(kinds)}"
        try:
            entry(hostile, folder)
        except EXPLAINED as error:
            if len(str(error)) < 20 or "\n" in str(error):
                failures.append(f"{what}: explains nothing: {error!r}")
        except Exception as error:
            logging.getLogger("test").info("%s", what, exc_info=True)
            failures.append(f"{what}: {error!r} at {_place(error)}")
        if (took := time.monotonic() - began) > LONGEST_S:
            failures.append(f"{what}: took {took:.0f} s")
        for entry_of_log in caplog.records:
            if entry_of_log.exc_info and entry_of_log.name.startswith(("client", "asyncio")):
                failures.append(
                    f"{what}: a traceback in the log: {entry_of_log.getMessage()} {entry_of_log.exc_info[1]!r}"
                )
    assert not failures, "\n".join(failures)


def _place(error: BaseException) -> str:
    trace = error.__traceback__
    places = []
    while trace is not None:
        places.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
        trace = trace.tb_next
    return " > ".join(places[-5:])
