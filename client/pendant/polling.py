"""Polls values that are not sent unasked while a page shows them, and reopens lost connections."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final, Generic, NoReturn, TypeVar

from client.errors import ClientError
from client.modbus import GENERAL_REGISTERS, ModbusClient
from urproto.compat_asyncio import timeout
from urproto.errors import URError

_AGAIN_S: Final = 0.5  # between attempts to reach a robot
_LOST: Final = (URError, OSError)


async def keep_following(follow: Callable[[], Awaitable[object]], lose: Callable[[str], object]) -> NoReturn:
    """Follow a connection; when it is lost, tell why, and try again after a while. For ever."""
    while True:
        try:
            await follow()
        except _LOST as error:
            lose(str(error))
        await asyncio.sleep(_AGAIN_S)


Answer = TypeVar("Answer")

_UNSEEN: Final = 2  # answers; a page in view may have had no frame since the last one


class Poller(Generic[Answer]):
    """Polls for the newest answer to a question. Reading ``value`` keeps it up to date.

    tell: called when the answer changes. rest: called when ``value`` is not read any more, to release resources.
    problem: why there is no answer, "" when there is one.
    """

    def __init__(
        self,
        ask: Callable[[], Awaitable[Answer]],
        every_s: float,
        tell: Callable[[], object],
        rest: Callable[[], Awaitable[object]] | None = None,
    ) -> None:
        self._ask = ask
        self._every_s = every_s
        self._tell = tell
        self._rest = rest
        self._answer: Answer | None = None
        self._asking: asyncio.Task[None] | None = None
        self._again = asyncio.Event()
        self._looked = False
        self.problem = ""

    @property
    def value(self) -> Answer | None:
        """None before the first answer, and while there is none."""
        self._looked = True
        if self._asking is None:
            self._asking = asyncio.get_running_loop().create_task(self._keep_asking())
        return self._answer

    @property
    def last(self) -> Answer | None:
        """As value, without a look."""
        return self._answer

    def refresh(self) -> None:
        """Ask at once: something has been changed."""
        self._again.set()

    def renew(self) -> None:
        """Forget the answer, which is no longer true, and ask at once."""
        self._answer = None
        self.refresh()

    async def close(self) -> None:
        """Ask no more."""
        asking, self._asking = self._asking, None
        if asking is not None:
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)

    async def _keep_asking(self) -> None:
        """Ends when nobody has looked since the last answer but one."""
        unseen = 0
        try:
            while unseen < _UNSEEN:
                self._looked = False
                self._again.clear()
                if await self._ask_once():
                    self._tell()
                await self._wait()
                unseen = 0 if self._looked else unseen + 1
            self._asking = None
        finally:
            if self._rest is not None:
                await self._rest()

    async def _wait(self) -> None:
        try:
            async with timeout(self._every_s):
                await self._again.wait()
        except TimeoutError:
            return

    async def _ask_once(self) -> bool:
        """True when the answer is another one; else it stays the same object, which is quick to compare."""
        answer: Answer | None = None
        problem = ""
        try:
            answer = await self._ask()
        except _LOST as error:
            problem = str(error)
        if (answer, problem) == (self._answer, self.problem):
            return False
        self._answer, self.problem = answer, problem
        return True


_EVERY_S: Final = 0.2
_TIMEOUT_S: Final = 2.0
_AT_ONCE: Final = 64  # a request takes 125 at most


class PortRegisters:
    """The general purpose registers of the robot's Modbus server, polled while a page shows them."""

    def __init__(self, host: str, port: int, tell: Callable[[], object]) -> None:
        self.host = host
        self.port = port
        self._client: ModbusClient | None = None
        self._poller = Poller(self._read, _EVERY_S, tell, self._disconnect)

    @property
    def words(self) -> tuple[int, ...]:
        """128 of them, none while they are not known. Looking at them is what keeps them new."""
        return self._poller.value or ()

    @property
    def problem(self) -> str:
        """Why they are not known."""
        return self._poller.problem

    async def write(self, address: int, word: int) -> None:
        """Set a register. Raises RobotRefused, ClientError."""
        async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
            await client.write_register(address, word)
        self._poller.refresh()

    async def close(self) -> None:
        """End the connection."""
        await self._poller.close()

    async def _read(self) -> tuple[int, ...]:
        if self._client is None:
            self._client = await ModbusClient(self.host, self.port, _TIMEOUT_S).__aenter__()
        try:
            words = list[int]()
            for first in GENERAL_REGISTERS[::_AT_ONCE]:
                words += await self._client.read_registers(first, _AT_ONCE)
        except _LOST:
            await self._disconnect()
            raise
        return tuple(words)

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await client.__aexit__(None, None, None)


Wish = TypeVar("Wish")

_NOTHING: Final = object()


class Newest(Generic[Wish]):
    """Carries out one request at a time; a request that is superseded before its turn is dropped.

    complain: called with the error of a request that failed.
    """

    def __init__(self, do: Callable[[Wish], Awaitable[object]], complain: Callable[[str], object]) -> None:
        self._do = do
        self._complain = complain
        self._wish: Wish | object = _NOTHING
        self._doing: asyncio.Task[None] | None = None

    def want(self, wish: Wish) -> None:
        """Do this next."""
        self._wish = wish
        if self._doing is None:
            self._doing = asyncio.get_running_loop().create_task(self._work())

    async def done(self) -> None:
        """Nothing is left to do."""
        if self._doing is not None:
            await asyncio.gather(self._doing, return_exceptions=True)

    async def _work(self) -> None:
        try:
            while self._wish is not _NOTHING:
                wish, self._wish = self._wish, _NOTHING
                try:
                    await self._do(wish)  # type: ignore[arg-type]
                except ClientError as error:
                    self._complain(str(error))
        finally:
            self._doing = None
