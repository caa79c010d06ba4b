"""An emulator in virtual time, and clients that are plain sockets."""

import asyncio
import socket
from collections.abc import Callable
from types import TracebackType
from typing import Any

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from tests.ticking import StepClock
from urproto.compat import Self
from urproto.robots import load_model
from urproto.rtde.codec import Package, PackageType, RequestProtocol, RTDEDecoder, SetupOutputs, Start

HOST = "127.0.0.1"
PATIENCE = 2000  # iterations of the event loop for data in transit on this machine


class Client:
    """A socket. ``received``: all data, ``ended``: how the connection ended: "end" or "reset"."""

    def __init__(self, port: int, source: str = "", buffer: int | None = None) -> None:
        self.socket = socket.socket()
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # acknowledgements arrive in real time
        if buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        if source:
            self.socket.bind((source, 0))
        try:
            self.socket.connect((HOST, port))
        except OSError:
            self.socket.close()
            raise
        self.socket.setblocking(False)
        self.address = self.socket.getsockname()
        self.received = b""
        self.keeps = True  # received data in pieces, since joining long streams takes long
        self.ended = ""

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self) -> bytes:
        """Data received since the last call."""
        data = b""
        try:
            while not self.ended and (piece := self.socket.recv(1 << 20)):
                data += piece
            self.ended = self.ended or "end"
        except BlockingIOError:
            pass
        except ConnectionResetError:
            self.ended = "reset"
        if self.keeps:
            self.received += data
        return data

    def close(self) -> None:
        self.socket.close()


class RTDEClient(Client):
    """A minimal RTDE client that sends and receives packages."""

    def __init__(self, port: int, **options: Any) -> None:
        super().__init__(port, **options)
        self._decoder = RTDEDecoder()

    def packages(self) -> list[Package]:
        return self._decoder.feed(self.read())

    def data(self) -> list[bytes]:
        """Payloads of the data packages received so far."""
        return [package.payload for package in self.packages() if package.type == PackageType.DATA_PACKAGE]


class Robot:
    """``step``: control periods, and time for the sockets after each."""

    def __init__(self, model: str, **options: Any) -> None:
        controller = ControllerConfig(model=load_model(model), running=True)
        config = EmulatorConfig(controller=controller, ephemeral_ports=True, control=False, **options)
        self.clock = StepClock()
        self.emulator = Emulator(config, self.clock)
        self.clients: list[Client] = []

    async def __aenter__(self) -> Self:
        await self.emulator.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for client in self.clients:
            client.close()
        await self.emulator.__aexit__(kind, error, traceback)

    @property
    def control(self) -> Any:
        return self.emulator.control

    @property
    def period_s(self) -> float:
        return self.emulator.controller.period_s

    async def step(self, periods: int = 1) -> None:
        for _ in range(periods):
            self.clock.step()
            for _ in range(3):
                await asyncio.sleep(0)

    async def until(self, done: Callable[[], object]) -> None:
        """Let the event loop run until a condition holds."""
        for _ in range(PATIENCE):
            if done():
                return
            await asyncio.sleep(0)
        raise AssertionError("it did not happen")

    async def until_ticking(self, done: Callable[[], object]) -> None:
        """Let control periods pass until a condition holds; outgoing connections need iterations of the loop and
        threads."""
        for _ in range(PATIENCE):
            if done():
                return
            await self.step()
            await asyncio.sleep(0.001)
        raise AssertionError("it did not happen")

    async def connect(self, port: str, kind: Any = Client, **options: Any) -> Any:
        """A client that the server has accepted."""
        server = self.emulator.servers[port]
        client = kind(server.port, **options)
        self.clients.append(client)
        await self.until(lambda: any(peer.endswith(f":{client.address[1]}") for peer in server.peers))
        return client

    async def dashboard(self) -> Client:
        """A client that has received the greeting."""
        client: Client = await self.connect("dashboard")
        await self.until(lambda: client.read())
        return client

    async def stream(self, names: tuple[str, ...] = ("timestamp",), **options: Any) -> RTDEClient:
        """A started RTDE client: a package in each period from now on, none so far."""
        client: RTDEClient = await self.connect("rtde", RTDEClient, **options)
        for request in (RequestProtocol(2), SetupOutputs(names, 1.0 / self.period_s), Start()):
            client.send(request.encode(2))
        replies: list[Package] = []

        def started() -> bool:
            replies.extend(client.packages())
            return any((reply.type, reply.payload) == (PackageType.START, b"\x01") for reply in replies)

        await self.until(started)
        await self.step()  # the first package is sent a period after the answer
        replies.extend(client.packages())
        assert all(reply.type != PackageType.DATA_PACKAGE for reply in replies), "data with the answer to START"
        return client

    async def request(self, client: Client, request: bytes, periods: int = 3) -> bytes:
        """The answer within some periods."""
        client.read()
        client.send(request)
        await asyncio.sleep(0)
        await self.step(periods)
        return client.read()

    def strikes(self) -> list[int]:
        return [fault["strikes"] for fault in self.control.faults()]

    def states(self) -> list[str]:
        return [fault["state"] for fault in self.control.faults()]
