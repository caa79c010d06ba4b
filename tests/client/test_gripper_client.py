"""The client of a gripper: against the emulated one, and against servers that are none."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import pytest

from client.errors import ConnectionLostError, GripperError, NoAnswerError, RobotUnreachableError
from client.gripper import GripperClient
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.lifecycle.power import PowerEvent
from emulator.machine import ControllerConfig
from tests.rows import each_row
from tests.ticking import StepClock
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.robotiq import MODELS, Fault, ObjectStatus, Status
from urproto.robots import load_model

HOST = "127.0.0.1"
MODEL = MODELS["robotiq-2f-85"]
STATE = {b"STA": b"STA 3", b"OBJ": b"OBJ 3", b"FLT": b"FLT 00", b"POS": b"POS 7", b"PRE": b"PRE 007"}


@pytest.fixture
async def emulator() -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model("ur5e"), running=True, gripper=MODEL, gripper_object_mm=30.0)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True), StepClock()) as emulator:
        yield emulator


async def passing(emulator: Emulator, work: Coroutine[Any, Any, Any]) -> Any:
    """Its result, after any number of control periods."""
    task = asyncio.ensure_future(work)
    async with timeout(20):
        while not task.done():
            emulator.controller.tick()
            await asyncio.sleep(0)
    return task.result()


async def test_a_gripper_grips_something(emulator: Emulator) -> None:
    gripper = emulator.controller.gripper
    assert gripper is not None
    async with GripperClient(HOST, emulator.ports["gripper"]) as client:
        assert (await passing(emulator, client.state())).problem == "is not active"
        await passing(emulator, client.activate())
        await passing(emulator, client.move(MODEL.closed_stop, MODEL.spe(85.0), MODEL.force(60.0)))
        assert (gripper.get("SPE"), gripper.get("FOR")) == ("128", "47")
        state = await passing(emulator, client.at_rest())
        assert (state.object_status, state.position_count) == (ObjectStatus.HELD_CLOSING, round(MODEL.count(30.0)))
        assert state.holds_object
        await passing(emulator, client.move(MODEL.open_stop))
        assert not (await passing(emulator, client.at_rest())).holds_object
        await passing(emulator, client.move(MODEL.closed_stop, 0))
        await passing(emulator, client.stop())
        here = gripper.position
        emulator.controller.tick()
        assert MODEL.open_stop < gripper.position == here < MODEL.count(30.0)

        gripper.fail(Fault.OVER_CURRENT)
        with pytest.raises(GripperError, match=r"has the fault OVER_CURRENT \(0x0e\): activate it again"):
            await passing(emulator, client.at_rest())
        await passing(emulator, client.activate())
        assert gripper.status is Status.ACTIVE
        with pytest.raises(LocalProtocolError, match=r"a count of the gripper.* from 0 to 255"):
            await client.move(256)
        emulator.controller.power_event(PowerEvent.POWER_OFF)
        emulator.controller.tick()
        with pytest.raises(GripperError, match="does not answer its controller: switch the arm on"):
            await passing(emulator, client.state())


@asynccontextmanager
async def server(answers: dict[bytes, bytes], default: bytes = b"") -> AsyncIterator[int]:
    """Answers by the request's last name, with a line end; closes the connection where there is nothing to answer."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            if not (answer := answers.get(line.split()[1], default)):
                break
            writer.write(answer + b"\n")
        writer.close()

    serving = await asyncio.start_server(serve, HOST, 0)
    try:
        yield int(serving.sockets[0].getsockname()[1])
    finally:
        serving.close()
        await serving.wait_closed()


@each_row(
    ("answers", "error", "text"),
    [
        ({b"STA": b"\xff\0 garbage"}, RemoteProtocolError, "this is not a gripper: it sent"),
        ({b"STA": b"x" * 5000}, RemoteProtocolError, "more than 1024 bytes without a line end"),
        ({b"STA": b"STA 3\nSTA 3"}, RemoteProtocolError, "several replies to one request"),
        ({b"STA": b"STA 2"}, RemoteProtocolError, "unknown state \\(2 is not a valid Status\\): see"),
        ({b"STA": b"POS 3"}, RemoteProtocolError, "GET STA is answered with 'POS 3'"),
        ({b"POS": b"POS 1e3"}, RemoteProtocolError, "GET POS is answered with 'POS 1e3'"),
        ({b"POS": b"POS 256"}, RemoteProtocolError, "check the port"),
        ({b"PRE": b"ack"}, RemoteProtocolError, "GET PRE is answered with 'ack'"),
        ({b"OBJ": b"OBJ ?"}, GripperError, "does not answer its controller"),
    ],
)
async def test_what_is_not_a_gripper(answers: dict[bytes, bytes], error: type[Exception], text: str) -> None:
    async with server(STATE | answers) as port, GripperClient(HOST, port) as client:
        with pytest.raises(error, match=text):
            await client.state()


async def test_a_refused_command() -> None:
    async with server(STATE | {b"POS": b"nack"}) as port, GripperClient(HOST, port) as client:
        with pytest.raises(RobotRefused, match="'SET POS 9 SPE 255 FOR 255 GTO 1': 'nack'"):
            await client.move(9)


async def test_it_reconnects() -> None:
    answers = dict(STATE)
    async with server(answers) as port:
        client = GripperClient(HOST, port, timeout_s=0.2)
        assert (await client.state()).position_count == 7, "it connects with its first request"
        del answers[b"OBJ"]
        with pytest.raises(ConnectionLostError):
            await client.state()
        answers[b"OBJ"] = b"\n"  # nothing
        with pytest.raises(NoAnswerError):
            await client.state()
        answers[b"OBJ"] = STATE[b"OBJ"]
        assert (await client.state()).object_status is ObjectStatus.AT_REQUEST
        answers.clear()
        with pytest.raises(ConnectionLostError):
            await client.state()
    with pytest.raises(RobotUnreachableError, match="start the emulator with --gripper"):
        await client.state()
