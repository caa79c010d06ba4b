"""The suite itself: it accesses a robot only through the client."""

import ast
import asyncio
import subprocess
import sys
from pathlib import Path

import pytest

from client import DashboardClient, PrimaryClient, RealtimeClient, RTDEClient, dashboard


def test_no_case_imports_the_emulator():
    for path in Path(__file__).parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        modules = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
        modules |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        assert not {name for name in modules if name and name.split(".")[0] in ("emulator", "urscript")}, path.name


def test_without_the_flag_nothing_moves():
    """Every case that moves is skipped before it connects: this address is unused (RFC 5737)."""
    folder = Path(__file__).parent
    options = ["--robot-ip", "192.0.2.1", "-m", "moves", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    command = [sys.executable, "-m", "pytest", str(folder), *options]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder.parents[1])
    assert result.returncode == 0, result.stdout
    summary = result.stdout.splitlines()[-1]
    assert "skipped" in summary
    assert not any(word in summary for word in ("passed", "failed", "error"))


@pytest.mark.moves
async def test_all_clients_in_one_event_loop(robot):
    """The same sequences with the asynchronous clients."""
    async with (
        DashboardClient(robot.host) as client,
        PrimaryClient(robot.host) as primary,
        RealtimeClient(robot.host) as realtime,
        RTDEClient(robot.host, ["timestamp", "robot_mode"], [["input_int_register_29"]]) as rtde,
    ):
        mode, state, seen, rtde_state, _ = await asyncio.gather(
            client.request(dashboard.ROBOT_MODE),
            primary.run(primary.core.robot_state()),
            realtime.receive(),
            rtde.latest(),
            rtde.write(input_int_register_29=3),
        )
        assert mode == state.mode.robot_mode == seen["robot_mode"] == rtde_state["robot_mode"]
        await rtde.pause()
        await rtde.resume()
        await rtde.reconnect()
        assert (await rtde.receive())["timestamp"] > rtde_state["timestamp"]
