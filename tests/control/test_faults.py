"""Faults over HTTP and on the command line, and a client that copes with them."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from client.rtde import RTDEClient
from emulator import ctl
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.controlapi import BadArguments, NotPossible, RemoteControl
from urproto.robots import load_model

HOST = "127.0.0.1"


@pytest.fixture
async def emulator() -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model("ur3"), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as running:
        yield running


async def run_in_thread(work: Callable[[], Any]) -> Any:
    """Do blocking work while the emulator continues."""
    return await asyncio.to_thread(work)


async def test_faults_over_http(emulator: Emulator) -> None:
    def use() -> list[dict[str, Any]]:
        robot = RemoteControl(HOST, emulator.ports["control"])
        try:
            first = robot.inject_fault("stall", port="rtde")
            robot.inject_fault("delay", delay_s=0.01, port="dashboard", after=1000)
            with pytest.raises(BadArguments, match="delay_s"):
                robot.inject_fault("delay")
            with pytest.raises(BadArguments, match="unknown fault"):
                robot.inject_fault("explosion", port="rtde")
            with pytest.raises(NotPossible, match="has no port"):
                robot.inject_fault("stall", port="tool line")
            with pytest.raises(NotPossible, match="ideal"):
                robot.inject_fault("lost_brake", joint=1)
            assert {"delay", "power_loss"} <= {kind["kind"] for kind in robot.fault_kinds()}
            robot.clear_fault(first)
            robot.clear_faults()
            return robot.faults()
        finally:
            robot.close()

    faults = await run_in_thread(use)
    assert [(fault["id"], fault["kind"], fault["state"]) for fault in faults] == [
        (1, "stall", "over"),
        (2, "delay", "over"),
    ]
    assert faults[1]["arguments"] == {"port": "dashboard", "delay_s": 0.01, "after": 1000}


async def test_the_control_api_outlives_the_controller(emulator: Emulator) -> None:
    def use() -> float:
        robot = RemoteControl(HOST, emulator.ports["control"])
        try:
            robot.inject_fault("restart_controller", outage_s=0.2, boot_s=0.2)
            robot.run_until("robot_mode == NO_CONTROLLER")
            robot.run_until("robot_mode == BOOTING")
            robot.run_until("robot_mode == POWER_OFF")
            robot.release_brakes()
            return robot.run_until("robot_mode == RUNNING")
        finally:
            robot.close()

    assert await run_in_thread(use) < 20.0
    assert all(server.listening for server in emulator.servers.values())


async def test_faults_on_the_command_line(emulator: Emulator) -> None:
    async def run(*words: str) -> tuple[int, str]:
        place = ["--port", str(emulator.ports["control"])]
        result = await run_in_thread(lambda: CliRunner().invoke(ctl.app, [*place, *words], env={"COLUMNS": "200"}))
        return result.exit_code, result.output

    assert await run("inject_fault", "drop_connection", "port=rtde", "probability=0.5", "peer=127.0.0.9") == (0, "1\n")
    assert await run("inject-fault", "stale_data", "after=100") == (0, "2\n")
    status, output = await run("faults")
    assert status == 0
    assert json.loads(output)[0]["arguments"] == {"port": "rtde", "probability": 0.5, "peer": "127.0.0.9"}
    assert await run("clear_fault", "1") == (0, "")
    status, output = await run("clear_fault", "1")
    assert (status, "no fault 1" in output) == (1, True)
    status, output = await run("inject_fault", "drop_connection", "wen=7")
    assert (status, "has no argument wen" in output, output.count("\n")) == (2, True, 1)
    status, output = await run()
    assert "inject_fault kind [name=value ...]" in output


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("drop_connection", {}),
        ("drop_connection", {"how": "end"}),
        ("restart_port", {"outage_s": 0.3}),
        ("restart_controller", {"outage_s": 0.3, "boot_s": 0.0}),
    ],
)
async def test_our_client_reconnects(emulator: Emulator, kind: str, arguments: dict[str, object]) -> None:
    rtde = RTDEClient(HOST, ["timestamp", "robot_mode"], port=emulator.ports["rtde"], reconnect_s=20.0)
    async with rtde:
        await rtde.receive()
        if kind != "restart_controller":
            arguments = {"port": "rtde", **arguments}
        emulator.control.inject_fault(kind, **arguments)
        async with timeout(20):
            while not rtde.core.reconnects:
                await rtde.receive()
            await rtde.receive()
    assert rtde.core.reconnects == 1
