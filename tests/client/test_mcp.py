"""The MCP server, driven by the official SDK's client: what may be read and moved, and which addresses are reached."""

import asyncio
import json
import os
import random
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcp import Client, StdioServerParameters

from client.mcp import Consent, Tools, make_server
from client.mcp.tools import CHANGING, READING
from tests.budget import examples
from urproto.addresses import is_loopback
from urproto.testing.process import EmulatorProcess

if sys.platform != "linux":  # emulators have addresses of their own there
    pytest.skip("the loopback addresses are those of Linux", allow_module_level=True)

ROOT = Path(__file__).parents[2]
NAMES = [tool.__name__ for tool in READING]
EMULATOR = "an emulator: nothing real moves"
ADDRESSES = (
    "", "10.1.2.3", "192.168.56.101", "example.com", "127.0.0.1.example.com", "::ffff:10.0.0.1", "[::1]", "0.0.0.0",
    "127.0.0.1@10.0.0.1", "127.0.0.1\n10.0.0.1", " 127.0.0.1", "0x0a000001", "167772161", "localhost.",
    "127.0.0.1/../10.0.0.1",
)  # fmt: skip
PROGRAM = 'def part():\n  movej([0, -1.4, 1.5, -1.7, -1.5, 0])\n  textmsg("done")\nend\n'


@pytest.fixture(scope="module")
def robot() -> Iterator[EmulatorProcess]:
    with EmulatorProcess(["--running", "--script-network", "loopback", "--speed", "3"]) as robot:
        yield robot


@pytest.fixture
def reached(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Hosts that a socket of this process was connected to, or whose name was resolved."""
    hosts: list[str] = []
    connect, resolve = socket.socket.connect, socket.getaddrinfo

    def connecting(self: socket.socket, address: Any) -> None:
        hosts.append(host := str(address[0]) if isinstance(address, tuple) else "127.0.0.1")
        if not is_loopback(host):
            raise OSError(f"{host} is not to be reached")
        connect(self, address)

    def resolving(host: Any, *values: Any, **named: Any) -> Any:
        hosts.append(str(host))
        if not is_loopback(str(host)):
            raise OSError(f"{host} is not to be resolved")
        return resolve(host, *values, **named)

    monkeypatch.setattr(socket.socket, "connect", connecting)
    monkeypatch.setattr(socket, "getaddrinfo", resolving)
    return hosts


def serve(host: str, *, motion: bool, addresses: tuple[str, ...] = ()) -> Any:
    consent = Consent(frozenset(addresses), motion)
    return make_server(Tools(consent, host), consent, "1.0")


async def answer(client: Client, tool: str, **arguments: Any) -> dict[str, Any]:
    result = await client.call_tool(tool, arguments)
    assert not result.is_error, result.content
    found = json.loads(result.content[0].text)
    assert isinstance(found, dict)
    return found


async def refusal(client: Client, tool: str, **arguments: Any) -> str:
    result = await client.call_tool(tool, arguments)
    assert result.is_error, result.content
    return str(result.content[0].text)


async def test_over_standard_input_and_output(robot: EmulatorProcess) -> None:
    command = StdioServerParameters(
        command=sys.executable,
        args=["-m", "client", "mcp", "--robot-ip", robot.host],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    async with Client(command) as client:
        assert [tool.name for tool in (await client.list_tools()).tools] == NAMES
        state = await answer(client, "read_state")
        assert state["answered_by"] == f"{robot.host}, {EMULATOR}"
        assert (state["robot_mode"], state["polyscope"], len(state["joints_rad"])) == ("RUNNING", "3.15.8", 6)


async def test_without_consent_nothing_moves(robot: EmulatorProcess) -> None:
    async with Client(serve(robot.host, motion=False)) as client:
        tools = (await client.list_tools()).tools
        assert [tool.name for tool in tools] == NAMES
        assert all(tool.annotations is not None and tool.annotations.read_only_hint for tool in tools)
        for tool in CHANGING:
            assert tool.__name__ in await refusal(client, tool.__name__)
    async with Client(serve(robot.host, motion=True)) as client:
        moving = {tool.name for tool in (await client.list_tools()).tools if tool.annotations.destructive_hint}
        assert moving == {tool.__name__ for tool in CHANGING}


async def test_no_call_reaches_an_address_without_consent(robot: EmulatorProcess, reached: list[str]) -> None:
    chance = random.Random(1)
    junk: list[Any] = ["", "x" * 5000, "\0", -1, 1e308, None, [], {}, "--model=ur5", "../../etc/passwd", "\ud800"]
    tools = [name for name in (tool.__name__ for tool in (*READING, *CHANGING)) if name != "try_program"]
    async with Client(serve(robot.host, motion=True)) as client:
        schemas = {tool.name: list(tool.input_schema["properties"]) for tool in (await client.list_tools()).tools}
        for _ in range(examples(1000)):
            tool = chance.choice(tools)
            arguments = {name: chance.choice(junk) for name in schemas[tool]}
            host = chance.choice(ADDRESSES[1:])
            arguments |= {"robot_ip": host} if "robot_ip" in arguments else {}
            arguments.pop("program", None)  # the checker is a process of its own, with tests of its own
            result = await client.call_tool(tool, arguments)
            assert result.is_error or "robot_ip" not in arguments
            assert "Traceback" not in str(result.content)
    assert all(map(is_loopback, reached)), set(reached)


async def test_each_address_needs_consent(robot: EmulatorProcess) -> None:
    async with Client(serve(robot.host, motion=False, addresses=("10.1.2.3",))) as client:
        for address in ADDRESSES[2:]:
            assert "add --allow" in await refusal(client, "read_state", robot_ip=address)
        assert (await answer(client, "read_state", robot_ip=robot.host))["safety_mode"] == "NORMAL"


async def test_a_program_is_written_checked_tried_mended_and_run(robot: EmulatorProcess) -> None:
    async with Client(serve(robot.host, motion=True)) as client:
        wrong = PROGRAM.replace("textmsg", "txtmsg")
        (problem,) = (await answer(client, "check_program", program=wrong))["problems"]
        assert (problem["line"], problem["severity"]) == (3, "error")
        assert "line 3" in await refusal(client, "send_program", program=wrong)

        too_far = PROGRAM.replace("[0, -1.4, 1.5, -1.7, -1.5, 0]", "p[3, 0, 0, 0, 0, 0]")
        tried = await answer(client, "try_program", program=too_far, robot_time_s=20)
        assert not tried["succeeded"]
        assert "result" in tried["output"]
        tried = await answer(client, "try_program", program=PROGRAM, robot_time_s=20)
        assert tried["succeeded"]
        assert "done" in tried["output"]

        ran = await answer(client, "send_program", program=PROGRAM)
        assert (ran["ended"], ran["texts"]) == (True, ["done"])
        assert (await answer(client, "read_state"))["joints_rad"] == pytest.approx(
            [0, -1.4, 1.5, -1.7, -1.5, 0], abs=1e-3
        )

        verbs = (await answer(client, "list_emulator_verbs"))["verbs"]
        assert "protective_stop" in {verb["name"] for verb in verbs}
        await answer(client, "use_emulator", verb="protective_stop", arguments={})
        assert (await answer(client, "read_state"))["safety_mode"] == "PROTECTIVE_STOP"
        assert await refusal(client, "move_joints", joints_rad=[0.1, -1.4, 1.5, -1.7, -1.5, 0])
        while (await client.call_tool("unlock_protective_stop", {})).is_error:  # for 5 s after it
            await asyncio.sleep(0.2)
        await answer(client, "make_ready")
        moved = await answer(client, "move_joints", joints_rad=[0.1, -1.4, 1.5, -1.7, -1.5, 0])
        assert moved["joints_rad"][0] == pytest.approx(0.1, abs=1e-3)
        assert "6 numbers" in await refusal(client, "move_joints", joints_rad=[0.1])
        assert (await answer(client, "send_dashboard_command", command="robotmode"))["answer"] == "Robotmode: RUNNING"
        assert (await answer(client, "set_digital_output", number=2, on=True))["digital_output_bits"] & 4
        assert "no cameras" in await refusal(client, "take_picture")


async def test_codes_and_journals(tmp_path: Path, robot: EmulatorProcess) -> None:
    async with Client(serve(robot.host, motion=False)) as client:
        assert "deviates" in (await answer(client, "explain_error_code", code=153, argument=1))["meaning"]
        assert "is not a .journal file" in await refusal(client, "replay_journal", file="/etc/passwd")
        (file := tmp_path / "a.journal").write_bytes(b"?" * 100)
        assert not (await answer(client, "replay_journal", file=str(file)))["succeeded"]
