"""What Python 3.10's asyncio lacks, or does otherwise than every later one.

There, `asyncio.wait_for` raises an error of asyncio's own, which no ``except TimeoutError`` catches: use `timeout`.
"""

import asyncio
import sys

if sys.version_info >= (3, 11):
    from asyncio import timeout
else:
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


__all__ = ["pause_reading", "timeout"]


def pause_reading(transport: asyncio.Transport) -> None:
    """As the transport's own, which in 3.10 does nothing while the connection is being made."""
    transport.pause_reading()
    if sys.version_info < (3, 11):
        asyncio.get_running_loop().call_soon(_pause_again, transport)


def _pause_again(transport: asyncio.Transport) -> None:
    if not transport.is_closing() and not transport.is_reading():
        transport.resume_reading()
        transport.pause_reading()
