"""What nobody tells by itself: asked for again and again, as long as a page shows it."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final, Generic, TypeVar

from client.errors import ClientError
from urproto.errors import ProtocolError, RobotRefused

__all__ = ["Asked"]

Answer = TypeVar("Answer")

_UNSEEN: Final = 2  # answers; a page in view may have had no frame since the last one
_MISTAKES: Final = (ClientError, ProtocolError, RobotRefused, OSError)


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
        except _MISTAKES as error:
            trouble = str(error)
        if (answer, trouble) == (self._answer, self.trouble):
            return False
        self._answer, self.trouble = answer, trouble
        return True
