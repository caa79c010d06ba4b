"""The whole emulator on real sockets of the loopback interface."""

import asyncio
import io
import os
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace

import pytest
from rich.console import Console

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.first_screen import first_screen
from emulator.machine import ControllerConfig
from emulator.readiness import NotReady, check_ready
from tests.rows import each_row
from tests.ticking import StepClock
from urproto.compat_asyncio import timeout
from urproto.robots import load_model
from urproto.rtde.codec import GetVersion, RequestProtocol, RTDEDecoder, SetupOutputs, Start

HOST = "127.0.0.1"


def config(model: str = "ur3", **more: object) -> EmulatorConfig:
    controller = ControllerConfig(model=load_model(model), running=True)
    return EmulatorConfig(controller=controller, ephemeral_ports=True, **more)  # type: ignore[arg-type]


@pytest.fixture(params=["ur3", "ur5e"])
async def emulator(request: pytest.FixtureRequest) -> AsyncIterator[Emulator]:
    async with Emulator(config(request.param)) as emulator:
        yield emulator


async def send_request(port: int, *lines: str) -> list[str]:
    reader, writer = await asyncio.open_connection(HOST, port)
    answers = [await reader.readline()]
    for line in lines:
        writer.write(f"{line}\n".encode())
        answers.append(await reader.readline())
    writer.close()
    return [answer.decode().rstrip("\n") for answer in answers[1:]]


async def test_every_port_answers(emulator: Emulator) -> None:
    assert len(set(emulator.ports.values())) == 11
    await check_ready(HOST, emulator.ports)


async def test_packages_do_not_wait_for_acknowledgements(emulator: Emulator) -> None:
    """Nagle's algorithm delayed a client's first packages by 40 ms and then sent them all together."""
    reader, writer = await asyncio.open_connection(HOST, emulator.ports["dashboard"])
    await reader.readline()
    (connection,) = emulator.servers["dashboard"].connections
    assert connection._transport is not None
    accepted = connection._transport.get_extra_info("socket")
    assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    writer.close()


async def test_an_emulator_can_be_restarted(emulator: Emulator) -> None:
    async with Emulator(config()) as other:
        await check_ready(HOST, other.ports)
    async with Emulator(config()) as other:
        await check_ready(HOST, other.ports)


async def test_many_concurrent_clients_on_each_port(emulator: Emulator) -> None:
    ports = [port for port in emulator.ports.values() for _ in range(20)]
    streams = await asyncio.gather(*(asyncio.open_connection(HOST, port) for port in ports))
    await check_ready(HOST, emulator.ports)
    for name, server in emulator.servers.items():
        assert len(server.connections) >= 20, name
    for _, writer in streams:
        writer.close()


async def test_a_port_in_use_is_named_and_nothing_stays_open() -> None:
    host = f"127.77.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"  # other test processes use the same ports
    controller = ControllerConfig(model=load_model("ur3"))
    in_use = pytest.raises(OSError, match=r"port 30002 \(secondary\).*another program uses it")
    with socket.create_server((host, 30002)), in_use:
        async with Emulator(EmulatorConfig(controller=controller, host=host)):
            pass
    async with Emulator(EmulatorConfig(controller=controller, host=host)) as emulator:
        assert {**emulator.ports, **dict.fromkeys(emulator.port_fallbacks, 502)} == emulator.config.wanted_ports


async def test_modbus_uses_a_free_port_if_its_default_is_taken() -> None:
    host = f"127.78.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    wanted = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")), host=host, port_offset=20_000)
    with socket.create_server((host, 20_502)):
        async with Emulator(wanted) as emulator:
            assert emulator.ports["modbus"] not in (20_502, 0)
            assert "port 20502 (modbus): another program uses it" in emulator.port_fallbacks["modbus"]
            console = Console(record=True, width=160, file=io.StringIO())
            console.print(first_screen(emulator))
            screen = console.export_text()
            assert str(emulator.ports["modbus"]) in screen
            assert "port 20502 (modbus): another program uses it; using a free port instead" in screen
            await check_ready(host, emulator.ports)
    async with Emulator(wanted) as emulator:
        assert (emulator.ports["modbus"], emulator.port_fallbacks) == (20_502, {})


@each_row(
    ("model", "host", "remote_control", "shown"),
    [
        ("ur5e", "127.94.7.1", False, True),
        ("ur5e", "127.94.7.1", True, False),
        ("ur5e", "127.0.0.1", False, False),  # addresses at which ur_rtde treats a robot as a simulator
        ("ur3", "127.94.7.1", False, False),
    ],
)
async def test_the_start_screen_shows_the_options_ur_rtde_needs(
    model: str, host: str, remote_control: bool, shown: bool
) -> None:
    controller = ControllerConfig(model=load_model(model), remote_control=remote_control)
    async with Emulator(EmulatorConfig(controller=controller, host=host, ephemeral_ports=True)) as emulator:
        emulator.config = replace(emulator.config, ephemeral_ports=False)
        console = Console(record=True, width=160, file=io.StringIO())
        console.print(first_screen(emulator))
    assert ("start with --remote-control" in console.export_text()) is shown


async def test_an_address_of_another_machine() -> None:
    with pytest.raises(OSError, match=r"cannot listen on 203\.0\.113\.1"):
        async with Emulator(config(host="203.0.113.1")):
            pass


async def test_shutdown_ends_it(emulator: Emulator) -> None:
    assert await send_request(emulator.ports["dashboard"], "shutdown") == ["Shutting down"]
    await asyncio.wait_for(emulator.stopped.wait(), 5)


async def test_programs_run_and_connect_to_their_driver(emulator: Emulator) -> None:
    called: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

    async def driver(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(struct.pack(">i", 7))
        called.set_result(await reader.readexactly(4))
        writer.close()

    server = await asyncio.start_server(driver, HOST, 0)
    port = server.sockets[0].getsockname()[1]
    _, writer = await asyncio.open_connection(HOST, emulator.ports["primary"])
    writer.write(
        f"""def call():
  if socket_open("{HOST}", {port}, "driver"):
    got = socket_read_binary_integer(1, "driver", 1.0)
    socket_send_int(got[1] * 6, "driver")
    sleep(0.1)
  end
end
""".encode()
    )
    assert await asyncio.wait_for(called, 5) == struct.pack(">i", 42)
    writer.close()
    server.close()


def deaf_client(port: int) -> socket.socket:
    """A connection without a reader, with the smallest buffer that the system allows."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    deaf.connect((HOST, port))
    deaf.setblocking(False)
    return deaf


async def test_a_client_that_does_not_read_does_not_affect_others() -> None:
    """States are skipped for it; unread answers end its connection."""
    clock = StepClock()
    async with Emulator(config(), clock) as emulator:
        deaf, deaf_rtde = deaf_client(emulator.ports["realtime"]), deaf_client(emulator.ports["rtde"])
        for _ in range(20):
            await asyncio.sleep(0)
            clock.step(50)
        assert len(emulator.servers["realtime"].connections) == 1, "unread states are not a reason to disconnect"

        flood = GetVersion().encode(1) * 2_000
        rtde = emulator.servers["rtde"]
        async with timeout(60):
            while not rtde.connections:
                await asyncio.sleep(0)
            while rtde.connections:
                with suppress(BlockingIOError, ConnectionError):
                    deaf_rtde.send(flood)
                await asyncio.sleep(0)
        reader, writer = await asyncio.open_connection(HOST, emulator.ports["rtde"])
        writer.write(RequestProtocol(2).encode(1) + SetupOutputs(("timestamp",), 125.0).encode(2) + Start().encode(2))
        replies = 4 + (4 + len("DOUBLE")) + 4
        await reader.readexactly(replies)
        clock.step(11)  # nothing is sent together with the answer to the start
        data = await reader.readexactly(10 * 12)
        assert len(RTDEDecoder().feed(data)) == 10
        writer.close()
        deaf.close()
        deaf_rtde.close()


async def test_readiness_names_the_port_that_fails() -> None:
    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"SSH-2.0 hello\n")
        writer.close()

    server = await asyncio.start_server(greet, HOST, 0)
    port = server.sockets[0].getsockname()[1]
    for name, problem in [
        ("dashboard", "the greeting is 'SSH-2.0 hello'"),
        ("primary", "closed|bytes"),
        ("realtime", "bytes"),
        ("rtde", "closed|reset"),
    ]:
        with pytest.raises(NotReady, match=rf"{name} port {port} on {HOST}.*({problem})"):
            await check_ready(HOST, {name: port}, timeout_s=2.0)
    server.close()
    with pytest.raises(NotReady, match="dashboard port 1 on"):
        await check_ready(HOST, {"dashboard": 1})


async def test_the_readiness_check_times_out() -> None:
    async with Emulator(config(), StepClock()) as emulator:
        with pytest.raises(NotReady, match=r"realtime port \d+ on 127.0.0.1: no answer within 0.1 s"):
            await check_ready(HOST, {"realtime": emulator.ports["realtime"]}, timeout_s=0.1)
