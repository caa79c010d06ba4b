"""Tracks open pages, polls values that are not sent unasked while a page shows them, and reopens lost connections."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final, Generic, NoReturn, TypeVar

from client.modbus import GENERAL_REGISTERS, ModbusClient
from urproto.compat_asyncio import timeout
from urproto.errors import URError

_RETRY_PERIOD_S: Final = 0.5  # between attempts to reach a robot
_LOST: Final = (URError, OSError)
_MAX_UNREAD: Final = 2  # answers; a visible page may not have had a frame since the last one
_REGISTER_PERIOD_S: Final = 0.2
_TIMEOUT_S: Final = 2.0
_REGISTERS_PER_REQUEST: Final = 64  # a request can have 125 at most
_NO_REQUEST: Final = object()


async def follow_forever(follow: Callable[[], Awaitable[object]], on_lost: Callable[[str], object]) -> NoReturn:
    """Follow a connection; when it is lost, report why and try again after a while. Runs forever."""
    while True:
        try:
            await follow()
        except _LOST as error:
            on_lost(str(error))
        await asyncio.sleep(_RETRY_PERIOD_S)


Answer = TypeVar("Answer")


class Poller(Generic[Answer]):
    """Polls for the newest answer to a question. Reading ``value`` keeps it up to date.

    on_change: called when the answer changes. release: called when ``value`` is no longer read, to free resources.
    problem: why there is no answer, "" when there is one.
    """

    def __init__(
        self,
        query: Callable[[], Awaitable[Answer]],
        period_s: float,
        on_change: Callable[[], object],
        release: Callable[[], Awaitable[object]] | None = None,
    ) -> None:
        self._query = query
        self._period_s = period_s
        self._on_change = on_change
        self._release = release
        self._answer: Answer | None = None
        self._polling: asyncio.Task[None] | None = None
        self._refresh_requested = asyncio.Event()
        self._was_read = False
        self.problem = ""

    @property
    def value(self) -> Answer | None:
        """The newest answer, None if there is none."""
        self._was_read = True
        if self._polling is None:
            self._polling = asyncio.get_running_loop().create_task(self._poll())
        return self._answer

    @property
    def last(self) -> Answer | None:
        """Like value, but reading it does not count."""
        return self._answer

    def refresh(self) -> None:
        """Query again immediately, because something has changed."""
        self._refresh_requested.set()

    def invalidate(self) -> None:
        """Discard the answer, which is no longer valid, and query again immediately."""
        self._answer = None
        self.refresh()

    async def close(self) -> None:
        polling, self._polling = self._polling, None
        if polling is not None:
            polling.cancel()
            await asyncio.gather(polling, return_exceptions=True)

    async def _poll(self) -> None:
        """Poll until ``value`` has not been read for some answers."""
        unread = 0
        try:
            while unread < _MAX_UNREAD:
                self._was_read = False
                self._refresh_requested.clear()
                if await self._poll_once():
                    self._on_change()
                await self._wait()
                unread = 0 if self._was_read else unread + 1
            self._polling = None
        finally:
            if self._release is not None:
                await self._release()

    async def _wait(self) -> None:
        try:
            async with timeout(self._period_s):
                await self._refresh_requested.wait()
        except TimeoutError:
            return

    async def _poll_once(self) -> bool:
        """Query once; returns whether the answer has changed. An equal answer stays the same object."""
        answer: Answer | None = None
        problem = ""
        try:
            answer = await self._query()
        except _LOST as error:
            problem = str(error)
        if (answer, problem) == (self._answer, self.problem):
            return False
        self._answer, self.problem = answer, problem
        return True


class GeneralRegisters:
    """The general purpose registers of the robot's Modbus server, polled while a page shows them."""

    def __init__(self, host: str, port: int, on_change: Callable[[], object]) -> None:
        self.host = host
        self.port = port
        self._client: ModbusClient | None = None
        self._poller = Poller(self._read, _REGISTER_PERIOD_S, on_change, self._disconnect)

    @property
    def words(self) -> tuple[int, ...]:
        """The 128 registers, none while they are unknown. Reading this property keeps them up to date."""
        return self._poller.value or ()

    @property
    def problem(self) -> str:
        return self._poller.problem

    async def write(self, address: int, word: int) -> None:
        """Set a register. Raises RobotRefused, ClientError."""
        async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
            await client.write_register(address, word)
        self._poller.refresh()

    async def close(self) -> None:
        await self._poller.close()

    async def _read(self) -> tuple[int, ...]:
        if self._client is None:
            self._client = await ModbusClient(self.host, self.port, _TIMEOUT_S).__aenter__()
        try:
            words = list[int]()
            for first in GENERAL_REGISTERS[::_REGISTERS_PER_REQUEST]:
                words += await self._client.read_registers(first, _REGISTERS_PER_REQUEST)
        except _LOST:
            await self._disconnect()
            raise
        return tuple(words)

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await client.__aexit__(None, None, None)


Request = TypeVar("Request")


class LatestRequest(Generic[Request]):
    """Carries out one request at a time; a request that is superseded before its turn is dropped.

    on_error: called with the error of a request that failed.
    """

    def __init__(self, execute: Callable[[Request], Awaitable[object]], on_error: Callable[[str], object]) -> None:
        self._execute = execute
        self._on_error = on_error
        self._request: Request | object = _NO_REQUEST
        self._task: asyncio.Task[None] | None = None

    def submit(self, request: Request) -> None:
        """Carry out this request next."""
        self._request = request
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def finish(self) -> None:
        """Wait until all requests are done."""
        if self._task is not None:
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        try:
            while self._request is not _NO_REQUEST:
                request, self._request = self._request, _NO_REQUEST
                try:
                    await self._execute(request)  # type: ignore[arg-type]
                except URError as error:
                    self._on_error(str(error))
        finally:
            self._task = None


class Audience:
    """The pages that browsers have open."""

    def __init__(self) -> None:
        self._pages: set[str] = set()
        self._page_opened = asyncio.Event()

    def join(self, page_id: str) -> None:
        self._pages.add(page_id)
        self._page_opened.set()

    def leave(self, page_id: str) -> None:
        self._pages.discard(page_id)
        if not self._pages:
            self._page_opened.clear()

    async def sleep(self, watched_s: float, unwatched_s: float) -> None:
        """Wait for ``watched_s`` if a page is open, else for ``unwatched_s`` or until a page opens."""
        if self._pages:
            await asyncio.sleep(watched_s)
            return
        with suppress(TimeoutError):
            async with timeout(unwatched_s):
                await self._page_opened.wait()
