"""Server of a running controller manager for other processes: the socket, and access control.

`client.controllers.session` lists the requests.
"""

import asyncio
import hmac
import json
import logging
import os
import secrets
import sys
from collections.abc import Iterator, Mapping
from contextlib import AsyncExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Final, TextIO

from client.controllers import protocol
from client.controllers.running import RunningManager
from client.controllers.session import Session
from client.errors import ManagerError
from urproto.addresses import BackdoorMark
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.text import quoted

_HELLO_S: Final = 5.0  # guess: for the first line of a connection
_DRAIN_S: Final = 5.0  # guess: how long an answer may wait to be read
_MAX_CONNECTIONS: Final = 32
_PAUSE_S: Final = 0.001  # after each request, so that a busy client leaves time for the control loop

_logger = logging.getLogger(__name__)


@contextmanager
def claim(robot_ip: str, rtde_port: int) -> Iterator[Path]:
    """Become the only manager of a robot on this machine; yields the path of its socket.

    Raises ManagerError and FileError.
    """
    place = protocol.rendezvous_path(robot_ip, rtde_port)
    path = place.with_name(f"{place.name}.lock")
    with _lock(path) as lock:
        if lock is None:
            process = path.read_text().strip() or "?"
            raise ManagerError(
                f"a controller manager for {robot_ip} is already running (process {process}): use it from other "
                "shells with `ur-client controllers`, or end it first"
            )
        lock.write(str(os.getpid()))
        lock.flush()
        try:
            yield place
        finally:
            path.unlink(missing_ok=True)


@contextmanager
def _lock(path: Path) -> Iterator[TextIO | None]:
    """Lock a file and truncate it; None if another process has locked it. The lock ends with the process."""
    while True:
        with path.open("a+") as file:
            if not _locked(file.fileno()):
                yield None
                return
            with suppress(FileNotFoundError):
                if path.stat().st_ino == os.fstat(file.fileno()).st_ino:  # otherwise it was removed meanwhile
                    file.truncate(0)
                    yield file
                    return


def _locked(descriptor: int) -> bool:
    """Whether this process got the lock; always True on systems without such locks."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


class ManagerServer:
    """Answers processes of this user for the duration of the context. place: the path from `claim`."""

    def __init__(self, running: RunningManager, place: Path) -> None:
        self._running = running
        self._base_path = place
        self._token = ""
        self._clients: set[asyncio.Task[None]] = set()
        self._opened = AsyncExitStack()

    async def __aenter__(self) -> Self:
        async with AsyncExitStack() as opening:
            server = await (self._listen_on_socket if protocol.HAS_UNIX_SOCKETS else self._listen_on_loopback)(opening)
            opening.push_async_callback(self._close, server)
            self._opened = opening.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._opened.aclose()

    async def _listen_on_socket(self, opening: AsyncExitStack) -> asyncio.Server:
        path = self._base_path.with_name(f"{self._base_path.name}.sock")
        if sys.platform == "win32":
            raise NotImplementedError
        path.unlink(missing_ok=True)  # left by a manager that was killed; a live one would hold the lock
        server = await asyncio.start_unix_server(self._accept, str(path), limit=protocol.MAX_REQUEST)
        opening.callback(path.unlink, missing_ok=True)
        path.chmod(0o600)
        return server

    async def _listen_on_loopback(self, opening: AsyncExitStack) -> asyncio.Server:
        server = await asyncio.start_server(self._accept, "127.0.0.1", 0, limit=protocol.MAX_REQUEST)
        port = server.sockets[0].getsockname()[1]
        opening.callback(BackdoorMark("127.0.0.1", port).close)
        self._token = secrets.token_hex(16)
        path = self._base_path.with_name(f"{self._base_path.name}.json")
        path.unlink(missing_ok=True)
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            json.dump({"port": port, "token": self._token}, file)
        opening.callback(path.unlink, missing_ok=True)
        return server

    async def _close(self, server: asyncio.Server) -> None:
        server.close()
        for client in self._clients:
            client.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._clients.add(task)
        task.add_done_callback(self._clients.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        session = Session(self._running)
        try:
            await self._handshake(reader, writer)
            while line := await _line(reader):
                await _send(writer, await _answer(session, line))
                await asyncio.sleep(_PAUSE_S)
        except ManagerError as error:
            with suppress(OSError, TimeoutError):
                await _send(writer, {"error": protocol.described_error(error)})
        except (OSError, TimeoutError):  # the client has disconnected, or does not read
            pass
        except Exception:
            _logger.exception("a client of the controller manager was disconnected")
        finally:
            writer.transport.abort() if writer.transport.get_write_buffer_size() else writer.close()
            await session.close()

    async def _handshake(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Exchange greetings. Raises ManagerError for a client that is not permitted."""
        if len(self._clients) > _MAX_CONNECTIONS:
            raise ManagerError(f"{_MAX_CONNECTIONS} programs are already connected to this manager: end some")
        async with timeout(_HELLO_S):
            hello = protocol.decoded(await _line(reader))
        token = hello.get("token")
        if self._token and not (isinstance(token, str) and hmac.compare_digest(token.encode(), self._token.encode())):
            raise ManagerError("the token does not match this controller manager")
        if hello.get("protocol") != protocol.VERSION:
            raise ManagerError(
                f"this controller manager speaks protocol {protocol.VERSION}, not {quoted(hello.get('protocol'))}: use "
                "the same version of ur-client on both sides"
            )
        robot = self._running.control.driver.config.host
        await _send(writer, {"protocol": protocol.VERSION, "robot": robot, "pid": os.getpid()})


async def _line(reader: asyncio.StreamReader) -> bytes:
    """The next line, empty at the end. Raises ManagerError for a line that is too long."""
    try:
        return await reader.readline()
    except ValueError:
        raise ManagerError(f"a message may have {protocol.MAX_REQUEST} bytes at most") from None


async def _send(writer: asyncio.StreamWriter, message: Mapping[str, Any]) -> None:
    """Send a message. Raises OSError, and TimeoutError if it is not read."""
    writer.write(protocol.encoded(message))
    async with timeout(_DRAIN_S):
        await writer.drain()


async def _answer(session: Session, line: bytes) -> protocol.Message:
    """Carry out a request. Raises ManagerError if it is not a request, since later data would be unreliable too."""
    message = protocol.decoded(line)
    number, do = message.pop("id", None), message.pop("do", None)
    if isinstance(number, bool) or not isinstance(number, int) or not isinstance(do, str):
        raise ManagerError("a request must have an id (a whole number) and a field do (a string)")
    try:
        return {"id": number, "result": await session.request(do, **message)}
    except URError as error:
        return {"id": number, "error": protocol.described_error(error)}
    except Exception as error:  # a request must not end the control loop, nor the connection
        _logger.exception("the request %s failed", do)
        return {"id": number, "error": {"text": f"{do} failed: {error!r}; see the log of the controller manager"}}
