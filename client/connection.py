"""Two thin shells around logic that knows no sockets.

The logic is a *flow*: a generator that yields bytes to have them sent, yields None to be
handed the next bytes from the robot, and returns its result. The same flow runs in either
shell, so nothing is written twice.
"""

import asyncio
import socket
import time
from collections.abc import Generator
from types import TracebackType
from typing import Self, TypeVar

from client.errors import ConnectionLostError, NoAnswerError, RobotUnreachableError

__all__ = ["DEFAULT_TIMEOUT_S", "AsyncConnection", "BlockingConnection", "Flow"]

Result = TypeVar("Result")
Flow = Generator[bytes | None, bytes, Result]

DEFAULT_TIMEOUT_S = 5.0  # for connecting and for each flow; guess: ample for a dashboard "load"
_LONGEST_WAIT_S = 86400.0  # an infinite timeout becomes this: sockets take no infinity
_CHUNK = 65536  # bytes per read


class AsyncConnection:
    """A TCP connection for asyncio programs; use it with ``async with``.

    Only one flow at a time may wait for bytes. Raises the errors of client.errors.
    """

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self.host = host
        self.port = port
        self.timeout_s = timeout_s
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        try:
            async with asyncio.timeout(self.timeout_s):
                self._streams = await asyncio.open_connection(self.host, self.port)
        except OSError as error:  # TimeoutError is one
            raise RobotUnreachableError(self.host, self.port, _reason(error)) from error
        tcp = self._streams[1].get_extra_info("socket")
        tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection; closing twice does no harm."""
        if self._streams is None:
            return
        writer = self._streams[1]
        self._streams = None
        writer.close()
        try:
            await writer.wait_closed()
        except OSError:  # the robot may have gone before us
            return

    async def run(self, flow: Flow[Result], timeout_s: float | None = None) -> Result:
        """Run a flow to its end, within ``timeout_s`` [s] or else the connection's."""
        limit = self.timeout_s if timeout_s is None else timeout_s
        try:
            async with asyncio.timeout(limit):
                return await self._drive(flow)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, limit) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error
        finally:
            flow.close()

    async def _drive(self, flow: Flow[Result]) -> Result:
        if self._streams is None:
            raise ConnectionLostError(self.host, self.port)
        reader, writer = self._streams
        answer: bytes | None = None
        while True:
            try:
                wanted = next(flow) if answer is None else flow.send(answer)
            except StopIteration as end:
                result: Result = end.value
                return result
            if wanted is not None:
                writer.write(wanted)
                await writer.drain()
                answer = b""
            elif not (answer := await reader.read(_CHUNK)):
                raise ConnectionLostError(self.host, self.port)


class BlockingConnection:
    """A TCP connection for scripts, notebooks and control loops; use it with ``with``."""

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self.host = host
        self.port = port
        self.timeout_s = timeout_s
        self._socket: socket.socket | None = None

    def __enter__(self) -> Self:
        try:
            self._socket = socket.create_connection((self.host, self.port), self.timeout_s)
        except OSError as error:
            raise RobotUnreachableError(self.host, self.port, _reason(error)) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; closing twice does no harm."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def run(self, flow: Flow[Result], timeout_s: float | None = None) -> Result:
        """Run a flow to its end, within ``timeout_s`` [s] or else the connection's."""
        limit = self.timeout_s if timeout_s is None else timeout_s
        try:
            return self._drive(flow, time.monotonic() + limit)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, limit) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error
        finally:
            flow.close()

    def _drive(self, flow: Flow[Result], deadline: float) -> Result:
        if self._socket is None:
            raise ConnectionLostError(self.host, self.port)
        answer: bytes | None = None
        while True:
            try:
                wanted = next(flow) if answer is None else flow.send(answer)
            except StopIteration as end:
                result: Result = end.value
                return result
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self._socket.settimeout(min(left, _LONGEST_WAIT_S))
            if wanted is not None:
                self._socket.sendall(wanted)
                answer = b""
            elif not (answer := self._socket.recv(_CHUNK)):
                raise ConnectionLostError(self.host, self.port)


def _reason(error: OSError) -> str:
    return "nobody answered in time" if isinstance(error, TimeoutError) else error.strerror or str(error)
