"""What nobody tells by itself: asked for again and again, as long as a page shows it."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final, Generic, TypeVar

from client.errors import ClientError
from client.modbus import GENERAL_REGISTERS, ModbusClient
from urproto.errors import URError

_EVERY_S: Final = 0.2
_AGAIN_S: Final = 1.0
_TIMEOUT_S: Final = 2.0
_AT_ONCE: Final = 64  # a request takes 125 at most


class PortRegisters:
    """words: 128 of them, none while they are not known. trouble: why not."""

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self.words: tuple[int, ...] = ()
        self.trouble = ""
        self._lookers = 0
        self._task: asyncio.Task[None] | None = None

    def look(self) -> None:
        """Begin to look, until ``leave``."""
        self._lookers += 1
        if self._task is None:
            self._task = asyncio.create_task(self._follow())

    def leave(self) -> None:
        """Look no more; the last one to leave ends the connection."""
        self._lookers -= 1
        if not self._lookers and self._task is not None:
            self._task.cancel()
            self._task = None
            self.words = ()

    async def write(self, address: int, word: int) -> None:
        """Set a register. Raises RobotRefused, ClientError."""
        async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
            await client.write_register(address, word)

    async def close(self) -> None:
        """End the connection."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    async def _follow(self) -> None:
        while True:
            try:
                async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
                    while True:
                        words = list[int]()
                        for first in GENERAL_REGISTERS[::_AT_ONCE]:
                            words += await client.read_registers(first, _AT_ONCE)
                        self.words, self.trouble = tuple(words), ""
                        await asyncio.sleep(_EVERY_S)
            except (URError, OSError) as error:
                self.words, self.trouble = (), str(error)
            await asyncio.sleep(_AGAIN_S)


Wish = TypeVar("Wish")

_NOTHING: Final = object()


class Newest(Generic[Wish]):
    """One wish at a time; those that were overtaken meanwhile are never carried out.

    complain: told what went wrong.
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


Answer = TypeVar("Answer")

_UNSEEN: Final = 2  # answers; a page in view may have had no frame since the last one


class Asked(Generic[Answer]):
    """The newest answer to a question. Looking at ``value`` is what keeps it new.

    tell: called when an answer is another one. trouble: why there is none, "" when there is one.
    """

    def __init__(self, ask: Callable[[], Awaitable[Answer]], every_s: float, tell: Callable[[], object]) -> None:
        self._ask = ask
        self._every_s = every_s
        self._tell = tell
        self._answer: Answer | None = None
        self._asking: asyncio.Task[None] | None = None
        self._again = asyncio.Event()
        self._looked = False
        self.trouble = ""

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
        while unseen < 2:
            self._looked = False
            self._again.clear()
            if await self._ask_once():
                self._tell()
            await self._wait()
            unseen = 0 if self._looked else unseen + 1
        self._asking = None

    async def _wait(self) -> None:
        try:
            async with asyncio.timeout(self._every_s):
                await self._again.wait()
        except TimeoutError:
            return

    async def _ask_once(self) -> bool:
        """True when the answer is another one; else it stays the same object, which is quick to compare."""
        answer: Answer | None = None
        trouble = ""
        try:
            answer = await self._ask()
        except (URError, OSError) as error:
            trouble = str(error)
        if (answer, trouble) == (self._answer, self.trouble):
            return False
        self._answer, self.trouble = answer, trouble
        return True
