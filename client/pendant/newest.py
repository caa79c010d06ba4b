"""Carries out the newest of many wishes: of what somebody drags, the place it is at now."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final, Generic, TypeVar

from client.errors import ClientError

__all__ = ["Newest"]

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
