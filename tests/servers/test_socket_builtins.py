"""The socket built-ins of a running emulator against a real TCP server."""

import asyncio
import socket
import struct
from collections.abc import AsyncIterator

import pytest

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.robots import load_model

HOST = "127.0.0.1"


@pytest.fixture(params=["ur3", "ur5e"])
async def emulator(request: pytest.FixtureRequest) -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model(request.param), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        yield emulator


class Driver:
    """Accepts one connection of a script."""

    def __init__(self) -> None:
        self.connected: asyncio.Future[tuple[asyncio.StreamReader, asyncio.StreamWriter]]
        self.connected = asyncio.get_running_loop().create_future()

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connected.set_result((reader, writer))


@pytest.fixture
async def driver() -> AsyncIterator[tuple[Driver, int]]:
    driver = Driver()
    server = await asyncio.start_server(driver.accept, HOST, 0)
    yield driver, server.sockets[0].getsockname()[1]
    server.close()
    if driver.connected.done():
        driver.connected.result()[1].transport.abort()
    await asyncio.sleep(0)


def start(emulator: Emulator, port: int, body: str) -> None:
    opening = f'socket_open("{HOST}", {port}, "s")\n'
    emulator.controller.programs.submit(f"def prog():\n{opening}{body}\nend\n")


async def ended(emulator: Emulator) -> list[str]:
    """The log once the program has ended."""
    log = emulator.controller.messages.history
    async with timeout(20):
        while not any("PROGRAM_XXX_STARTED" in line for line in log):
            await asyncio.sleep(0.005)
        while emulator.controller.programs.state is not RuntimeState.STOPPED:
            await asyncio.sleep(0.005)
    return list(log)


async def test_a_conversation(emulator: Emulator, driver: tuple[Driver, int]) -> None:
    peer, port = driver
    start(
        emulator,
        port,
        """
        socket_send_line("hello", "s")
        socket_send_int(-2, "s")
        socket_send_byte(10, "s")
        a = socket_read_binary_integer(2, "s")
        b = socket_read_ascii_float(3, "s")
        c = socket_read_string("s", "<", ">")
        d = socket_read_byte_list(3, "s")
        e = socket_read_line("s")
        socket_set_var("A", 5, "s")
        f = socket_get_var("B", "s")
        socket_send_line(str_cat(to_str(a), to_str(b)), "s")
        socket_send_line(str_cat(str_cat(c, to_str(d)), str_cat(e, to_str(f))), "s")
        """,
    )
    reader, writer = await peer.connected
    assert await reader.readline() == b"hello\n"
    assert await reader.readexactly(5) == struct.pack(">i", -2) + b"\n"
    for byte in struct.pack(">ii", 7, -7) + b"noise( 1.5, -2 ,3)" + b"x<text>" + b"\x01\x02\xff" + b"line\r\n":
        writer.write(bytes([byte]))
        await writer.drain()
    assert await reader.readline() == b"SET A 5\n"
    assert await reader.readline() == b"GET B\n"
    writer.write(b"B -12\n")
    assert await reader.readline() == b"[2, 7, -7][3, 1.5, -2, 3]\n"
    assert await reader.readline() == b"text[3, 1, 2, 255]line-12\n"
    assert await reader.read() == b""  # connections close at the end of the program
    assert not any("exception" in line for line in await ended(emulator))


async def test_many_long_sends_arrive_whole(emulator: Emulator, driver: tuple[Driver, int]) -> None:
    peer, port = driver
    line = "0123456789" * 100
    body = f'i = 0\nwhile i < 500:\n  if not socket_send_line("{line}", "s"):\n    halt\n  end\n  i = i + 1\nend'
    start(emulator, port, body)
    reader, _ = await peer.connected
    async with timeout(20):
        assert await reader.read(-1) == f"{line}\n".encode() * 500


async def test_a_peer_that_vanishes_wakes_a_reader(emulator: Emulator, driver: tuple[Driver, int]) -> None:
    peer, port = driver
    start(emulator, port, 'socket_send_line("ready", "s")\ntextmsg("got ", socket_read_byte_list(3, "s", 0))')
    reader, writer = await peer.connected
    await reader.readline()
    writer.write(b"ab")
    await writer.drain()
    writer.close()
    assert any(line.endswith("got [0,-1,-1,-1]") for line in await ended(emulator))


async def test_a_reset_is_a_close(emulator: Emulator, driver: tuple[Driver, int]) -> None:
    peer, port = driver
    start(emulator, port, 'socket_send_line("ready", "s")\ntextmsg("got ", socket_read_line("s", 0))')
    reader, writer = await peer.connected
    await reader.readline()
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()
    assert any("got " in line for line in await ended(emulator))
