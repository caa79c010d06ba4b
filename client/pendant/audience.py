"""Tracks open pages: while no browser has one open, the pendant requests less from the robot."""

import asyncio
from contextlib import suppress

from urproto.compat_asyncio import timeout


class Audience:
    """The pages that browsers have open."""

    def __init__(self) -> None:
        self._pages: set[str] = set()
        self._page_opened = asyncio.Event()

    def join(self, page_id: str) -> None:
        """A page was opened."""
        self._pages.add(page_id)
        self._page_opened.set()

    def leave(self, page_id: str) -> None:
        """A page was closed."""
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
