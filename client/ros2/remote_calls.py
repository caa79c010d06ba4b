"""Calls from the process of the nodes to that of the control loop, and messages in the other direction.

A call is a module-level function, or a method of a class, with arguments: a pickle, which the control loop executes
between two cycles. `Reference`s among the arguments stand for objects of that process. Pickles would let a peer execute
anything, so this is for a private socket between a process and the one that it has started.

This module and those that it imports are free of rclpy.
"""

import asyncio
import concurrent.futures
import copyreg
import inspect
import io
import logging
import pickle
import socket
import struct
import threading
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass
from itertools import count
from typing import Any, Final

from client.errors import Ros2Error
from urproto.errors import URError

_HEADER: Final = struct.Struct("!QI")  # number of the call, 0 for messages; length of the pickle, 0 to cancel the call
_MESSAGES: Final = 0
_MAX_UNSENT: Final = 2**16  # bytes of a peer that does not read: beyond them, newer messages replace older ones; guess
_RETRY_S: Final = 0.01  # until which they are tried again; guess
_LOST: Final = "the process of the control loop has ended: start the driver again"

Resolve = Callable[[Hashable], Any]

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reference:
    """Stands for an object of the control loop's process among the arguments of a call."""

    key: Hashable


class _Pickler(pickle.Pickler):
    """With references; errors need not be able to repeat the call of their constructor."""

    def persistent_id(self, obj: Any) -> Hashable | None:
        return obj.key if isinstance(obj, Reference) else None

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, BaseException):
            return copyreg.__newobj__, (type(obj), *obj.args), obj.__dict__ or None  # type: ignore[attr-defined]
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, resolve: Resolve) -> None:
        super().__init__(io.BytesIO(data))
        self.persistent_load = resolve  # type: ignore[method-assign]


def _frame(number: int, content: object) -> bytes:
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(content)
    return _with_header(number, file.getvalue())


def _with_header(number: int, data: bytes) -> bytes:
    return _HEADER.pack(number, len(data)) + data


# the nodes' side


class Caller:
    """Calls functions in the other process, from any thread; a thread receives answers and messages.

    on_messages: called in that thread with all messages that arrive together, by key; must not raise or wait for calls.
    on_end: called in that thread when the other process has closed the connection, before calls fail.
    """

    def __init__(
        self, link: socket.socket, on_messages: Callable[[dict[Hashable, Any]], object], on_end: Callable[[], object]
    ) -> None:
        self._link = link
        self._on_messages = on_messages
        self._on_end = on_end
        self._numbers = count(1)
        self._lock = threading.Lock()
        self._pending: dict[int, concurrent.futures.Future[Any]] = {}
        self._ended = False
        self._thread = threading.Thread(target=self._receive, name="control loop", daemon=True)
        self._thread.start()

    def call(self, function: Callable[..., Any], *args: Any, **kwargs: Any) -> "concurrent.futures.Future[Any]":
        """Begin a call; cancelling the future cancels the call. The future may raise Ros2Error if the process ends."""
        future: concurrent.futures.Future[Any] = concurrent.futures.Future()
        number = next(self._numbers)
        frame = _frame(number, (function, args, kwargs))
        with self._lock:
            if self._ended:
                raise Ros2Error(_LOST)
            self._pending[number] = future
        future.add_done_callback(lambda _: self._on_done(number, future))
        self._send(frame)
        return future

    def _on_done(self, number: int, future: "concurrent.futures.Future[Any]") -> None:
        if future.cancelled() and self._pending.pop(number, None) is not None:
            self._send(_HEADER.pack(number, 0))

    def _send(self, frame: bytes) -> None:
        with self._lock:
            try:
                self._link.sendall(frame)
            except OSError:  # the thread that receives notices it too
                return

    def end(self) -> None:
        """Let the other process end; it still answers what it has begun."""
        try:
            self._link.shutdown(socket.SHUT_WR)
        except OSError:  # it has ended already
            return

    def close(self) -> None:
        self._thread.join()
        self._link.close()

    def _receive(self) -> None:
        with self._link.makefile("rb") as stream:
            try:
                while header := stream.read(_HEADER.size):
                    number, length = _HEADER.unpack(header)
                    self._take(number, pickle.loads(stream.read(length)))
            except (OSError, EOFError, struct.error, pickle.UnpicklingError):  # it was killed
                pass
        with self._lock:
            self._ended = True
            pending = list(self._pending)
        self._on_end()
        for number in pending:
            self._take(number, (False, Ros2Error(_LOST)))

    def _take(self, number: int, content: Any) -> None:
        if number == _MESSAGES:
            self._on_messages(content)
            return
        future = self._pending.pop(number, None)
        if future is None or not future.set_running_or_notify_cancel():
            return
        succeeded, value = content
        future.set_result(value) if succeeded else future.set_exception(value)


# the control loop's side


class Callee:
    """Executes calls in the event loop, until the peer closes the connection. resolve: finds objects of references.

    It never waits for the peer. A peer that does not read gets the newest message of each key once it reads again.
    """

    def __init__(self, resolve: Resolve) -> None:
        self._resolve = resolve
        self._running: dict[int, asyncio.Task[None]] = {}
        self._messages: dict[Hashable, Callable[[], Any]] = {}
        self._scheduled = False
        self._writer: asyncio.StreamWriter | None = None

    def publish(self, key: Hashable, message: Callable[[], Any]) -> None:
        """Send a message after this cycle. message: called then, if no newer one with this key has replaced it."""
        self._messages[key] = message
        self._schedule(0.0)

    def withdraw(self, key: Hashable) -> None:
        """Do not send a message that has not been sent yet."""
        self._messages.pop(key, None)

    async def serve(self, link: socket.socket) -> None:
        """Execute calls until the peer closes the connection; calls that are not finished then are cancelled."""
        reader, self._writer = await asyncio.open_connection(sock=link)
        try:
            while True:
                number, length = _HEADER.unpack(await reader.readexactly(_HEADER.size))
                if not length:
                    if (task := self._running.get(number)) is not None:
                        task.cancel()
                    continue
                self._execute(number, await reader.readexactly(length))
        except (asyncio.IncompleteReadError, OSError):
            return
        finally:
            for task in self._running.values():
                task.cancel()
            await asyncio.gather(*self._running.values(), return_exceptions=True)
            self._writer.close()
            self._writer = None

    def _execute(self, number: int, data: bytes) -> None:
        """Call the function now: a task would delay a setpoint by one more iteration of the loop."""
        try:
            function, args, kwargs = _Unpickler(data, self._resolve).load()
            result = function(*args, **kwargs)
        except Exception as error:
            self._answer(number, False, error)
        else:
            if inspect.isawaitable(result):
                task = asyncio.get_running_loop().create_task(self._finish(number, result))
                self._running[number] = task
                task.add_done_callback(lambda _: self._running.pop(number))
            else:
                self._answer(number, True, result)

    async def _finish(self, number: int, work: Awaitable[Any]) -> None:
        try:
            result = await work
        except Exception as error:
            self._answer(number, False, error)
        else:
            self._answer(number, True, result)

    def _answer(self, number: int, succeeded: bool, value: Any) -> None:
        if not succeeded and not isinstance(value, URError):
            _logger.error("a call from a node failed", exc_info=value)
        self._send_messages()  # first, so that no message of a goal comes after its end
        if self._writer is None:
            return
        try:
            frame = _frame(number, (succeeded, value))
        except Exception as error:  # a mistake in a function must not end the control loop
            frame = _frame(number, (False, TypeError(f"the answer cannot be sent: {error!r}")))
        self._writer.write(frame)

    def _schedule(self, delay_s: float) -> None:
        if not self._scheduled and self._writer is not None:
            self._scheduled = True
            loop = asyncio.get_running_loop()
            loop.call_later(delay_s, self._send_due) if delay_s else loop.call_soon(self._send_due)

    def _send_due(self) -> None:
        self._scheduled = False
        self._send_messages()

    def _send_messages(self) -> None:
        if not self._messages or self._writer is None:
            return
        if self._writer.transport.get_write_buffer_size() > _MAX_UNSENT:
            self._schedule(_RETRY_S)
            return
        due, self._messages = self._messages, {}
        data = pickle.dumps({key: message() for key, message in due.items()}, pickle.HIGHEST_PROTOCOL)
        self._writer.write(_with_header(_MESSAGES, data))
