"""What Python 3.10's asyncio lacks, or does otherwise than every later one.

There, `asyncio.wait_for` raises an error of asyncio's own, which no ``except TimeoutError`` catches: use `timeout`.
"""

import sys

if sys.version_info >= (3, 11):
    from asyncio import timeout
else:
    import asyncio
    from collections.abc import AsyncIterator
    from contextlib import asynccontextmanager

    import async_timeout

    @asynccontextmanager
    async def timeout(delay: float | None) -> AsyncIterator[None]:
        """As asyncio's own: raises TimeoutError when what it holds takes longer than that [s]. None: never."""
        try:
            async with async_timeout.timeout(delay):
                yield
        except asyncio.TimeoutError as error:
            raise TimeoutError from error


__all__ = ["timeout"]
