"""Scripts that call a real XML-RPC server: the standard library's, in a thread, over loopback."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.primary.messages import RobotMessage, RuntimeExceptionMessage, TextMessage
from urproto.robots import load_model

HOST = "127.0.0.1"


class KeepAlive(SimpleXMLRPCRequestHandler):
    """Configured like the vendor's sample server."""

    protocol_version = "HTTP/1.1"
    rpc_paths = ("/", "/RPC2")


class Camera:
    """The remote side; ``seen`` has the arguments of every call and ``peers`` the connections."""

    def __init__(self, handler: type[SimpleXMLRPCRequestHandler]) -> None:
        self.seen: list[tuple[Any, ...]] = []
        self.peers: list[Any] = []
        self.server = SimpleXMLRPCServer((HOST, 0), handler, logRequests=False, allow_none=True)
        self.server.timeout = 5
        self.server.register_introspection_functions()
        self.server.register_function(self.echo, "echo")
        self.server.register_function(self.record, "record")
        self.server.register_function(self.fail, "fail")
        accept: Callable[[], Any] = self.server.get_request

        def get_request() -> Any:
            accepted = accept()
            self.peers.append(accepted[1])
            accepted[0].settimeout(5)
            return accepted

        self.server.get_request = get_request  # type: ignore[method-assign]

    @property
    def port(self) -> int:
        return int(self.server.server_address[1])

    def echo(self, value: Any) -> Any:
        return value

    def record(self, *values: Any) -> bool:
        self.seen.append(values)
        return True

    def fail(self) -> None:
        raise RuntimeError("no picture")


def serving(handler: type[SimpleXMLRPCRequestHandler]) -> Iterator[Camera]:
    camera = Camera(handler)
    thread = threading.Thread(target=camera.server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield camera
    camera.server.shutdown()
    thread.join()
    camera.server.server_close()


@pytest.fixture(params=[SimpleXMLRPCRequestHandler, KeepAlive], ids=["HTTP/1.0", "HTTP/1.1"])
def camera(request: pytest.FixtureRequest) -> Iterator[Camera]:
    yield from serving(request.param)


@pytest.fixture
async def emulator(camera: Camera) -> AsyncIterator[Emulator]:  # after the camera, so that its sockets close first
    controller = ControllerConfig(model=load_model("ur5e"), running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as emulator:
        yield emulator


async def run(emulator: Emulator, body: str) -> list[RobotMessage]:
    """Run a program to its end; its messages."""
    reply: list[RobotMessage] = []
    ended = asyncio.Event()
    started = False

    def watch(snapshot: Any) -> None:
        nonlocal started
        reply.extend(snapshot.messages)
        started = started or snapshot.runtime_state is RuntimeState.PLAYING
        if started and snapshot.runtime_state is RuntimeState.STOPPED:
            ended.set()

    unsubscribe = emulator.controller.subscribe(watch)
    emulator.controller.programs.submit(f"def prog():\n{body}\nend\n")
    async with timeout(20):
        await ended.wait()
    unsubscribe()
    return [message for message in reply if isinstance(message, TextMessage | RuntimeExceptionMessage)]


def factory(camera: Camera, path: str = "/RPC2") -> str:
    return f'camera = rpc_factory("xmlrpc", "http://{HOST}:{camera.port}{path}")\n'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("True", "True"),
        ("-42", "-42"),
        ("1.5", "1.5"),
        ("1e-12", "1e-12"),
        ('"a <b> & c"', "a <b> & c"),
        ("p[0.1, -0.2, 0.3, 1, 2, 3]", "p[0.1,-0.2,0.3,1,2,3]"),
        ("[1, 2.5, 3]", "[1,2.5,3]"),
        ("[[1, 2], [3, 4]]", "[[1,2],[3,4]]"),
    ],
)
async def test_values_round_trip(emulator: Emulator, camera: Camera, value: str, text: str) -> None:
    (reply,) = await run(emulator, f"{factory(camera)}textmsg(camera.echo({value}))")
    assert isinstance(reply, TextMessage)
    assert reply.text == text


async def test_arguments_received_by_the_server(emulator: Emulator, camera: Camera) -> None:
    body = 'camera.record(True, 7, 0.25, "x", p[1, 2, 3, 4, 5, 6], [1, 2], struct(a=1))\ncamera.record()'
    assert await run(emulator, factory(camera) + body) == []
    pose = {"x": 1.0, "y": 2.0, "z": 3.0, "rx": 4.0, "ry": 5.0, "rz": 6.0}
    assert camera.seen == [(True, 7, 0.25, "x", pose, [1, 2], {"a": 1}), ()]


async def test_a_kept_connection_serves_many_calls(emulator: Emulator, camera: Camera) -> None:
    body = "i = 0\nwhile i < 20:\n camera.record(i)\n i = i + 1\nend"
    assert await run(emulator, factory(camera) + body) == []
    assert camera.seen == [(i,) for i in range(20)]
    keeps = camera.server.RequestHandlerClass is KeepAlive
    assert len(camera.peers) == (1 if keeps else 20)


async def test_a_closed_connection_is_reopened(emulator: Emulator, camera: Camera) -> None:
    body = "camera.record(1)\ncamera.closeXMLRPCClientConnection()\ncamera.record(2)"
    assert await run(emulator, factory(camera) + body) == []
    assert camera.seen == [(1,), (2,)]
    assert len(camera.peers) == 2


async def test_long_arguments_and_results(emulator: Emulator, camera: Camera) -> None:
    body = "a = make_list(9000, 0.123456789)\nb = camera.echo(a)\ntextmsg(a == b)"
    (reply,) = await run(emulator, factory(camera) + body)
    assert isinstance(reply, TextMessage), reply
    assert reply.text == "True"


async def test_dotted_methods(emulator: Emulator, camera: Camera) -> None:
    (reply,) = await run(emulator, f"{factory(camera)}names = camera.system.listMethods()\ntextmsg(names[0])")
    assert isinstance(reply, TextMessage)
    assert reply.text == "echo"


@pytest.mark.parametrize(
    ("call", "path", "problem"),
    [
        ("unknown()", "/RPC2", 'method "unknown" is not supported'),
        ("fail()", "/RPC2", "no picture"),
        ("echo()", "/RPC2", "missing 1 required positional argument"),
        ("echo(1)", "/elsewhere", "HTTP 404"),
    ],
)
async def test_failures_end_the_program(emulator: Emulator, camera: Camera, call: str, path: str, problem: str) -> None:
    (reply,) = await run(emulator, f"{factory(camera, path)}camera.{call}")
    assert isinstance(reply, RuntimeExceptionMessage)
    assert problem in reply.text
    assert reply.line == 3


async def test_a_missing_server(emulator: Emulator, camera: Camera) -> None:
    (reply,) = await run(emulator, f'camera = rpc_factory("xmlrpc", "http://{HOST}:1")\ncamera.echo(1)')
    assert isinstance(reply, RuntimeExceptionMessage)
    assert "cannot connect to 127.0.0.1:1: is the server running?" in reply.text
