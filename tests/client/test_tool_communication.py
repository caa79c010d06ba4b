"""``ur-client tool-comm``: a robot's tool line as a serial device, with real pseudo terminals on both sides."""

import asyncio
import os
import signal
import subprocess
import sys
import termios
import tty
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest

from client.errors import DeviceError, RobotUnreachableError
from client.tool_communication import PORT, ToolCommunication
from urproto.compat_asyncio import timeout

HOST = "127.0.0.1"


class Robot:
    """Port 54321 of a robot whose tool echoes."""

    def __init__(self) -> None:
        self.port = 0
        self.writers: list[asyncio.StreamWriter] = []
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, HOST, self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        assert self._server is not None
        self._server.close()
        for writer in self.writers:
            writer.close()
        self.writers.clear()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        with suppress(ConnectionError):
            while data := await reader.read(4096):
                writer.write(data)
        writer.close()


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    robot = Robot()
    await robot.start()
    yield robot
    await robot.stop()


async def exchange(path: Path, data: bytes) -> bytes:
    """As a program with a serial port: open, write, read as much, close."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    loop = asyncio.get_running_loop()
    got = bytearray()
    done = asyncio.Event()

    def readable() -> None:
        got.extend(os.read(descriptor, 4096))
        if len(got) >= len(data):
            done.set()

    loop.add_reader(descriptor, readable)
    try:
        os.write(descriptor, data)
        async with timeout(20):
            await done.wait()
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)
    return bytes(got)


async def test_bytes_both_ways_and_a_clean_end(robot: Robot, tmp_path: Path) -> None:
    device = tmp_path / "ttyUR"
    async with ToolCommunication(HOST, robot.port, device):
        assert await exchange(device, bytes(range(256))) == bytes(range(256)), "raw: no byte means anything"
        assert await exchange(device, b"opened again") == b"opened again"
    assert not device.is_symlink()


async def test_a_program_may_set_the_port_up_as_it_likes(robot: Robot, tmp_path: Path) -> None:
    device = tmp_path / "ttyUR"
    async with ToolCommunication(HOST, robot.port, device):
        descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(descriptor)
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = termios.B9600
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        os.close(descriptor)
        assert await exchange(device, b"9600") == b"9600"


async def test_it_connects_again(robot: Robot, tmp_path: Path) -> None:
    device = tmp_path / "ttyUR"
    reported: list[str] = []
    back = asyncio.Event()

    def report(text: str) -> None:
        reported.append(text)
        if "again" in text and "connected" in text:
            back.set()

    async with ToolCommunication(HOST, robot.port, device, report) as line:
        running = asyncio.create_task(line.run())
        assert await exchange(device, b"before") == b"before"
        await robot.stop()
        while not reported:
            await asyncio.sleep(0)
        await robot.start()
        async with timeout(20):
            await back.wait()
        assert await exchange(device, b"after") == b"after"
        running.cancel()
        await asyncio.wait([running])
    assert ["closed the connection" in reported[0], len(reported)] == [True, 2]


async def test_an_unread_device(robot: Robot, tmp_path: Path) -> None:
    """More than a terminal holds is lost, and nothing stands still."""
    device = tmp_path / "ttyUR"
    async with ToolCommunication(HOST, robot.port, device):
        while not robot.writers:
            await asyncio.sleep(0)
        robot.writers[0].write(bytes(200_000))
        await robot.writers[0].drain()
        descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
        os.close(descriptor)


async def test_no_robot(tmp_path: Path) -> None:
    device = tmp_path / "ttyUR"
    with pytest.raises(RobotUnreachableError):
        async with ToolCommunication(HOST, 1, device):
            pass
    assert not device.is_symlink(), "nothing is left behind"


async def test_the_name_of_the_device(robot: Robot, tmp_path: Path) -> None:
    taken = tmp_path / "notes.txt"
    taken.write_text("mine")
    link = tmp_path / "link"
    link.symlink_to(taken)
    for path in (taken, link, tmp_path, tmp_path / "missing" / "ttyUR"):
        with pytest.raises(DeviceError, match="choose another path"):
            async with ToolCommunication(HOST, robot.port, path):
                pass
    assert (taken.read_text(), link.is_symlink()) == ("mine", True)
    stale = tmp_path / "ttyUR"
    stale.symlink_to("/dev/pts/9999")
    async with ToolCommunication(HOST, robot.port, stale):
        assert await exchange(stale, b"x") == b"x"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_the_command(robot: Robot, tmp_path: Path, number: signal.Signals) -> None:
    device = tmp_path / "ttyUR"
    command = [sys.executable, "-c", "from client.cli import main; main()", "tool-comm", "--device", str(device)]
    offset = str(robot.port - PORT)
    process = subprocess.Popen([*command, "--port-offset", offset], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdout is not None
        reported = await read_until(process.stdout.fileno(), b"\n")
        assert reported == f"{device} is the tool of {HOST}:{robot.port}. Ctrl-C ends it.\n".encode()
        assert await exchange(device, b"hello") == b"hello"
        process.send_signal(number)
        assert await read_until(process.stdout.fileno(), None) == b""
        assert process.communicate(timeout=20) == (b"", b"")
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0
    assert not device.is_symlink()


async def read_until(descriptor: int, end: bytes | None) -> bytes:
    """Read a pipe up to these bytes, or to its end, while the robot goes on."""
    loop = asyncio.get_running_loop()
    got = bytearray()
    done = asyncio.Event()

    def readable() -> None:
        data = os.read(descriptor, 4096)
        got.extend(data)
        if not data or (end is not None and got.endswith(end)):
            done.set()

    loop.add_reader(descriptor, readable)
    try:
        async with timeout(30):
            await done.wait()
    finally:
        loop.remove_reader(descriptor)
    return bytes(got)
