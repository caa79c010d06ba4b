"""The tool's serial line from end to end: a device, the emulator, the driver's side, a program with a serial port."""

import asyncio
import os
import socket
import termios
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig
from emulator.devices.tool_line import SerialSettings
from emulator.machine import ControllerConfig
from emulator.readiness import check_ready
from urproto.compat_asyncio import timeout
from urproto.robots import load_model

HOST = "127.0.0.1"
ON = SerialSettings(True)


def config(device: str, model: str = "ur5e", **more: object) -> EmulatorConfig:
    controller = ControllerConfig(model=load_model(model), running=True)
    return EmulatorConfig(controller=controller, ephemeral_ports=True, tool_device=device, **more)  # type: ignore[arg-type]


def switch_on(emulator: Emulator, settings: SerialSettings = ON) -> None:
    emulator.controller.tool_line.settings = settings
    emulator.controller.signals.set_tool_voltage(24)
    emulator.controller.tick()
    assert emulator.controller.tool_line.live


@pytest.fixture
async def echo() -> AsyncIterator[Emulator]:
    async with Emulator(config("echo")) as emulator:
        switch_on(emulator)
        yield emulator


class Client:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    @classmethod
    async def connect(cls, emulator: Emulator) -> "Client":
        return cls(*await asyncio.open_connection(HOST, emulator.ports["tool line"]))

    async def echoed(self, data: bytes) -> bytes:
        self.writer.write(data)
        async with timeout(20):
            return await self.reader.readexactly(len(data))

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


async def test_any_bytes_are_echoed(echo: Emulator) -> None:
    client = await Client.connect(echo)
    data = bytes(range(256)) * 20
    assert await client.echoed(data) == data
    await client.close()


async def test_one_client_at_a_time_uses_the_line(echo: Emulator) -> None:
    first, second = await Client.connect(echo), await Client.connect(echo)
    second.writer.write(b"second")
    assert await first.echoed(b"first") == b"first"
    waiting = asyncio.create_task(second.reader.readexactly(6))
    assert await first.echoed(b"again") == b"again"
    assert not waiting.done()
    await first.close()
    async with timeout(20):
        assert await waiting == b"second", "data sent while waiting is not lost"
    await second.close()


async def test_probing_the_port_has_no_side_effects(echo: Emulator) -> None:
    """As in the vendor's script before it starts socat."""
    (await asyncio.open_connection(HOST, echo.ports["tool line"]))[1].close()
    client = await Client.connect(echo)
    assert await client.echoed(b"here") == b"here"
    await client.close()
    await check_ready(HOST, echo.ports)


async def test_the_tool_line_opens_only_if_configured() -> None:
    with pytest.raises(ConfigError, match="UR3 has no serial line at its tool"):
        config("echo", "ur3")
    plain = EmulatorConfig(controller=ControllerConfig(model=load_model("ur5e")))
    assert "tool line" not in plain.wanted_ports
    assert config("echo").wanted_ports["tool line"] == 0


async def test_an_invalid_device(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for path, problem in ((file, "is not a serial port"), (tmp_path / "none", "No such file")):
        with pytest.raises(OSError, match=problem):
            async with Emulator(config(str(path))):
                pass


@contextmanager
def opened(path: str) -> Iterator[int]:
    """A serial device opened like in a program: raw, waiting at most two seconds for a byte."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(descriptor)
        yield descriptor
    finally:
        os.close(descriptor)


async def read(descriptor: int, count: int) -> bytes:
    """This number of bytes from a terminal, without blocking the event loop."""
    loop = asyncio.get_running_loop()
    got = bytearray()
    done = asyncio.Event()

    def readable() -> None:
        got.extend(os.read(descriptor, count - len(got)))
        if len(got) >= count:
            done.set()

    loop.add_reader(descriptor, readable)
    try:
        async with timeout(20):
            await done.wait()
    finally:
        loop.remove_reader(descriptor)
    return bytes(got)


async def test_a_user_device_on_a_pseudo_terminal() -> None:
    async with Emulator(config("pty")) as emulator:
        switch_on(emulator)
        client = await Client.connect(emulator)
        with opened(emulator.tool_device) as device:
            client.writer.write(b"\x09\x03\x07\xd0")
            assert await read(device, 4) == b"\x09\x03\x07\xd0"
            os.write(device, b"\x00\xff\n\r\x03\x11")
            async with timeout(20):
                assert await client.reader.readexactly(6) == b"\x00\xff\n\r\x03\x11", "no byte means anything to it"
        with opened(emulator.tool_device) as device:
            os.write(device, b"again")
            async with timeout(20):
                assert await client.reader.readexactly(5) == b"again", "the device may come and go"
        await client.close()


async def test_a_serial_port_of_this_machine() -> None:
    """Its other end represents the cable. Baud rate, parity and stop bits are those of the program."""
    wire, port = os.openpty()
    tty.setraw(port)
    try:
        async with Emulator(config(os.ttyname(port))) as emulator:
            switch_on(emulator, SerialSettings(True, 57600, 1, 2))
            attributes = termios.tcgetattr(port)
            assert attributes[4:6] == [termios.B57600, termios.B57600]
            assert attributes[2] & termios.CSTOPB
            client = await Client.connect(emulator)
            client.writer.write(b"ping")
            assert await read(wire, 4) == b"ping"
            os.write(wire, b"pong")
            async with timeout(20):
                assert await client.reader.readexactly(4) == b"pong"
            await client.close()
    finally:
        os.close(wire)
        os.close(port)


async def test_an_unplugged_device(caplog: pytest.LogCaptureFixture) -> None:
    wire, port = os.openpty()
    name = os.ttyname(port)
    async with Emulator(config(name)) as emulator:
        switch_on(emulator)
        os.close(port)
        os.close(wire)
        async with timeout(20):
            while "was disconnected" not in caplog.text:
                await asyncio.sleep(0)
        client = await Client.connect(emulator)
        client.writer.write(b"anyone?")
        await client.writer.drain()
        for _ in range(10):
            emulator.controller.tick()
        await check_ready(HOST, {name: port for name, port in emulator.ports.items() if name != "tool line"})
        await client.close()


async def test_the_port_is_in_use() -> None:
    with socket.create_server(("127.94.54.32", 54321)):
        controller = ControllerConfig(model=load_model("ur5e"))
        with pytest.raises(OSError, match=r"54321 \(tool line\): another program uses it"):
            async with Emulator(EmulatorConfig(controller=controller, host="127.94.54.32", tool_device="echo")):
                pass
