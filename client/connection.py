"""Two thin shells around logic that knows no sockets.

The logic is a *flow*: a generator that yields what it wants and returns its result. It yields

- bytes, to have them sent;
- None, to be handed the next bytes from the robot;
- POLL, to be handed what has arrived already, b"" when nothing has;
- TimeLimit, to have another one from now on;
- Reconnect, to go on over a new connection.

What goes wrong meanwhile is raised inside the flow, at its yield: a flow may catch a
ClientError, explain it, or come back with Reconnect. The same flow runs in either shell, so
nothing is written twice.
"""

import asyncio
import socket
import struct
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from types import TracebackType
from typing import Final, Generic, Literal, TypeVar

from client.errors import ClientError, ConnectionLostError, NoAnswerError, RobotUnreachableError
from urproto.compat import Self
from urproto.compat_asyncio import timeout

Result = TypeVar("Result")

DEFAULT_TIMEOUT_S = 5.0  # for connecting and for each flow; guess: ample for a dashboard "load"
_LONGEST_WAIT_S = 86400.0  # an infinite timeout becomes this: sockets take no infinity
_LEAST_WAIT_S = 1e-6  # a socket that does not wait at all is told apart by 0
_LOOKS = 2  # of the event loop at its sockets: a callback that is due may be in front of the first one
_LOOKING_S = 1.0  # how long one looks, beyond the time limit, at what has arrived already; guess
_RETRY_EVERY_S = 0.5  # between attempts to connect again; guess: a controller takes a minute to boot
_CHUNK = 65536  # bytes per read
# what opening a connection raises: TimeoutError is an OSError; names that no host can have, ports beyond 65535
_NO_CONNECTION: Final = (OSError, UnicodeError, OverflowError)


class _Poll(Enum):
    POLL = "poll"


POLL: Final = _Poll.POLL


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """From here on the flow may take this long [s]; None is the limit it was started with."""

    seconds: float | None


@dataclass(frozen=True, slots=True)
class Reconnect:
    """Close the connection, wait, and try to open it for ``within_s`` [s]. The time limit begins anew."""

    within_s: float
    after_s: float = 0.0


Step = bytes | None | Literal[_Poll.POLL] | TimeLimit | Reconnect
Flow = Generator[Step, bytes, Result]


class _Progress(Generic[Result]):
    """What a running flow wants next, and until when."""

    def __init__(self, flow: Flow[Result], limit_s: float) -> None:
        self.wanted: Step = None
        self.result: list[Result] = []  # empty until the flow has ended
        self.limit_s = limit_s
        self._flow = flow
        self._first_limit_s = limit_s
        self._deadline = time.monotonic() + limit_s
        self._advance(partial(next, flow))

    @property
    def left_s(self) -> float:
        """Time left. When it has run out still so much that one looks at what has arrived."""
        return min(max(self._deadline - time.monotonic(), _LEAST_WAIT_S), _LONGEST_WAIT_S)

    @property
    def over(self) -> bool:
        """The time ran out a while ago. What has arrived already is then all there is: a robot may send without end."""
        return self.wanted is POLL and time.monotonic() > self._deadline + _LOOKING_S

    def answer(self, data: bytes) -> None:
        """Hand the flow what it wanted."""
        if isinstance(self.wanted, Reconnect):
            self._set_limit(self.limit_s)
        self._advance(partial(self._flow.send, data))

    def fail(self, error: ClientError) -> None:
        """Raise an error inside the flow; it comes back out unless the flow handles it."""
        if isinstance(error, NoAnswerError):
            self._set_limit(self.limit_s)  # a flow that goes on gets its time again
        self._advance(partial(self._flow.throw, error))

    def _set_limit(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._deadline = time.monotonic() + limit_s

    def _advance(self, step: Callable[[], Step]) -> None:
        try:
            self.wanted = step()
            while isinstance(self.wanted, TimeLimit):
                seconds = self.wanted.seconds
                self._set_limit(self._first_limit_s if seconds is None else seconds)
                self.wanted = self._flow.send(b"")
        except StopIteration as end:
            self.result.append(end.value)


class Connection:
    """Where a TCP connection leads, and what is said on it first; its two shells are below."""

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self.host = host
        self.port = port
        self.timeout_s = timeout_s

    def _opening(self) -> Flow[None]:
        """What has to be said before a new connection can be used."""
        yield from ()


class AsyncConnection(Connection):
    """A TCP connection for asyncio programs; use it with ``async with``.

    Only one flow at a time may wait for bytes. Raises the errors of client.errors.
    """

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        await self._open()
        try:
            await self.run(self._opening())
        except BaseException:
            await self.close()
            raise
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
        try:
            progress = _Progress(flow, self.timeout_s if timeout_s is None else timeout_s)
            while not progress.result:
                try:
                    answer = await self._perform(progress)
                except ClientError as error:
                    progress.fail(error)
                else:
                    progress.answer(answer)
            return progress.result[0]
        finally:
            flow.close()

    async def _open(self) -> None:
        try:
            async with timeout(self.timeout_s):
                self._streams = await asyncio.open_connection(self.host, self.port)
        except _NO_CONNECTION as error:
            raise RobotUnreachableError(self.host, self.port, _reason(error)) from error
        tcp = self._streams[1].get_extra_info("socket")
        tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    async def _perform(self, progress: _Progress[Result]) -> bytes:
        if isinstance(progress.wanted, Reconnect):
            await self._reconnect(progress.wanted)
            return b""
        if progress.over:
            return b""
        try:
            return await self._exchange(progress.wanted, progress.left_s)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, progress.limit_s) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error

    async def _exchange(self, wanted: Step, left_s: float) -> bytes:
        if self._streams is None:
            raise ConnectionLostError(self.host, self.port)
        reader, writer = self._streams
        if wanted is POLL:
            return await self._poll(reader)
        if isinstance(wanted, bytes):
            async with timeout(left_s):
                writer.write(wanted)
                await writer.drain()
                return b""
        try:
            async with timeout(left_s):
                return self._not_ended(await reader.read(_CHUNK))
        except TimeoutError:
            return await self._last_look(reader)

    async def _last_look(self, reader: asyncio.StreamReader) -> bytes:
        """What came while this program was too busy to look. Raises TimeoutError when that is nothing."""
        for _ in range(_LOOKS):
            if data := await self._poll(reader):
                return data
        raise TimeoutError

    async def _poll(self, reader: asyncio.StreamReader) -> bytes:
        await asyncio.sleep(0)  # lets the loop look at the socket
        try:
            async with timeout(0):
                return self._not_ended(await reader.read(_CHUNK))
        except TimeoutError:
            return b""

    def _not_ended(self, data: bytes) -> bytes:
        if not data:
            raise ConnectionLostError(self.host, self.port)
        return data

    async def _reconnect(self, how: Reconnect) -> None:
        await self.close()
        await asyncio.sleep(how.after_s)
        until = time.monotonic() + how.within_s
        while True:
            try:
                return await self._open()
            except RobotUnreachableError:
                if time.monotonic() + _RETRY_EVERY_S > until:
                    raise
            await asyncio.sleep(_RETRY_EVERY_S)


class BlockingConnection(Connection):
    """A TCP connection for scripts, notebooks and control loops; use it with ``with``."""

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._socket: socket.socket | None = None

    def __enter__(self) -> Self:
        self._open()
        try:
            self.run(self._opening())
        except BaseException:
            self.close()
            raise
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

    def shut_down(self) -> None:
        """End the conversation, for any thread: one that waits for bytes gets ConnectionLostError."""
        if (connected := self._socket) is not None:
            with suppress(OSError):  # it has ended already
                connected.shutdown(socket.SHUT_RDWR)

    def run(self, flow: Flow[Result], timeout_s: float | None = None) -> Result:
        """Run a flow to its end, within ``timeout_s`` [s] or else the connection's."""
        try:
            progress = _Progress(flow, self.timeout_s if timeout_s is None else timeout_s)
            while not progress.result:
                try:
                    answer = self._perform(progress)
                except ClientError as error:
                    progress.fail(error)
                else:
                    progress.answer(answer)
            return progress.result[0]
        finally:
            flow.close()

    def chunks(self, silence_s: float) -> Iterator[bytes]:
        """What arrives from now on, as it does; NoAnswerError when nothing comes for so long."""
        if self._socket is None:
            raise ConnectionLostError(self.host, self.port)
        receive = self._socket.recv
        # the system's own time limit: with Python's, each read would be preceded by a wait
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _time_value(silence_s))
        while True:
            try:
                data = receive(_CHUNK)
            except BlockingIOError as error:
                raise NoAnswerError(self.host, self.port, silence_s) from error
            except OSError as error:
                raise ConnectionLostError(self.host, self.port) from error
            yield self._not_ended(data)

    def _not_ended(self, data: bytes) -> bytes:
        if not data:
            raise ConnectionLostError(self.host, self.port)
        return data

    def _open(self) -> None:
        try:
            self._socket = socket.create_connection((self.host, self.port), self.timeout_s)
        except _NO_CONNECTION as error:
            raise RobotUnreachableError(self.host, self.port, _reason(error)) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _perform(self, progress: _Progress[Result]) -> bytes:
        if isinstance(progress.wanted, Reconnect):
            self._reconnect(progress.wanted)
            return b""
        if progress.over:
            return b""
        try:
            return self._exchange(progress.wanted, progress.left_s)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, progress.limit_s) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error

    def _exchange(self, wanted: Step, left_s: float) -> bytes:
        if self._socket is None:
            raise ConnectionLostError(self.host, self.port)
        self._socket.settimeout(0.0 if wanted is POLL else left_s)
        if isinstance(wanted, bytes):
            self._socket.sendall(wanted)
            return b""
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:  # nothing there to poll
            return b""
        return self._not_ended(data)

    def _reconnect(self, how: Reconnect) -> None:
        self.close()
        time.sleep(how.after_s)
        until = time.monotonic() + how.within_s
        while True:
            try:
                return self._open()
            except RobotUnreachableError:
                if time.monotonic() + _RETRY_EVERY_S > until:
                    raise
            time.sleep(_RETRY_EVERY_S)


def _time_value(seconds: float) -> bytes:
    """A C timeval; 0 would be for ever."""
    micros = max(1, round(seconds * 1e6))
    return struct.pack("@ll", *divmod(micros, 1_000_000))


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "nobody answered in time"
    return getattr(error, "strerror", None) or str(error)
