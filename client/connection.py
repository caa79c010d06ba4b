"""Two thin wrappers, asynchronous and blocking, around protocol logic without I/O.

The logic is a *flow*: a generator that yields requests and returns its result. It yields

- bytes to send them;
- None to receive the next bytes from the robot;
- POLL to receive what has already arrived, b"" if nothing has;
- TimeLimit to set a new time limit from now on;
- Reconnect to continue over a new connection.

Errors are raised inside the flow, at its yield: a flow may catch a ClientError, explain it, or recover with Reconnect.
Both wrappers run the same flows, so no logic is duplicated. `FlowMethod` makes a method
of both from one that returns a flow.
"""

import asyncio
import math
import socket
import struct
import time
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Concatenate, Final, Generic, Literal, ParamSpec, TypeVar, overload

from client.errors import ClientError, ConnectionLostError, NoAnswerError, RobotUnreachableError
from client.quantities import checked, checked_call
from urproto.compat import Self
from urproto.compat_asyncio import timeout

Params = ParamSpec("Params")
Result = TypeVar("Result")

DEFAULT_TIMEOUT_S = 5.0  # for connecting and for each flow; guess: ample for a dashboard "load"
_MAX_WAIT_S = 86400.0  # replaces an infinite timeout, which sockets do not accept
_MIN_WAIT_S = 1e-6  # not 0, which makes a socket non-blocking
_EARLY_S = 0.001  # by which a timer may end before its time: the resolution of clocks
_FINAL_POLLS = 2  # polls of the sockets by the event loop: a pending callback may come before the first one
_OVERTIME_S = 1.0  # how long data that has already arrived is still read after the time limit; guess
_RETRY_S = 0.5  # between attempts to connect again; guess: a controller takes a minute to boot
_CHUNK = 65536  # bytes per read
# errors of opening a connection; TimeoutError is an OSError, the others come from invalid host names and port numbers
_NO_CONNECTION: Final = (OSError, UnicodeError, OverflowError)


class _Poll(Enum):
    POLL = "poll"


POLL: Final = _Poll.POLL


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """From now on the flow may take this long [s]; None restores the limit that it was started with."""

    seconds: float | None


@dataclass(frozen=True, slots=True)
class Reconnect:
    """Close the connection, wait ``after_s`` [s], and try to reopen it for ``within_s`` [s]. Restarts the limit."""

    within_s: float
    after_s: float = 0.0


Step = bytes | None | Literal[_Poll.POLL] | TimeLimit | Reconnect
Flow = Generator[Step, bytes, Result]


class _Progress(Generic[Result]):
    """The pending request of a running flow, and its deadline."""

    def __init__(self, flow: Flow[Result], limit_s: float, silence_s: float) -> None:
        self.pending: Step = None
        self.result: list[Result] = []  # empty until the flow has ended
        self.limit_s = limit_s
        self._flow = flow
        self._silence_s = silence_s
        self._first_limit_s = limit_s
        self._deadline = time.monotonic() + limit_s
        self._advance(partial(next, flow))

    @property
    def left_s(self) -> float:
        """Time left [s]; never 0, so that data that has already arrived is still read after the deadline."""
        return min(max(self._deadline - time.monotonic(), _MIN_WAIT_S), self._silence_s, _MAX_WAIT_S)

    @property
    def waited_s(self) -> float:
        """Of a wait that has just ended without an answer: the limit that ended it [s]."""
        left_s = self._deadline - time.monotonic()
        return self._silence_s if left_s > _EARLY_S else self.limit_s

    @property
    def over(self) -> bool:
        """True if the deadline passed a while ago: then polling ends too, since a robot may send without end."""
        return self.pending is POLL and time.monotonic() > self._deadline + _OVERTIME_S

    def answer(self, data: bytes) -> None:
        """Pass the requested data to the flow."""
        if isinstance(self.pending, Reconnect):
            self._set_limit(self.limit_s)
        self._advance(partial(self._flow.send, data))

    def fail(self, error: ClientError) -> None:
        """Raise an error inside the flow; it propagates to the caller unless the flow handles it."""
        if isinstance(error, NoAnswerError):
            self._set_limit(self.limit_s)  # a flow that continues gets its full time again
        self._advance(partial(self._flow.throw, error))

    def _set_limit(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._deadline = time.monotonic() + limit_s

    def _advance(self, step: Callable[[], Step]) -> None:
        try:
            self.pending = step()
            while isinstance(self.pending, TimeLimit):
                seconds = self.pending.seconds
                self._set_limit(self._first_limit_s if seconds is None else seconds)
                self.pending = self._flow.send(b"")
        except StopIteration as end:
            self.result.append(end.value)


@checked
class Connection:
    """Address and opening flow of a TCP connection; base of the two wrappers below."""

    silence_s = math.inf
    """A robot that sends nothing for this long [s] while a flow waits for it is gone, however long that may take."""

    def __init__(self, host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self.host = host
        self.port = port
        self.timeout_s = timeout_s

    def _opening(self) -> Flow[None]:
        """The flow that prepares a new connection for use."""
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

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection; may be called more than once."""
        if self._streams is None:
            return
        writer = self._streams[1]
        self._streams = None
        if writer.transport.get_write_buffer_size():  # a robot that takes no data would hold up the end
            writer.transport.abort()
        writer.close()
        try:
            await writer.wait_closed()
        except OSError:  # the robot may have closed it first
            return

    async def run(self, flow: Flow[Result], timeout_s: float | None = None) -> Result:
        """Run a flow to its end, within ``timeout_s`` [s], by default the connection's timeout."""
        try:
            progress = _Progress(flow, self.timeout_s if timeout_s is None else timeout_s, self.silence_s)
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
        if isinstance(progress.pending, Reconnect):
            await self._reconnect(progress.pending)
            return b""
        if progress.over:
            return b""
        try:
            return await self._exchange(progress.pending, progress.left_s)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, progress.waited_s) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error

    async def _exchange(self, pending: Step, left_s: float) -> bytes:
        if self._streams is None:
            raise ConnectionLostError(self.host, self.port)
        reader, writer = self._streams
        if pending is POLL:
            return await self._poll(reader)
        if isinstance(pending, bytes):
            async with timeout(left_s):
                writer.write(pending)
                await writer.drain()
                return b""
        try:
            async with timeout(left_s):
                return self._check_open(await reader.read(_CHUNK))
        except TimeoutError:
            return await self._final_poll(reader)

    async def _final_poll(self, reader: asyncio.StreamReader) -> bytes:
        """Return what arrived while this program was busy. Raises TimeoutError if nothing did."""
        for _ in range(_FINAL_POLLS):
            if data := await self._poll(reader):
                return data
        raise TimeoutError

    async def _poll(self, reader: asyncio.StreamReader) -> bytes:
        await asyncio.sleep(0)  # lets the event loop poll the socket
        try:
            async with timeout(0):
                return self._check_open(await reader.read(_CHUNK))
        except TimeoutError:
            return b""

    def _check_open(self, data: bytes) -> bytes:
        if not data:
            raise ConnectionLostError(self.host, self.port)
        return data

    async def _reconnect(self, request: Reconnect) -> None:
        await self.close()
        await asyncio.sleep(request.after_s)
        deadline = time.monotonic() + request.within_s
        while True:
            try:
                return await self._open()
            except RobotUnreachableError:
                if time.monotonic() + _RETRY_S > deadline:
                    raise
            await asyncio.sleep(_RETRY_S)


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

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; may be called more than once."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def shut_down(self) -> None:
        """Shut the connection down, from any thread; a thread waiting for bytes gets ConnectionLostError."""
        if (connected := self._socket) is not None:
            with suppress(OSError):  # already closed
                connected.shutdown(socket.SHUT_RDWR)

    def send_now(self, data: bytes) -> None:
        """Send a few bytes from any thread; a lost connection is reported by the next read."""
        if data and (connected := self._socket) is not None:
            with suppress(OSError):
                connected.send(data)

    def run(self, flow: Flow[Result], timeout_s: float | None = None) -> Result:
        """Run a flow to its end, within ``timeout_s`` [s], by default the connection's timeout."""
        try:
            progress = _Progress(flow, self.timeout_s if timeout_s is None else timeout_s, self.silence_s)
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
        """Yield bytes as they arrive. Raises NoAnswerError if nothing arrives for ``silence_s`` [s]."""
        if self._socket is None:
            raise ConnectionLostError(self.host, self.port)
        receive = self._socket.recv
        # the operating system's timeout: with Python's, every read would need an additional poll
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _time_value(silence_s))
        while True:
            try:
                data = receive(_CHUNK)
            except BlockingIOError as error:
                raise NoAnswerError(self.host, self.port, silence_s) from error
            except OSError as error:
                raise ConnectionLostError(self.host, self.port) from error
            yield self._check_open(data)

    def _check_open(self, data: bytes) -> bytes:
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
        if isinstance(progress.pending, Reconnect):
            self._reconnect(progress.pending)
            return b""
        if progress.over:
            return b""
        try:
            return self._exchange(progress.pending, progress.left_s)
        except TimeoutError as error:
            raise NoAnswerError(self.host, self.port, progress.waited_s) from error
        except OSError as error:
            raise ConnectionLostError(self.host, self.port) from error

    def _exchange(self, pending: Step, left_s: float) -> bytes:
        if self._socket is None:
            raise ConnectionLostError(self.host, self.port)
        self._socket.settimeout(0.0 if pending is POLL else left_s)
        if isinstance(pending, bytes):
            self._socket.sendall(pending)
            return b""
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:  # POLL, and nothing has arrived
            return b""
        return self._check_open(data)

    def _reconnect(self, request: Reconnect) -> None:
        self.close()
        time.sleep(request.after_s)
        deadline = time.monotonic() + request.within_s
        while True:
            try:
                return self._open()
            except RobotUnreachableError:
                if time.monotonic() + _RETRY_S > deadline:
                    raise
            time.sleep(_RETRY_S)


class FlowMethod(Generic[Params, Result]):
    """A decorator: a method that returns a flow becomes one that runs it, as its class does: awaited, or blocking."""

    def __init__(self, method: Callable[Concatenate[Any, Params], Flow[Result]]) -> None:
        self._method = checked_call(method)
        self.__doc__ = method.__doc__

    @overload
    def __get__(self, connection: None, kind: type) -> Self: ...
    @overload
    def __get__(self, connection: AsyncConnection, kind: type) -> Callable[Params, Coroutine[Any, Any, Result]]: ...
    @overload
    def __get__(self, connection: BlockingConnection, kind: type) -> Callable[Params, Result]: ...
    def __get__(self, connection: AsyncConnection | BlockingConnection | None, kind: type) -> Any:
        if connection is None:
            return self
        run, method = connection.run, self._method
        return lambda *args, **kwargs: run(method(connection, *args, **kwargs))


def _time_value(seconds: float) -> bytes:
    """Pack a C timeval; at least 1 µs, because 0 would mean forever."""
    micros = max(1, round(seconds * 1e6))
    return struct.pack("@ll", *divmod(micros, 1_000_000))


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return getattr(error, "strerror", None) or str(error)
