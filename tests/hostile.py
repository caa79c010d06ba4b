"""A hostile robot: real streams of every port, corrupted on their way to the client. For tests and `make chaos`."""

import asyncio
import socket
import struct
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from random import Random
from types import TracebackType
from typing import Any, Final

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat import Self
from urproto.ports import CONTROLLER_PORTS
from urproto.robots import load_model

__all__ = ["KINDS", "HostileRobot"]

SPOILT: Final = ("dashboard", "primary", "secondary", "realtime", "rtde", "tool line", "modbus")
_PATIENCE_S: Final = 30.0
_MAX_ENDLESS: Final = 4_000_000  # bytes of an endless answer; a client has to give up earlier
_LENGTH: Final = struct.Struct(">i")
_FRAMES: Final = {  # length field of a frame, and the size of its header
    "rtde": (struct.Struct(">H"), 3),
    "primary": (_LENGTH, 5),
    "secondary": (_LENGTH, 5),
    "realtime": (_LENGTH, 4),
}
_ABSURD: Final = (
    *(struct.pack(">d", value) for value in (float("nan"), float("inf"), -1e308, 5e-324, 1e18, -1.0)),
    *(b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\x80" + bytes(7), bytes(8), b"\xff\xfe\xc3\x28" * 2, bytes(2) + b"\1" * 6),
)


class Spoiler:
    """Corrupts the bytes of one connection. after: number of bytes passed on unchanged."""

    def __init__(self, kind: str, port: str, random: Random) -> None:
        self.kind = kind
        self.port = port
        self.random = random
        self.after = int(random.expovariate(1 / 600)) if random.random() < 0.8 else 0
        self._buffer = b""
        self._before = [b""]

    async def pass_on(
        self, data: bytes, write: Callable[[bytes], Awaitable[None]], end: Callable[[bool], None]
    ) -> None:
        """Pass on data of the robot; end(True) resets the connection, end(False) half-closes it."""
        honest, data = data[: self.after], data[self.after :]
        self.after -= len(honest)
        if honest:
            await write(honest)
        if data:
            await getattr(self, f"_{self.kind}")(data, write, end)

    async def _honest(self, data: bytes, write: Any, end: Any) -> None:
        await write(data)

    async def _flip(self, data: bytes, write: Any, end: Any) -> None:
        spoilt = bytearray(data)
        for _ in range(1 + len(data) // 200):
            spoilt[self.random.randrange(len(data))] = self.random.randrange(256)
        await write(bytes(spoilt))

    async def _garbage(self, data: bytes, write: Any, end: Any) -> None:
        await write(self.random.randbytes(self.random.randrange(1, 3000)))

    async def _text(self, data: bytes, write: Any, end: Any) -> None:
        await write(
            self.random.choice(
                [b"\xff\xfe\n", b"\n\n\n", b"\0\n", b"Robotmode: \xc3\n", b"PolyScope 99999999999999.\n"]
            )
        )

    async def _cut(self, data: bytes, write: Any, end: Any) -> None:
        await write(data[: self.random.randrange(len(data))])
        end(True)

    async def _fin(self, data: bytes, write: Any, end: Any) -> None:
        await write(data[: self.random.randrange(len(data))])
        end(False)

    async def _stall(self, data: bytes, write: Any, end: Any) -> None:
        pass

    async def _drip(self, data: bytes, write: Any, end: Any) -> None:
        for byte in data[:50]:
            await write(bytes([byte]))
            await asyncio.sleep(0.002)

    async def _huge(self, data: bytes, write: Any, end: Any) -> None:
        await write(
            self.random.choice([b"\x7f\xff\xff\xff", b"\xff" * 4, b"\0\0\0\0", b"\xff\xff", b"\0\0", b"\x80\0\0\0"])
            + data
        )

    async def _endless(self, data: bytes, write: Any, end: Any) -> None:
        for _ in range(_MAX_ENDLESS // 65536):
            await write(data[:1] * 65536)

    async def _twice(self, data: bytes, write: Any, end: Any) -> None:
        self._before.append(data)
        del self._before[:-20]
        await write(data + self.random.choice(self._before))

    async def _absurd(self, data: bytes, write: Any, end: Any) -> None:
        """Valid frames that contain numbers which no robot sends."""
        if self.port not in _FRAMES:
            return await self._flip(data, write, end)
        length, head = _FRAMES[self.port]
        self._buffer += data
        while len(self._buffer) >= head and len(self._buffer) >= (
            size := max(length.unpack_from(self._buffer)[0], head)
        ):
            frame, self._buffer = bytearray(self._buffer[:size]), self._buffer[size:]
            for _ in range(self.random.randrange(4) if size > head + 8 else 0):
                place = self.random.randrange(head, size - 8)
                frame[place : place + 8] = self.random.choice(_ABSURD)
            await write(bytes(frame))
        return None


KINDS: Final = tuple(name[1:] for name, member in vars(Spoiler).items() if name.startswith("_") and callable(member)
                     and not name.startswith("__"))  # fmt: skip


class HostileRobot:
    """An emulator behind a proxy that corrupts its output, on the usual ports of a separate loopback address.

    host: address of the corrupted ports. begin: sets how later connections are corrupted, by kind and seed.
    """

    def __init__(self, model: str = "ur5e") -> None:
        controller = ControllerConfig(model=load_model(model), running=True)
        self.robot = Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, tool_device="echo"))
        self.host = ""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._servers: list[asyncio.Server] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._seeds: Iterator[tuple[str, int]] = iter(())
        self.begin(("honest",), 0)

    def __enter__(self) -> Self:
        self._thread.start()
        self._wait(self._open())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._wait(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_PATIENCE_S)
        self._loop.close()

    def begin(self, kinds: tuple[str, ...], seed: int) -> None:
        """Corrupt new connections in these ways, the first one in the first way."""
        random = Random(seed)
        first = [kinds[0]]

        def seeds() -> Iterator[tuple[str, int]]:
            while True:
                yield (first.pop() if first else random.choice(kinds)), random.randrange(2**32)

        self._seeds = seeds()

    def _wait(self, what: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(what, self._loop).result(_PATIENCE_S)

    async def _open(self) -> None:
        await self.robot.__aenter__()
        random = Random()
        while not self.host:
            host = f"127.{random.randrange(64, 128)}.{random.randrange(256)}.{random.randrange(1, 255)}"
            with suppress(OSError):
                for name in SPOILT:
                    await self._serve(name, host)
                self.host = host

    async def _serve(self, name: str, host: str) -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.current_task()
            assert task
            self._tasks.add(task)
            try:
                await self._carry(name, reader, writer)
            except (OSError, asyncio.CancelledError):
                pass
            finally:
                self._tasks.discard(task)
                writer.transport.abort()

        port = CONTROLLER_PORTS[name] if name != "modbus" else 0
        self._servers.append(await asyncio.start_server(serve, host, port))
        if name == "modbus":
            self.modbus_port = self._servers[-1].sockets[0].getsockname()[1]

    async def _carry(self, name: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        kind, seed = next(self._seeds)
        spoiler = Spoiler(kind, name, Random(seed))
        robot_reader, robot_writer = await asyncio.open_connection("127.0.0.1", self.robot.ports[name])

        async def write(data: bytes) -> None:
            writer.write(data)
            await writer.drain()

        def end(reset: bool) -> None:
            if reset:
                linger = struct.pack("ii", 1, 0)
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                writer.transport.abort()
            else:
                writer.write_eof()
            raise ConnectionResetError

        async def answers() -> None:
            try:
                while data := await robot_reader.read(65536):
                    await spoiler.pass_on(data, write, end)
            except (OSError, RuntimeError):  # it is the client's turn to hang up
                return

        answering = asyncio.create_task(answers())
        try:
            while data := await reader.read(65536):
                robot_writer.write(data)
        finally:
            answering.cancel()
            await asyncio.gather(answering, return_exceptions=True)
            robot_writer.transport.abort()

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.robot.__aexit__(None, None, None)
